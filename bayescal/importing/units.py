"""Units that people write, and what one is in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from bayescal.errors import BayescalError


@dataclass(frozen=True)
class Unit:
    """``SI = scale x value + offset``; `dimension` says what it measures."""

    name: str
    dimension: str
    scale: float
    offset: float = 0.0


def _units(dimension: str, **scale: float) -> dict[str, Unit]:
    return {name: Unit(name, dimension, value) for name, value in scale.items()}


_DEG = math.pi / 180

UNITS: dict[str, Unit] = {
    **_units("length", mm=1e-3, m=1.0, cm=1e-2, um=1e-6, **{"in": 0.0254}),
    **_units("angle", deg=_DEG, rad=1.0, mrad=1e-3),
    **_units("rate", degps=_DEG, radps=1.0),
    **_units("torque", Nm=1.0, mNm=1e-3, Ncm=1e-2),
    **_units("mass", kg=1.0, g=1e-3, lb=0.45359237),
    **_units("time", s=1.0, ms=1e-3, min=60.0, h=3600.0),
    "C": Unit("C", "temperature", 1.0),
    "K": Unit("K", "temperature", 1.0, -273.15),
    "F": Unit("F", "temperature", 5 / 9, -160 / 9),
}
"""By name; the dataset holds degrees Celsius."""

ALIASES = {
    "µm": "um",
    "μm": "um",
    "inch": "in",
    '"': "in",
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "radians": "rad",
    "deg/s": "degps",
    "rad/s": "radps",
    "N.m": "Nm",
    "N*m": "Nm",
    "nm": "Nm",
    "°C": "C",
    "degC": "C",
    "°F": "F",
    "sec": "s",
    "seconds": "s",
    "msec": "ms",
    "Deg": "deg",
    "DEG": "deg",
    "Rad": "rad",
    "RAD": "rad",
    "MM": "mm",
    "inches": "in",
}
"""Other spellings. ``nm`` is a torque, as in the dataset: nanometres do not occur in logs."""


def unit_of(name: str, dimension: str, where: str) -> Unit:
    """The unit called `name`; refused, with those that would do, unless it measures `dimension`."""
    unit = UNITS.get(ALIASES.get(name, name))
    known = f"give one of {listed(dimension)}"
    if unit is None:
        raise BayescalError(f"unknown unit `{name}`", where, known)
    if unit.dimension != dimension:
        raise BayescalError(f"`{name}` is a unit of {unit.dimension}, not of {dimension}", where, known)
    return unit


def name_and_unit(cell: str) -> tuple[str, Unit | None]:
    """Name and stated unit, or None, of a cell of a header such as ``X [mm]``, ``A1 (deg)``, ``T / °C``."""
    parts = re.fullmatch(r"(.+?)\s*(?:\[(.+)\]|\((.+)\)|<(.+)>|\s/\s*(.+))", cell)
    name = next((part for part in parts.groups()[1:] if part), "").strip() if parts else ""
    return (parts[1], UNITS[ALIASES.get(name, name)]) if parts and is_unit(name) else (cell, None)


def is_unit(name: str) -> bool:
    """Whether a word is the name of a unit."""
    return ALIASES.get(name, name) in UNITS


def listed(dimension: str) -> str:
    """Names of the units of a dimension."""
    return ", ".join(name for name, unit in UNITS.items() if unit.dimension == dimension)


def meant(unit: Unit, factor: float) -> str:
    """Name of the unit that is `factor` times `unit`; empty if none is."""
    for other in UNITS.values():
        if other.dimension == unit.dimension and math.isclose(other.scale, factor * unit.scale, rel_tol=1e-6):
            return other.name
    return ""


def quantity(text: str, dimension: str, count: int, where: str) -> tuple[float, ...]:
    """Values in SI of a text such as ``0 0 31 mm``: `count` numbers and their unit."""
    words = text.replace(",", " ").split()
    numbers = list(_floats(words[:-1], where))
    if len(words) != count + 1 or is_number(words[-1]):
        what = f"'{text}' is not {count} number{'s' * (count > 1)} and a unit of {dimension}"
        raise BayescalError(what, where, f"write it as `{'0 ' * count}{listed(dimension).split(', ')[0]}`")
    unit = unit_of(words[-1], dimension, where)
    return tuple(unit.scale * n + unit.offset for n in numbers)


def is_number(text: str) -> bool:
    """Whether a cell holds a plain finite number."""
    try:
        return math.isfinite(float(text)) and "_" not in text
    except ValueError:
        return False


def _floats(words: Iterable[str], where: str) -> Iterable[float]:
    for word in words:
        if not is_number(word):
            raise BayescalError(f"'{word}' is not a number", where, "write plain numbers, then the unit")
        yield float(word)
