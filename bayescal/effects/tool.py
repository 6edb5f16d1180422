"""Tool: the TCP offset, the stylus tip in the flange frame, of every tool that the fitted measurements use.

A tool that only validation measurements of fitted targets use keeps its prior, which their prediction has.
Also the tool's orientation on the flange, if rows read it. Part of every model. A tool with a stated
uncertainty of 0 is not fitted.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import TURN, Term
from bayescal.effects import location
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

LOOSE, LOOSE_ANGLE = 5e-3, 0.2  # m, rad: the contract's priors if none is stated


def _parameters(c: Circumstances) -> list[Parameter]:
    """The point of each tool, and the turn from its stated or first estimated orientation."""
    end, out = c.chain.n + 1, list[Parameter]()
    used_tools = (*c.fitted_tools, *c.predicted_tools)
    places = [(k, c.tool_u[k], LOOSE, "m", end, "t", c.tool_centres[k].tolist()) for k in used_tools]
    turns = [(k, c.tool_u_angle[k], LOOSE_ANGLE, "rad", TURN, "r", [0.0] * 3) for k in c.turned_tools]
    for k, stated, loose, unit, frame, kind, nominal in (*places, *turns):
        sd = loose if stated is None else stated
        used = (c.tool == k).astype(float)
        driver = 1.0 if np.all(used) else used
        for axis, value in zip("xyz", nominal, strict=True) if sd else ():
            name = f"{c.tool_names[k]} {(kind + axis).removeprefix('t')}"
            terms = (Term(frame, kind + axis, driver),)
            out.append(Parameter(name, unit, terms, sd, value, site=location.TOOL))
    return out


TOOL = Effect(
    "tool",
    "position of the stylus tip in the flange frame, and orientation of the tool",
    _parameters,
    remedy=("Measure the tool centre point again, and check that the stylus and the flange bolts are tight."),
)
