"""Backlash: lost motion in a gear. The link lags its motor by the half-width in either direction of motion.

Driver: the sign of the velocity at the gear (`joints.side_of`). For coupled axes this is the velocity between
the two links, unless the robot file states that a linkage couples them. The other side is a separate form,
which a diagnosis compares: ``backlash@reading`` acts with the displayed readings on all links that they move,
``backlash@link`` acts between the links. Below 0.03 deg/s (assumed) the sign goes smoothly to zero. A
negative value is a lag, a positive value a lead. Prior: 0.08 mrad, from half-widths of 0.003 to 0.16 mrad
(an ABB IRB 120 measured with a laser tracker; J4 and J6 had the largest).
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.joints import at, motion, side_of, sides, turned, without_velocity
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size, magnitude
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 8e-5  # rad
STANDSTILL = np.radians(0.03)  # rad/s: below it, a joint may rest anywhere within its lost motion


def _parameters(c: Circumstances, side: str) -> list[Parameter]:
    assert c.velocity is not None
    out = []
    for j, name in enumerate(c.robot.joint_names, start=1):
        speed = motion(c.robot, j, c.velocity, side)
        sign = speed / np.hypot(speed, STANDSTILL)
        if np.any(speed):
            terms = turned(c.robot, j, sign, side)
            out.append(Parameter(f"backlash {name}", "rad", terms, SD, **at(j, Driver("direction", j))))
    return out


BACKLASH = Effect(
    "backlash",
    "lost motion on reversal of joint k, half-width b",
    lambda c: _parameters(c, side_of(c.robot)),
    without_velocity,
    sizes={"rad": Size("half-width", magnitude)},
    phrase=("every joint", "has lost motion on reversal"),
    confusable_with=("unsettled",),
    forms=sides(_parameters),
)
