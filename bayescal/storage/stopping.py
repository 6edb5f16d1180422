"""A command that is stopped: by Ctrl-C, or by the signal with which a batch system ends it.

The signal raises `Stopped` in the main thread, so that temporary files are removed. Where that takes long,
for example in compiled code, a second thread ends the process; the next command removes the files then.
"""

import atexit
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Lock, Thread, current_thread, main_thread
from types import FrameType
from typing import NoReturn

Progress = Callable[[str, float], None]
"""What a long calculation calls: with its stage (or '12 of 200') and the completed fraction."""
PATIENCE = 0.6
"""Seconds from a signal to the end of the process, unless the main thread ends before."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
SHOW_CURSOR = "\x1b[?25h"
"""A progress bar hides the cursor."""
_kept: list[Callable[[], str]] = [lambda: "nothing was written"]
_leaving: list[int] = []
"""The exit code of a stopped command, as soon as it ends."""
_reported = Lock()
"""Held as soon as the end of the process is reported."""


def silent(stage: str, fraction: float) -> None:
    """No report of the progress."""


class Stopped(BaseException):
    """The process is to end.

    Parameters
    ----------
    number : int
        The signal.
    """

    def __init__(self, number: int) -> None:
        self.number, self.kept = number, _kept[-1]()
        super().__init__(f"stopped; {self.kept}")

    @property
    def code(self) -> int:
        """The exit code, as a shell states it for a process that a signal ended."""
        return 128 + self.number

    def report(self) -> None:
        """Write one line to the error stream, once."""
        if _reported.acquire(blocking=False):
            with suppress(OSError, ValueError):
                lead = f"\r{SHOW_CURSOR}" if sys.stderr.isatty() else ""
                sys.stderr.write(f"{lead}bayescal: {self}\n")
                sys.stderr.flush()


@contextmanager
def keeping(text: Callable[[], str]) -> Iterator[None]:
    """State what is kept if the process is stopped within."""
    _kept.append(text)
    try:
        yield
    finally:
        _kept.remove(text)


def completed(text: str) -> None:
    """State what is complete, if the process is stopped from now on."""
    _kept[0] = lambda: text


@contextmanager
def stoppable() -> Iterator[None]:
    """Within, a signal raises `Stopped` in the main thread, and ends the process in less than a second.

    Signals that are ignored remain so. In another thread than the main one nothing changes.
    """
    if current_thread() is not main_thread():
        yield
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    before = {s: handler for s in SIGNALS if (handler := signal.getsignal(s)) is not signal.SIG_IGN}
    waking = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    for number in before:
        signal.signal(number, _stop)
    Thread(target=_end, args=(reading, tuple(before)), daemon=True).start()
    atexit.register(_at_end, tuple(before))  # the first that is registered is called last
    try:
        yield
    finally:
        signal.set_wakeup_fd(waking)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(writing)


def _stop(number: int, frame: FrameType | None) -> None:
    for each in SIGNALS:
        signal.signal(each, lambda number, frame: None)  # further signals change nothing
    sys.unraisablehook = lambda unraisable: None  # compiled code may lose the exception: see `_end`
    raise Stopped(number)


def _end(reading: int, numbers: tuple[int, ...]) -> None:
    """End the process some time after the first of the signals; return when nothing can come any more."""
    with suppress(OSError):
        while got := os.read(reading, 1):
            if got[0] in numbers:
                time.sleep(PATIENCE)
                stopped = Stopped(got[0])
                stopped.report()
                os._exit(stopped.code)
    os.close(reading)


def leave(stopped: Stopped) -> NoReturn:
    """Report why the process ends, and end it."""
    stopped.report()
    _leaving.append(stopped.code)
    sys.exit(stopped.code)


def _at_end(numbers: tuple[signal.Signals, ...]) -> None:
    """Let signals end the process while Python itself ends, without a traceback; a stopped one ends now.

    Python frees all modules at its end: half a second of processor time, in which no other thread runs.
    """
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)
    if _leaving:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        os._exit(_leaving[0])
