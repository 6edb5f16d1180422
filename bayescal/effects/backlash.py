r"""Backlash: lost motion in a gear. The link lags its motor by the half-width in either direction of motion.

Formula: $`\rho_{z,k} = b_k \, \frac{\omega_k}{\sqrt{\omega_k^2 + \omega_0^2}}`$;
b is the half-width, ω the speed, ω0 = 0.03 deg/s.

Driver: the sign of the velocity at the gear (`common.side_of`). For coupled axes this is the velocity between
the two links, unless the robot file states that a linkage couples them. The other side is a separate form,
which a diagnosis compares: ``backlash@reading`` acts with the displayed readings on all links that they move,
``backlash@link`` acts between the links. Below 0.03 deg/s (assumed) the sign goes smoothly to zero. A
negative value is a lag, a positive value a lead. Prior: 0.08 mrad, from half-widths of 0.003 to 0.16 mrad
(an ABB IRB 120 measured with a laser tracker; J4 and J6 had the largest); along a prismatic joint 0.03 mm
(assumed: a rack and pinion), and ω is its speed, ω0 = 0.5 mm/s.

A loaded joint does not always follow its motion. Friction of the link presses the teeth against the flank of
the motion, gravity against that of its torque, and the larger one decides: ``backlash@held-30`` has a
friction of 30 % of the joint's usual torque (the 90th percentile over the contacts). With little friction
this is `hysteresis`, with much it is the usual form.
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.common import (
    at,
    at_gears,
    motion,
    sense,
    side_of,
    sides,
    turned,
    usual,
    without_torques,
    without_velocity,
)
from bayescal.effects.compliance import loaded
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size, magnitude
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter

SD, ALONG_SD = 8e-5, 3e-5  # rad; m, of a prismatic joint

FRICTIONS = (0.3, 0.6)  # shares of the usual torque (assumed)
CHANGES = 0.03  # share of the usual torque within which the flank changes (assumed)


def _parameters(c: Circumstances, side: str) -> list[Parameter]:
    assert c.velocity is not None
    return at_gears(c, "backlash", c.velocity, side, ("rad", SD), "direction", sense, ("m", ALONG_SD))


def _held(share: float) -> Form:
    """The form with a friction of a share of the usual torque."""

    def parameters(c: Circumstances) -> list[Parameter]:
        if without_torques(c) or c.velocity is None:
            return []
        out, side = [], side_of(c.robot)
        for j, name, _, torque in loaded(c):
            speed = motion(c.robot, j, c.velocity, side)
            push = share * sense(speed) - torque / usual(c, torque)
            terms = turned(c.robot, j, np.tanh(push / CHANGES), side)
            unit, sd = ("m", ALONG_SD) if c.robot.slides[j - 1] else ("rad", SD)
            out.append(Parameter(f"backlash {name}", unit, terms, sd, **at(j, Driver("flank", j))))
        return out

    words = f"where gravity torques above {share:.0%} of the usual torque hold the joint on one flank"
    return Form(f"held-{100 * share:.0f}", words, parameters)


BACKLASH = Effect(
    "backlash",
    "lost motion on reversal of joint k, half-width b",
    lambda c: _parameters(c, side_of(c.robot)),
    without_velocity,
    sizes=dict.fromkeys(("rad", "m"), Size("half-width", magnitude)),
    phrase=("every joint", "has lost motion on reversal"),
    remedy=(
        "Adjust the belt tension or the preload of the gear, and check keys, couplings and worn "
        "teeth. Until then, approach accurate points from one direction."
    ),
    confusable_with=("unsettled",),
    forms=(*sides(_parameters), *map(_held, FRICTIONS)),
    directed=True,
    simulated_within=2e-6,
)
