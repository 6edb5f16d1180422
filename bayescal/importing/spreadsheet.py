"""Cells of an Excel workbook; ``book.xlsx#Sheet`` names one of its sheets."""

from __future__ import annotations

import datetime
import zipfile
from pathlib import Path
from typing import Any

from bayescal.errors import BayescalError
from bayescal.importing.cells import Lines
from bayescal.reading import content_of

SUFFIXES = (".xlsx", ".xlsm")


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
    content_of(book)
    try:
        import openpyxl
    except ImportError:
        remedy = "install it: `pip install bayescal[xlsx]`, or save the sheet as CSV"
        raise BayescalError("workbooks need the package openpyxl", file, remedy) from None
    try:
        values, formulas = (
            openpyxl.load_workbook(book, read_only=True, data_only=only) for only in (True, False)
        )
    except (zipfile.BadZipFile, KeyError, ValueError, OSError):
        raise BayescalError("not a workbook", file, "save it again, or as CSV") from None
    try:
        name = _sheet(values, sheet, file)
        rows = list(values[name].iter_rows(values_only=True))
        sources = list(formulas[name].iter_rows(values_only=True))
    finally:
        values.close()
        formulas.close()
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


def _sheet(book: Any, sheet: str, file: str) -> str:
    """The sheet that is named, or the only one with rows."""
    if sheet and sheet not in book.sheetnames:
        raise BayescalError(f"no sheet `{sheet}`", file, f"there are {', '.join(book.sheetnames)}")
    filled = [sheet] if sheet else [s for s in book.sheetnames if any(map(any, book[s].values))]
    if len(filled) != 1:
        what = f"{len(filled)} sheets with rows" if filled else "no rows"
        example = f"`{file}#{(filled or book.sheetnames)[0]}`"
        raise BayescalError(what, file, f"name one: {example}; there are {', '.join(book.sheetnames)}")
    return filled[0]


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, (datetime.datetime, datetime.date, datetime.time)):
        return value.isoformat()
    return str(value).strip() if isinstance(value, str) else repr(value)
