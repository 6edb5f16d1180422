"""Tool: the ball's centre in the flange frame, for every tool that the fitted rows use.

Part of every model; a tool whose uncertainty is stated as 0 stays as it is.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

LOOSE = 5e-3  # m, the contract's prior where none is stated


def _parameters(c: Circumstances) -> list[Parameter]:
    out = []
    for k in c.fitted_tools:
        stated = c.tool_u[k]
        sd = LOOSE if stated is None else stated
        if sd == 0.0:
            continue
        used = (c.tool == k).astype(float)
        driver = 1.0 if np.all(used) else used
        for axis, name in enumerate("xyz"):
            terms = (Term(c.chain.n + 1, f"t{name}", driver),)
            out.append(
                Parameter(
                    f"{c.tool_names[k]} {name}",
                    "m",
                    terms,
                    sd,
                    float(c.tool_centres[k, axis]),
                    site="tool",
                    driver="1",
                )
            )
    return out


TOOL = Effect("tool", "the ball's centre in the flange frame", _parameters)
