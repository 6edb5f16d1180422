"""Contents of the columns of a log: ``j1 = A1 deg``, as text or as a YAML file."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayescal.dataset.table import JOINT as JOINTS
from bayescal.dataset.table import PLAIN, joint_columns
from bayescal.errors import BayescalError
from bayescal.files import read_document, stem_of, unknown
from bayescal.importing.units import Unit, is_unit, listed, unit_of

DIMENSIONS = {
    **dict.fromkeys(("x", "y", "z", "length", "u"), "length"),
    **dict.fromkeys(("rx", "ry", "rz"), "angle"),
    "time": "time",
    "temperature": "temperature",
    "payload": "mass",
}
"""What each quantity measures."""

JOINT = {"": "angle", "_velocity": "rate", "_command": "angle", "_torque": "torque"}
"""Of a joint: ``j1``, ``j1_velocity`` and so on."""

OF_UNIT = {"degps": "_velocity", "nm": "_torque"}
"""Quantities of a joint that a column of measurements.csv names by its unit alone."""

SPELLED = {"c": "C"}
"""Units whose name in measurements.csv is another."""

SETTINGS = ("validate",)
"""Entries of a map that are not columns."""

TEXTS = ("id", "role", "target", "tool", "stop", "repeat")
"""Quantities that are text."""


@dataclass(frozen=True)
class Column:
    """Where a quantity stands: a column by its name or its number (``#3``), or one text for all rows."""

    name: str
    unit: Unit | None = None
    constant: bool = False

    @property
    def number(self) -> int | None:
        """Place of the column, from 1, where it is called by that."""
        return int(self.name[1:]) if re.fullmatch(r"#[1-9]\d*", self.name) and not self.constant else None


Map = Mapping[str, Column]


def read_map(text: str, n: int) -> Map:
    """Read what the columns hold.

    Parameters
    ----------
    text : str
        ``j1=A1 deg, x=X mm, id=Point, target='cube.+x'``, or the path of a YAML file with such entries
        (``j1: A1 deg``). ``j*=A* deg`` stands for all joints. A text in quotes holds for all rows.
    n : int
        Number of joints.

    Raises
    ------
    BayescalError
        For an unknown quantity, one given twice, or a number without a unit.
    """
    out: dict[str, Column] = {}
    for key, value, where in _entries(text):
        if key in SETTINGS:
            continue
        for joint in range(1, n + 1) if key.startswith("j*") else (0,):
            name, said = (t.replace("*", str(joint)) if joint else t for t in (key, value))
            if name in out:
                raise BayescalError(f"`{name}` is given twice", where, "keep a single entry")
            out[name] = _column(name, said, where, n)
    return out


def setting(text: str, key: str) -> tuple[str, str]:
    """An entry of a map that is no column, of `SETTINGS`: its value and where it is, or empty texts."""
    found = [(value, where) for name, value, where in _entries(text) if name == key]
    if len(found) > 1:
        raise BayescalError(f"`{key}` is given twice", found[1][1], "keep a single entry")
    return found[0] if found else ("", "")


def own_map(header: Sequence[str], n: int, where: str) -> Map:
    """The map of a table with columns of measurements.csv, whose units are in their names.

    Raises
    ------
    BayescalError
        For a column that measurements.csv does not have.
    """
    every = [*PLAIN, *(c for kind in JOINTS for c in joint_columns(kind, n))]
    out: dict[str, Column] = {}
    for name in header:
        if name not in every:
            what, remedy = unknown("column", name, every)
            raise BayescalError(what, f"{where}:1", f"{remedy}, or state the columns by --map")
        stem, unit = stem_of(name)
        key = stem + OF_UNIT.get(unit, "")
        out[key] = (
            Column(name, unit_of(SPELLED.get(unit, unit), dimension_of(key, n, where), where))
            if unit
            else Column(name)
        )
    return out


def _entries(text: str) -> list[tuple[str, str, str]]:
    """Entries of a map: key, value, and where it is."""
    return _of_file(Path(text)) if text.lower().endswith((".yaml", ".yml")) else _of_text(text)


def _of_file(path: Path) -> list[tuple[str, str, str]]:
    document = read_document(path)
    out = []
    for key, value in document.data.items():
        where = document.where((key,))
        if not isinstance(value, str):
            raise BayescalError(f"`{key}` is not a column and its unit", where, f"write `{key}: NAME unit`")
        out.append((key, value, where))
    return out


def _of_text(text: str) -> list[tuple[str, str, str]]:
    out = []
    for part in filter(None, map(str.strip, next(csv.reader([text], quotechar="'"), []))):
        key, equals, value = (p.strip() for p in part.partition("="))
        if not equals or not value:
            raise BayescalError(
                f"'{part}' is not an entry of a map", "--map", "write `j1=A1 deg, x=X mm, ...`"
            )
        out.append((key, value, "--map"))
    return out


def _column(key: str, said: str, where: str, n: int) -> Column:
    """One entry; texts have no unit, numbers must have one."""
    if key in TEXTS:
        quoted = re.fullmatch(r"""(['"])(.+)\1""", said)
        return Column(quoted[2], constant=True) if quoted else Column(said)
    dimension = dimension_of(key, n, where)
    name, _, unit = said.rpartition(" ")
    if not name or not (is_unit(unit) or re.fullmatch(r"[a-zA-Z/°µ]{1,7}", unit)):
        what = f"column `{said}` of `{key}` has no unit"
        example = listed(dimension).split(", ")[0]
        raise BayescalError(what, where, f"write `{key}={said} {example}`, or one of {listed(dimension)}")
    return Column(name.strip(), unit_of(unit, dimension, where))


def dimension_of(key: str, n: int, where: str) -> str:
    """What the quantity `key` measures; unknown ones and joints beyond the n-th are refused."""
    joint = re.fullmatch(r"j(\d+)(\w*)", key)
    if joint and joint[2] in JOINT:
        if not 1 <= int(joint[1]) <= n:
            raise BayescalError(f"`{key}`, but the robot has {n} joints", where, "check --robot")
        return JOINT[joint[2]]
    if key not in DIMENSIONS:
        joints = [f"j{i + 1}{tail}" for tail in JOINT for i in range(n)]
        raise BayescalError(
            *_swap(unknown("quantity", key, [*joints[:n], *DIMENSIONS, *TEXTS, *SETTINGS]), where)
        )
    return DIMENSIONS[key]


def _swap(message: tuple[str, str], where: str) -> tuple[str, str, str]:
    return message[0], where, message[1]
