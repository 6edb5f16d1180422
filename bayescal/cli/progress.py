"""The progress bar of long commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(first: str = "estimate") -> Iterator[Callable[[str, float], None]]:
    """A progress bar on the error stream; call it with a stage (or '12 of 200') and the fraction done.

    Parameters
    ----------
    first : str
        The stage shown first.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    with Progress(
        TextColumn("{task.description:>9}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True, highlight=False),
        transient=True,
    ) as bar:
        task = bar.add_task(first, total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)
