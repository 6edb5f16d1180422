r"""Hysteresis: gravity torque presses the gear of a joint against one or the other tooth flank.

Formula: $`\rho_{z,k} = w_k \tanh \frac{\tau_k}{s \, T_k}`$;
w is the half-width, T the usual torque, s the share.

Driver: a smooth sign, tanh of the gravity torque divided by a small share of the joint's usual torque (the
90th percentile over the contacts): at small torques the gear is between the flanks. The share is scanned:
``hysteresis@0.02`` changes flanks within 2 %. Prior: 0.05 mrad, within the half-widths of 0.003 to 0.16 mrad
that approaches from two sides show (an ABB IRB 120 measured with a laser tracker; the same distance of the
flanks under gravity is assumed). A change over a larger share of the torque is `hardening`.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.compliance import loaded
from bayescal.effects.joints import at, usual, without_torques
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size, magnitude
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Scan

SD = 5e-5  # rad
SHARES = np.array([0.02, 0.06, 0.12])


def _at(c: Circumstances, share: float) -> list[Parameter]:
    return [
        Parameter(
            f"hysteresis {name}", "rad", (Term(j, "rz", np.tanh(torque / (share * usual(c, torque)))),), SD,
            **at(j, Driver("torque", j, form="sign")),
        )
        for j, name, _, torque in loaded(c)
    ]  # fmt: skip


def _parameters(c: Circumstances) -> list[Parameter]:
    return _at(c, float(SHARES[1]))


HYSTERESIS = Effect(
    "hysteresis",
    "torque-reversal hysteresis of joint k",
    _parameters,
    without_torques,
    Scan(
        "share of the usual torque within which it changes",
        "changing flanks within {:.0%} of the usual torque",
        lambda c: SHARES,
        _at,
    ),
    sizes={"rad": Size("half-width", magnitude)},
    phrase=("every joint", "has torque-reversal hysteresis"),
    remedy=(
        "Check the preload and wear of the gear, and the belt tension: the load presses the teeth on "
        "either flank. Check the counterbalance spring. Until then, use poses in which the torque "
        "keeps its sign."
    ),
    confusable_with=("hardening",),
    requires=("compliance",),
)
