"""Base compliance: what the arm stands on turns by the gravity moment of the whole arm.

Driver: each component of the gravity moment in the base frame turns that frame about its own axis; a
stand may yield more one way than another, so each axis has its compliance. Prior: about
3e-6 rad/(N m), a tenth of a shoulder's, with 1.5 times that as standard deviation (assumed: 30 N m tilt
by 0.1 mrad, or 0.05 mm at half a metre; bending and base tilt took the mean error of an ABB IRB 120
from 0.099 to 0.081 mm).
"""

from __future__ import annotations

from bayescal.arm.motion import Term
from bayescal.effects.compliance import SPREAD
from bayescal.effects.joints import carries, without_masses
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

MEAN = 3e-6  # rad/(N m)


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.moments is not None
    out = []
    for k, axis in enumerate("xyz"):
        moment = c.moments[:, 0, k]
        if carries(moment):
            tilt = (Term(0, f"r{axis}", moment),)
            name = f"base-compliance {axis}"
            out.append(Parameter(name, "rad/(N m)", tilt, SPREAD * MEAN, 0.0, MEAN, positive=True))
    return out


BASE_COMPLIANCE = Effect(
    "base-compliance", "a stand that yields to the arm's gravity moment", _parameters, without_masses
)
