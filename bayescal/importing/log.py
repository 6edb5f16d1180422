"""A log as a table: its header, its rows, and what is no row.

Rows of a text file: its encoding, the separator of its cells, comments.

Cells of an Excel workbook; ``book.xlsx#Sheet`` names one of its sheets.
"""

import csv
import datetime
import io
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayescal.errors import BayescalError, listed
from bayescal.importing.units import SPELLED, Unit, is_number, name_and_unit
from bayescal.storage.reading import content_of, library

SUFFIXES = (".xlsx", ".xlsm")
LARGEST = 2**28
"""Bytes of the parts of a workbook, unpacked."""
MOST_CELLS = 3_000_000
"""Cells of a sheet, and its rows: a file of 10 kB can state 10^10."""
TOO_LARGE = "delete what is not data, or save the sheet as CSV"
Row = tuple[object, ...]

COMMENTS = ("//", "#", "!", "%")
"""How a comment begins; SpatialAnalyzer writes ``//``."""

MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}
"""Byte order marks and their encodings."""

Rows = list[tuple[int, tuple[str, ...]]]
"""Cells of lines, stripped, with the number of each line."""


@dataclass(frozen=True)
class Lines:
    """Rows of a file without empty ones; comments apart; and notes on how they were read.

    `padded`: they are of a sheet, in which empty cells at the end of a row are no cells.
    """

    kept: Rows
    comments: Rows
    notes: tuple[str, ...] = ()
    padded: bool = False


def text_of(path: Path) -> tuple[str, str]:
    """The text of a file: UTF-8, UTF-16 with a byte order mark, or Windows-1252.

    Returns
    -------
    tuple of str
        The text, and a note if the file does not state its encoding, else "".

    Raises
    ------
    BayescalError
        If it is none of them.
    """
    content = content_of(path)
    marked = [name for mark, name in MARKS.items() if content.startswith(mark)]
    for encoding in marked or ("utf-8", "cp1252"):
        try:
            text = content.decode(encoding)
            break
        except UnicodeDecodeError:
            continue
    else:
        raise BayescalError("the encoding is not known", path.name, "save the file as UTF-8")
    guess = f"{path.name} is not UTF-8: it is read as Windows-1252 (Western European)"
    note = guess if encoding == "cp1252" else ""
    if "\0" in text:
        remedy = "save it as text in UTF-8; a spreadsheet must be .xlsx"
        raise BayescalError("not a text file", path.name, remedy)
    return text, note


def text_lines(path: Path) -> Lines:
    """Rows of a text file."""
    text, note = text_of(path)
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [(number, line) for number, line in lines if line.lstrip().startswith(COMMENTS)]
    kept = [(number, line) for number, line in lines if not line.lstrip().startswith(COMMENTS)]
    separator = _separator([line for _, line in kept])
    return Lines(
        [(number, _split(line, separator)) for number, line in kept],
        [(number, _split(line.lstrip().lstrip("".join(COMMENTS)), separator)) for number, line in comments],
        (note,) if note else (),
    )


def _split(line: str, separator: str) -> tuple[str, ...]:
    """Cells of a line, stripped; a white space at its end adds none."""
    if '"' in line:
        line = line.strip() if separator == " " else line
        out = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        return tuple(cell.strip() for cell in out if cell or separator != " ")
    return tuple(line.split()) if separator == " " else tuple(map(str.strip, line.split(separator)))


def _separator(lines: Sequence[str]) -> str:
    """A semicolon, a tab, a comma or white space: the first of them that most lines have."""
    return next((s for s in ";\t," if 2 * sum(s in line for line in lines) > len(lines)), " ")


def _lines(path: Path) -> Lines:
    """Rows of a file, or of a workbook, whose path may end with the name of a sheet."""
    is_workbook = path.name.partition("#")[0].lower().endswith(SUFFIXES)
    lines = sheet_lines(path) if is_workbook else text_lines(path)
    if not lines.kept:
        raise BayescalError("no rows", path.name, "check the file")
    return lines


def sheet_lines(path: Path) -> Lines:
    """Rows of a sheet as texts; of formulas the values that were computed last.

    Raises
    ------
    BayescalError
        Without the package openpyxl, for several sheets of which none is named, and for a formula without
        a value.
    """
    file, _, sheet = path.name.partition("#")
    content = content_of(path.with_name(file))
    remedy = "install it: `pip install bayescal[xlsx]`, or save the sheet as CSV"
    openpyxl = library("openpyxl", "workbooks need the package openpyxl", file, remedy)
    rows, sources, name = _rows(openpyxl.load_workbook, content, sheet, file)
    kept: Rows = []
    computed = 0
    for number, (row, source) in enumerate(zip(rows, sources, strict=True), 1):
        for value, formula in zip(row, source, strict=True):
            if isinstance(formula, str) and formula.startswith("="):
                computed += 1
                if value is None:
                    remedy = "open and save it in a spreadsheet program, or paste the values"
                    raise BayescalError(f"a formula without a value: {formula}", f"{file}:{number}", remedy)
        cells = tuple(_text(value) for value in row)
        while cells and not cells[-1]:
            cells = cells[:-1]
        if cells:
            kept.append((number, cells))
    notes = [f"sheet `{name}` of {file}"]
    if computed:
        notes.append(f"{computed} cells of {file} are formulas: their last values are read")
    return Lines(kept, [], tuple(notes), padded=True)


