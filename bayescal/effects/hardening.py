r"""Nonlinear stiffness of a joint: it depends on the torque. A positive value is softening.

Formula: $`\rho_{z,k} = h_k \, \tau_k |\tau_k|`$;
with a knee: h tanh(τ / (s T)), T the usual torque and s the share.

Driver: gravity torque times its magnitude, in addition to `compliance`. Prior: an elbow of 2e-4 rad/(N m) was
30 % softer near zero torque than at 8 N m, where its wind-up is 1.6 mrad (an ABB IRB 120 measured with a
laser tracker). So the compliance of every joint is assumed to change by 30 % at 1.6 mrad: the prior is 0.3
of the compliance divided by the torque that causes this wind-up. For joints other than the elbow this is an
assumption. A gear may also be soft up to a knee and linear beyond it: ``hardening@0.4`` has the knee at 40 %
of the joint's usual torque, the 90th percentile over the contacts. Knees are scanned. The two flanks of the
teeth may differ: ``hardening@uneven`` has a deflection of its own for each sign of the torque.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.common import at, usual, without_torques
from bayescal.effects.compliance import by_torque, loaded
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Scan

CHANGE = 0.3  # of the compliance
WOUND_UP = 1.6e-3  # rad
KNEES = np.array([0.2, 0.3, 0.45, 0.8])
UNEVEN_KNEE = 0.45  # as a share of the usual torque
UNEVEN_ODDS = 0.1  # assumed: two amounts fit other errors by torque too


def _parameters(c: Circumstances) -> list[Parameter]:
    def sd(compliance: float, most: float) -> float:
        return CHANGE * compliance**2 / WOUND_UP

    return by_torque(c, "hardening", lambda torque, most: torque * np.abs(torque), sd, "rad/(N m)^2")


def _uneven(c: Circumstances) -> list[Parameter]:
    """Parameters of a soft part that differs between the signs of the torque."""
    return [
        Parameter(
            f"hardening {name} {words}", "m" if c.robot.slides[j - 1] else "rad",
            (Term(j, c.robot.axes[j - 1], side * np.maximum(side * soft, 0.0)),),
            CHANGE * compliance * UNEVEN_KNEE * usual(c, torque), **at(j, Driver("torque", j, form="uneven")),
        )
        for j, name, compliance, torque in loaded(c)
        for soft in [np.tanh(torque / (UNEVEN_KNEE * usual(c, torque)))]
        for side, words in ((1.0, "positive"), (-1.0, "negative"))
    ]  # fmt: skip


def _at(c: Circumstances, knee: float) -> list[Parameter]:
    """Parameters with a knee: soft up to a share of the joint's usual torque, linear beyond."""
    return by_torque(
        c,
        "hardening",
        lambda torque, most: np.tanh(torque / (knee * most)),
        lambda compliance, most: CHANGE * compliance * knee * most,
    )


HARDENING = Effect(
    "hardening",
    "nonlinear (torque-dependent) stiffness of joint k",
    _parameters,
    without_torques,
    Scan(
        "knee as a share of the usual torque",
        "low stiffness up to {:.0%} of the usual torque",
        lambda c: KNEES,
        _at,
    ),
    sizes={
        "rad/(N m)^2": Size("change of the compliance per torque"),
        **dict.fromkeys(("rad", "m"), Size("deflection of the soft part")),
    },
    phrase=("every joint", "has nonlinear stiffness"),
    remedy=(
        "Check the preload of the reduction and of its bearings, and look for wear of the strain-wave "
        "gear. If the gear is in order, keep the effect in the model and calibrate at the loads of "
        "the task."
    ),
    confusable_with=("hysteresis",),
    requires=("compliance",),
    forms=(Form("uneven", "of another amount at each sign of the torque", _uneven, UNEVEN_ODDS),),
    simulated_within=5e-7,
)
