"""measurements.csv and other tables: columns, and cells as numbers with the line of whatever is wrong."""

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.transforms import rpy_of
from bayescal.errors import BayescalError, shown
from bayescal.storage.files import outside, range_of, si, stem_of, unknown
from bayescal.storage.reading import decoded, table_beside, text_of
from factors.kind import cross_matrix

XYZ = ("x_mm", "y_mm", "z_mm")
RPY = ("rx_deg", "ry_deg", "rz_deg")
QUATERNION = ("qw", "qx", "qy", "qz")
PIXEL = ("u_px", "v_px", "point")
LABELS = ("stop", "repeat")
"""Columns of texts that need not be there."""
CLEARANCE = "clearance_mm"
"""Column of a plan that a session does not have."""
EMPTY: Mapping[str, float | str] = {
    **dict.fromkeys(LABELS, ""),
    **dict.fromkeys(("velocity", "payload"), 0.0),
    **dict.fromkeys(("xyz", "rpy", "pixel", "length", "u"), np.nan),
}
"""What an empty cell stands for, by the field of `Measurements`; no cell of another field is empty."""

UNIT_LENGTH = 1e-3
"""Deviation of the length of a quaternion from 1, up to which it is rounding (assumed)."""
LONGEST_CELL = 200
"""Characters of a cell."""

MEANINGS: dict[str, dict[str, str]] = table_beside(__file__, "meanings.toml")
"""What keys of dataset.yaml and columns mean."""
COLUMNS = MEANINGS["columns"]
"""What the columns of measurements.csv mean, in the contract's order; N stands for the number of a joint."""
PLAIN = tuple(key for key in COLUMNS if not key.startswith("jN_"))
JOINT = {"deg": "mm", "degps": "mmps", "command_deg": "command_mm", "nm": "n"}
"""Columns there are one of a joint, ``j1_deg`` ... ``jn_deg`` and so on, and those of a prismatic joint."""


def joint_columns(kind: str, units: Sequence[str]) -> tuple[str, ...]:
    """``j1_deg`` to ``jn_deg`` for `kind` ``deg``; ``j1_mm`` where `units`, as of `Robot.units`, are mm."""
    return tuple(f"j{i}_{JOINT[kind] if unit == 'mm' else kind}" for i, unit in enumerate(units, start=1))


def known_columns(units: Sequence[str]) -> tuple[str, ...]:
    """All columns that there may be of an arm whose joints have the `units`."""
    return (*PLAIN, *(column for kind in JOINT for column in joint_columns(kind, units)))


