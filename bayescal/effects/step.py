"""Step: a sudden shift of the base at a row n.

Driver: 0 before a row and 1 from this row on, for each of the six displacements of the base. The model is not
linear in the row. It is given, as ``step@212`` for the 212th row of the session; the default is the middle of
the fitted rows, which are in the order of time. A diagnosis scans the rows. A step ends with its session: of
several sessions, each has a step in its middle, or only the session with the given row has one. Prior:
0.05 mm and 0.1 mrad (assumed: 0.05 mm at half a metre; an operator would notice a larger shift).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.location import BASE, Driver
from bayescal.effects.sessions import apart, each, within
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Scan, Where

SD = {"t": ("m", 5e-5), "r": ("rad", 1e-4)}
ROWS = 48  # candidates
EDGE = 0.03  # share of the fitted rows that must be before, and after, a step


def after(c: Circumstances, row: float) -> np.ndarray:
    """1 from the given row (counted from 1) on, else 0, (N,)."""
    return (np.arange(len(c.q)) >= row - 1).astype(float)


def moments(c: Circumstances) -> np.ndarray:
    """Numbers (from 1) of rows that may be the first after a step, evenly spread over the fitted ones."""
    return np.concatenate([_moments(one.fitted) for one in each(c)])


def _moments(fitted: np.ndarray) -> np.ndarray:
    count = len(fitted)
    low = max(1, round(EDGE * count))
    at = np.unique(np.linspace(low, count - low, ROWS).round().astype(int))
    return fitted[at[(at > 0) & (at < count)]] + 1.0


def _at(c: Circumstances, row: float) -> list[Parameter]:
    if not c.sessions:
        return _shift(c, row)
    index = min(int(row), len(c.q)) - 1
    return [within(p, s) for s in c.sessions if s.rows[index] for p in _shift(c, row)]


def _shift(c: Circumstances, row: float) -> list[Parameter]:
    since = after(c, row)
    where: Where = {"site": BASE, "driver": Driver("event")}
    out = []
    for axis in ("tx", "ty", "tz", "rx", "ry", "rz"):
        unit, sd = SD[axis[0]]
        out.append(Parameter(f"step {axis.removeprefix('t')}", unit, (Term(0, axis, since),), sd, **where))
    return out


def _middle(c: Circumstances) -> list[Parameter]:
    return _shift(c, c.fitted[len(c.fitted) // 2] + 1.0)


def _missing(c: Circumstances) -> str:
    return "" if len(c.fitted) > 1 else "a step needs more than one row"


STEP = Effect(
    "step",
    "sudden shift of the base at row n",
    lambda c: apart(c, _middle),
    _missing,
    Scan("first row after it", "from row {:.0f} on", moments, _at),
    sizes={"m": Size("shift", length), "rad": Size("rotation", length)},
    phrase=("the base", "shifted suddenly"),
    confusable_with=("thermal-drift",),
)
