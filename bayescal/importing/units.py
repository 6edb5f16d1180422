"""Units, numbers, expressions on columns (``A3 + A2``, ``U95 / 2``)."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.errors import BayescalError
from bayescal.robots.servos import STEP, STEPS
from bayescal.storage.files import unknown


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
    "steps": Unit("steps", "angle", STEP, -STEP * STEPS / 2),
    **_units("rate", degps=_DEG, radps=1.0),
    **_units("speed", mmps=1e-3, mps=1.0),
    **_units("force", N=1.0),
    **_units("torque", Nm=1.0, mNm=1e-3, Ncm=1e-2),
    **_units("current", A=1.0, mA=1e-3),
    **_units("mass", kg=1.0, g=1e-3, lb=0.45359237),
    **_units("time", s=1.0, ms=1e-3, min=60.0, h=3600.0),
    "C": Unit("C", "temperature", 1.0),
    "K": Unit("K", "temperature", 1.0, -273.15),
    "F": Unit("F", "temperature", 5 / 9, -160 / 9),
}
"""By name; the dataset holds degrees Celsius. Steps of a servo are 4096 a turn, zero at half a turn."""

SPELLINGS = {
    "um": ("µm", "μm"),
    "mm": ("MM",),
    "in": ("inch", "inches", '"'),
    "deg": ("°", "degree", "degrees", "Deg", "DEG"),
    "rad": ("radian", "radians", "Rad", "RAD"),
    "degps": ("deg/s",),
    "radps": ("rad/s",),
    "mmps": ("mm/s",),
    "mps": ("m/s",),
    "Nm": ("N.m", "N*m", "nm"),
    "C": ("°C", "degC"),
    "F": ("°F",),
    "s": ("sec", "seconds"),
    "ms": ("msec",),
}
ALIASES = {spelling: name for name, spellings in SPELLINGS.items() for spelling in spellings}
"""Other spellings. ``nm`` is a torque, as in the dataset: nanometres do not occur in logs."""


def unit_of(name: str, dimension: str, where: str) -> Unit:
    """The unit called `name`; refused, with those that would do, unless it measures `dimension`."""
    unit = UNITS.get(ALIASES.get(name, name))
    if unit is not None and unit.dimension == dimension:
        return unit
    what = f"`{name}` is a unit of {unit.dimension}, not of {dimension}" if unit else f"unknown unit `{name}`"
    raise BayescalError(what, where, f"give one of {listed(dimension)}")


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
    for word in words[:-1]:
        if not is_number(word):
            raise BayescalError(f"'{word}' is not a number", where, "write plain numbers, then the unit")
    if len(words) != count + 1 or is_number(words[-1]):
        what = f"'{text}' is not {count} number{'s' * (count > 1)} and a unit of {dimension}"
        raise BayescalError(what, where, f"write it as `{'0 ' * count}{listed(dimension).split(', ')[0]}`")
    unit = unit_of(words[-1], dimension, where)
    return tuple(unit.scale * float(word) + unit.offset for word in words[:-1])


def is_number(text: str) -> bool:
    """Whether a cell holds a plain finite number."""
    try:
        return math.isfinite(float(text)) and "_" not in text
    except ValueError:
        return False


OPERATORS: dict[type, Callable[..., np.ndarray]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}

TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|\{(?P<braced>[^{}]+)\}|(?P<hash>#[1-9]\d*)"
    r"|(?P<name>[^\W\d][\w.]*)|(?P<sign>[-+*/()]))"
)
"""Names with other characters than letters, digits, ``_`` and ``.`` are enclosed in braces."""

LONGEST = 300
"""Characters of an expression."""


@dataclass(frozen=True)
class Expression:
    """Columns by index from 0, and the tree that combines them, `None` of a column alone."""

    text: str
    columns: tuple[int, ...]
    tree: ast.expr | None = None

    def value(self, numbers: Callable[[int], np.ndarray], count: int) -> np.ndarray:
        """The values (N,) of all rows, from those of a column, `numbers(index)`."""
        if self.tree is None:
            return numbers(self.columns[0])
        values = {f"c{i}": numbers(i) for i in self.columns}
        with np.errstate(all="ignore"):
            return np.broadcast_to(_walk(self.tree, values), (count,)).astype(float)


def place(name: str, header: Sequence[str], width: int, where: str) -> int:
    """Index of the column with a name (its unit in brackets may be left out) or a number (``#3``).

    Raises
    ------
    BayescalError
        If there is no such column, or several.
    """
    if re.fullmatch(r"#[1-9]\d*", name) and name not in header:
        if int(name[1:]) <= width:
            return int(name[1:]) - 1
        what = f"there is no column {name[1:]}, the file has {width} columns"
        raise BayescalError(what, where, "columns are numbered from 1")
    indices = [i for i, cell in enumerate(header) if cell == name]
    indices = indices or [i for i, cell in enumerate(header) if name_and_unit(cell)[0] == name]
    if len(indices) == 1:
        return indices[0]
    if indices:
        numbers = " and ".join(f"#{i + 1}" for i in indices)
        raise BayescalError(f"columns {numbers} are both called `{name}`", where, "give the number")
    _, remedy = unknown("column", name, header)
    hint = remedy if header else "the file has no header: use #1, #2, ... as column names"
    raise BayescalError(f"no column `{name}`", where, hint)


def parse(text: str, header: Sequence[str], width: int, where: str) -> Expression:
    """Read an expression on the columns of a header.

    Parameters
    ----------
    text : str
        The name of a column, or an expression.
    header : sequence of str
        Names of the columns; empty if there are none.
    width : int
        Number of columns.
    where : str
        For messages.

    Raises
    ------
    BayescalError
        For an unknown column, a text that is no expression, and a number that is the name of a column too.
    """
    is_name = text in header or any(name_and_unit(cell)[0] == text for cell in header)
    if is_name and is_number(text):
        what = f"`{text}` is the number {text} and the name of a column"
        raise BayescalError(what, where, f"write {{{text}}} for the column, {float(text)} for the number")
    tokens = None if is_name else _tokens(text)
    if tokens is None or (len(tokens) == 1 and tokens[0][0] != "number"):
        name = text if tokens is None else tokens[0][1]
        return Expression(text, (place(name, header, width, where),))
    columns: list[int] = []
    source = []
    for kind, token in tokens:
        if kind in ("number", "sign"):
            source.append(token)
        else:
            columns.append(place(token, header, width, where))
            source.append(f"c{columns[-1]}")
    try:
        tree = ast.parse(" ".join(source), mode="eval").body
        expression = Expression(text, tuple(dict.fromkeys(columns)), tree)
        expression.value(lambda _: np.ones(1), 1)
    except (SyntaxError, ValueError, RecursionError):
        remedy = "use columns, numbers, + - * / and parentheses"
        raise BayescalError(f"'{text}' is no expression", where, remedy) from None
    return expression


def _tokens(text: str) -> list[tuple[str, str]] | None:
    """Kinds and texts of the tokens; None if the text has characters of no token."""
    out: list[tuple[str, str]] = []
    position = 0
    text = text.strip()
    while position < len(text):
        match = TOKEN.match(text, position)
        if match is None or len(text) > LONGEST:
            return None
        out.append(next((kind, token) for kind, token in match.groupdict().items() if token))
        position = match.end()
    operands = [kind == "sign" for kind, _ in out]
    return None if not any(operands) and len(out) > 1 else out  # words: the name of a column


def _walk(tree: ast.AST, values: dict[str, np.ndarray]) -> np.ndarray:
    """The value of a tree; ValueError for anything but finite numbers, columns and `OPERATORS`."""
    if isinstance(tree, ast.BinOp) and type(tree.op) in OPERATORS:
        return OPERATORS[type(tree.op)](_walk(tree.left, values), _walk(tree.right, values))
    if isinstance(tree, ast.UnaryOp) and type(tree.op) in OPERATORS:
        return OPERATORS[type(tree.op)](_walk(tree.operand, values))
    if isinstance(tree, ast.Name):
        return values[tree.id]
    if isinstance(tree, ast.Constant) and isinstance(tree.value, (int, float)) and math.isfinite(tree.value):
        return np.asarray(float(tree.value))
    raise ValueError
