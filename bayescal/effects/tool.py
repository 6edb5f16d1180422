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
    out = []
    for k in (*c.fitted_tools, *c.predicted_tools):
        stated = c.tool_u[k]
        sd = LOOSE if stated is None else stated
        if sd == 0.0:
            continue
        used = (c.tool == k).astype(float)
        driver = 1.0 if np.all(used) else used
        for axis, name in enumerate("xyz"):
            terms = (Term(c.chain.n + 1, f"t{name}", driver),)
            label, nominal = f"{c.tool_names[k]} {name}", float(c.tool_centres[k, axis])
            out.append(Parameter(label, "m", terms, sd, nominal, site=location.TOOL))
    return [*out, *_turns(c)]


def _turns(c: Circumstances) -> list[Parameter]:
    """Rotation vector of each tool relative to its stated orientation, or else to a first estimate of it."""
    out = []
    for k in c.turned_tools:
        stated = c.tool_u_angle[k]
        sd = LOOSE_ANGLE if stated is None else stated
        if sd == 0.0:
            continue
        used = (c.tool == k).astype(float)
        for axis in ("rx", "ry", "rz"):
            terms = (Term(TURN, axis, used),)
            out.append(Parameter(f"{c.tool_names[k]} {axis}", "rad", terms, sd, site=location.TOOL))
    return out


TOOL = Effect(
    "tool",
    "position of the stylus tip in the flange frame, and orientation of the tool",
    _parameters,
    remedy=("Measure the tool centre point again, and check that the stylus and the flange bolts are tight."),
)
