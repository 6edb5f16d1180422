r"""Settling error: a joint is read before it stands still, and moves on in its direction of motion.

Formula: $`\rho_{z,k} = x_k \, (q_{\mathrm{command},k} - q_k)`$; or x times the speed.

Driver: the remaining motion at the gear (`common.side_of`), which is the commanded angle minus the reading
(`jN_command_deg`); the value is the share of it that follows after the reading. If there are no commanded
angles, or the readings are these, the driver is the speed of the joint, and the value is a time. Backlash
follows the sign of the speed instead, and `latency` is one time for all joints at a contact. Prior: a share
of 0.3, and 10 ms (assumed: between the delay of a trigger, 1 to 2 ms, and the time constant of a servo, 20 to
50 ms). A negative value is a reading that is ahead of the joint.
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.common import at_gears, side_of
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SHARE, TIME = 0.3, 1e-2  # of the remaining motion; s
AT_REST = 1e-7  # rad: rounding of angles in a file


def remaining(c: Circumstances) -> np.ndarray | None:
    """Commanded angles minus readings (N, n), rad, or None if no joint has a way to go in any row."""
    if c.command is None:
        return None
    way = c.command - c.readings
    return way if np.any(np.abs(way[c.fitted]) > AT_REST) else None


def _parameters(c: Circumstances) -> list[Parameter]:
    way, side = remaining(c), side_of(c.robot)
    if way is not None:
        return at_gears(c, "unsettled", way, side, ("1", SHARE), "remaining motion")
    assert c.velocity is not None
    return at_gears(c, "unsettled", c.velocity, side, ("s", TIME), "joint speed")


def _missing(c: Circumstances) -> str:
    first = ("j1_command_mm", "j1_mmps") if c.robot.slides[0] else ("j1_command_deg", "j1_degps")
    lacks = " ... or ".join(first)
    return "" if c.velocity is not None or remaining(c) is not None else f"no {lacks} ..."


UNSETTLED = Effect(
    "unsettled",
    "settling error of joint k: it is read before standstill",
    _parameters,
    _missing,
    sizes={"1": Size("share of the remaining motion"), "s": Size("time")},
    phrase=("every joint", "has a settling error: it is read before standstill"),
    remedy=(
        "Wait until the arm stands still before the reading (a dwell of a few time constants), "
        "approach more slowly, and check the brake release and the tuning of the joint controller."
    ),
    confusable_with=("backlash", "latency"),
)
