"""Step: the base has been bumped, and stands elsewhere from then on.

Driver: 0 before a row and 1 from it on, for each of the six displacements of the base. The row is not
linear: it is given, as ``step@212`` for the 212th row of the session, or is the middle one of the fitted
rows, which are in the order of time. Who suspects another scans them. A step ends with its session: of
several, each has one in its middle, or the one with that row has it. Prior: 0.05 mm and 0.1 mrad (assumed:
0.05 mm at half a metre; a greater bump would have been noticed).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.location import BASE, Driver
from bayescal.effects.sessions import apart, each, within
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Scan, Where

SD = {"t": ("m", 5e-5), "r": ("rad", 1e-4)}
MOMENTS = 48
EDGE = 0.03  # of the fitted rows: before and after must each show themselves


def after(c: Circumstances, row: float) -> np.ndarray:
    """1 from the row of that number (from 1) on, else 0, (N,)."""
    return (np.arange(len(c.q)) >= row - 1).astype(float)


def moments(c: Circumstances) -> np.ndarray:
    """Numbers (from 1) of rows that may be the first after a step, evenly spread over the fitted ones."""
    return np.concatenate([_moments(one.fitted) for one in each(c)])


def _moments(fitted: np.ndarray) -> np.ndarray:
    count = len(fitted)
    low = max(1, round(EDGE * count))
    at = np.unique(np.linspace(low, count - low, MOMENTS).round().astype(int))
    return fitted[at[(at > 0) & (at < count)]] + 1.0


def _at(c: Circumstances, row: float) -> list[Parameter]:
    if not c.sessions:
        return _bump(c, row)
    index = min(int(row), len(c.q)) - 1
    return [within(p, s) for s in c.sessions if s.rows[index] for p in _bump(c, row)]


def _bump(c: Circumstances, row: float) -> list[Parameter]:
    since = after(c, row)
    where: Where = {"site": BASE, "driver": Driver("event")}
    out = []
    for axis in ("tx", "ty", "tz", "rx", "ry", "rz"):
        unit, sd = SD[axis[0]]
        out.append(Parameter(f"step {axis.removeprefix('t')}", unit, (Term(0, axis, since),), sd, **where))
    return out


def _middle(c: Circumstances) -> list[Parameter]:
    return _bump(c, c.fitted[len(c.fitted) // 2] + 1.0)


def _missing(c: Circumstances) -> str:
    return "" if len(c.fitted) > 1 else "there is no before and after of a single row"


STEP = Effect(
    "step",
    "sudden shift of the base at row n",
    lambda c: apart(c, _middle),
    _missing,
    Scan("first row after it", "from row {:.0f} on", moments, _at),
    phrase=("the base", "shifted suddenly"),
    confusable_with=("thermal-drift",),
)
