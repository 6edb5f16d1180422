"""A part of an effect, what it has at one place, left out of a model as if it were unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bayescal.effects import Parameter, Site
from bayescal.errors import BayescalError

OPTION = "--without"


@dataclass(frozen=True)
class Part:
    """Parameters of one effect at one site; a joint is told with the link behind it.

    'geometry at joint 4' is theta4 and d4, and a4, alpha4 (and beta4) of the link that joint 4 moves, in
    Craig's subscripts: a row of a standard DH table; in a modified one a4 and alpha4 stand in the row after
    it. 'geometry at link 4' is the link alone.
    """

    effect: str
    site: Site

    @classmethod
    def of(cls, words: str) -> Part:
        """Read ``geometry at joint 4``."""
        effect, _, site = (" ".join(w.split()) for w in words.partition(" at "))
        if not effect or not site:
            raise BayescalError(
                f"'{words.strip()}' is no effect at a place",
                OPTION,
                "say, for example, 'geometry at joint 4'",
            )
        return cls(effect, Site.read(site))

    def __str__(self) -> str:
        return f"{self.effect} at {self.site}"

    def holds(self, p: Parameter) -> bool:
        """Whether a parameter belongs to the part."""
        return p.effect == self.effect and str(self.site) in map(str, p.site.also)


def parts_of(words: Sequence[str], effects: Sequence[str]) -> tuple[Part, ...]:
    """Read what a model is to lack, each part once.

    Raises
    ------
    BayescalError
        For what is no effect at a place, or an effect that the model does not have.
    """
    parts = tuple(dict.fromkeys(map(Part.of, words)))
    plain = dict.fromkeys(name.partition("@")[0] for name in effects)
    for part in parts:
        if part.effect not in plain:
            remedy = f"the model has: {', '.join(plain)}" if plain else "the model has no effect"
            raise BayescalError(f"{part.effect} is not in the model", f"{OPTION} '{part}'", remedy)
    return parts


def kept(parameters: Sequence[Parameter], without: Sequence[Part]) -> tuple[Parameter, ...]:
    """Parameters that belong to none of the parts.

    Raises
    ------
    BayescalError
        Where an effect is there and has nothing at the place named.
    """
    for part in without:
        own = [p for p in parameters if p.effect == part.effect]
        if own and not any(map(part.holds, own)):
            sites = dict.fromkeys(str(site) for p in own for site in p.site.also)
            what = f"{part.effect} has nothing at '{part.site}'"
            raise BayescalError(what, OPTION, f"it has: {', '.join(sites)}")
    return tuple(p for p in parameters if not any(part.holds(p) for part in without))
