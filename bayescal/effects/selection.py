"""An effect as a model names it: its setting, its site and its priors.

The text is ``EFFECT[@SETTING] [in proportion] [at SITE and ...] [by DRIVER and ...] [xFACTOR]``:

- ``backlash``, ``step@212``: the effect at all its sites, in its usual setting or in another one;
- ``gear-mesh@100/50 at joint 1 and joint 5``, ``step@40/212 at base and base``: a setting for each site;
- ``backlash at joint 3``, ``compliance at joint 2 and joint 3``: only there; a joint includes its link;
- ``coupling at joint 5 by angle 4``: only the parameters with this driver (without its commas);
- ``compliance in proportion``: one factor for all its parameters, in proportion to their prior means;
- ``backlash at joint 3 x4``: prior standard deviations times 4 and prior means at the nominal values.

The vocabulary as a table: the effects of this package, of other installed packages, and of a user.

Another package provides effects as entry points of the group `GROUP`. They are read once, at the first use of
the table. A program adds its own effects with `register`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points

import numpy as np

from bayescal.effects.compliance import SPREAD
from bayescal.effects.location import ARM, Site, face, words_of
from bayescal.effects.vocabulary import Effect, Parameter
from bayescal.errors import BayescalError

WORDS = re.compile(
    r"(?P<effect>[^@\s]+)(?:@(?P<setting>\S*))?(?P<together> in proportion)?"
    r"(?: at (?P<sites>.+?))?(?: by (?P<driver>.+?))?(?: x(?P<factor>[-+]?[\d.]+(?:e[-+]?\d+)?))?"
)


@dataclass(frozen=True)
class Selection:
    """An effect, or a part of it, with its priors; its `str` is the text that `read` reads."""

    effect: str
    setting: str | None = None
    sites: tuple[Site, ...] = ()  # () for all
    drivers: tuple[str, ...] = ()  # () for all
    together: bool = False  # one common factor
    factor: float | None = None  # on the prior standard deviations; None for the usual prior

    @classmethod
    def read(cls, words: str) -> Selection:
        """Read a text; one that does not follow the form is a name without anything else.

        Raises
        ------
        BayescalError
            For a factor that is not a number above 0.
        """
        plain = " ".join(words.split())
        match = WORDS.fullmatch(plain)
        if match is None:
            return cls(plain)
        part, setting = {key: text or "" for key, text in match.groupdict().items()}, match["setting"]
        sites = tuple(Site.read(s) for s in part["sites"].split(" and ") if s)
        drivers = tuple(dict.fromkeys(d for d in part["driver"].split(" and ") if d))
        where, example = f"--model '{plain}'", "give a factor on the prior, for example x2"
        factor = positive(part["factor"], where, example) if part["factor"] else None
        return cls(part["effect"], setting, sites, drivers, bool(part["together"]), factor)

    @property
    def name(self) -> str:
        """The effect with its setting: ``step@212``."""
        return self.effect if self.setting is None else f"{self.effect}@{self.setting}"

    def __str__(self) -> str:
        return "".join(
            (
                self.name,
                " in proportion" if self.together else "",
                f" at {words_of(self.sites)}" if self.sites else "",
                f" by {' and '.join(self.drivers)}" if self.drivers else "",
                "" if self.factor is None else f" x{shortest(self.factor)}",
            )
        )

    @property
    def unscaled(self) -> Selection:
        """The same text with `` x2`` as the end of a target's name, ``plate x2``, instead of a factor."""
        if self.factor is None or not self.sites or self.drivers or self.sites[-1].kind != "face":
            return self
        last = face(f"{self.sites[-1]} x{shortest(self.factor)}")
        return replace(self, sites=(*self.sites[:-1], last), factor=None)

    def among(self, parameters: Iterable[Parameter]) -> Selection:
        """The selection itself, or `unscaled` where one of the parameters is at the site that this names."""
        other = self.unscaled
        sites = {str(site) for p in parameters for site in p.site.also}
        return other if other.sites and str(other.sites[-1]) in sites else self

    def holds(self, p: Parameter) -> bool:
        """Whether a parameter of the effect is at one of the sites and has the driver."""
        on_site = not self.sites or any(str(site) in map(str, p.site.also) for site in self.sites)
        return on_site and (not self.drivers or driver_words(p) in self.drivers)

    def of(self, parameters: Sequence[Parameter], where: str) -> list[Parameter]:
        """The selected ones of an effect's parameters, with the priors that the text states.

        Parameters
        ----------
        parameters : sequence of Parameter
            All parameters of the effect, in its setting.
        where : str
            The option, for a message.

        Raises
        ------
        BayescalError
            If the effect has no parameters at a site, none with the driver, or no proportion.
        """
        asked = self.among(parameters)
        if asked is not self:
            return asked.of(parameters, where)
        for site in self.sites:
            if not any(replace(self, sites=(site,), drivers=()).holds(p) for p in parameters):
                sites = dict.fromkeys(str(also) for p in parameters for also in p.site.also)
                what = f"{self.effect} has no parameters at `{site}`"
                raise BayescalError(what, where, f"its sites are: {', '.join(sites)}")
        selected = [p for p in parameters if self.holds(p)]
        there = dict.fromkeys(driver_words(p) for p in parameters if replace(self, drivers=()).holds(p))
        if unknown := [driver for driver in self.drivers if driver not in there]:
            what = f"{self.effect} has no parameters by `{unknown[0]}` there"
            raise BayescalError(what, where, f"its drivers there are: {', '.join(there)}")
        if self.together:
            joined = in_proportion(self.effect, selected)
            if selected and not joined:
                remedy = f"say {replace(self, together=False)}"
                raise BayescalError(f"{self.effect} has no parameters in proportion there", where, remedy)
            selected = joined
        if self.factor is None:
            return selected
        return [replace(p, sd=p.sd * self.factor, mean=p.nominal) for p in selected]