def _rows(load: Any, content: bytes, sheet: str, file: str) -> tuple[list[Row], list[Row], str]:
    """Rows of a sheet: values, formulas where there are any, and its name.

    Raises
    ------
    BayescalError
        Of a file that is no workbook, or one that is too large once it is unpacked.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as parts:
            size = sum(part.file_size for part in parts.infolist())
        if size > LARGEST:
            raise BayescalError(f"{size / 1e6:.0f} MB when unpacked", file, TOO_LARGE)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions, which are not read
            books = [load(io.BytesIO(content), read_only=True, data_only=only) for only in (True, False)]
            name = _sheet(books[0], sheet, file)
            values, formulas = (_cells(book, name, file) for book in books)
            return values, formulas, name
    except BayescalError:
        raise
    except Exception:  # openpyxl fails in any way at parts that are damaged
        raise BayescalError("not a workbook", file, "save it again, or as CSV") from None


def _cells(book: Any, name: str, file: str) -> list[Row]:
    """Rows of a sheet, without the empty ones behind its last."""
    out, count, cells = [], 0, book[name]
    cells.reset_dimensions()  # what a file states of its extent may be wrong: rows outside would be lost
    for row in cells.iter_rows(values_only=True):
        out.append(row)
        count += 1 + len(row)
        if count > MOST_CELLS:
            raise BayescalError(f"more than {MOST_CELLS / 1e6:.0f} million cells", file, TOO_LARGE)
    return out


def _sheet(book: Any, sheet: str, file: str) -> str:
    """The sheet that is named, or the only one with rows."""
    if sheet and sheet not in book.sheetnames:
        raise BayescalError(f"no sheet `{sheet}`", file, f"there are {listed(book.sheetnames)}")
    filled = [sheet] if sheet else [s for s in book.sheetnames if any(map(any, _cells(book, s, file)))]
    if len(filled) != 1:
        there = listed(book.sheetnames)
        if not filled:
            raise BayescalError("no rows", file, f"sheets are {there}")
        what = f"{len(filled)} sheets with rows"
        raise BayescalError(what, file, f"name one: `{file}#{filled[0]}`; there are {there}")
    return filled[0]


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, (datetime.datetime, datetime.date, datetime.time)):
        return value.isoformat()
    return str(value).strip() if isinstance(value, str) else repr(value)


KEY_VALUE = re.compile(r"[^\W\d][\w .]*[:=](\s|$)")
"""A line such as ``Total points: 40``."""

Missing = Callable[[Sequence[str]], int]
"""How many of the columns that a map needs are not in a row, taken as a header."""

SEARCHED = 500
"""Rows in which a header is sought."""


@dataclass(frozen=True)
class Log:
    """Cells of a file, stripped, row by row, with each row's line.

    `header` is empty where there is none. `units` are those that the header states, or a row below it.
    `notes` says what was left out.
    """

    name: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    units: tuple[Unit | None, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.rows[0])


def read_log(
    path: Path, headed: bool | None = None, missing: Missing | None = None, cut: bool = False
) -> Log:
    """Read a log.

    The separator is a semicolon, a tab, a comma or white space: the first of them that most lines have.
    Comments and empty lines are left out, and so are lines before the header, repetitions of the
    header, and lines at the end without numbers; `notes` counts them.

    Parameters
    ----------
    path : Path
        A text file, in UTF-8, UTF-16 with a byte order mark, or Windows-1252; or a workbook.
    headed : bool, optional
        Whether there is a header; left out, the first row is one if none of its cells is a number.
    missing : callable, optional
        Columns that a row lacks as the header: the header is the first row that lacks none.
    cut : bool
        Whether the last row may be cut off, as a recording that was stopped leaves it; it is then left out.

    Raises
    ------
    BayescalError
        If the file cannot be read, or its rows differ in length.
    """
    name, lines = path.name, _lines(path)
    header, rows, before = _headed(lines, headed, missing)
    notes = list(lines.notes)
    if before:
        notes.append(_left(before, name, "before the header"))
    widest = header or _usual(rows)
    header = _trimmed(header, len(widest)) if header else ()
    width = len(header) or len(_trimmed(widest, 0))
    rows = [(number, row[:-1] if len(row) == width + 1 and not row[-1] else row) for number, row in rows]
    units = [name_and_unit(cell)[1] for cell in header]
    if rows and header and len(rows[0][1]) == width and _are_units(rows[0][1]):
        below = [_unit(cell) for cell in rows.pop(0)[1]]
        units = [unit or other for unit, other in zip(units, below, strict=True)]
    again = [row for row in rows if header and row[1] == header]
    if again:
        notes.append(f"{len(again)} repetitions of the header of {name} left out")
        rows = [row for row in rows if row[1] != header and not (header and _are_units(row[1]))]
    footer: Rows = []
    while rows and _is_footer(rows[-1][1], width):
        footer.insert(0, rows.pop())
    if footer:
        notes.append(_left(footer, name, "behind the last row"))
    if not rows:
        raise BayescalError("no rows below the header", name, "check the file")
    if lines.padded:
        rows = [(number, row + ("",) * (width - len(row))) for number, row in rows]
    if missing is not None and missing(header):  # the map is refused, not the rows below what is no header
        rows = [(number, row) for number, row in rows if len(row) == width] or rows
    if cut and len(rows) > 1 and len(rows[-1][1]) < width:
        notes.append(_left([rows.pop()], name, "that is cut off"))
    for number, row in rows:
        if len(row) != width:
            what = f"{len(row)} cells, the {'header' if header else 'first row'} has {width}"
            remedy = "write a cell for each column; quote cells that contain a separator"
            raise BayescalError(what, f"{name}:{number}", remedy)
    numbers, body = zip(*rows, strict=True)
    return Log(name, header, body, numbers, tuple(units) or (None,) * width, tuple(notes))


def header_of(path: Path) -> tuple[str, ...]:
    """The probable header of a log whose map is not known, for a message; () if none is found."""
    rows = [(number, _trimmed(row, 0)) for number, row in _lines(path).kept[:SEARCHED]]
    width = len(_usual(rows))
    full = (row for _, row in rows if len(row) == width and all(row))
    return next((row for row in full if not any(map(is_number, row))), ())


def _headed(lines: Lines, headed: bool | None, missing: Missing | None) -> tuple[tuple[str, ...], Rows, Rows]:
    """The header, or (), the rows below it, and those before it."""
    rows = lines.kept
    if missing is not None:
        lacks: list[int] = []
        for _, row in rows[:SEARCHED]:
            lacks.append(missing(_trimmed(row, 0)))
            if not lacks[-1]:
                break
        if min(lacks) > 0:
            for number, row in lines.comments:
                if not missing(_trimmed(row, 0)):
                    below = [r for r in rows if r[0] > number]
                    return row, below, [r for r in rows if r[0] < number]
        best = lacks.index(min(lacks))
        return rows[best][1], rows[best + 1 :], rows[:best]
    if headed is None:
        headed = not any(map(is_number, rows[0][1]))
    return (rows[0][1], rows[1:], []) if headed else ((), rows, [])


def _usual(rows: Rows) -> tuple[str, ...]:
    """The first row with the most frequent number of cells; the first row if none is frequent."""
    count = Counter(len(row) for _, row in rows)
    usual = max(count, key=lambda width: (count[width], width == len(rows[0][1])))
    return next(row for _, row in rows if len(row) == usual) if count[usual] > 1 else rows[0][1]


def _trimmed(row: tuple[str, ...], least: int) -> tuple[str, ...]:
    """A row without an empty cell at its end, where its line ends with a separator."""
    return row[:-1] if len(row) > max(least - 1, 1) and not row[-1] else row


def _are_units(row: Iterable[str]) -> bool:
    """Whether a row below the header states units: some cells do, and all that are filled do."""
    stated = [cell for cell in row if cell not in ("", "-", "[-]", "[]")]
    return bool(stated) and all(_unit(cell) is not None for cell in stated)


def _unit(cell: str) -> Unit | None:
    return SPELLED.get(cell.strip("[]()<> "))


def _is_footer(row: Sequence[str], width: int) -> bool:
    """Whether a row at the end is no measurement: of another length or a single cell, without numbers."""
    filled = [cell for cell in row if cell]
    if len(row) == width and len(filled) > 1:
        return False
    return not any(map(is_number, filled)) or bool(KEY_VALUE.match(" ".join(filled)))


def _left(rows: Rows, name: str, where: str) -> str:
    """A note on lines left out: how many, where, and how the first begins."""
    text = " ".join(cell for cell in rows[0][1] if cell)
    shown = text if len(text) < 40 else text[:37] + "..."
    count = f"{len(rows)} line{'s' * (len(rows) > 1)}"
    return f"{count} of {name} {where} left out: '{shown}' (line {rows[0][0]})"
