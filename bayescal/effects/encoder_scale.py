"""Encoder scale: a joint turns by a little more or less than it reads.

Driver: the joint's reading, rad, on every link that this reading moves. Prior: 1e-4, so that a radian
errs as much as the first harmonics do. Assumed: absolute encoders and whole gear ratios leave no scale
to err, but what is slower than one turn looks like it.
"""

from __future__ import annotations

from bayescal.effects.joints import at, moved
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 1e-4  # rad a rad


def _parameters(c: Circumstances) -> list[Parameter]:
    return [
        Parameter(f"encoder-scale {name}", "1", moved(c, j, c.readings[:, j - 1]), SD, **at(j, f"angle {j}"))
        for j, name in enumerate(c.robot.joint_names, start=1)
        if c.readings[:, j - 1].any()
    ]


ENCODER_SCALE = Effect(
    "encoder-scale",
    "joint k turns by more or less than its reading says",
    _parameters,
    phrase=("every joint", "has an encoder scale error"),
    confusable_with=("eccentricity", "second-harmonic"),
)
