"""Errors of readings that are taken at another time than the measurement, or before standstill."""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects.common import at_gears, side_of, without_surface, without_velocity
from bayescal.effects.imaging import at_view, late_images
from bayescal.effects.location import CAMERA, LATER, PROBE, Driver, Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

LATENCY_SD = 2e-3  # s
CLOCK_SD = 20e-3  # s, of images: exposure, transfer and the clocks of two computers (assumed)


def _latency(c: Circumstances) -> list[Parameter]:
    assert c.speed is not None
    assert c.velocity is not None
    speed = np.where(c.touching, c.speed, 0.0)
    terms = (Term(CONTACT, "normal", speed),)
    parameter = Parameter("latency", "s", terms, LATENCY_SD, site=PROBE, driver=Driver("contact speed"))
    out = [parameter] if speed.any() else []
    for v in c.views:
        turns, site = late_images(c, v), at_view(v, CAMERA)
        clock = Parameter(f"latency {v.name}", "s", turns, CLOCK_SD, site=site, driver=Driver("clock"))
        out += [clock] if turns else []
    return out


LATENCY = Effect(
    "latency",
    "joint readings later than the measurement by t, or older (t < 0)",
    _latency,
    lambda c: (without_surface(c) if not c.views else "") or without_velocity(c),
    sizes={"s": Size(LATER)},
    phrase=("every joint", "has readings of another time than the measurement"),
    remedy=(
        "Measure more slowly or at rest, latch the joint readings by hardware at the trigger, or correct the "
        "delay in the controller. Measurements at two speeds show the delay."
    ),
    confusable_with=("unsettled",),
    directed=True,
    side="clock",
)
r"""Latency: the joints are read a time t after the contact, while the arm moves further.

Formula: $`\delta_n = t \, v_n`$; v is the speed of the ball towards the surface.

Driver: the speed of the ball towards the surface, m/s. Prior: 2 ms, from trigger delays of 1 to 2 ms. A
negative value is of readings that are older than the contact: they lag. If all contacts have the same speed,
latency is not distinguishable from the ball's radius.

Images of an arm that moves: t is the time by which the readings are later than the image.
"""


SHARE, TIME = 0.3, 1e-2  # of the remaining motion; s
AT_REST = 1e-7  # rad: rounding of angles in a file


def remaining(c: Circumstances) -> np.ndarray | None:
    """Commanded angles minus readings (N, n), rad, or None if no joint has a way to go in any row."""
    if c.command is None:
        return None
    way = c.command - c.readings
    return way if np.any(np.abs(way[c.fitted]) > AT_REST) else None


def _unsettled(c: Circumstances) -> list[Parameter]:
    way, side = remaining(c), side_of(c.robot)
    if way is not None:
        return at_gears(c, "unsettled", way, side, ("1", SHARE), "remaining motion")
    assert c.velocity is not None
    return at_gears(c, "unsettled", c.velocity, side, ("s", TIME), "joint speed")


def _unsettled_missing(c: Circumstances) -> str:
    first = ("j1_command_mm", "j1_mmps") if c.robot.slides[0] else ("j1_command_deg", "j1_degps")
    lacks = " ... or ".join(first)
    return "" if c.velocity is not None or remaining(c) is not None else f"no {lacks} ..."


UNSETTLED = Effect(
    "unsettled",
    "settling error of joint k: it is read before standstill",
    _unsettled,
    _unsettled_missing,
    sizes={"1": Size("share of the remaining motion"), "s": Size("time")},
    phrase=("every joint", "has a settling error: it is read before standstill"),
    remedy=(
        "Wait until the arm stands still before the reading (a dwell of a few time constants), "
        "approach more slowly, and check the brake release and the tuning of the joint controller."
    ),
    confusable_with=("backlash", "latency"),
)
r"""Settling error: a joint is read before it stands still, and moves on in its direction of motion.

Formula: $`\rho_{z,k} = x_k \, (q_{\mathrm{command},k} - q_k)`$; or x times the speed.

Driver: the remaining motion at the gear (`common.side_of`), which is the commanded angle minus the reading
(`jN_command_deg`); the value is the share of it that follows after the reading. If there are no commanded
angles, or the readings are these, the driver is the speed of the joint, and the value is a time. Backlash
follows the sign of the speed instead, and `latency` is one time for all joints at a contact. Prior: a share
of 0.3, and 10 ms (assumed: between the delay of a trigger, 1 to 2 ms, and the time constant of a servo, 20 to
50 ms). A negative value is a reading that is ahead of the joint.
"""
