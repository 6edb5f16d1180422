"""Ball radius: a ball larger or smaller than stated, or a pre-travel alike in every direction.

Driver: minus one at every contact with a surface: a larger ball touches further out. Prior: 10 um, from
a pre-travel of 5 to 20 um. By construction neither of the two can be told from the other, nor from the
offsets of planes that nothing is stated of: only a certified length between opposite faces, or a
certified diameter, tells, and there an error b looks like one of scale, 2 b over the length. Without
such a certificate the prior is all that is known.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects.joints import without_surface
from bayescal.effects.location import PROBE
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 10e-6  # m


def _parameters(c: Circumstances) -> list[Parameter]:
    out = []
    for k in c.fitted_tools:
        used = c.touching & (c.tool == k)
        if np.any(used):
            larger = (Term(CONTACT, "normal", -used.astype(float)),)
            name = f"ball-radius {c.tool_names[k]}"
            out.append(Parameter(name, "m", larger, SD, c.tool_radii[k] or 0.0, site=PROBE))
    return out


BALL_RADIUS = Effect(
    "ball-radius",
    "effective stylus-ball radius differs from its stated value",
    _parameters,
    without_surface,
    phrase=("the probe", "has a stylus-ball radius that differs from its stated value"),
)
