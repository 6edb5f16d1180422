"""Hysteresis: a joint that rests on the one or the other flank, as gravity pushes it.

Driver: a smooth sign, tanh of the gravity torque over the torque at which the joint's usual compliance
turns it by as much as the prior scale: small torques leave it between the flanks. Prior: 0.05 mrad,
the middle of the half-widths of 0.003 to 0.16 mrad that approaches from two sides show (an ABB IRB 120
measured with a laser tracker; that gravity's flanks are as far apart is assumed).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.compliance import loaded
from bayescal.effects.joints import without_masses
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 5e-5  # rad


def _parameters(c: Circumstances) -> list[Parameter]:
    return [
        Parameter(f"hysteresis {name}", "rad", (Term(j, "rz", np.tanh(torque * compliance / SD)),), SD)
        for j, name, compliance, torque in loaded(c)
    ]


HYSTERESIS = Effect(
    "hysteresis", "joints that rest on a flank, by the sign of gravity torque", _parameters, without_masses
)
