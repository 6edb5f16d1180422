"""Ticks that have room: as many as the width of an axis allows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axis import Axis

EACH = 14.0
"""Room of a tick label on the x axis, mm."""
UP = 8.0
"""Room of a tick label on the y axis, mm."""
APART = 8.0
"""Least distance of two tick labels on a logarithmic axis, mm."""
STEPS = ((1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0), (1.0, 2.0, 3.0, 5.0), (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))
"""Ticks of a decade, from many to few."""


def linear(axis: Axis, room: float, each: float = EACH) -> None:
    """Ticks of a linear axis that is `room` mm long, `each` mm for a label."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(max(int(room / each), 2), steps=[1, 2, 2.5, 5, 10]))


def log(axis: Axis, low: float, high: float, room: float) -> None:
    """Ticks of a logarithmic axis from `low` to `high` that is `room` mm long."""
    from matplotlib.ticker import FixedLocator, NullLocator

    length = np.log(high / low)
    for steps, every in (*((own, 1) for own in STEPS), ((1.0,), 2), ((1.0,), 3)):
        chosen = ticks_of(low, high, steps)[::every]
        if np.all(np.diff(np.log(chosen)) * room / length >= APART):
            break
    axis.set_major_locator(FixedLocator(chosen))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: f"{value:.10g}")


def ticks_of(low: float, high: float, steps: Sequence[float]) -> list[float]:
    """Ticks of logarithmic axes within the limits."""
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [s * 10.0**d for d in decades for s in steps if low <= s * 10.0**d * 1.0000001 <= high * 1.000001]


def around(values: Sequence[float], pad: float = 0.06) -> tuple[float, float]:
    """Limits of a logarithmic axis about positive values, at least a factor of three apart."""
    at = np.log(np.asarray(values, float))
    low, high = float(np.min(at)), float(np.max(at))
    more = max(pad * (high - low), 0.5 * (np.log(3.0) - (high - low)))
    return float(np.exp(low - more)), float(np.exp(high + more))
