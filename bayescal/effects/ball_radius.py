r"""Ball radius: a stylus ball larger or smaller than stated, or a pre-travel equal in all directions.

Formula: $`\delta_n = -x`$; the displacement of the ball along the direction of contact.

Driver: minus one at every contact with a surface, because a larger ball touches further out. Prior: 10 µm,
from a pre-travel of 5 to 20 µm. The two causes are not distinguishable by construction. Neither is
distinguishable from the offsets of planes without a stated position. Only a certified length between
opposite faces, or a certified diameter, makes the effect identifiable. There an error b looks like a scale
error of 2 b divided by the length. Without such a certificate the effect is not identifiable.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects.common import without_surface
from bayescal.effects.location import PROBE
from bayescal.effects.sizes import Size
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
    sizes={"m": Size("deviation of the radius")},
    phrase=("the probe", "has a stylus-ball radius that differs from its stated value"),
    remedy=(
        "Replace a worn stylus or clean its ball, and check the diameter that was entered. Qualify "
        "the probe on a reference sphere with the trigger speed of the task."
    ),
)
