"""Pages of studies: Markdown tables, which are kept between two marks of a page of the documentation."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bayescal.errors import BayescalError
from bayescal.storage.files import write_together

Marks = tuple[str, str]


def line(cells: Iterable[object]) -> str:
    """A row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def table(headings: Iterable[str], lines: Iterable[Iterable[object]]) -> str:
    """A Markdown table; "" without lines."""
    head, body = list(headings), list(map(line, lines))
    return "\n".join([line(head), line(["---"] * len(head)), *body]) if body else ""


def between(path: Path, marks: Marks, text: str) -> None:
    """Replace the text between two marks of a page; the rest does not change.

    Raises
    ------
    BayescalError
        Where the page cannot be read or has no marks.
    """
    begin, end = marks
    try:
        before, rest = path.read_text(encoding="utf-8").split(begin, 1)
        _, after = rest.split(end, 1)
    except OSError as error:
        raise BayescalError(error.strerror or "cannot be read", str(path)) from None
    except ValueError:
        raise BayescalError(
            "the page has no marks for the tables", str(path), f"add {begin} and {end}"
        ) from None
    write_together({path: f"{before}{begin}\n{text}\n{end}{after}"})


def published(text: str, page: Path | None, marks: Marks, new: bool = False) -> None:
    """Print tables, and renew them in a page; a `new` page, if it does not exist, is made of them alone."""
    print(text)
    if page is not None:
        if new and not page.exists():
            page.write_text("\n".join((*marks, "")), encoding="utf-8")
        between(page, marks, text)
