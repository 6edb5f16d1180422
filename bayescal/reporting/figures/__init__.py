"""Figures of records, drawn by a second process while the first one computes and writes the other files.

`figures.py` lists the figures, and writes them as PNG. The process is started ahead, because it imports
Matplotlib first. It writes nothing: it answers a record with the bytes of the figures. If it fails for any
reason, the first process draws them itself.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayescal.reporting.figures.estimates import Draws
    from bayescal.storage.reading import Json

Figures = dict[str, bytes]
"""Names of PNG files and their content."""
PATIENCE = 120.0
"""Time, s, after which a process that does not answer is ended (assumed: it draws in three)."""
AHEAD = ("matplotlib.backends.backend_agg", "matplotlib.figure", "PIL.PngImagePlugin")
"""Modules that are slow to import: the process imports them while it waits for a record."""
_waiting: list[subprocess.Popen[bytes]] = []


@contextmanager
def drawing_beside(wanted: bool = True) -> Iterator[None]:
    """Have a process ready within, for the first record whose figures are `begun`.

    Without a second core, or where Matplotlib is imported already, there is none: it would take longer.
    """
    if not wanted or cores() < 2 or "matplotlib" in sys.modules:
        yield
        return
    started = _start()
    _waiting.append(started)
    try:
        yield
    finally:
        started.kill()
        if started in _waiting:  # else the thread that asks it closes it
            _waiting.remove(started)
            started.communicate()
        started.wait()


def figures_of(record: Json, draws: Draws | None = None) -> Figures:
    """The figures of a record, drawn by this process."""
    # imported here: a second process is started before all slow imports
    from bayescal.reporting.figures import figures

    return figures.figures_of(record, draws)


def begun(record: Json, draws: Draws | None = None) -> Callable[[], Figures]:
    """Begin to draw the figures of a record, with the draws of its parameters; call the result for them."""
    if not _waiting:
        return lambda: figures_of(record, draws)
    question = pickle.dumps((dict(record), draws))
    asked = ThreadPoolExecutor(1).submit(_waiting.pop().communicate, question)

    def wait() -> Figures:
        try:
            drawn: Figures = pickle.loads(asked.result(PATIENCE)[0])
        except (TimeoutError, OSError, EOFError, pickle.UnpicklingError):  # it hangs, or failed
            return figures_of(record, draws)
        return drawn

    return wait


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _start() -> subprocess.Popen[bytes]:
    """The process: it imports from the same folders as this one, and says nothing on a terminal."""
    code = f"from {__name__} import answer; answer()"
    return subprocess.Popen(
        [sys.executable, "-P", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )  # fmt: skip


def answer() -> None:
    """Read a record, and write its figures: what the second process does."""
    for name in (*AHEAD, "bayescal.reporting.figures.figures"):
        import_module(name)
    asked = sys.stdin.buffer.read()
    if asked:  # else the first process has ended
        sys.stdout.buffer.write(pickle.dumps(figures_of(*pickle.loads(asked))))
