"""Gear mesh: the reducer's ripple, once and twice a turn of the motor.

Driver: sine and cosine of N and 2 N times the link-relative angle, N the motor's turns a turn of the
joint; a strain-wave gear meshes twice a turn. Prior: 0.05 mrad each, from amplitudes of 0.02 to
0.13 mrad at 2 N (an ABB IRB 120 measured with a laser tracker).
"""

from __future__ import annotations

from bayescal.effects.joints import waves
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 5e-5  # rad


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.robot.reductions is not None
    return [
        p
        for j, turns in enumerate(c.robot.reductions, start=1)
        for order in (float(turns), 2.0 * float(turns))
        for p in waves(c, f"gear-mesh {order:g}", j, order, SD)
    ]


def _missing(c: Circumstances) -> str:
    return "" if c.robot.reductions is not None else "no reductions in the robot file"


GEAR_MESH = Effect("gear-mesh", "the reducer's ripple: once and twice a motor turn", _parameters, _missing)
