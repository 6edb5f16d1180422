"""Small tasks for workers, which log that they were begun and may kill the process that does them."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Tiny:
    """A task: its number, where begun tasks are logged, and how many processes die of it."""

    number: int
    folder: Path
    deadly: int = 0
    seconds: float = 0.02


def work(task: Tiny) -> tuple[int, int]:
    """The square of the number, and the process that took it."""
    with (task.folder / f"{task.number}").open("a") as log:
        log.write(f"{os.getpid()}\n")
    time.sleep(task.seconds)
    if len(begun(task.folder, task.number)) <= task.deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    return task.number**2, os.getpid()


def begun(folder: Path, number: int) -> list[str]:
    """The processes that began a task."""
    return (folder / f"{number}").read_text().split()


def threads(_: object) -> str | None:
    """What BLAS was told before it was loaded."""
    return os.environ.get("OPENBLAS_NUM_THREADS")


def refuse(number: int) -> int:
    raise ValueError(f"not {number}")


def until(so, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not so():
        assert time.monotonic() < end
        time.sleep(0.02)


COUNT = 12
SQUARES = {k: k**2 for k in range(COUNT)}


def squares(found) -> dict[int, int]:
    return {index: result[0] for index, result in found}


def tiny(folder, **deadly) -> list[Tiny]:
    return [Tiny(k, folder, deadly.get(f"task{k}", 0)) for k in range(COUNT)]
