"""Independent tasks on worker processes, local or on a Dask cluster; lost tasks are repeated.

Only this module imports `distributed`.
"""

import logging
import os
import signal
import socket
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent import futures
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import Any

from bayescal.errors import BayescalError
from bayescal.storage.reading import library
from bayescal.storage.stopping import Stopped

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

    def put_back(self, job: Job) -> None:
        """Return a job to the queue."""
        self._back.append(job)


KILLS = 3
"""Number of killed processes after which a task is abandoned."""
GLANCE = 5.0
"""Seconds between checks of a crew: workers of a cluster may connect and disconnect."""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")


class Process:
    """A local process, and the job that it does; a job is there until its result is taken."""

    def __init__(self) -> None:
        self.jobs: dict[futures.Future[Any], Job] = {}
        self._pool = self._start()

    @staticmethod
    def _start() -> futures.ProcessPoolExecutor:
        return futures.ProcessPoolExecutor(1, get_context("spawn"), initializer=settle)

    def fill(self, work: Work, queue: Queue) -> None:
        """Submit a job, if none is under way."""
        while not self.jobs and (job := queue.take()):
            try:
                with _no_interrupts():  # the process is started here
                    self.jobs[self._pool.submit(work, job.task)] = job
            except futures.BrokenExecutor:  # it was killed between two jobs
                queue.put_back(job)
                self._pool = self._start()

    def done(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        """The finished job; one that was lost with its process is queued again, some times."""
        for future in [future for future in self.jobs if future.done()]:
            job = self.jobs.pop(future)
            if not isinstance(future.exception(), futures.BrokenExecutor):
                yield job.index, future.result()
                continue
            self._pool = self._start()
            job.kills += 1
            if job.kills == KILLS:
                yield job.index, Lost(f"its process was killed {KILLS} times")
            else:
                queue.put_back(job)

    def close(self) -> None:
        """Cancel jobs; the running one is awaited."""
        self._pool.shutdown(cancel_futures=True)

    def kill(self) -> None:
        """End running jobs: this process is stopped."""
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
        crews: list[Process | Cluster] = []
        for _ in range(workers if dask is None else 1):
            crews.append(Process() if dask is None else Cluster(dask))
            stack.callback(crews[-1].close)
        while True:
            for crew in crews:
                crew.fill(work, queue)
            under_way = [future for crew in crews for future in crew.jobs]
            if not under_way:
                return
            try:
                futures.wait(under_way, GLANCE, futures.FIRST_COMPLETED)
            except (KeyboardInterrupt, Stopped):
                for crew in crews:
                    crew.kill()
                raise
            for crew in crews:
                yield from crew.done(queue)


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """A process that is started within receives no Ctrl-C: its parent ends it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def settle() -> None:
    """Initialise a worker process: one thread of BLAS, Ctrl-C ignored, ends with its parent."""
    os.environ |= {f"{library}_NUM_THREADS": "1" for library in THREADS}
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (parent := parent_process()) is not None:
        Thread(target=_leave_with, args=(parent,), daemon=True).start()


def _leave_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


CONNECT = 10.0
"""Seconds to wait for the scheduler."""
PATIENCE = 30.0
"""Seconds to wait for a worker to connect, or to reconnect."""
MISSING = "a scheduler and workers are started with `dask scheduler` and `dask worker ADDRESS --nthreads 1`"
AGAIN = "the same command continues where it stopped"
PACKAGE = "bayescal"
INSTALL = "install the same bayescal for its scheduler and workers"


class Cluster:
    """All workers of a cluster, with one job for each of their current threads.

    No worker then has a waiting job: Dask counts the death of a worker against all of its jobs. Dask itself
    gives lost jobs to other workers, until too many workers died.
    """

    def __init__(self, address: str) -> None:
        library("distributed", "needs the package `distributed`", "--dask", "pip install 'bayescal[dask]'")
        from distributed import Client, KilledWorker
        from distributed.comm.addressing import get_address_host_port

        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # failures are reported here
        self.address, self.jobs, self._killed = address, dict[futures.Future[Any], Job](), KilledWorker
        try:  # test the address first: a client would retry for a long time
            socket.create_connection(get_address_host_port(address), CONNECT).close()
            self._client = Client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            words = str(error).partition("\n")[0] or "no answer"
            raise BayescalError(f"no Dask scheduler there: {words}", address, MISSING) from None
        self._executor = self._client.get_executor(pure=False)
        try:
            self._check()
        except BayescalError:
            self.close()
            raise

    def _check(self) -> None:
        """Raise an error for workers without the package: a failed import would end them like a crash."""
        self._threads()
        try:
            self._client.run(version, PACKAGE)
        except ImportError:
            raise BayescalError(f"a worker lacks {PACKAGE}", self.address, INSTALL) from None

    def fill(self, work: Work, queue: Queue) -> None:
        """See `Process`.

        Raises
        ------
        BayescalError
            If there is no worker, or the scheduler was lost.
        """
        room = self._threads() - len(self.jobs)
        while room > 0 and (job := queue.take()):
            self.jobs[self._executor.submit(work, job.task)] = job
            room -= 1

    def _threads(self) -> int:
        try:
            if not self._client.nthreads():
                self._client.wait_for_workers(1, timeout=PATIENCE)
            return sum(self._client.nthreads().values())
        except TimeoutError:
            raise BayescalError("has no workers", self.address, f"{MISSING}; {AGAIN}") from None
        except OSError:
            raise self._gone() from None

    def done(self, queue: Queue) -> Iterator[tuple[int, Any]]:
        """See `Process`.

        Raises
        ------
        BayescalError
            Where the scheduler was lost, or lacks the package.
        """
        for future in [future for future in self.jobs if future.done()]:
            yield self.jobs.pop(future).index, self._result(future)

    def _result(self, future: futures.Future[Any]) -> Any:
        try:
            return future.result()
        except self._killed as error:
            return Lost(f"the workers of this task were killed, {error.allowed_failures + 1} of them")
        except futures.CancelledError:
            raise self._gone() from None
        except (ImportError, RuntimeError) as error:
            if isinstance(error, RuntimeError) and "deserialization" not in str(error):
                raise
            raise BayescalError("the cluster cannot load the work", self.address, INSTALL) from error

    def _gone(self) -> BayescalError:
        return BayescalError("the Dask scheduler was lost", self.address, AGAIN)

    def close(self) -> None:
        """Cancel running jobs."""
        self._executor.shutdown(wait=False)
        self._client.close(timeout=CONNECT)

    def kill(self) -> None:
        """See `Process`; `close` cancels its jobs without waiting."""
