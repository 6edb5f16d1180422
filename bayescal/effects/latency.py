"""Latency: the joints are read a moment after the ball touched, when the arm has gone on.

Driver: the speed of the ball into the surface, m/s. Prior: 2 ms, from trigger delays of 1 to 2 ms; a
value below 0 is one that the controller makes up for too well. At one speed it cannot be told from the
ball's radius.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects.joints import without_surface, without_velocity
from bayescal.effects.location import PROBE, Driver
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 2e-3  # s


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.speed is not None
    speed = np.where(c.touching, c.speed, 0.0)
    term = Term(CONTACT, "normal", speed)
    return (
        [Parameter("latency", "s", (term,), SD, site=PROBE, driver=Driver("contact speed"))]
        if speed.any()
        else []
    )


def _missing(c: Circumstances) -> str:
    return without_surface(c) or without_velocity(c)


LATENCY = Effect(
    "latency",
    "joint readings delayed by t",
    _parameters,
    _missing,
    phrase=("every joint", "has delayed readings"),
)
