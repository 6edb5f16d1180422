"""A text file of rows, whatever separates its cells, and what a map makes of it."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.files import decoded, unknown
from bayescal.importing.mapping import TEXTS, Column, Map
from bayescal.importing.units import Unit, is_number

COMMENTS = ("//", "#", "!", "%")
"""How a comment begins; SpatialAnalyzer writes ``//``."""


@dataclass(frozen=True)
class Log:
    """Cells of a file, stripped, row by row, with each row's line; `header` is empty where there is none."""

    name: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    decimal_comma: bool = False  # possible: the cells are not separated by commas


@dataclass(frozen=True)
class Columns:
    """N rows by quantity: `numbers` (N,) in SI, nan where empty, and `texts`; with lines and units."""

    name: str
    line: np.ndarray  # (N,) int
    numbers: dict[str, np.ndarray]
    texts: dict[str, np.ndarray]
    said: dict[str, Column]

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.line)

    def take(self, rows: np.ndarray) -> Columns:
        """Some of the rows, by index or mask."""
        numbers = {k: v[rows] for k, v in self.numbers.items()}
        texts = {k: v[rows] for k, v in self.texts.items()}
        return Columns(self.name, self.line[rows], numbers, texts, self.said)

    def unit(self, key: str) -> Unit | None:
        """The unit that `key` was said to be in."""
        return self.said[key].unit if key in self.said else None


def read_log(path: Path, headed: bool | None = None) -> Log:
    """Read the cells of a text file.

    The separator is a semicolon, a tab, a comma or white space: the first of them that the first row
    has. Lines that begin as a comment, and empty ones, are left out; a line may end
    with a separator. A semicolon or a tab leaves the comma free to be the decimal mark.

    Parameters
    ----------
    path : Path
        A UTF-8 file.
    headed : bool, optional
        Whether the first row is a header; left out, it is one if none of its cells is a number.

    Raises
    ------
    BayescalError
        If the file cannot be read, or its rows differ in length.
    """
    text, _ = decoded(path)
    kept = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith(COMMENTS)
    ]
    if not kept:
        raise BayescalError("no rows", path.name, "check the file")
    separator = next((s for s in ";\t," if s in kept[0][1]), " ")
    rows = [(number, _cells(line, separator)) for number, line in kept]
    first = rows[0][1]
    first = first if first[-1] else first[:-1]
    ends = len(first) + 1  # cells of a line that ends with a separator
    rows = [(n, cells[:-1] if len(cells) == ends and not cells[-1] else cells) for n, cells in rows]
    headed = not any(map(is_number, first)) if headed is None else headed
    for number, cells in rows:
        if len(cells) != len(first):
            what = f"{len(cells)} cells, the first row has {len(first)}"
            raise BayescalError(
                what,
                f"{path.name}:{number}",
                "write a cell for each column; quote cells that contain a separator",
            )
    body = rows[1:] if headed else rows
    if not body:
        raise BayescalError("no rows below the header", path.name, "check the file")
    lines, cells_of = zip(*body, strict=True)
    return Log(path.name, tuple(first) if headed else (), cells_of, lines, separator in ";\t")


def _cells(line: str, separator: str) -> tuple[str, ...]:
    if separator == " ":
        return tuple(line.split())
    cells = next(csv.reader(io.StringIO(line), delimiter=separator, skipinitialspace=True))
    return tuple(map(str.strip, cells))


def columns_of(log: Log, map_: Map) -> Columns:
    """What the map makes of a log: numbers in SI, texts, each with the line it came from."""
    numbers: dict[str, np.ndarray] = {}
    texts: dict[str, np.ndarray] = {}
    for key, column in map_.items():
        cells = _column(log, key, column)
        if key in TEXTS:
            texts[key] = np.array(cells)
        else:
            assert column.unit is not None
            raw = np.array([_number(log, row, key, cell) for row, cell in enumerate(cells)])
            numbers[key] = column.unit.scale * raw + column.unit.offset
    return Columns(log.name, np.array(log.line), numbers, texts, dict(map_))


def _column(log: Log, key: str, column: Column) -> list[str]:
    if column.constant:
        return [column.name] * len(log.rows)
    at = column.number
    if at is None:
        if column.name not in log.header:
            _, remedy = unknown("column", column.name, log.header)
            hint = remedy if log.header else "the file has no header: use #1, #2, ... as column names"
            raise BayescalError(f"no column `{column.name}` for `{key}`", f"{log.name}:1", hint)
        at = log.header.index(column.name) + 1
    if at > len(log.rows[0]):
        what = f"`{key}` is mapped to column {at}, but the file has {len(log.rows[0])} columns"
        raise BayescalError(what, log.name, "columns are numbered from 1")
    return [row[at - 1] for row in log.rows]


def _number(log: Log, row: int, key: str, cell: str) -> float:
    text = cell.strip("[]")  # a list of joints, as URScript logs it
    text = text.replace(",", ".") if log.decimal_comma and "." not in text else text
    if not cell:
        return np.nan
    if not is_number(text):
        where = f"{log.name}:{log.line[row]}"
        raise BayescalError(f"`{key}` is not a number: '{cell}'", where, "correct the cell or remove the row")
    return float(text)


def first(columns: Columns, bad: np.ndarray, what: Callable[[int], str], remedy: str) -> None:
    """Refuse the first row where `bad` (N,) holds, with its line."""
    if bad.any():
        row = int(np.argmax(bad))
        raise BayescalError(what(row), f"{columns.name}:{columns.line[row]}", remedy)
