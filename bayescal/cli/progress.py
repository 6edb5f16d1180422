"""The progress of long commands: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Event, Lock, Thread

EVERY = 5.0
"""Seconds between two lines, at least; a shorter command writes none."""
GROWTH = 0.1
"""Smallest time between two lines, as a fraction of the elapsed time: a run of an hour writes some dozens."""


@contextmanager
def progress(first: str = "estimate") -> Iterator[_Bar | _Lines]:
    """The progress of a command on the error stream.

    It is called with a stage (or '12 of 200') and the completed fraction; `say` prints a line beside it.

    Parameters
    ----------
    first : str
        The stage shown first.
    """
    with bar(first) if sys.stderr.isatty() else lines(first) as shown:
        yield shown


@dataclass
class _Bar:
    """A bar of rich."""

    update: Callable[[str, float], None]
    say: Callable[[str], None]

    def __call__(self, stage: str, fraction: float) -> None:
        self.update(stage, fraction)


@contextmanager
def bar(first: str) -> Iterator[_Bar]:
    """A progress bar, removed at the end."""
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Rich

    from bayescal.public.results import console

    terminal = console(stderr=True)
    with Rich(
        TextColumn("{task.description:>9}", markup=False),
        BarColumn(),
        TimeRemainingColumn(),
        console=terminal,
        transient=True,
    ) as shown:
        task = shown.add_task(first, total=1.0)

        def update(stage: str, fraction: float) -> None:
            shown.update(task, description=stage, completed=fraction)

        yield _Bar(update, lambda text: terminal.print(text, soft_wrap=True))


@dataclass
class _Lines:
    """Lines of text: stage, completed share, elapsed time."""

    stage: str
    fraction: float = 0.0
    begin: float = field(default_factory=time.monotonic)
    ended: Event = field(default_factory=Event)
    _lock: Lock = field(default_factory=Lock)

    def __call__(self, stage: str, fraction: float) -> None:
        self.stage, self.fraction = stage, fraction

    def say(self, text: str) -> None:
        """Print a line."""
        with self._lock:
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()

    def watch(self) -> None:
        """Print lines until the end, also while the command reports nothing."""
        while not self.ended.wait(max(EVERY, GROWTH * self.elapsed)):
            self.say(f"{self.stage} {100 * self.fraction:.0f} %, {self.elapsed:.0f} s")

    @property
    def elapsed(self) -> float:
        """Seconds since the begin."""
        return time.monotonic() - self.begin


@contextmanager
def lines(first: str) -> Iterator[_Lines]:
    """Lines on the error stream, from a thread of their own."""
    shown = _Lines(first)
    thread = Thread(target=shown.watch, daemon=True)
    thread.start()
    try:
        yield shown
    finally:
        shown.ended.set()
        thread.join()
