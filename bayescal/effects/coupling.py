"""Coupling: turning a joint turns the next one a little, through a shared gear train.

Driver: the reading of the joint before, rad, acting as an error of the joint's own reading. Prior: 1e-4,
like an encoder's scale. Assumed: of an ABB IRB 120 measured with a laser tracker nothing was to be seen
at the wrist.
"""

from __future__ import annotations

from bayescal.effects.joints import moved
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 1e-4  # rad a rad


def _parameters(c: Circumstances) -> list[Parameter]:
    names = c.robot.joint_names
    return [
        Parameter(f"coupling {names[j - 2]} to {names[j - 1]}", "1", moved(c, j, c.readings[:, j - 2]), SD)
        for j in range(2, c.robot.n + 1)
        if c.readings[:, j - 2].any()
    ]


COUPLING = Effect("coupling", "joints that turn with the one before", _parameters)
