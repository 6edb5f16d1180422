"""One table for terminal, page, CSV and pandas: items, and columns with heading, value and text."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from rich.console import ConsoleRenderable, Group, RenderableType
from rich.text import Text

from bayescal.reporting.text import MISSING, FigureTable, facts, length

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True)
class Bar:
    """A cell with a bar: the filled fraction (0 to 1), the text behind it, and whether it is marked."""

    fraction: float
    text: str
    marked: bool = False
    kind: ClassVar[str] = "bar"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Parameters
    ----------
    heading : str
    of : str, int or callable
        What an item has there: its key, index or attribute, or a function of the item.
    text : callable
        Text (or `Bar`, markup) of a value; None is `MISSING`.
    words : bool
        Whether the cells are words, which a page sets to the left; the first column always is.
    """

    heading: str
    of: str | int | Callable[[Any], Any]
    text: Callable[[Any], Any] = str
    words: bool = False

    def value(self, item: Any) -> Any:
        """The value of an item."""
        if callable(self.of):
            return self.of(item)
        if isinstance(self.of, int) or isinstance(item, Mapping):
            return item[self.of]
        return getattr(item, self.of)

    def cell(self, item: Any) -> Any:
        """The text of an item."""
        value = self.value(item)
        return MISSING if value is None else self.text(value)


@dataclass(frozen=True)
class Sheet:
    """A table: columns, the first of names, and items, one for each row.

    Rows beyond `shown` are folded on a page. `style` is that of the row of an item in the terminal.
    """

    columns: tuple[Column, ...]
    items: Sequence[Any]
    caption: str = ""
    shown: int | None = None
    style: Callable[[Any], str] | None = None
    kind: ClassVar[str] = "sheet"

    @property
    def title(self) -> str:
        """The heading of the first column."""
        return self.columns[0].heading

    @property
    def headings(self) -> tuple[str, ...]:
        """The headings of the other columns."""
        return tuple(c.heading for c in self.columns[1:])

    @property
    def words(self) -> tuple[int, ...]:
        """Columns (from 0) of words."""
        return tuple(k for k, c in enumerate(self.columns) if c.words)

    @property
    def rows(self) -> tuple[tuple[Any, ...], ...]:
        """The cells."""
        return tuple(tuple(c.cell(item) for c in self.columns) for item in self.items)


def sheet_of_cells(headings: Iterable[str], rows: Iterable[Sequence[Any]], caption: str = "") -> Sheet:
    """A table of cells that are text already."""
    return Sheet(tuple(Column(h, k, as_is) for k, h in enumerate(headings)), tuple(rows), caption)


def of_key(function: Callable[[Any, Any], Any], key: Any) -> Callable[[Any], Any]:
    """The function of an item, from one of an item and a key: for columns that are made in a loop."""
    return lambda item: function(item, key)


def as_is(value: Any) -> Any:
    """A cell that needs no format."""
    return value


def headed(name: str, *further: str) -> Text:
    """The heading of a result in the terminal: its name, and what follows, without what is empty."""
    return Text.assemble((name, "bold"), *(f"  {text}" for text in further if text))


def inside(within: bool) -> Text:
    """Whether a value lies within its prediction interval, in the terminal."""
    return Text("within", style="green") if within else Text("outside", style="yellow")


def bar_of(
    items: Iterable[Mapping[str, Any]], key: str, marked: Callable[[Any], bool] = lambda item: False,
    unit: str = "",
) -> Callable[[Any], Bar]:  # fmt: skip
    """The bar of an item of a record: a length in µm relative to the largest of all items."""
    largest = max((item[key] or 0.0 for item in items), default=0.0) or 1.0
    return lambda item: Bar((item[key] or 0.0) / largest, length(item[key]) + unit, marked(item))


def terminal(sheet: Sheet, *headings: str) -> FigureTable:
    """A table of the terminal, where bars are their texts; with other headings also without the caption."""
    table = FigureTable(*(headings or (sheet.title, *sheet.headings)))
    for item, cells in zip(sheet.items, sheet.rows, strict=True):
        texts = (cell.text if isinstance(cell, Bar) else cell for cell in cells)
        table.add_row(*texts, style=sheet.style(item) if sheet.style else "")
    table.caption = "" if headings else sheet.caption
    return table


def screen(*parts: Any) -> RenderableType:
    """What the terminal prints of a result: a `Sheet`, `Facts` or a line each, one below the other.

    What is None, and tables without rows, are left out.
    """
    return Group(*(_printed(part) for part in parts if _holds(part)))


def _holds(part: Any) -> bool:
    return bool(part.items) if isinstance(part, Sheet) else part is not None


def _printed(part: Any) -> RenderableType:
    if isinstance(part, str | ConsoleRenderable):
        return part
    return terminal(part) if isinstance(part, Sheet) else facts(part)


def below(*parts: Any) -> tuple[Any, ...]:
    """Parts of a screen with a blank line above; nothing if the first of them is left out."""
    return ("", *parts) if _holds(parts[0]) else ()


def frame(sheet: Sheet, index: str) -> DataFrame:
    """A table of pandas: values, not texts, by heading; the column `index` becomes the index."""
    from pandas import DataFrame

    rows = [{c.heading: c.value(item) for c in sheet.columns} for item in sheet.items]
    return DataFrame(rows, columns=[c.heading for c in sheet.columns]).set_index(index)  # an empty one too
