"""Thermal drift: the arm grows as it warms up, and its joint zeros wander.

Driver: the temperature, or the time where none is recorded (an artefact's is none of the arm's), from -1
to 1 over the session. One value makes every length of the arm grow alike; each joint zero has a
drift of its own. The base's is left out: about the first axis it is that of the first zero. Values are
half of what happens over the session. Prior: zeros 0.05 mrad, from drifts of 0.06 to 0.13 mrad over a
session (an ABB IRB 120 measured with a laser tracker); growth 5e-5, as of aluminium (23e-6 1/K) over
4 K (assumed).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

ZERO_SD = 5e-5  # rad
GROWTH_SD = 5e-5  # m a m


def course(c: Circumstances) -> tuple[str, np.ndarray] | None:
    """What the drift goes by, and its course over the session (N,) from -1 to 1; None if nothing varies."""
    for name, values in (("temperature", c.temperature), ("time", c.time)):
        if values is not None and len(values) and np.ptp(values) > 0:
            low, high = np.min(values), np.max(values)
            return name, (2.0 * values - (low + high)) / (high - low)
    return None


def _lengths(c: Circumstances, driver: np.ndarray) -> tuple[Term, ...]:
    """Every a and d of the table, growing by its own length times the driver."""
    robot = c.robot
    behind = 0 if robot.convention == "mdh" else 1
    along = [(i + 1, "tz", float(d)) for i, d in enumerate(robot.d)]
    across = [(i + behind, "tx", float(a)) for i, a in enumerate(robot.a)]
    return tuple(Term(frame, axis, length * driver) for frame, axis, length in along + across if length)


def _parameters(c: Circumstances) -> list[Parameter]:
    found = course(c)
    assert found is not None
    by, driver = found
    lengths = _lengths(c, driver)
    out = [Parameter(f"thermal-drift growth by {by}", "1", lengths, GROWTH_SD)] if lengths else []
    for j, name in enumerate(c.robot.joint_names, start=1):
        out.append(Parameter(f"thermal-drift {name} by {by}", "rad", (Term(j, "rz", driver),), ZERO_SD))
    return out


def _missing(c: Circumstances) -> str:
    return "" if course(c) else "no temperature_c of the arm or the air, and no time_s, that varies"


THERMAL_DRIFT = Effect("thermal-drift", "lengths and joint zeros that drift", _parameters, _missing)
