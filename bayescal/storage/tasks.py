"""Independent tasks, their queue, and what does them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol

Work = Callable[[Any], Any]


@dataclass(frozen=True)
class Lost:
    """The result of a task that killed its workers, with the reason as text."""

    words: str


@dataclass
class Job:
    """A task, its index, and the number of processes that it killed."""

    index: int
    task: Any
    kills: int = 0


class Queue:
    """Jobs to be done: returned ones first, then new ones, which are generated on demand."""

    def __init__(self, tasks: Iterable[Any]) -> None:
        self._fresh = (Job(k, task) for k, task in enumerate(tasks))
        self._back: deque[Job] = deque()

    def take(self) -> Job | None:
        """The next, or None."""
        return self._back.popleft() if self._back else next(self._fresh, None)

    def put_back(self, jobs: Iterable[Job]) -> None:
        """Return jobs to the queue, in their order."""
        self._back.extendleft(reversed(list(jobs)))


class Crew(Protocol):
    """Executor of jobs: a local process, or a cluster."""

    jobs: dict[Future[Any], Job]
    """Under way, in the order in which they were handed over."""

    def fill(self, work: Work, queue: Queue) -> None:
        """Submit jobs up to the capacity."""

    def done(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        """Return finished jobs; jobs that were lost with a worker are queued again."""

    def close(self) -> None:
        """Cancel running jobs."""

    def kill(self) -> None:
        """End running jobs: this process is stopped."""
