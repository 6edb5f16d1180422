"""What a map makes of the table of a log: numbers in SI and texts, by quantity."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayescal.errors import BayescalError
from bayescal.importing.log import Log
from bayescal.importing.mapping import COUNTED, LONG, STAMPS, TEXTS, Column, Map, dimension_of
from bayescal.importing.units import CONVENTIONS, Expression, Unit, is_number, listed, parse, place, unit_of

DECIMALS = ("", "comma")
"""How numbers with a comma are stated to be meant; "" finds it."""

MANY = 10**6
"""Columns of a file that has any number of them."""

GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
"""A number whose comma may be decimal or separate thousands."""


@dataclass(frozen=True)
class Columns:
    """N rows by quantity: `cells` (N,), numbers in SI, nan where empty, and texts; with lines and units.

    `clock` is that of the time: "" if it counts from the beginning of the session, else as in `Stamps`.
    `notes` says what was left out.
    """

    name: str
    line: np.ndarray  # (N,) int
    cells: dict[str, np.ndarray]
    said: dict[str, Column]
    clock: str = ""
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.line)

    def take(self, rows: np.ndarray) -> Columns:
        """Some of the rows, by index or mask."""
        return replace(self, line=self.line[rows], cells={k: v[rows] for k, v in self.cells.items()})

    def without(self, keys: Iterable[str]) -> Columns:
        """All but some quantities."""
        return replace(self, cells={k: v for k, v in self.cells.items() if k not in {*keys}})

    def block(self, keys: Sequence[str]) -> np.ndarray | None:
        """Quantities side by side (N, k), or None where none of them is given; some of them is an error."""
        missing = [key for key in keys if key not in self.cells]
        if not missing:
            return np.column_stack([self.cells[key] for key in keys])
        if len(missing) == len(keys):
            return None
        what = f"`{missing[0]}` is not mapped, `{next(k for k in keys if k not in missing)}` is"
        raise BayescalError(what, self.name, f"map all of {', '.join(keys)}, or none")

    def unit(self, key: str) -> Unit | None:
        """The unit that `key` was said to be in."""
        return self.said[key].unit if key in self.said else None


def missing_in(map_: Map) -> Callable[[Sequence[str]], int] | None:
    """How many entries of a map a header lacks; None for a map that calls all columns by their numbers."""

    def missing(row: Sequence[str], width: int | None = None) -> int:
        width = len(row) if width is None else width
        return sum(not c.optional and not _is_there(c, key, row, width) for key, c in map_.items())

    return missing if missing((), MANY) else None


def columns_of(log: Log, map_: Map, decimal: str = "") -> Columns:
    """What the map makes of a log.

    Parameters
    ----------
    log : Log
    map_ : Map
    decimal : str
        The decimal mark of numbers with a comma, of `DECIMALS`.

    Raises
    ------
    BayescalError
        For columns that are not there, cells that are not numbers, units that are missing or that
        contradict the header, and numbers whose comma may separate thousands.
    """
    map_ = {k: c for k, c in map_.items() if not c.optional or _is_there(c, k, log.header, log.width)}
    used = {k: _used(c, k, log.header, log.width, f"{log.name}: `{k}`") for k, c in map_.items()}
    counted = [k for k, c in map_.items() if _is_sum(c) or not _is_text(k, c)]
    numeric = {i for k in counted for e in used[k] for i in e.columns}
    numbers = _Numbers(log, _mark(log, numeric, decimal))
    cells: dict[str, np.ndarray] = {}
    said = dict(map_)
    clock = ""
    for key, column in map_.items():
        if _base(key) in TEXTS:
            cells[key] = np.array(_filled(log, column, used[key]))
        elif column.turn:
            base, sign, tool = key.partition("@")
            scale = column.unit.scale if column.unit else 1.0
            for i, part in enumerate(used[key]):
                cells[f"{base}{i}{sign}{tool}"] = scale * numbers.value(key, part)
        elif column.stamp:
            numbered = [*map(repr, numbers.finite(key, used[key][0]).tolist())] if _is_sum(column) else None
            cells[key], clock = _stamped(log, key, column, numbered or _filled(log, column, used[key]))
        else:
            unit = _unit_of(log, key, column, used[key][0])
            cells[key] = unit.scale * numbers.finite(key, used[key][0]) + unit.offset
            said[key] = replace(column, unit=unit)
            if key == "time" and np.nanmax(cells[key], initial=0.0) > LONG:
                kinds = [kind for kind in STAMPS if kind.startswith("epoch")]
                alone = not used[key][0].tree and f"epoch_{unit.name}" in kinds
                remedy = f"write `time={column.name} epoch_{unit.name}`"
                remedy = remedy if alone else f"map the column alone, as one of {', '.join(kinds)}"
                raise BayescalError("the times are longer than three years: since 1970?", log.name, remedy)
    taken = {i for expressions in used.values() for e in expressions for i in e.columns}
    names = log.header or tuple(f"#{i + 1}" for i in range(log.width))
    unused = tuple(name for i, name in enumerate(names) if i not in taken and name)
    return Columns(log.name, np.array(log.line), cells, said, clock, log.notes, unused)


def _base(key: str) -> str:
    return key.partition("@")[0]


def _is_there(column: Column, key: str, header: Sequence[str], width: int) -> bool:
    try:
        _used(column, key, header, width, "")
        return True
    except BayescalError:
        return False


def _is_sum(column: Column) -> bool:
    """Whether a time stamp is a number by an expression: ``{sec} + {nanosec} / 1e9``."""
    return column.stamp in COUNTED and bool(re.search(r"[-+*/]", re.sub(r"\{[^{}]*\}", "", column.name)))


def _is_text(key: str, column: Column) -> bool:
    return _base(key) in TEXTS or bool(column.stamp)


def _used(column: Column, key: str, header: Sequence[str], width: int, where: str) -> list[Expression]:
    """The columns that an entry of a map needs."""
    if _is_text(key, column) and not _is_sum(column):
        several = column.constant or "{" in column.name
        names = re.findall(r"\{([^{}]+)\}", column.name) if several else [column.name]
        return [Expression(name, (place(name, header, width, where),)) for name in names]
    if not column.turn:
        return [parse(column.name, header, width, where)]
    names = re.findall(r"\{[^{}]+\}|\S+", column.name)
    span = re.fullmatch(r"#(\d+)\.\.#?(\d+)", column.name)
    if span:
        names = [f"#{i}" for i in range(int(span[1]), int(span[2]) + 1)]
    if len(names) != CONVENTIONS[column.turn].count:
        what = f"{column.turn} needs {CONVENTIONS[column.turn].count} columns, {len(names)} are given"
        remedy = "separate them by spaces; names with spaces are enclosed in braces"
        raise BayescalError(what, column.where, remedy)
    return [parse(name, header, width, where) for name in names]


def _filled(log: Log, column: Column, used: Sequence[Expression]) -> list[str]:
    """Texts of all rows: those of a column, a constant, or one with columns in braces."""
    if not column.constant and "{" not in column.name:
        return [row[used[0].columns[0]] for row in log.rows]
    parts = re.split(r"\{[^{}]+\}", column.name)
    out = []
    for row in log.rows:
        values = [row[e.columns[0]] for e in used] + [""]
        out.append("".join(a + b for a, b in zip(parts, values, strict=True)))
    return out


def _stamped(log: Log, key: str, column: Column, stamps: Sequence[str]) -> tuple[np.ndarray, str]:
    """Seconds (N,) of time stamps (N,), nan where the cell is empty, and their clock."""
    seconds, clock, before = np.full(len(log.rows), np.nan), "", -np.inf
    for row, text in enumerate(stamps):
        if (cell := text.strip()) in ("", "nan"):
            continue
        try:
            seconds[row], clock_of = STAMPS[column.stamp](cell, before)
            if clock_of != (clock or clock_of):
                raise ValueError("some time stamps state their time zone, others do not")
        except ValueError as error:
            remedy = f"state the kind, one of {', '.join(STAMPS)}, or a unit of time"
            raise BayescalError(f"`{key}`: {error}", f"{log.name}:{log.line[row]}", remedy) from None
        clock, before = clock_of, seconds[row]
    return seconds, clock


def _unit_of(log: Log, key: str, column: Column, used: Expression) -> Unit:
    """The unit of an entry: as stated; else that of the header."""
    headed = [(i, log.units[i]) for i in used.columns]
    if column.unit is not None:
        for i, unit in headed:
            if unit is not None and unit != column.unit:
                head = log.header[i]
                what = f"`{key}` is stated in {column.unit.name}, but `{head}` of the file is in {unit.name}"
                raise BayescalError(what, log.name, "correct the map, or the header")
        return column.unit
    dimension = column.dimension or dimension_of(_base(key), ("deg",) * 99, log.name)
    units = {unit for _, unit in headed}
    if len(units) == 1 and (unit := units.pop()) is not None:
        return unit_of(unit.name, dimension, f"{log.name}: `{key}`")
    example = listed(dimension).split(", ")[0]
    remedy = f"write `{key}={column.name} {example}`, or one of {listed(dimension)}"
    raise BayescalError(f"column `{column.name}` of `{key}` has no unit", column.where, remedy)


def _mark(log: Log, numeric: set[int], decimal: str) -> str:
    """The decimal mark of the numbers with a comma; "" if there are none."""
    if decimal == "comma":
        return ","
    if not any("," in "".join([row[i] for row in log.rows]) for i in numeric):
        return ""
    numbered = list(zip(log.rows, log.line, strict=True))
    every = [(row[i].strip("[]"), n) for i in sorted(numeric) for row, n in numbered]
    commas = [(cell, n) for cell, n in every if "," in cell]
    if any(re.fullmatch(r"[+-]?\d*\.\d+(?:[eE][+-]?\d+)?", cell) for cell, _ in every):
        return "."
    if all(GROUPED.fullmatch(cell) for cell, _ in commas):
        what = f"'{commas[0][0]}' may have a decimal comma or a separator of thousands"
        remedy = "give --decimal comma, or remove the separators"
        raise BayescalError(what, f"{log.name}:{commas[0][1]}", remedy)
    return ","


class _Numbers:
    """Numbers of the columns of a log."""

    def __init__(self, log: Log, mark: str) -> None:
        self.log, self.mark = log, mark
        self.columns: dict[int, np.ndarray] = {}

    def value(self, key: str, expression: Expression) -> np.ndarray:
        """Values (N,) of an expression, which the map states for `key`."""
        return expression.value(partial(self.numbers, key), len(self.log.rows))

    def finite(self, key: str, expression: Expression) -> np.ndarray:
        """Values (N,), refused where they are not finite though all their cells are."""
        values = self.value(key, expression)
        given = np.all([np.isfinite(self.numbers(key, i)) for i in expression.columns], axis=0)
        if (bad := given & ~np.isfinite(values)).any():
            where = f"{self.log.name}:{self.log.line[int(np.argmax(bad))]}"
            what = f"`{key}` = {expression.text} has no finite value"
            raise BayescalError(what, where, "correct the expression")
        return values

    def numbers(self, key: str, index: int) -> np.ndarray:
        """Numbers (N,) of a column, nan where its cell is empty or `nan`."""
        if index not in self.columns:
            cells = [row[index] for row in self.log.rows]
            try:  # a long record: all cells at once
                out = np.array([float(cell) for cell in cells])
            except ValueError:
                out = np.array([np.nan])
            if not np.isfinite(out).all() or "_" in "".join(cells):
                out = np.array([self._number(row, cell, key) for row, cell in enumerate(cells)])
            self.columns[index] = out
        return self.columns[index]

    def _number(self, row: int, cell: str, key: str) -> float:
        text = cell.strip("[]")  # a list of joints, as URScript logs it
        if self.mark == "," and "." not in text:
            text = text.replace(",", ".")
        if not text or text.lower() == "nan":
            return np.nan
        if not is_number(text):
            where = f"{self.log.name}:{self.log.line[row]}"
            remedy = "correct the cell or remove the row"
            if "[" in cell:
                remedy = "write a column for each number of a list"
            elif "," in text or "'" in text or " " in text:
                remedy = "write numbers without separators of thousands"
            raise BayescalError(f"`{key}` is not a number: '{cell}'", where, remedy)
        return float(text)


def first(columns: Columns, bad: np.ndarray, what: Callable[[int], str], remedy: str) -> None:
    """Refuse the first row where `bad` (N,) holds, with its line."""
    if bad.any():
        row = int(np.argmax(bad))
        raise BayescalError(what(row), f"{columns.name}:{columns.line[row]}", remedy)
