"""Hardening: a gear that yields less the more it is wound up (or more: a value above 0).

Driver: gravity torque times its size, beside `compliance`. Prior: an elbow of 2e-4 rad/(N m) was 30 %
softer near zero torque than at 8 N m, where it is wound up by 1.6 mrad (an ABB IRB 120 measured with a
laser tracker). So at 1.6 mrad every joint's compliance is taken to change by 30 %: 0.3 of the compliance
over the torque that winds it up so far. For other joints than the elbow that is assumed. A gear may also be
soft up to a knee and linear beyond: ``hardening@0.4`` has it at 40 % of the joint's usual torque (that
which nine contacts in ten stay below); knees are scanned.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.compliance import loaded
from bayescal.effects.joints import at, usual, without_masses
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Scan

CHANGE = 0.3  # of the compliance
WOUND_UP = 1.6e-3  # rad
KNEES = np.array([0.2, 0.3, 0.45, 0.8])


def _parameters(c: Circumstances) -> list[Parameter]:
    return [
        Parameter(
            f"hardening {name}", "rad/(N m)^2", (Term(j, "rz", torque * np.abs(torque)),),
            CHANGE * compliance**2 / WOUND_UP, **at(j, Driver("torque", j)),
        )
        for j, name, compliance, torque in loaded(c)
    ]  # fmt: skip


def _at(c: Circumstances, knee: float) -> list[Parameter]:
    """The same with a knee: soft up to a share of the joint's usual torque, linear beyond."""
    return [
        Parameter(
            f"hardening {name}", "rad", (Term(j, "rz", np.tanh(torque / (knee * usual(c, torque)))),),
            CHANGE * compliance * knee * usual(c, torque), **at(j, Driver("torque", j)),
        )
        for j, name, compliance, torque in loaded(c)
    ]  # fmt: skip


HARDENING = Effect(
    "hardening",
    "torque-dependent stiffness of joint k",
    _parameters,
    without_masses,
    Scan(
        "knee as a share of the usual torque",
        "low stiffness up to {:.0%} of the usual torque",
        lambda c: KNEES,
        _at,
    ),
    phrase=("every joint", "has torque-dependent stiffness"),
    confusable_with=("hysteresis",),
    requires=("compliance",),
)
