"""Cells of an Excel workbook; ``book.xlsx#Sheet`` names one of its sheets."""

from __future__ import annotations

import datetime
import io
import warnings
import zipfile
from pathlib import Path
from typing import Any

from bayescal.errors import BayescalError, listed
from bayescal.importing.cells import Lines
from bayescal.reading import content_of

SUFFIXES = (".xlsx", ".xlsm")
LARGEST = 2**28
"""Bytes of the parts of a workbook, unpacked."""
MOST_CELLS = 3_000_000
"""Cells of a sheet, and its rows: a file of 10 kB can state 10^10."""
TOO_LARGE = "delete what is not data, or save the sheet as CSV"
Row = tuple[object, ...]


def is_spreadsheet(path: Path) -> bool:
    """Whether a path, with the name of a sheet or without, is that of a workbook."""
    return path.name.partition("#")[0].lower().endswith(SUFFIXES)


def sheet_lines(path: Path) -> Lines:
    """Rows of a sheet as texts; of formulas the values that were computed last.

    Raises
    ------
    BayescalError
        Without the package openpyxl, for several sheets of which none is named, and for a formula without
        a value.
    """
    file, _, sheet = path.name.partition("#")
    book = path.with_name(file)
    content = content_of(book)
    try:
        import openpyxl
    except ImportError:
        remedy = "install it: `pip install bayescal[xlsx]`, or save the sheet as CSV"
        raise BayescalError("workbooks need the package openpyxl", file, remedy) from None
    rows, sources, name = _rows(openpyxl.load_workbook, content, sheet, file)
    kept: list[tuple[int, tuple[str, ...]]] = []
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
    return Lines(tuple(kept), (), tuple(notes))


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
            values, formulas = (
                load(io.BytesIO(content), read_only=True, data_only=only) for only in (True, False)
            )
            name = _sheet(values, sheet, file)
            return _cells(values, name, file), _cells(formulas, name, file), name
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
