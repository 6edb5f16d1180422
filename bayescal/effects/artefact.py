r"""Artefact: a certified value of parallelism, squareness or distance is in error.

Formula: $`v_\mathrm{true} = v_\mathrm{certified} + x`$; v is an angle or a length of a certificate.

One parameter for each certified value, true minus certified. Prior: ten times the stated uncertainty for an
angle (assumed: a wrong certificate, or the certificate of another artefact, is in error by many times its
uncertainty), three times for a length. The error moves neither the arm nor a contact. It is identifiable
only if the contacts determine the same angle or distance independently. An error of a length is nearly
confusable with a scale error of the arm: a wider prior for it would increase the uncertainty of every
distance by more than the correction is worth.
"""

from __future__ import annotations

from bayescal.arm.motion import CERTIFICATE, Term
from bayescal.effects import location
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size
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


ARTEFACT = Effect(
    "artefact",
    "a certified value is in error",
    _parameters,
    lambda c: "" if c.certified_values else "no certificate ties fitted targets",
    sizes={"m": Size("true less certified value"), "rad": Size("true less certified value")},
    phrase=("the artefact", "has a certified value in error"),
    remedy=(
        "Check that the certificate belongs to this artefact and its values are entered correctly. "
        "Then have the artefact measured again; check its temperature and its clamps."
    ),
    in_robot_file=True,
)