def plain(name: str) -> str:
    """The effect that a name of a model is about: ``step`` of ``step@212``."""
    return Selection.read(name).effect


def shortest(value: float) -> str:
    """The shortest text that reads as this number."""
    text = format(value, "g")
    return text if float(text) == value else repr(float(value))


def driver_words(p: Parameter) -> str:
    """A parameter's driver, without the commas that separate effects."""
    return str(p.driver).replace(",", "")


def in_proportion(effect: str, parameters: Sequence[Parameter]) -> list[Parameter]:
    """One common factor for several physically positive parameters, in proportion to their prior means."""
    if len(parameters) < 2 or not all(p.positive and p.mean for p in parameters):
        return []
    terms = tuple(
        replace(t, driver=np.asarray(t.driver) * (p.mean or 0.0)) for p in parameters for t in p.terms
    )
    sites = {p.site for p in parameters}
    return [
        Parameter(
            f"{effect} in proportion", "1", terms, SPREAD, site=sites.pop() if len(sites) == 1 else ARM,
            driver=replace(parameters[0].driver, joint=0), effect=effect,
            stands_for=tuple(parameters),
        )
    ]  # fmt: skip


def positive(words: str, where: str, remedy: str) -> float:
    """A number above 0 from its text, or an error with its place and remedy."""
    try:
        value = float(words)
    except ValueError:
        value = float("nan")
    if not 0 < value < np.inf:
        raise BayescalError(f"'{words}' is not a number above 0", where, remedy)
    return value


GROUP = "bayescal.effects"
"""Group of the entry points; each one names an `Effect`."""
NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
"""Permitted names of effects: options separate names by commas, settings by @, sites by blanks."""


class Vocabulary(Mapping[str, Effect]):
    """Effects by name, in the order in which they were added.

    Parameters
    ----------
    listed : iterable of Effect
        The effects of the package.
    reserved : iterable of str
        Names that no further effect may have: they have another meaning in files and options.
    """

    def __init__(self, listed: Iterable[Effect], reserved: Iterable[str] = ()) -> None:
        listed = tuple(listed)
        self._effects = {effect.name: effect for effect in listed}
        assert len(self._effects) == len(listed), "two effects of one name"
        self._own = frozenset(self._effects)
        self._reserved = frozenset(reserved)
        self._complete = False

    def __getitem__(self, name: str) -> Effect:
        self._read_entry_points()
        return self._effects[name]

    def __iter__(self) -> Iterator[str]:
        self._read_entry_points()
        return iter(tuple(self._effects))

    def __len__(self) -> int:
        self._read_entry_points()
        return len(self._effects)

    def register(self, effect: Effect) -> None:
        """Add an effect: models may then name it, and the diagnosis tries it.

        Parameters
        ----------
        effect : Effect

        Raises
        ------
        BayescalError
            If the argument is not an effect, if its name is in use or not permitted on a command line, or if
            its fields name effects that do not exist.
        """
        self._read_entry_points()
        self._add(effect, "effects.register")
        try:
            self._check_names(effect, "effects.register")
        except BayescalError:
            del self._effects[effect.name]
            raise

    def unregister(self, name: str) -> None:
        """Remove a registered effect, so that another effect can be registered under its name.

        Raises
        ------
        BayescalError
            For an effect of the package, or one that is not registered.
        """
        if name in self._own or name not in self:
            names = ", ".join(n for n in self if n not in self._own) or "none"
            raise BayescalError(f"`{name}` was not registered", "effects.unregister", f"registered: {names}")
        del self._effects[name]

    def _add(self, effect: object, where: str) -> None:
        if not isinstance(effect, Effect):
            what = f"{type(effect).__name__} is not an Effect"
            raise BayescalError(what, where, "give a bayescal.effects.Effect")
        if not NAME.fullmatch(effect.name):
            remedy = "use small letters, digits and hyphens, for example cable-drag"
            raise BayescalError(f"`{effect.name}` cannot name an effect", where, remedy)
        if effect.name in self._effects or effect.name in self._reserved:
            raise BayescalError(f"the name `{effect.name}` is in use", where, "give the effect another name")
        self._effects[effect.name] = effect

    def _check_names(self, effect: Effect, where: str) -> None:
        for field in ("confusable_with", "requires", "part_of"):
            for other in getattr(effect, field):
                if other == effect.name or other not in self._effects:
                    what = f"{field} of {effect.name} names `{other}`, which is not another effect"
                    raise BayescalError(what, where, f"known: {', '.join(self._effects)}")

    def _read_entry_points(self) -> None:
        if self._complete:
            return
        self._complete = True  # at once: a package that is loaded here may read the vocabulary
        before = dict(self._effects)
        try:
            loaded = [(_loaded(entry), _place(entry)) for entry in entry_points(group=GROUP)]
            for effect, where in loaded:
                self._add(effect, where)
            for effect, where in loaded:
                assert isinstance(effect, Effect)
                self._check_names(effect, where)
        except BaseException:
            self._effects, self._complete = before, False
            raise


def _place(entry: EntryPoint) -> str:
    package = f" of {entry.dist.name}" if entry.dist is not None else ""
    return f"entry point {entry.name} = {entry.value}{package}"


def _loaded(entry: EntryPoint) -> object:
    try:
        return entry.load()
    except BayescalError:
        raise
    except Exception as error:
        what = f"cannot be loaded: {type(error).__name__}: {error}"
        raise BayescalError(what, _place(entry), "correct or uninstall that package") from error
