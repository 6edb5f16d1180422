"""Bending: bearings and links that tilt across their joint's axis under gravity.

Driver: the components x and y of the gravity moment in the joint's frame, each turning it about its own
axis; one compliance a joint, alike both ways. Prior: about a tenth of the joint's usual compliance,
with 1.5 times that as standard deviation. Assumed, and of the right order: bending and base tilt took
the mean error of an ABB IRB 120 from 0.099 to 0.081 mm, which is 0.06 mm at half a metre and 30 N m.
Where the first axis is upright, its bending differs from `base-compliance` only where the base yields
more one way than the other.
"""

from __future__ import annotations

from bayescal.arm.motion import Term
from bayescal.effects.compliance import SPREAD, typical
from bayescal.effects.joints import carries, without_masses
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SHARE = 0.1  # of the joint's compliance about its axis


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.moments is not None
    out = []
    for j, (name, about) in enumerate(zip(c.robot.joint_names, typical(c.robot.n), strict=True), start=1):
        across = c.moments[:, j, :2]
        if carries(across):
            tilt = (Term(j, "rx", across[:, 0]), Term(j, "ry", across[:, 1]))
            mean = SHARE * float(about)
            out.append(
                Parameter(f"bending {name}", "rad/(N m)", tilt, SPREAD * mean, 0.0, mean, positive=True)
            )
    return out


BENDING = Effect(
    "bending", "bearings and links that tilt across their axis by gravity", _parameters, without_masses
)
