"""How a model is fitted: options of a fit, a diagnosis and their refits, and parts that stay nominal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from bayescal.effects import ALWAYS, MODELS, Parameter, Site, parameters_of
from bayescal.effects.location import ARM as ARM_SITE
from bayescal.effects.location import NUMBERED
from bayescal.effects.selection import Selection, plain
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene

OPTION = "--without"


@dataclass(frozen=True)
class Part:
    """Parameters of one effect at one site; a joint includes the link that it moves.

    'geometry at joint 4' is theta4 and d4, and a4, alpha4 (and beta4) of the link that joint 4 moves, in
    Craig's subscripts. This is a row of a standard DH table; in a modified table a4 and alpha4 are in the
    next row. 'geometry at link 4' is only the link.
    """

    effect: str
    site: Site
    name: str = ""  # of a single parameter

    @classmethod
    def of(cls, words: str, parameters: Sequence[Parameter] = ()) -> Part:
        """Read ``geometry at joint 4``, or the name of one of `parameters`: ``base-compliance y``."""
        for p in parameters:
            if p.name == words.strip():
                return cls(p.effect, p.site, p.name)
        asked = Selection.read(words).unscaled
        if len(asked.sites) != 1 or asked != Selection(asked.effect, sites=asked.sites):
            what = f"`{words.strip()}` is not an effect at a site, and no parameter of the model"
            raise BayescalError(what, OPTION, "write, for example, 'geometry at joint 4' or 'compliance J3'")
        return cls(asked.effect, asked.sites[0])

    def __str__(self) -> str:
        return self.name or f"{self.effect} at {self.site}"

    def holds(self, p: Parameter) -> bool:
        """Whether a parameter belongs to the part."""
        if self.name:
            return p.name == self.name
        return p.effect == self.effect and Selection(self.effect, sites=(self.site,)).holds(p)


def parts_of(
    words: Sequence[str], effects: Sequence[str], parameters: Sequence[Parameter] | None = None
) -> tuple[Part, ...]:
    """Read the parts that a model omits, each part once.

    `parameters` are those of the model, which may be named. Without them, as for parts that a run has
    recorded, any text without a site is such a name.

    Raises
    ------
    BayescalError
        For a text that is no parameter and not an effect at a site, or for an effect that the model lacks.
    """
    parts = tuple(
        dict.fromkeys(_recorded(text) if parameters is None else Part.of(text, parameters) for text in words)
    )
    modelled = dict.fromkeys(map(plain, effects))
    for part in parts:
        if not part.name and part.effect not in modelled:
            remedy = f"the model has: {', '.join(modelled)}" if modelled else "the model has no effect"
            raise BayescalError(f"{part.effect} is not in the model", f"{OPTION} '{part}'", remedy)
    return parts


def _recorded(words: str) -> Part:
    return Part.of(words) if " at " in words else Part("", ARM_SITE, words.strip())


def kept(parameters: Sequence[Parameter], without: Sequence[Part]) -> tuple[Parameter, ...]:
    """Parameters that belong to none of the parts.

    Raises
    ------
    BayescalError
        If the model has an effect, but the effect has no parameters at the site.
    """
    for part in without:
        candidates = [p for p in parameters if p.effect == part.effect]
        if candidates and not any(map(part.holds, candidates)):
            sites = dict.fromkeys(str(site) for p in candidates for site in p.site.also)
            what = f"{part.effect} has no parameters at `{part.site}`"
            raise BayescalError(what, OPTION, f"its sites are: {', '.join(sites)}")
    return tuple(p for p in parameters if not any(part.holds(p) for part in without))


QUANTITIES = {"m": " lengths", "rad": " angles"}
"""What parameters of a family are, by their unit."""
STATED = {
    ("camera", "px"): "errors of focal lengths and optical axis",
    ("camera", "1"): "errors of distortion",
    ("board", "1"): "errors of the size of boards",
    ("board", "m"): "errors of the flatness of boards",
}
"""Families of what a session states of cameras and boards, by site and unit."""


def family(p: Parameter) -> str:
    """Parameters whose prior widths have the same source: of one effect and unit, at joints or at links.

    What a session states of a camera or board with u is one too. "" of all others, at the base or of a tool:
    their widths are assumed loose. The simpler model of an effect has its families.
    """
    if p.site.kind not in NUMBERED:
        return STATED.get((p.site.kind, p.unit), "") if p.effect in ALWAYS else ""
    whole = next((name for name, e in MODELS.items() if e.simpler and e.simpler == p.effect), p.effect)
    return f"{whole}{QUANTITIES.get(p.unit, '')} of {p.site.kind}s"


@dataclass(frozen=True)
class FitOptions:
    """How a model is fitted; its effects are given beside, because levels and refits differ in them.

    Attributes
    ----------
    without : tuple of Part
        Parts of the effects that stay nominal.
    robust : bool
        Exclude outliers.
    prior_width : float
        Factor on the prior standard deviations of the arm.
    widths : mapping
        Further factors by `family`, that the data told (`estimate.widths`).
    doubted : tuple of str
        Parameters whose priors in the robot file contradict the data: they have the usual ones.
    seed : int
        The same seed gives the same result.
    latent_joints : bool
        Keep the joint readings as variables of the graph.
    tolerance : float, optional
        m, of the error of a distance; conformance is decided by ISO 14253-1.
    """

    without: tuple[Part, ...] = ()
    robust: bool = True
    prior_width: float = 1.0
    seed: int = 0
    latent_joints: bool = False
    tolerance: float | None = None
    widths: Mapping[str, float] = field(default_factory=dict)
    doubted: tuple[str, ...] = ()

    def wider(self, p: Parameter) -> Parameter:
        """A parameter with the prior of a fit."""
        if p.usual is not None and p.name in self.doubted:
            p = replace(p, mean=p.usual[0], sd=p.usual[1])
        return replace(p, sd=p.sd * self.prior_width * self.widths.get(family(p), 1.0))

    @property
    def contrary(self) -> tuple[str, ...]:
        """The finding of priors in the robot file that the data contradict, as a text; none without one."""
        if not self.doubted:
            return ()
        return (
            f"{', '.join(self.doubted)}: contrary to the prior of the robot file, which is not used here: "
            "the arm differs from those that it was learnt from",
        )

    @property
    def omitted(self) -> tuple[str, ...]:
        """The parts that stay nominal, as text: ``geometry at joint 4``."""
        return tuple(map(str, self.without))

    def omitting(self, words: Sequence[str], scene: Scene, effects: tuple[str, ...]) -> FitOptions:
        """These options with parts of a model that stay nominal, by their texts; the model is checked.

        Raises
        ------
        BayescalError
            For priors without width, an effect named twice, or a part that the model does not have.
        """
        check_asked(effects, self.prior_width)
        if not words:
            return self
        parameters = parameters_of(effects, scene.circumstances())
        return replace(self, without=parts_of(words, effects, parameters))


USUAL = FitOptions()
"""Options of a fit for which none are given."""


def check_asked(effects: tuple[str, ...], prior_width: float) -> None:
    """Refuse priors without width, and an effect named twice."""
    if not 0 < prior_width < float("inf"):
        what = "a model without priors would shrink the arm to fit its contacts"
        raise BayescalError(what, "--prior-width", "give a number above 0")
    asked = {plain(name) for name in effects}
    if len(asked) < len(effects):
        remedy = "name it once; for several sites: 'backlash at joint 2 and joint 3'"
        raise BayescalError("an effect is named twice", "--model", remedy)
