r"""Hysteresis: gravity torque presses the gear of a joint against one or the other tooth flank.

Formula: $`\rho_{z,k} = w_k \tanh \frac{\tau_k}{s \, T_k}`$;
w is the half-width, T the usual torque, s the share.

Driver: a smooth sign, tanh of the gravity torque divided by a small share of the joint's usual torque (the
90th percentile over the contacts): at small torques the gear is between the flanks. The share is scanned:
``hysteresis@0.02`` changes flanks within 2 %. Prior: 0.05 mrad, within the half-widths of 0.003 to 0.16 mrad
that approaches from two sides show (an ABB IRB 120 measured with a laser tracker; the same distance of the
flanks under gravity is assumed). A change over a larger share of the torque is `hardening`.

``hysteresis@late-20`` and ``hysteresis@late-60`` have a memory: the change over 20 % of the usual torque is
followed late, with a lag that fades over 20 or 60 % of the usual torque (a first-order lag along the path of
the torque from contact to contact, as in Dahl's model of friction). Without a memory this curve is
`hardening`.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from bayescal.effects.common import lagging, without_torques
from bayescal.effects.compliance import by_torque
from bayescal.effects.sizes import Size, magnitude
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Scan

SD = 5e-5  # rad; m of a prismatic joint (assumed)
SHARES = np.array([0.02, 0.06, 0.12])
CHANGE = 0.2  # share of the usual torque within which a late change takes place (tuned)
LAGS = (0.2, 0.6)  # shares of the usual torque over which it is followed (tuned)


def _at(c: Circumstances, share: float) -> list[Parameter]:
    return by_torque(
        c, "hysteresis", lambda torque, most: np.tanh(torque / (share * most)), lambda *_: SD, form="sign"
    )


def _parameters(c: Circumstances) -> list[Parameter]:
    return _at(c, float(SHARES[1]))


def _late(c: Circumstances, lag: float) -> list[Parameter]:
    def followed(torque: np.ndarray, most: float) -> np.ndarray:
        return lagging(c, np.tanh(torque / (CHANGE * most)), torque, lag * most)

    return by_torque(c, "hysteresis", followed, lambda *_: SD, form="late")


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
    sizes=dict.fromkeys(("rad", "m"), Size("half-width", magnitude)),
    phrase=("every joint", "has torque-reversal hysteresis"),
    remedy=(
        "Check the preload and wear of the gear, and the belt tension: the load presses the teeth on "
        "either flank. Check the counterbalance spring. Until then, use poses in which the torque "
        "keeps its sign."
    ),
    confusable_with=("hardening",),
    requires=("compliance",),
    forms=tuple(
        Form(
            f"late-{100 * lag:.0f}",
            f"followed late, over {lag:.0%} of the usual torque",
            partial(_late, lag=lag),
        )
        for lag in LAGS
    ),
    simulated_within=5e-7,
)
