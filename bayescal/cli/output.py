"""The run folder of a command, and what the command prints at its end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType


@contextmanager
def run_folder(out: Path | None, datasets: Sequence[Path], command: str) -> Iterator[Path]:
    """The folder that a command will write, locked: `out`, or runs/<datasets>-<command>.

    Checked before a long computation, so that its result can be written.

    Raises
    ------
    BayescalError
        If the folder contains files other than an earlier run of the command, or another run writes to it.
    """
    from bayescal.storage.folders import claimed

    names = "+".join(folder.resolve().name for folder in datasets)
    folder = out or Path("runs") / f"{names}-{command}"
    with claimed(folder, f"{command}.json"):
        yield folder


def show(report: RenderableType, folder: Path, written: Sequence[str]) -> None:
    """Print a result, and the names of the files that were written to its run folder."""
    from bayescal.public.results import console

    terminal = console()
    terminal.print(report)
    said(terminal, "written", f"{folder}/{', '.join(written)}")


def said(terminal: Console, heading: str, text: str, width: int = 17) -> None:
    """Print a line with its heading, however long it is."""
    from rich.text import Text

    terminal.print(Text.assemble((f"{heading:<{width}}", "dim"), text), soft_wrap=True)
