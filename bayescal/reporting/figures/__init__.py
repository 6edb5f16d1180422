"""Figures of records, drawn by a second process while the first one computes and writes the other files.

`figures.py` lists the figures, and writes them as PNG. The process is started ahead, because it imports
Matplotlib first. It writes nothing: it answers a record with the bytes of the figures. If it fails for any
reason, the first process draws them itself.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from bayescal.storage.workers import settle

if TYPE_CHECKING:
    from bayescal.reporting.figures.estimates import Draws
    from bayescal.storage.reading import Json

Figures = dict[str, bytes]
"""Names of PNG files and their content."""
PATIENCE = 120.0
"""Time, s, after which a process that does not answer is ended (assumed: it draws in three)."""
AHEAD = ("matplotlib.backends.backend_agg", "matplotlib.figure", "PIL.PngImagePlugin", f"{__name__}.figures")
"""Modules that are slow to import: the process imports them while it waits for a record."""
_waiting: list[Connection] = []


@contextmanager
def drawing_beside(wanted: bool = True) -> Iterator[None]:
    """Have a process ready within, for the first record whose figures are `begun`.

    Without a second core, or where Matplotlib is imported already, there is none: it would take longer.
    """
    if not wanted or cores() < 2 or "matplotlib" in sys.modules:
        yield
        return
    here, there = Pipe()
    process = get_context("spawn").Process(target=answer, args=(there,), daemon=True)
    process.start()
    there.close()  # the process alone has it: it ends, and so does the pipe
    _waiting.append(here)
    try:
        yield
    finally:
        _waiting.clear()
        process.kill()
        process.join()


def answer(there: Connection) -> None:
    """Read a record, and answer with its figures: what the second process does."""
    settle()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # it says nothing on a terminal
    for name in AHEAD:
        import_module(name)
    there.send(figures_of(*there.recv()))


def figures_of(record: Json, draws: Draws | None = None) -> Figures:
    """The figures of a record, drawn by this process."""
    # imported here: a second process is started before all slow imports
    from bayescal.reporting.figures import figures

    return figures.figures_of(record, draws)


def begun(record: Json, draws: Draws | None = None) -> Callable[[], Figures]:
    """Begin to draw the figures of a record, with the draws of its parameters; call the result for them."""
    if not _waiting:
        return lambda: figures_of(record, draws)
    here = _waiting.pop()
    ThreadPoolExecutor(1).submit(here.send, (dict(record), draws))

    def wait() -> Figures:
        with suppress(OSError, EOFError):  # it failed
            if here.poll(PATIENCE):
                drawn: Figures = here.recv()
                return drawn
        return figures_of(record, draws)

    return wait


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
