"""Units, numbers, expressions on columns (``A3 + A2``, ``U95 / 2``), and conventions of orientations.

Sources of the conventions: the programming manuals of the manufacturers, for the order and the axes of their
angles; UR: rotation vector, in the description of `p[x, y, z, rx, ry, rz]`; ABB: orient, q1 is the real part.
"""

import ast
import math
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rpy_matrix, rpy_of
from bayescal.dataset.table import is_written_number
from bayescal.errors import BayescalError
from bayescal.robots.servos import STEP, STEPS
from bayescal.storage.files import unknown
from bayescal.storage.reading import table_beside


@dataclass(frozen=True)
class Unit:
    """``SI = scale x value + offset``; `dimension` says what it measures."""

    name: str
    dimension: str
    scale: float
    offset: float = 0.0


_STATED = [
    (Unit(name, dimension, stated["scale"], stated.get("offset", 0.0)), stated.get("also", ()))
    for dimension, units in table_beside(__file__, "units.toml").items()
    for name, stated in units.items()
]
UNITS = {unit.name: unit for unit, _ in _STATED} | {"steps": Unit("steps", "angle", STEP, -STEP * STEPS / 2)}
"""By name; the dataset holds degrees Celsius. Steps of a servo are 4096 a turn, zero at half a turn."""
SPELLED = UNITS | {spelling: unit for unit, also in _STATED for spelling in also}
"""By name and by other spellings."""


def unit_of(name: str, dimension: str, where: str) -> Unit:
    """The unit called `name`; refused, with those that would do, unless it measures `dimension`."""
    unit = SPELLED.get(name)
    if unit is not None and unit.dimension == dimension:
        return unit
    what = f"`{name}` is a unit of {unit.dimension}, not of {dimension}" if unit else f"unknown unit `{name}`"
    raise BayescalError(what, where, f"give one of {listed(dimension)}")


def name_and_unit(cell: str) -> tuple[str, Unit | None]:
    """Name and stated unit, or None, of a cell of a header such as ``X [mm]``, ``A1 (deg)``, ``T / °C``."""
    parts = re.fullmatch(r"(.+?)\s*(?:\[(.+)\]|\((.+)\)|<(.+)>|\s/\s*(.+))", cell)
    name = next((part for part in parts.groups()[1:] if part), "").strip() if parts else ""
    return (parts[1], SPELLED[name]) if parts and name in SPELLED else (cell, None)


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
    return is_written_number(text) and math.isfinite(float(text))


OPERATORS: dict[type, Callable[..., np.ndarray]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: np.divide,
    ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip

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
    indices = indices or [i for i, cell in enumerate(header) if cell == name.lstrip("% ")]  # of a comment
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


LOOSE = 1e-3
"""Deviation of a quaternion from unit length, or of a matrix from a rotation: rounding is less."""


@dataclass(frozen=True)
class Convention:
    """`count` numbers a row, angles or not; the rotations, or matrices, of numbers (N, count); words."""

    count: int
    angles: bool
    rotations: Callable[[np.ndarray], Rotation | np.ndarray]
    words: str


REAL_FIRST = partial(Rotation.from_quat, scalar_first=True)
CONVENTIONS: dict[str, Convention] = {
    "rpy": Convention(3, True, rpy_matrix, "R = Rz(third) Ry(second) Rx(first)"),
    "wpr": Convention(3, True, rpy_matrix, "FANUC W P R: R = Rz(R) Ry(P) Rx(W)"),
    "abc": Convention(3, True, partial(Rotation.from_euler, "ZYX"), "KUKA A B C: R = Rz(A) Ry(B) Rx(C)"),
    "zyx": Convention(3, True, partial(Rotation.from_euler, "ZYX"), "R = Rz(first) Ry(second) Rx(third)"),
    "xyz": Convention(3, True, partial(Rotation.from_euler, "XYZ"), "Stäubli Rx Ry Rz: R = Rx Ry Rz"),
    "oat": Convention(3, True, partial(Rotation.from_euler, "ZYZ"), "Kawasaki O A T: R = Rz(O) Ry(A) Rz(T)"),
    "rotvec": Convention(3, True, Rotation.from_rotvec, "Universal Robots: rotation vector"),
    "wxyz": Convention(4, False, REAL_FIRST, "quaternion, real part first (ABB q1 ... q4)"),
    "xyzw": Convention(4, False, Rotation.from_quat, "quaternion, real part last (ROS)"),
    "matrix": Convention(9, False, lambda v: v.reshape(-1, 3, 3), "rotation matrix, row by row"),
    "matrix-columns": Convention(
        9, False, lambda v: v.reshape(-1, 3, 3).transpose(0, 2, 1), "rotation matrix, column by column"
    ),
}
"""By the word that states them in a map."""


def not_rotations(values: np.ndarray, name: str) -> tuple[np.ndarray, str]:
    """Rows (N,) of numbers (N, count) that are no rotation, and in words what they are not."""
    if name in ("wxyz", "xyzw"):
        return np.abs(np.linalg.norm(values, axis=1) - 1) > LOOSE, "a unit quaternion"
    if name.startswith("matrix"):
        m = values.reshape(-1, 3, 3)
        off = np.abs(m @ m.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        return (off > LOOSE) | (np.linalg.det(np.nan_to_num(m)) < 0), "a rotation matrix"
    return np.zeros(len(values), bool), ""


def matrices(values: np.ndarray, name: str) -> np.ndarray:
    """Rotation matrices (N, 3, 3) of numbers (N, count), angles in rad; nan where a number is missing."""
    given = np.isfinite(values).all(axis=1)
    out = np.full((len(values), 3, 3), np.nan)
    if given.any():
        turns = CONVENTIONS[name].rotations(values[given])
        u, _, vt = np.linalg.svd(turns.as_matrix() if isinstance(turns, Rotation) else turns)
        out[given] = u @ vt  # the nearest rotation, of rounded numbers
    return out


def roll_pitch_yaw(turns: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (N, 3), rad, of rotation matrices (N, 3, 3); nan where these are."""
    return np.array([rpy_of(turn) if np.isfinite(turn).all() else np.full(3, np.nan) for turn in turns])


def stated_rotation(text: str, where: str) -> np.ndarray:
    """Roll, pitch, yaw (3,), rad, of a text such as ``0 0 90 wpr deg`` or ``1 0 0 0 wxyz``.

    Raises
    ------
    BayescalError
        For a convention that is not known, another count of numbers, and what is no rotation.
    """
    words = text.replace(",", " ").split()
    unit = unit_of(words.pop(), "angle", where) if words and words[-1] in SPELLED else None
    name = words.pop() if words else ""
    convention = CONVENTIONS.get(name)
    if convention is None or len(words) != convention.count or convention.angles == (unit is None):
        what = f"'{text.strip()}' is not an orientation"
        remedy = f"write `0 0 90 wpr deg` or `1 0 0 0 wxyz`; {', '.join(CONVENTIONS)}"
        raise BayescalError(what, where, remedy)
    if not all(map(is_number, words)):
        raise BayescalError(f"'{text.strip()}' has a word that is not a number", where, "write plain numbers")
    values = np.array([[float(word) for word in words]]) * (unit.scale if unit else 1.0)
    bad, what = not_rotations(values, name)
    if bad.any():
        raise BayescalError(f"'{text.strip()}' is not {what}", where, "check the numbers")
    return np.asarray(roll_pitch_yaw(matrices(values, name))[0])
