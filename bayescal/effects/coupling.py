"""Coupling: turning a joint turns its neighbours a little, through a shared gear train.

Driver: the reading of one of the two joints before, or of the one after, rad, acting as an error of the
joint's own reading. Prior: 1e-4, like an encoder's scale. Assumed: of an ABB IRB 120 measured with a laser
tracker nothing was to be seen at the wrist.
"""

from __future__ import annotations

from bayescal.effects.joints import at, moved
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 1e-4  # rad a rad
BEFORE = 2  # joints: gear trains run through a wrist, from J4 to J5 and J6


def _parameters(c: Circumstances) -> list[Parameter]:
    names = c.robot.joint_names
    return [
        Parameter(
            f"coupling {names[k - 1]} to {names[j - 1]}", "1", moved(c, j, c.readings[:, k - 1]), SD,
            **at(j, f"angle {k}"),
        )
        for j in range(1, c.robot.n + 1)
        for k in range(max(1, j - BEFORE), min(c.robot.n, j + 1) + 1)
        if k != j and c.readings[:, k - 1].any()
    ]  # fmt: skip


COUPLING = Effect(
    "coupling",
    "joint k turns when a neighbouring joint turns",
    _parameters,
    phrase=("every joint", "has an error proportional to the preceding joint"),
    confusable_with=("bending",),
)
