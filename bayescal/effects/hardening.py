"""Hardening: a gear that yields less the more it is wound up (or more: a value above 0).

Driver: gravity torque times its size, beside `compliance`. Prior: an elbow of 2e-4 rad/(N m) was 30 %
softer near zero torque than at 8 N m, where it is wound up by 1.6 mrad (an ABB IRB 120 measured with a
laser tracker). So at 1.6 mrad every joint's compliance is taken to change by 30 %: 0.3 of the
compliance over the torque that winds it up so far. For other joints than the elbow that is assumed.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.compliance import loaded
from bayescal.effects.joints import without_masses
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

CHANGE = 0.3  # of the compliance
WOUND_UP = 1.6e-3  # rad


def _parameters(c: Circumstances) -> list[Parameter]:
    return [
        Parameter(
            f"hardening {name}", "rad/(N m)^2", (Term(j, "rz", torque * np.abs(torque)),),
            CHANGE * compliance**2 / WOUND_UP,
        )
        for j, name, compliance, torque in loaded(c)
    ]  # fmt: skip


HARDENING = Effect("hardening", "gears that stiffen as they wind up", _parameters, without_masses)
