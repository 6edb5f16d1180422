"""Numbers of a record as text: µm from the keys in µm, "-" where there is none."""

from __future__ import annotations

from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.shared.text import um, um2, with_u

MISSING = "-"


def length(value: float | None) -> str:
    """A length in µm, three significant digits, without its unit."""
    return MISSING if value is None else um(1e-6 * value)


def uncertainty(value: float | None) -> str:
    """An uncertainty in µm, two significant digits, without its unit."""
    return MISSING if value is None else um2(1e-6 * value)


def interval(ends: list[float | None] | None, of: float = 1.0) -> str:
    """An interval in µm: ``4.3 to 6.6``."""
    if not ends or None in ends:
        return MISSING
    low, high = (of * end for end in ends if end is not None)
    return f"{length(low)} to {length(high)}"


def quantity(value: float | None, unit: str) -> str:
    """A value with its unit, two significant digits."""
    if value is None:
        return MISSING
    figures = f"{value:.2g}" if abs(value) < 99.5 else f"{float(f'{value:.2g}'):.0f}"
    return f"{figures} {unit_label(unit)}".rstrip()


def measured(value: float, u: float, unit: str) -> str:
    """A value with its standard uncertainty and unit: ``0.0244(10) deg``."""
    return f"{with_u(value, u)} {unit_label(unit)}".rstrip()


def share(value: float | None) -> str:
    """A fraction in per cent."""
    return MISSING if value is None else f"{100 * value:.0f} %"
