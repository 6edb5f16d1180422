r"""Latency: the joints are read a time t after the contact, while the arm moves further.

Formula: $`\delta_n = t \, v_n`$; v is the speed of the ball towards the surface.

Driver: the speed of the ball towards the surface, m/s. Prior: 2 ms, from trigger delays of 1 to 2 ms. A
negative value is of readings that are older than the contact: they lag. If all contacts have the same speed,
latency is not distinguishable from the ball's radius.

Images of an arm that moves: t is the time by which the readings are later than the image.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects.common import without_surface, without_velocity
from bayescal.effects.imaging import at_view, late_images
from bayescal.effects.location import CAMERA, PROBE, Driver
from bayescal.effects.sizes import LATER, Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 2e-3  # s
CLOCK_SD = 20e-3  # s, of images: exposure, transfer and the clocks of two computers (assumed)


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.speed is not None
    assert c.velocity is not None
    speed = np.where(c.touching, c.speed, 0.0)
    terms = (Term(CONTACT, "normal", speed),)
    parameter = Parameter("latency", "s", terms, SD, site=PROBE, driver=Driver("contact speed"))
    out = [parameter] if speed.any() else []
    for v in c.views:
        turns, site = late_images(c, v), at_view(v, CAMERA)
        clock = Parameter(f"latency {v.name}", "s", turns, CLOCK_SD, site=site, driver=Driver("clock"))
        out += [clock] if turns else []
    return out


LATENCY = Effect(
    "latency",
    "joint readings later than the measurement by t, or older (t < 0)",
    _parameters,
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
