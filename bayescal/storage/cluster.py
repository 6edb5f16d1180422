"""Tasks on the workers of a Dask cluster. Only this module imports `distributed`."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from importlib.metadata import version
from typing import Any

from bayescal.errors import BayescalError
from bayescal.storage.reading import library
from bayescal.storage.tasks import Job, Lost, Queue, Work

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
        self.address, self.jobs, self._killed = address, dict[Future[Any], Job](), KilledWorker
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
        """See `tasks.Crew`.

        Raises
        ------
        BayescalError
                If there is no worker, or the scheduler was lost.
        """
        room = self._threads() - len(self.jobs)
        for _ in range(room):
            if (job := queue.take()) is None:
                return
            self.jobs[self._executor.submit(work, job.task)] = job

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
        """See `tasks.Crew`.

        Raises
        ------
        BayescalError
            Where the scheduler was lost, or lacks the package.
        """
        for future in [future for future in self.jobs if future.done()]:
            yield self.jobs.pop(future).index, self._result(future)

    def _result(self, future: Future[Any]) -> Any:
        try:
            return future.result()
        except self._killed as error:
            return Lost(f"the workers of this task were killed, {error.allowed_failures + 1} of them")
        except CancelledError:
            raise self._gone() from None
        except (ImportError, RuntimeError) as error:
            if isinstance(error, RuntimeError) and "deserialization" not in str(error):
                raise
            raise BayescalError("the cluster cannot load the work", self.address, INSTALL) from error

    def _gone(self) -> BayescalError:
        return BayescalError("the Dask scheduler was lost", self.address, AGAIN)

    def close(self) -> None:
        """See `tasks.Crew`."""
        self._executor.shutdown(wait=False)
        self._client.close(timeout=CONNECT)

    def kill(self) -> None:
        """See `tasks.Crew`; `close` cancels its jobs without waiting."""
