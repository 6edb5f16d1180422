"""Independent tasks on worker processes, here or on a Dask cluster: a killed worker loses nothing."""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import Any, Protocol

KILLS = 3
"""Processes that a task may take with it before it is given up."""
DEPTH = 2
"""Tasks that a process has: one under way, one in its queue."""
GLANCE = 5.0
"""Seconds after which a crew is looked at though nothing was done: workers of a cluster come and go."""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")
Work = Callable[[Any], Any]


@dataclass(frozen=True)
class Lost:
    """What a task leaves behind that killed its workers, in words."""

    words: str


@dataclass
class Job:
    """A task, its place among all, and the processes that died of it."""

    index: int
    task: Any
    kills: int = 0


class Queue:
    """Jobs to be done: those that came back first, then fresh ones, taken up only as they are needed."""

    def __init__(self, tasks: Iterable[Any]) -> None:
        self._fresh = (Job(k, task) for k, task in enumerate(tasks))
        self._back: deque[Job] = deque()

    def take(self) -> Job | None:
        """The next, or None."""
        return self._back.popleft() if self._back else next(self._fresh, None)

    def put_back(self, jobs: Iterable[Job]) -> None:
        """Take jobs back, in their order."""
        self._back.extendleft(reversed(list(jobs)))


class Crew(Protocol):
    """What does jobs: one process of our own, or a cluster."""

    jobs: dict[Future[Any], Job]
    """Under way, in the order in which they were handed over."""

    def fill(self, work: Work, queue: Queue) -> None:
        """Take up as many jobs as are to be under way."""

    def done(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        """Hand over what was done since; what was lost with a worker goes back into the queue."""

    def close(self) -> None:
        """Drop what is under way."""


class Process:
    """One process. It does jobs in their order, so the first that is not done is the one that killed it."""

    def __init__(self) -> None:
        self.jobs: dict[Future[Any], Job] = {}
        self._pool = self._start()

    @staticmethod
    def _start() -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, get_context("spawn"), initializer=_settle)

    def fill(self, work: Work, queue: Queue) -> None:
        """See `Crew`."""
        while len(self.jobs) < DEPTH and (job := queue.take()):
            try:
                self.jobs[self._pool.submit(work, job.task)] = job
            except BrokenExecutor:
                queue.put_back([job])
                if self.jobs:  # `done` sees to them first
                    return
                self._pool = self._start()

    def done(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        """See `Crew`."""
        ended = [future for future in self.jobs if future.done()]
        if any(_broken(future) for future in ended):
            wait(self.jobs)  # those behind it break with it
            yield from self._buried(queue)
            return
        for future in ended:
            yield self.jobs.pop(future).index, future.result()

    def _buried(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        jobs, self.jobs, self._pool = self.jobs, {}, self._start()
        first, *behind = (job for future, job in jobs.items() if _broken(future))
        first.kills += 1
        given_up = first.kills == KILLS
        queue.put_back(behind if given_up else [first, *behind])
        yield from ((job.index, future.result()) for future, job in jobs.items() if not _broken(future))
        if given_up:
            yield first.index, Lost(f"the process that did it was killed {KILLS} times")

    def close(self) -> None:
        """See `Crew`; the job under way is waited for."""
        self._pool.shutdown(cancel_futures=True)


def results(
    work: Work, tasks: Iterable[Any], workers: int = 1, dask: str | None = None
) -> Generator[tuple[int, Any], None, None]:
    """Do all tasks, and hand over each result as it comes.

    Close it (`contextlib.closing`) where it may be left early: what is under way then is dropped.

    Parameters
    ----------
    work : callable
        Of a module's top level; what it raises is raised here.
    tasks : iterable
        Taken up as they are needed, so that few are in memory.
    workers : int
        Processes on this machine, each with one thread of BLAS.
    dask : str, optional
        Address of a Dask scheduler, ``tcp://host:port``, whose workers are used instead. They must have the
        same package.

    Yields
    ------
    tuple of int and object
        The place of a task and its result, in the order in which they are done. The result is `Lost` where
        the task killed its worker three times (on Dask, as often as the cluster's ``allowed-failures`` say).

    Raises
    ------
    BayescalError
        Where the cluster cannot be reached, or is lost.
    """
    queue = Queue(tasks)
    with ExitStack() as stack:
        crews: list[Crew] = []
        for make in _crews(workers, dask):
            crews.append(make())
            stack.callback(crews[-1].close)
        while True:
            for crew in crews:
                crew.fill(work, queue)
            under_way = [future for crew in crews for future in crew.jobs]
            if not under_way:
                return
            wait(under_way, GLANCE, FIRST_COMPLETED)
            for crew in crews:
                yield from crew.done(queue)


def _crews(workers: int, dask: str | None) -> list[Callable[[], Crew]]:
    if dask is None:
        return [Process] * workers
    from bayescal.blind.cluster import Cluster

    return [lambda: Cluster(dask)]


def _broken(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenExecutor)


def _settle() -> None:
    """Begin a worker process: one thread of BLAS, deaf to Ctrl-C (its parent hears it), gone with that."""
    os.environ |= {f"{library}_NUM_THREADS": "1" for library in THREADS}
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (parent := parent_process()) is not None:
        Thread(target=_leave_with, args=(parent,), daemon=True).start()


def _leave_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
