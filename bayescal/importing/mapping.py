"""Contents of the columns of a log: ``j1 = A1 deg``, as text or as a YAML file; and time stamps."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from bayescal.dataset.table import CLEARANCE, known_columns
from bayescal.errors import BayescalError
from bayescal.importing.joint_formats import QUANTITIES
from bayescal.importing.units import CONVENTIONS, SPELLED, UNITS, Unit, listed, unit_of
from bayescal.robots.servos import STEP, Servo
from bayescal.storage.files import read_document, stem_of, unknown

DIMENSIONS, SLIDING = QUANTITIES["dimensions"], QUANTITIES["sliding"]
OF_UNIT, DATES = QUANTITIES["of_unit"], QUANTITIES["dates"]
DAY = 86400.0
"""s."""

LONG = 1e8
"""s: a session clock does not count three years; such a number is a time since 1970."""

CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d+))?)?\s*([AaPp][Mm])?")
ZONE = r"\s*(?:Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?)"


Stamp = Callable[[str, float], tuple[float, str]]
"""Seconds of a cell, from the cell and the seconds of the one above, and on which clock.

Clocks are UTC, local (no zone), day and counter. What is no time stamp of the kind is a ValueError.
"""


def _dated(kind: str) -> Stamp:
    """Reader of date and time; without a time zone as if in UTC."""
    pattern, order = DATES[kind]

    def read(cell: str, before: float) -> tuple[float, str]:
        stamp = re.fullmatch(rf"{pattern}(?:(?:T|\s+)(?P<clock>.*?)(?P<zone>{ZONE})?)?", cell)
        try:
            if stamp is None:
                raise ValueError
            zone = re.sub("UTC|GMT", "Z", (stamp["zone"] or "Z").strip())
            year, month, date = (int(stamp[i]) for i in order)
            day = datetime.fromisoformat(f"{year:04}-{month:02}-{date:02}T00:00{zone}")
            seconds = _seconds(stamp["clock"]) if stamp["clock"] or stamp["zone"] else 0.0
        except ValueError:
            raise ValueError(f"'{cell}' is not a date and time ({kind})") from None
        return day.timestamp() + seconds, "UTC" if stamp["zone"] else "local"

    return read


def _seconds(text: str) -> float:
    """Seconds of a time of day, ``15:04:05.25``, ``3:04:05 PM``."""
    clock = CLOCK.fullmatch(text.strip())
    if clock is None:
        raise ValueError
    hour, minute, second = int(clock[1]), int(clock[2]), int(clock[3] or 0)
    if clock[5]:
        if not 1 <= hour <= 12:
            raise ValueError
        hour = hour % 12 + 12 * (clock[5].lower() == "pm")
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError
    return 3600.0 * hour + 60.0 * minute + second + float(f"0.{clock[4] or 0}")


def _of_day(cell: str, before: float) -> tuple[float, str]:
    """A time of day; a step back by more than half a day is midnight, a smaller one is refused."""
    try:
        now = _seconds(cell)
    except ValueError:
        raise ValueError(f"'{cell}' is not a time of day, HH:MM:SS") from None
    if before > DAY:
        now += before // DAY * DAY
    if before - now > DAY / 2:
        now += DAY
    elif now < before:
        raise ValueError(f"the time of day '{cell}' is before that of the row above")
    return now, "day"


def _counted(clock: str, per_second: float = 1.0) -> Stamp:
    """Reader of a number: the time since 1970 (the clock UTC), or since a controller was started."""

    def read(cell: str, before: float) -> tuple[float, str]:
        try:
            seconds = float(cell.replace(",", ".")) / per_second
        except ValueError:
            raise ValueError(f"'{cell}' is not a number") from None
        if clock == "UTC" and not LONG < seconds < 100 * LONG:
            raise ValueError(f"{cell} is not a time since 1970 in this unit")
        return seconds, clock

    return read


STAMPS: dict[str, Stamp] = {
    **{kind: _dated(kind) for kind in DATES}, "clock": _of_day, "counter_s": _counted("counter"),
    "epoch_s": _counted("UTC"), "epoch_ms": _counted("UTC", 1e3), "epoch_us": _counted("UTC", 1e6),
    "epoch_ns": _counted("UTC", 1e9),
}  # fmt: skip
"""Kinds of time stamps by the word that states them."""
COUNTED = tuple(kind for kind in STAMPS if kind.startswith(("epoch", "counter")))
"""Those that are numbers."""

OF_JOINTS = {of["key"]: (of["dimension"], name) for name, of in QUANTITIES["joints"].items()}
"""Of a joint, ``j1``, ``j1_velocity`` and so on: what is measured, and its name in joint logs."""

OF_CONTACTS = tuple(of["key"] for of in QUANTITIES["joints"].values() if "contacts" in of)
"""Those that logs of contacts have too."""

PER_CENT = ("%", "pct", "percent", "permille")
"""Units of torques relative to the rated ones, which differ by joint."""

VALIDATE = "validate"
"""The entry of a map that is not a column: the rule for validation measurements."""

ROTATION = "rotation"
"""The measured orientation, in a convention of `CONVENTIONS`."""

OF_REFLECTOR = ("x", "y", "z", "u", "rx", "ry", "rz", ROTATION)
"""Quantities that may be those of a named reflector, ``x@A``."""

TEXTS = ("id", "role", "target", "tool", "stop", "repeat", "motion", "kind")
"""Quantities that are text."""


@dataclass(frozen=True)
class Column:
    """Where a quantity stands in a log.

    `name` is the name of a column, its number (``#3``), an expression on columns, or a `constant` text for
    all rows, in which names in braces stand for the texts of columns. Without `unit` it is that of the
    header; `stamp` is the kind of a time stamp, `turn` the convention of an orientation (spaces between its
    columns). An `optional` entry counts if its columns are there. `dimension` is what a quantity measures.
    """

    name: str
    unit: Unit | None = None
    constant: bool = False
    stamp: str = ""
    optional: bool = False
    where: str = "--map"
    turn: str = ""
    dimension: str = ""


Map = Mapping[str, Column]


PRODUCT = re.compile(r"\s\*\s(?![^{}]*\})")
"""A product in a text for all joints: not within a name in braces."""
OF_SERVOS = re.compile(r"j([1-9][0-9]*)(_command|_link)?")


def calibrated(map_: Map, servos: Sequence[Servo]) -> Map:
    """A map whose steps are zero in the middle of the range of each servo, and not at half a turn.

    Raises
    ------
    BayescalError
        If none of the readings is in steps.
    """
    out = dict(map_)
    for key, column in map_.items():
        match = OF_SERVOS.fullmatch(key)
        if match and column.unit == UNITS["steps"]:
            zero = -STEP * servos[int(match[1]) - 1].middle
            out[key] = replace(column, unit=replace(column.unit, offset=zero))
    if out == dict(map_):
        raise BayescalError("no readings are in steps", "--calibration", "write `j*=q* steps` in the map")
    return out


def read_map(
    text: str, units: Sequence[str], formal: bool = False, names: Sequence[str] = ()
) -> dict[str, Column]:
    """Read what the columns hold.

    Parameters
    ----------
    text : str
        ``j1=A1 deg, x=X mm, id=Point, target='cube.+x'``, or the path of a YAML file with such entries
        (``j1: A1 deg``). ``j*=A* deg`` stands for all joints; ``*0`` counts them from 0, ``*name`` is one of
        `names`. A text in quotes holds for all rows. The unit may be in the key instead: ``x_mm=X``.
    units : sequence of str
        Of the joints: mm of prismatic ones, else deg.
    formal : bool
        The map of a format: keys that end in ``?`` are optional.
    names : sequence of str
        Of the joints, for ``*name``; () if they are not known.

    Raises
    ------
    BayescalError
        For an unknown quantity, one given twice, or an unknown unit.
    """
    out: dict[str, Column] = {}
    for key, value, where in _entries(text):
        if key == VALIDATE:
            continue
        optional = formal and key.endswith("?")
        key = key.rstrip("?") if optional else key
        for joint in range(1, len(units) + 1) if key.startswith("j*") else (0,):
            name, said = (_of_joint(t, joint, names) if joint else t for t in (key, value))
            base, sign, tool = name.partition("@")
            quantity, unit = quantity_of(base, units, where)
            if sign and (quantity not in OF_REFLECTOR or not tool):
                what = f"`{name}` is not a quantity of a reflector"
                raise BayescalError(what, where, f"those are {', '.join(OF_REFLECTOR)}, as in x@A")
            quantity += sign + tool
            if quantity in out:
                raise BayescalError(f"`{quantity}` is given twice", where, "keep a single entry")
            out[quantity] = _column(quantity, Column(said, unit, optional=optional, where=where), units)
    return out


def own_map(header: Sequence[str], units: Sequence[str], where: str) -> dict[str, Column]:
    """The map of a table with columns of measurements.csv, whose units are in their names.

    Raises
    ------
    BayescalError
        For a column that measurements.csv does not have.
    """
    every = known_columns(units)
    out: dict[str, Column] = {}
    for name in (column for column in header if column != CLEARANCE):
        if name not in every:
            what, remedy = unknown("column", name, every)
            raise BayescalError(what, f"{where}:1", f"{remedy}, or state the columns by --map")
        quantity, unit = quantity_of(name, units, where)
        out[quantity] = Column(name, unit, where=where)
    return out


def validation_rule(text: str) -> tuple[str, str]:
    """The rule for validation measurements in a map, and where it is; empty texts without one."""
    rules = [(value, where) for name, value, where in _entries(text) if name == VALIDATE]
    if len(rules) > 1:
        raise BayescalError(f"`{VALIDATE}` is given twice", rules[1][1], "keep a single entry")
    return rules[0] if rules else ("", "")


def quantity_of(key: str, units: Sequence[str], where: str) -> tuple[str, Unit | None]:
    """The quantity that a key names, and the unit in its name: ``x_mm``, ``j1_degps``; None without one."""
    if key in TEXTS or key == ROTATION:
        return key, None
    stem, suffix = stem_of(key)
    unit = SPELLED.get(suffix) or SPELLED.get(suffix.upper())
    if unit and key not in DIMENSIONS:
        quantity = stem + (OF_UNIT.get(suffix, "") if re.fullmatch(r"j[1-9][0-9]*", stem) else "")
        return quantity, unit_of(unit.name, dimension_of(quantity, units, where), where)
    dimension_of(key, units, where)
    return key, None


def dimension_of(key: str, units: Sequence[str], where: str) -> str:
    """What the quantity `key` measures; unknown ones and joints without a unit are refused."""
    joint = re.fullmatch(r"j([1-9][0-9]*)(\w*)", key)
    if joint and joint[2] in OF_JOINTS:
        if not 1 <= int(joint[1]) <= len(units):
            raise BayescalError(f"`{key}`, but the robot has {len(units)} joints", where, "check --robot")
        dimension = OF_JOINTS[joint[2]][0]
        return SLIDING.get(dimension, dimension) if units[int(joint[1]) - 1] == "mm" else dimension
    if key not in DIMENSIONS:
        joints = [f"j{i + 1}" for i in range(len(units))]
        what, remedy = unknown("quantity", key, [*joints, *DIMENSIONS, ROTATION, *TEXTS, VALIDATE])
        raise BayescalError(what, where, remedy)
    return DIMENSIONS[key]


def _of_joint(text: str, joint: int, names: Sequence[str]) -> str:
    """A text for a joint: ``*`` is its number, ``*0`` its number counted from 0, ``*name`` its name.

    A ``*`` between blanks multiplies, if the number stands elsewhere in the text.
    """
    if joint <= len(names):
        text = text.replace("*name", names[joint - 1])
    parts = PRODUCT.split(text)
    if all("*" not in part for part in parts):
        parts = [text]
    return " * ".join(p.replace("*0", str(joint - 1)).replace("*", str(joint)) for p in parts)


def _entries(text: str) -> list[tuple[str, str, str]]:
    """Entries of a map: key, value, and where it is."""
    return _of_file(Path(text)) if text.lower().endswith((".yaml", ".yml")) else _of_text(text)


def _of_file(path: Path) -> list[tuple[str, str, str]]:
    document = read_document(path)
    out = []
    for key, value in document.data.items():
        where = document.where((key,))
        if not isinstance(value, str):
            remedy = f'write `{key}: NAME unit`, in quotes if it begins with a brace: "{{A 1}} deg"'
            raise BayescalError(f"`{key}` is not a column and its unit", where, remedy)
        out.append((key, value, where))
    return out


def _of_text(text: str) -> list[tuple[str, str, str]]:
    out = []
    for part in filter(None, map(str.strip, next(csv.reader([text], quotechar="'"), []))):
        key, equals, value = (p.strip() for p in part.partition("="))
        if not equals or not value:
            what = f"'{part}' is not an entry of a map"
            raise BayescalError(what, "--map", "write `j1=A1 deg, x=X mm, ...`")
        out.append((key, value, "--map"))
    return out


def _column(key: str, entry: Column, units: Sequence[str]) -> Column:
    """An entry whose name is all that it says, with what this states; texts have no unit."""
    key, said, where = key.partition("@")[0], entry.name, entry.where
    if key == ROTATION:
        return _rotation(entry)
    if key in TEXTS:
        quoted = re.fullmatch(r"""(['"])(.+)\1""", said)
        return replace(entry, name=quoted[2], constant=True) if quoted else entry
    dimension = dimension_of(key, units, where)
    entry = replace(entry, dimension=dimension)
    name, _, last = said.rpartition(" ")
    name = name.strip()
    if entry.unit is not None or not name:
        return entry
    if key == "time" and last in STAMPS:
        return replace(entry, name=name, unit=UNITS["s"], stamp=last)
    if name[-1] in "+-*/(" or not re.fullmatch(r"[a-zA-Z/°µμ.*%]{1,8}", last):
        return entry
    if last not in SPELLED:
        remedy = f"give one of {listed(dimension)}; a name with spaces is enclosed in braces: {{{said}}}"
        if dimension == "torque" and last.lower() in PER_CENT:
            each = f"{key}={{{name}}} * 1.5 Nm"
            remedy = f"multiply by the rated torque of each joint: for 150 N m write `{each}`"
        raise BayescalError(f"unknown unit `{last}`", where, remedy)
    return replace(entry, name=name, unit=unit_of(last, dimension, where))


def _rotation(entry: Column) -> Column:
    """An orientation: columns, the convention and, of angles, the unit."""
    said, where = entry.name, entry.where
    words = said.split()
    unit = unit_of(words.pop(), "angle", where) if words and words[-1] in SPELLED else None
    turn = words.pop() if words else ""
    if turn not in CONVENTIONS or not words:
        remedy = f"write `rotation=q1 q2 q3 q4 wxyz` or `A B C abc deg`; known are {', '.join(CONVENTIONS)}"
        raise BayescalError("the convention of the orientation is not stated", where, remedy)
    if CONVENTIONS[turn].angles and unit is None:
        raise BayescalError("the orientation has no unit", where, f"write `rotation={said} deg`")
    if not CONVENTIONS[turn].angles and unit is not None:
        raise BayescalError(f"{turn} has no unit", where, f"remove `{unit.name}`")
    return replace(entry, name=" ".join(words), unit=unit, turn=turn)
