"""Artefact: a paper that is wrong, of faces not as parallel, square or far apart as it says.

One parameter a stated value, true minus certified. Prior: ten times the stated uncertainty of an angle
(assumed: a paper that is wrong, or the artefact of another number, is wrong by many times what it states),
three times that of a length. It moves neither arm nor contact: only where contacts tell the same angle or
distance on their own can it be seen. A wrong length alone is hardly told from an arm of another size: set
free, it would cost every distance more than it mends.
"""

from __future__ import annotations

from bayescal.arm.motion import CERTIFICATE, Term
from bayescal.effects import location
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

TIMES = {"rad": 10.0, "m": 3.0}  # the stated uncertainty


def _parameters(c: Circumstances) -> list[Parameter]:
    out = []
    for value in c.certified_values:
        term = Term(CERTIFICATE, str(value.certificate), value.rows)
        name, sd = f"artefact {value.name}", TIMES[value.unit] * value.u
        out.append(
            Parameter(name, value.unit, (term,), sd, site=location.ARTEFACT, driver=Driver("certificate"))
        )
    return out


def _missing(c: Circumstances) -> str:
    return "" if c.certified_values else "no certificate ties fitted targets"


ARTEFACT = Effect(
    "artefact",
    "a certified value is in error",
    _parameters,
    _missing,
    phrase=("the artefact", "has a certified value in error"),
)
