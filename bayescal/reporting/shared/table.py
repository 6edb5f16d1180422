"""Tables of the terminal in which no figure is ever cut off: names wrap, columns move to a further block."""

from __future__ import annotations

from collections.abc import Iterable

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Column, Table
from rich.text import Text

GAP = 2
"""Blanks between columns."""
LEAST_NAME = 15
"""Characters that a name keeps before columns move to a further block."""


class FigureTable(Table):
    """A table without lines: a column of names, headed by the title, and columns of figures to the right.

    A column of figures is as wide as its widest cell; its heading wraps at blanks. Names wrap. Columns that
    do not fit the terminal's width follow in a further block with the same names.
    """

    def __init__(self, title: str, *headings: str) -> None:
        super().__init__(box=None, pad_edge=False, header_style="dim", padding=(0, GAP, 0, 0))
        self.add_column(title)
        for heading in headings:
            self.add_column(heading, justify="right")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Blocks of columns, each no wider than the terminal."""
        names, *figures = self.columns
        longest = max(_cells(names), default=0)
        longest = max(longest, cell_len(str(names.header)))
        for k, block in enumerate(_blocks(figures, options.max_width - min(longest, LEAST_NAME))):
            if k:
                yield Text("")
            yield from self._block(block, longest, options.max_width)
        if self.caption:
            yield Text(str(self.caption), style="dim italic")

    def _block(self, figures: list[Column], longest: int, width: int) -> Iterable[Table]:
        room = max(width - sum(GAP + _width(c) for c in figures), 1)
        table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, GAP, 0, 0))
        table.add_column(_plain(self.columns[0].header), width=min(longest, room), overflow="fold")
        for column in figures:
            table.add_column(
                _plain(column.header), justify=column.justify, width=_width(column), overflow="fold"
            )
        columns = [list(c.cells) for c in (self.columns[0], *figures)]
        for row, cells in zip(self.rows, zip(*columns, strict=True), strict=True):
            table.add_row(*map(_plain, cells), style=row.style)
        yield table


def _plain(cell: RenderableType) -> RenderableType:
    """A cell whose text is no markup, whatever console prints it."""
    return Text(cell) if isinstance(cell, str) else cell


def _cells(column: Column) -> list[int]:
    """Widths of a column's cells."""
    return [cell.cell_len if isinstance(cell, Text) else cell_len(str(cell)) for cell in column.cells]


def _width(column: Column) -> int:
    """What a column of figures needs: its widest cell, and the longest word of its heading."""
    return max([1, *_cells(column), *(cell_len(word) for word in str(column.header).split())])


def _blocks(figures: list[Column], room: int) -> list[list[Column]]:
    """Columns in order, in as few blocks as fit a width; each block has one column at least."""
    out: list[list[Column]] = [[]]
    left = room
    for column in figures:
        left -= GAP + _width(column)
        if left < 0 and out[-1]:
            out.append([])
            left = room - GAP - _width(column)
        out[-1].append(column)
    return out
