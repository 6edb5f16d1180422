"""Encoder scale: a joint turns by a little more or less than it reads.

Driver: what passes the encoder (`joints.side_of`), rad: of coupled axes the angle between the two links,
unless the robot file says that a linkage couples them. The other side is a form of its own, for a diagnosis
to weigh: ``encoder-scale@reading`` by the reading shown, on all links that it moves, ``encoder-scale@link``
between the links. Prior: 1e-4, so that a radian errs as much as the first harmonics do. Assumed: absolute
encoders and whole gear ratios leave no scale to err, but what is slower than one turn looks like it.
"""

from __future__ import annotations

from bayescal.effects.joints import at, motion, side_of, sides, turned
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 1e-4  # rad a rad


def _parameters(c: Circumstances, side: str) -> list[Parameter]:
    out = []
    for j, name in enumerate(c.robot.joint_names, start=1):
        angle = motion(c.robot, j, c.readings, side)
        if angle.any():
            terms = turned(c.robot, j, angle, side)
            out.append(Parameter(f"encoder-scale {name}", "1", terms, SD, **at(j, Driver("angle", j))))
    return out


ENCODER_SCALE = Effect(
    "encoder-scale",
    "joint k turns by more or less than its reading says",
    lambda c: _parameters(c, side_of(c.robot)),
    phrase=("every joint", "has an encoder scale error"),
    confusable_with=("eccentricity", "second-harmonic"),
    forms=sides(_parameters),
)
