"""Lines of a log, of whatever encoding, and their cells, whatever separates them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayescal.errors import BayescalError
from bayescal.reading import content_of

COMMENTS = ("//", "#", "!", "%")
"""How a comment begins; SpatialAnalyzer writes ``//``."""

MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}
"""Byte order marks and their encodings."""

Raw = str | tuple[str, ...]
"""A line of a text file, or the cells of a row of a spreadsheet."""


@dataclass(frozen=True)
class Lines:
    """Lines with their numbers, without empty ones; comments apart; and notes on how they were read."""

    kept: tuple[tuple[int, Raw], ...]
    comments: tuple[tuple[int, str], ...]
    notes: tuple[str, ...] = ()


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
    encoding = next((name for mark, name in MARKS.items() if content.startswith(mark)), "utf-8")
    note = ""
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        try:
            if encoding != "utf-8":
                raise
            text = content.decode("cp1252")
            note = f"{path.name} is not UTF-8: it is read as Windows-1252 (Western European)"
        except UnicodeDecodeError:
            raise BayescalError("the encoding is not known", path.name, "save the file as UTF-8") from None
    if "\0" in text:
        remedy = "save it as text in UTF-8; a spreadsheet must be .xlsx"
        raise BayescalError("not a text file", path.name, remedy)
    return text, note


def text_lines(path: Path) -> Lines:
    """Lines of a text file."""
    text, note = text_of(path)
    kept: list[tuple[int, Raw]] = []
    comments = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith(COMMENTS):
            comments.append((number, line))
        elif line.strip():
            kept.append((number, line))
    return Lines(tuple(kept), tuple(comments), (note,) if note else ())


def cells(raw: Raw, separator: str) -> tuple[str, ...]:
    """Cells of a line, stripped; a separator at its end adds none."""
    if isinstance(raw, tuple):
        return raw
    if separator == " ":
        return tuple(raw.split()) if '"' not in raw else _quoted(raw.strip(), separator)
    return tuple(map(str.strip, raw.split(separator))) if '"' not in raw else _quoted(raw, separator)


def _quoted(line: str, separator: str) -> tuple[str, ...]:
    out = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return tuple(cell.strip() for cell in out if cell or separator != " ")


def separator_of(lines: Sequence[Raw]) -> str:
    """A semicolon, a tab, a comma or white space: the first of them that most lines have."""
    texts = [line for line in lines if isinstance(line, str)]
    return next((s for s in ";\t," if 2 * sum(s in line for line in texts) > len(texts)), " ")
