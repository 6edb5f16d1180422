"""Ticks that have room: as many as the width of an axis allows."""

from collections.abc import Sequence
from typing import Any

import numpy as np

MM_PER_INCH = 25.4
EACH = 14.0
"""Room of a tick label on the x axis, mm."""
UP = 8.0
"""Room of a tick label on the y axis, mm."""
APART = 8.0
"""Least distance of two tick labels on a logarithmic axis, mm."""
STEPS = ((1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0), (1.0, 2.0, 3.0, 5.0), (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))
"""Ticks of a decade, from many to few."""


def size_of(axes: Any) -> tuple[float, float]:
    """Width and height of axes, mm."""
    box, per_mm = axes.get_window_extent(), axes.figure.dpi / MM_PER_INCH
    return float(box.width / per_mm), float(box.height / per_mm)


def width_of(axes: Any) -> float:
    """The width of axes, mm."""
    return size_of(axes)[0]


def linear(axis: Any, room: float, each: float = EACH) -> None:
    """Ticks of a linear axis that is `room` mm long, `each` mm for a label."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(max(int(room / each), 2), steps=[1, 2, 2.5, 5, 10]))


def linear_both(axes: Any, tall: float, each: float = EACH) -> None:
    """Ticks of linear axes that are `tall` mm high, `each` mm for a label of x."""
    linear(axes.xaxis, width_of(axes), each)
    linear(axes.yaxis, tall, UP)


def linear_x(axes: Any, low: float, high: float, each: float = EACH) -> None:
    """A linear x axis between limits, `each` mm for a label."""
    axes.set_xlim(low, high)
    linear(axes.xaxis, width_of(axes), each)


def without_y(axes: Any) -> None:
    """No ticks and no line of the y axis."""
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def log_x(axes: Any, values: Sequence[float]) -> None:
    """A logarithmic x axis about values."""
    axes.set_xscale("log")
    axes.set_xlim(*_log_ticks(axes.xaxis, values, width_of(axes)))


def log_y(axes: Any, values: Sequence[float], tall: float) -> None:
    """A logarithmic y axis, `tall` mm high, about values."""
    axes.set_yscale("log")
    axes.set_ylim(*_log_ticks(axes.yaxis, values, tall))


def _log_ticks(axis: Any, values: Sequence[float], room: float) -> tuple[float, float]:
    """Set the ticks of a logarithmic axis that is `room` mm long; its limits are returned."""
    from matplotlib.ticker import FixedLocator, NullLocator

    low, high = around(values)
    for steps, every in (*((ticks, 1) for ticks in STEPS), ((1.0,), 2), ((1.0,), 3)):
        chosen = ticks_of(low, high, steps)[::every]
        if np.all(np.diff(np.log(chosen)) * room / np.log(high / low) >= APART):
            break
    axis.set_major_locator(FixedLocator(chosen))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: f"{value:.10g}")
    return low, high


def ticks_of(low: float, high: float, steps: Sequence[float]) -> list[float]:
    """Ticks of logarithmic axes within the limits."""
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [s * 10.0**d for d in decades for s in steps if low <= s * 10.0**d * 1.0000001 <= high * 1.000001]


def around(values: Sequence[float], pad: float = 0.06) -> tuple[float, float]:
    """Limits of a logarithmic axis about positive values, at least a factor of three apart."""
    logs = np.log(np.asarray(values, float))
    low, high = float(np.min(logs)), float(np.max(logs))
    more = max(pad * (high - low), 0.5 * (np.log(3.0) - (high - low)))
    return float(np.exp(low - more)), float(np.exp(high + more))
