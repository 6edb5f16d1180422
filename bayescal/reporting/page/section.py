"""What a page consists of: sections, and the blocks of a section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from markupsafe import Markup


@dataclass(frozen=True)
class Section:
    """A part of a page: its anchor, its heading, its template, and the names that the template uses."""

    key: str
    title: str
    template: str
    context: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Fault:
    """What is wrong, on the first screen: its name, facts with their headings, and what to inspect."""

    name: str
    facts: tuple[tuple[str, str], ...] = ()
    remedy: str = ""


@dataclass(frozen=True)
class Bar:
    """A cell with a bar: the filled fraction (0 to 1), the text behind it, and whether it is marked."""

    fraction: float
    text: str
    marked: bool = False
    kind: ClassVar[str] = "bar"


@dataclass(frozen=True)
class Sheet:
    """A table: the heading of its first column, the headings of the others, its rows, and its caption.

    A cell is text, a `Bar` or markup. `words` are the columns (from 0) of text, which are set to the left;
    the first column always is. Rows beyond `shown` are folded.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    caption: str = ""
    words: tuple[int, ...] = ()
    shown: int | None = None
    kind: ClassVar[str] = "sheet"


@dataclass(frozen=True)
class Text:
    """A paragraph; `style` is "", "quiet", "warning" or "command"."""

    text: str
    style: str = ""
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Facts:
    """Names and their values."""

    rows: tuple[tuple[str, str], ...]
    kind: ClassVar[str] = "facts"


@dataclass(frozen=True)
class Figures:
    """Drawings beside each other, where there is room: title and SVG of each."""

    drawings: tuple[tuple[str, Markup], ...]
    kind: ClassVar[str] = "figures"


Block = Sheet | Text | Facts | Figures


def blocks(key: str, title: str, *parts: Block | None) -> Section | None:
    """A section of blocks, or None where it has none; tables without rows are left out."""
    some = [p for p in parts if p is not None and not (isinstance(p, Sheet) and not p.rows)]
    return Section(key, title, "blocks.html.j2", {"blocks": some}) if some else None


def texts(lines: Sequence[str], style: str = "") -> tuple[Text, ...]:
    """A paragraph of each line."""
    return tuple(Text(line, style) for line in lines)
