"""Backlash: play in a gear, so that the link trails its motor by half the play, whichever way it turns.

Driver: the sign of the velocity of the *reading*, on every link that this reading moves: on coupled axes
the motors have the play, not the angles between links. A value below 0 trails, one above 0 leads. Prior:
0.08 mrad, from half-widths of 0.003 to 0.16 mrad (an ABB IRB 120 measured with a laser tracker; J4
and J6 worst).
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.joints import moved, without_velocity
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 8e-5  # rad


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.velocity is not None
    out = []
    for j, name in enumerate(c.robot.joint_names, start=1):
        way = np.sign(c.velocity[:, j - 1])
        if np.any(way):
            out.append(Parameter(f"backlash {name}", "rad", moved(c, j, way), SD))
    return out


BACKLASH = Effect("backlash", "play in the gears, by the way of approach", _parameters, without_velocity)