def fields_of_columns(units: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Fields of `Measurements` in the contract's order, each with the columns of the joints that fill it."""
    joints = zip(("readings", "velocity", "command", "torque"), JOINT, strict=True)
    return {
        **{field: joint_columns(kind, units) for field, kind in joints},
        "xyz": XYZ,
        "rpy": RPY,
        "pixel": PIXEL,
        **{stem_of(column)[0]: (column,) for column in PLAIN[PLAIN.index("length_mm") :]},
    }


@dataclass(frozen=True)
class Table:
    """Cells as text by column (stripped), and the line each row begins in (the header is line 1)."""

    name: str
    cells: dict[str, tuple[str, ...]]
    line: np.ndarray  # (N,) int
    content: bytes  # of the file, to hash

    def error(self, row: int, what: str, remedy: str = "") -> BayescalError:
        """What is wrong in a row, with its line."""
        return BayescalError(what, f"{self.name}:{self.line[row]}", remedy)

    def first(self, bad: np.ndarray, what: str, remedy: str = "", **values: Any) -> None:
        """Refuse the first row where `bad` (N,) holds.

        ``{column}`` in the texts stands for its cell, ``{name}`` for its entry in one of `values` (N,).
        """
        if bad.any():
            row = int(np.argmax(bad))
            cells = {k: shown(v[row]) for k, v in self.cells.items()}
            cells |= {k: v[row] for k, v in values.items()}
            raise self.error(row, what.format_map(cells), remedy.format_map(cells))

    def numbers(self, column: str, needed: bool) -> np.ndarray:
        """A column in SI units (N,); empty cells are refused where `needed`, else nan."""
        cells = self.cells[column]
        empty = np.array([not c for c in cells])
        if needed:
            self.first(empty, f"`{column}` is empty", "fill the cell in")
        wrong = np.array([bool(c) and not is_written_number(c) for c in cells])
        self.first(wrong, f"`{column}` is not a number: '{{{column}}}'", "write a plain number")
        values = np.array([float(c) if c else np.nan for c in cells])
        what = f"`{column}` is {{{column}}}, not a finite number"
        self.first(~np.isfinite(values) & ~empty, what, "correct the cell or remove the row")
        low, high = range_of(column)
        wrong = (values < low) | (values > high)
        self.first(wrong, outside(column, values[wrong]), "check the number and its unit")
        return values * si(column)

    def optional(self, column: str) -> np.ndarray | None:
        """`numbers` without empty cells, or None where there is no such column."""
        return self.numbers(column, needed=True) if column in self.cells else None

    def block(self, columns: Iterable[str], needed: bool) -> np.ndarray | None:
        """Columns side by side (N, k), SI; None where there are none of them."""
        columns = tuple(columns)
        if columns[0] not in self.cells:
            return None
        return np.column_stack([self.numbers(c, needed) for c in columns])

    def texts(self, column: str) -> np.ndarray | None:
        """A column of texts (N,), or None where there is no such column."""
        return np.array(self.cells[column]) if column in self.cells else None


def table_of(content: bytes, name: str, units: Sequence[str]) -> Table:
    """The table of the bytes of a measurements.csv, joints in `units`: header and shape checked.

    The cells still are text. The clearance of a plan, which may be there, is not read.
    """
    text = text_of(content, name)
    check = partial(check_columns, units=units)
    return _with_angles(cells_of(text, name, content, check))


def _with_angles(table: Table) -> Table:
    """The table with `RPY` in place of quaternions; empty cells stay empty."""
    quaternions = table.block(QUATERNION, needed=False)
    if quaternions is None:
        return table
    there = ~np.isnan(quaternions).all(axis=1)
    size = np.linalg.norm(np.where(there[:, None], quaternions, 0.5), axis=1)
    table.first(np.isnan(size), "the quaternion is not complete", "fill in qw, qx, qy and qz, or none")
    what = "the quaternion has the length {size:.4g}, not 1"
    table.first(abs(size - 1.0) > UNIT_LENGTH, what, "check the columns: qw is the real part", size=size)
    w, cross = quaternions[there, :1, None], cross_matrix(quaternions[there, 1:])
    turns = [rpy_of(m) for m in np.eye(3) + 2.0 * (w * cross + cross @ cross)]
    angles = np.full((len(there), 3), "", object)
    angles[there] = [[repr(x) for x in row] for row in np.degrees(turns).reshape(-1, 3).tolist()]
    kept = {name: cells for name, cells in table.cells.items() if name not in QUATERNION}
    return replace(table, cells=kept | dict(zip(RPY, map(tuple, angles.T), strict=True)))


def read_cells(path: Path, check_header: Callable[[list[str], str], None]) -> Table:
    """Read a table with a header; `check_header(columns, where)` refuses columns.

    Raises
    ------
    BayescalError
        With the line, for a file that is not CSV, has no rows, or has rows of different lengths.
    """
    text, content = decoded(path)
    return cells_of(text, path.name, content, check_header)


def cells_of(text: str, name: str, content: bytes, check_header: Callable[[list[str], str], None]) -> Table:
    """The table of a file's text; raises as `read_cells`."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    before = 0
    try:
        for row in reader:
            if row:
                rows.append(row)
                lines.append(before + 1)
            before = reader.line_num
    except csv.Error as error:
        where = f"{name}:{reader.line_num}"
        raise BayescalError(f"not CSV: {error}", where, "check the quotes") from None
    for cells, line in zip(rows, lines, strict=True):
        if max(map(len, cells)) > LONGEST_CELL:
            what = f"a cell has {max(map(len, cells))} characters, at most {LONGEST_CELL} are read"
            raise BayescalError(what, f"{name}:{line}", "check the quotes, or shorten it")
    header = [c.strip() for c in rows[0]]
    check_header(header, f"{name}:{lines[0]}")
    for cells, line in zip(rows, lines, strict=True):
        if len(cells) != len(header):
            what = f"{len(cells)} cells, the header has {len(header)}"
            remedy = "one cell a column; the decimal mark is a dot"
            remedy = "remove the comment" if cells[0].lstrip().startswith("#") else remedy
            raise BayescalError(what, f"{name}:{line}", remedy)
    if len(rows) == 1:
        raise BayescalError("no rows below the header", f"{name}:{lines[0]}", "add rows")
    columns = (tuple(map(str.strip, column)) for column in zip(*rows[1:], strict=True))
    return Table(name, dict(zip(header, columns, strict=True)), np.array(lines[1:]), content)


def is_written_number(cell: str) -> bool:
    """Whether a cell is a number, also one that is not finite."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # float() reads 1_000


def check_names(header: list[str], where: str) -> None:
    """Refuse columns without a name, doubled ones, and a table whose columns are not separated by commas."""
    if len(header) == 1 and re.search(r"[;\t]", header[0]):
        raise BayescalError("the columns are not separated by commas", where, "save with commas and dots")
    for i, column in enumerate(header):
        if column in header[:i]:
            raise BayescalError(f"column `{column}` is given twice", where, "keep one")
        if not column:
            raise BayescalError(f"column {i + 1} has no name", where, "name it, or delete it")


def check_groups(header: list[str], where: str, groups: Iterable[tuple[str, ...]]) -> None:
    """Refuse a part of columns that belong together."""
    for group in groups:
        missing = [c for c in group if c not in header]
        if missing and len(missing) < len(group):
            remedy = f"give all of {', '.join(group)}, or none"
            raise BayescalError(f"column `{missing[0]}` is missing", where, remedy)


def csv_text(header: Iterable[str], rows: Iterable[Iterable[object]], newline: str = "\n") -> str:
    """A CSV table as text; None is an empty cell."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator=newline)
    writer.writerow(header)
    writer.writerows(rows)
    return out.getvalue()


def check_columns(header: list[str], where: str, units: Sequence[str]) -> None:
    """Refuse unknown, doubled and missing columns of measurements.csv, of joints with these units."""
    header = [name for name in header if name != CLEARANCE]
    check_names(header, where)
    columns, n = known_columns(units), len(units)
    for column in header:
        joint = re.fullmatch(rf"j([1-9][0-9]*)_({'|'.join([*JOINT, *JOINT.values()])})", column)
        if joint and int(joint[1]) > n:
            what = f"column `{column}`, but the robot has {n} joints"
            raise BayescalError(what, where, "check `robot` in dataset.yaml")
        if joint and column not in columns:
            prismatic = units[int(joint[1]) - 1] == "mm"
            kind = "prismatic" if prismatic else "revolute"
            what = f"column `{column}`, but joint {joint[1]} is {kind}"
            words = dict(zip(JOINT.values(), JOINT, strict=True)) | (JOINT if prismatic else {})
            raise BayescalError(what, where, f"write `j{joint[1]}_{words[joint[2]]}`")
        if column not in columns:
            what, remedy = unknown("column", column, columns)
            raise BayescalError(what, where, remedy)
    joints = joint_columns("deg", units)
    for column in ("id", "target", *joints):
        if column not in header:
            span = f"the robot has {n} joints: {joints[0]} to {joints[-1]}"
            remedy = span if column in joints else "add it"
            raise BayescalError(f"column `{column}` is missing", where, remedy)
    groups = (*(joint_columns(kind, units) for kind in tuple(JOINT)[1:]), XYZ, RPY, QUATERNION, PIXEL)
    check_groups(header, where, groups)
    if QUATERNION[0] in header and RPY[0] in header:
        raise BayescalError(f"both `{QUATERNION[0]}` and `{RPY[0]}` are given", where, "keep one of them")
