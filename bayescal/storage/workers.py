"""Independent tasks on worker processes, local or on a Dask cluster; lost tasks are repeated."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import Any

from bayescal.storage.stopping import Stopped
from bayescal.storage.tasks import Crew, Job, Lost, Queue, Work

KILLS = 3
"""Number of killed processes after which a task is abandoned."""
DEPTH = 2
"""Tasks of a process: one running, one queued."""
GLANCE = 5.0
"""Seconds between checks of a crew: workers of a cluster may connect and disconnect."""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")


class Process:
    """A local process. Jobs run in order, so the first unfinished job is the one that killed it."""

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
                with _no_interrupts():  # the process is started here
                    self.jobs[self._pool.submit(work, job.task)] = job
            except BrokenExecutor:
                queue.put_back([job])
                if self.jobs:  # `done` handles them first
                    return
                self._pool = self._start()

    def done(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        """See `Crew`."""
        ended = [future for future in self.jobs if future.done()]
        if any(_broken(future) for future in ended):
            wait(self.jobs)  # later jobs fail with it
            yield from self._replaced(queue)
            return
        for future in ended:
            yield self.jobs.pop(future).index, future.result()

    def _replaced(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        """What the jobs of a broken pool returned, with a new pool for the others."""
        jobs, self.jobs, self._pool = self.jobs, {}, self._start()
        first, *behind = (job for future, job in jobs.items() if _broken(future))
        first.kills += 1
        given_up = first.kills == KILLS
        queue.put_back(behind if given_up else [first, *behind])
        yield from ((job.index, future.result()) for future, job in jobs.items() if not _broken(future))
        if given_up:
            yield first.index, Lost(f"its process was killed {KILLS} times")

    def close(self) -> None:
        """See `Crew`; the running job is awaited."""
        self._pool.shutdown(cancel_futures=True)

    def kill(self) -> None:
        """See `Crew`."""
        for process in list(self._pool._processes.values()):  # public from Python 3.14
            process.kill()


def results(
    work: Work, tasks: Iterable[Any], workers: int = 1, dask: str | None = None
) -> Generator[tuple[int, Any], None, None]:
    """Execute all tasks, and yield each result when it is finished.

    Use `contextlib.closing` where iteration may stop early: running tasks are then cancelled.

    Parameters
    ----------
    work : callable
        A function at module level; its exceptions are raised here.
    tasks : iterable
        Iterated on demand, so that few are in memory.
    workers : int
        Processes on this machine, each with one thread of BLAS.
    dask : str, optional
        Address of a Dask scheduler, ``tcp://host:port``, whose workers are used instead. They must have the
        same package.

    Yields
    ------
    tuple of int and object
        Index and result of each task, in the order of completion. The result is `Lost` where the task killed
        its worker three times (on Dask: ``allowed-failures`` of the cluster).

    Raises
    ------
    BayescalError
        If the cluster cannot be reached, or is lost.
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
            try:
                wait(under_way, GLANCE, FIRST_COMPLETED)
            except (KeyboardInterrupt, Stopped):
                for crew in crews:
                    crew.kill()
                raise
            for crew in crews:
                yield from crew.done(queue)


def _crews(workers: int, dask: str | None) -> list[Callable[[], Crew]]:
    if dask is None:
        return [Process] * workers
    from bayescal.storage.cluster import Cluster

    return [lambda: Cluster(dask)]


def _broken(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenExecutor)


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """A process that is started within receives no Ctrl-C: its parent ends it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _settle() -> None:
    """Initialise a worker process: one thread of BLAS, Ctrl-C ignored, ends with its parent."""
    os.environ |= {f"{library}_NUM_THREADS": "1" for library in THREADS}
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (parent := parent_process()) is not None:
        Thread(target=_leave_with, args=(parent,), daemon=True).start()


def _leave_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
