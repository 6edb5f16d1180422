"""Backlash: play in a gear, so that the link trails its motor by half the play, whichever way it turns.

Driver: the sign of the velocity of the motion that passes the gear (`joints.side_of`): of coupled axes that
between the two links, unless the robot file says that a linkage couples them. As a form of its own, for a
diagnosis to weigh, the other side: ``backlash@reading`` by the readings shown, moving all links that they
move, ``backlash@link`` between the links. Below 0.03 deg/s a joint hardly turns (assumed), and the sign
fades. A value below 0 trails, one above 0 leads. Prior: 0.08 mrad, from half-widths of 0.003 to 0.16 mrad
(an ABB IRB 120 measured with a laser tracker; J4 and J6 worst).
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.joints import at, motion, side_of, sides, turned, without_velocity
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 8e-5  # rad
STANDSTILL = np.radians(0.03)  # rad/s: slower than that, a joint stands anywhere in its play


def _parameters(c: Circumstances, side: str) -> list[Parameter]:
    assert c.velocity is not None
    out = []
    for j, name in enumerate(c.robot.joint_names, start=1):
        speed = motion(c.robot, j, c.velocity, side)
        way = speed / np.hypot(speed, STANDSTILL)
        if np.any(speed):
            terms = turned(c.robot, j, way, side)
            out.append(Parameter(f"backlash {name}", "rad", terms, SD, **at(j, Driver("direction", j))))
    return out


BACKLASH = Effect(
    "backlash",
    "lost motion on reversal of joint k, half-width b",
    lambda c: _parameters(c, side_of(c.robot)),
    without_velocity,
    phrase=("every joint", "has lost motion on reversal"),
    forms=sides(_parameters),
)
