"""Step: the base has been bumped, and stands elsewhere from then on.

Driver: 0 before a moment and 1 from it on, for each of the six displacements of the base. The moment is
not linear, so it is given: the middle of the fitted rows, which are in the order of time. Who suspects
another looks with `after` where it explains most. Prior: 0.05 mm and 0.1 mrad (assumed: 0.05 mm at
half a metre; a greater bump would have been noticed).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = {"t": ("m", 5e-5), "r": ("rad", 1e-4)}


def after(c: Circumstances, moment: float = 0.5) -> np.ndarray:
    """1 for the rows from a moment on, else 0, (N,); the moment as a share of the fitted rows."""
    first = c.fitted[min(int(moment * len(c.fitted)), len(c.fitted) - 1)]
    return (np.arange(len(c.q)) >= first).astype(float)


def _parameters(c: Circumstances) -> list[Parameter]:
    since = after(c)
    out = []
    for axis in ("tx", "ty", "tz", "rx", "ry", "rz"):
        unit, sd = SD[axis[0]]
        out.append(Parameter(f"step {axis.removeprefix('t')}", unit, (Term(0, axis, since),), sd))
    return out


def _missing(c: Circumstances) -> str:
    return "" if len(c.fitted) > 1 else "there is no before and after of a single row"


STEP = Effect("step", "a base that was bumped in the middle of the session", _parameters, _missing)
