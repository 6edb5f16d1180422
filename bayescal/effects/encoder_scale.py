r"""Encoder scale: a joint turns by slightly more or less than its reading.

Formula: $`\rho_{z,k} = s_k q_k`$; of a prismatic joint $`\delta_{z,k} = s_k q_k`$.

Driver: the angle that the encoder measures (`common.side_of`), rad. For coupled axes this is the angle
between the two links, unless the robot file states that a linkage couples them. The other side is a separate
form, which a diagnosis compares: ``encoder-scale@reading`` acts with the displayed reading on all links that
it moves, ``encoder-scale@link`` acts between the links. Prior: 1e-4, so that the error at one radian equals
the prior of the first harmonics. Assumed: absolute encoders and integer gear ratios have no scale error, but
a periodic error with less than one period per revolution looks like one. The same of a linear scale or a
rack: 0.1 mm/m (assumed).
"""

from __future__ import annotations

from bayescal.effects.common import at_gears, side_of, sides
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 1e-4  # rad per rad


def _parameters(c: Circumstances, side: str) -> list[Parameter]:
    return at_gears(c, "encoder-scale", c.readings, side, ("1", SD), "angle")


ENCODER_SCALE = Effect(
    "encoder-scale",
    "joint k turns by more or less than its reading says",
    lambda c: _parameters(c, side_of(c.robot)),
    sizes={"1": Size("relative error of the reading")},
    phrase=("every joint", "has an encoder scale error"),
    remedy=(
        "Check the gear ratio and the encoder resolution in the controller, and the teeth and tension "
        "of a timing belt. An absolute encoder with a true scale error must be replaced."
    ),
    confusable_with=("eccentricity", "second-harmonic", "positioning"),
    forms=sides(_parameters),
    in_robot_file=True,
    simulated_within=5e-8,
)
