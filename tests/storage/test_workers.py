"""Tasks on worker processes: all are done, each once, whatever happens to the workers."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
import tiny_work
from cases import ROOT, refused
from tiny_work import COUNT, SQUARES, Tiny, squares, tiny, until

from bayescal.errors import BayescalError
from bayescal.storage.stopping import Stopped
from bayescal.storage.workers import KILLS, Lost, results


def children() -> list:
    """Worker processes of ours."""
    return [p for p in multiprocessing.active_children() if p.name.startswith("SpawnProcess")]


def test_all_are_done_by_all_and_few_are_under_way(tmp_path):
    taken, done, processes = [], {}, set()

    def tasks():
        for task in tiny(tmp_path):
            assert len(taken) - len(done) < 2
            taken.append(task)
            yield task

    assert not children()
    for index, (square, process) in results(tiny_work.work, tasks(), workers=2):
        done[index] = square
        processes.add(process)
        assert len(children()) == 2
    assert done == SQUARES
    assert len(processes) == 2
    assert os.getpid() not in processes
    assert not children()


def begun(folder) -> dict[int, int]:
    """How often each task was begun."""
    return {k: len(tiny_work.begun(folder, k)) for k in range(COUNT)}


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_worker_loses_nothing(tmp_path, workers):
    assert squares(results(tiny_work.work, tiny(tmp_path, task5=1), workers)) == SQUARES
    assert begun(tmp_path) == dict.fromkeys(range(COUNT), 1) | {5: 2}


def test_a_task_that_kills_is_given_up(tmp_path):
    found = dict(results(tiny_work.work, tiny(tmp_path, task0=99, task5=KILLS - 1), workers=2))
    assert isinstance(found.pop(0), Lost)
    assert squares(found.items()) == {k: v for k, v in SQUARES.items() if k}
    assert len(tiny_work.begun(tmp_path, 0)) == KILLS


def test_what_work_raises_is_raised_and_nothing_stays_behind():
    with pytest.raises(ValueError, match="not 3"):
        list(results(tiny_work.refuse, [3]))
    assert not children()


def test_left_early_it_drops_the_rest(tmp_path):
    with closing(results(tiny_work.work, tiny(tmp_path))) as found:
        next(found)
    assert not children()
    assert len(list(tmp_path.iterdir())) == 1


def test_blas_has_one_thread(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    assert dict(results(tiny_work.threads, [0])) == {0: "1"}


def test_workers_go_with_their_parent(tmp_path):
    program = (
        "import tiny_work, pathlib, sys\n"
        "from bayescal.storage.workers import results\n"
        "if __name__ == '__main__':\n"
        f"    list(results(tiny_work.work, [tiny_work.Tiny(0, pathlib.Path({str(tmp_path)!r}), 0, 600.0)]))\n"
    )
    script = tmp_path / "parent.py"
    script.write_text(program)
    environment = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
    parent = subprocess.Popen([sys.executable, str(script)], env=environment)
    until(lambda: (tmp_path / "0").exists() and tiny_work.begun(tmp_path, 0))
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    worker = int(tiny_work.begun(tmp_path, 0)[0])
    until(lambda: not alive(worker))


@pytest.mark.parametrize("stop", [KeyboardInterrupt, Stopped(signal.SIGINT)])
def test_a_stop_ends_the_workers_without_awaiting_their_jobs(tmp_path, monkeypatch, stop):
    def stopped(*args):
        until(lambda: (tmp_path / "0").exists() and tiny_work.begun(tmp_path, 0))
        raise stop

    monkeypatch.setattr("bayescal.storage.workers.futures.wait", stopped)
    begin = time.monotonic()
    with pytest.raises((KeyboardInterrupt, Stopped)):
        list(results(tiny_work.work, [Tiny(0, tmp_path, 0, 600.0)]))
    assert time.monotonic() - begin < 300
    assert not children()


def alive(process: int) -> bool:
    """Whether a process is there and has not ended."""
    stat = Path(f"/proc/{process}/stat")
    return stat.exists() and stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense", "tcp://nowhere.invalid:8786"])
def test_no_scheduler_there(address):
    refused("no Dask scheduler there", lambda: list(results(tiny_work.refuse, [3], dask=address)))


def test_dask_is_asked_for_where_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BayescalError, match=r"pip install 'bayescal\[dask\]'"):
        list(results(tiny_work.refuse, [3], dask="tcp://127.0.0.1:9"))


def test_dask_does_the_same_though_a_worker_is_killed(cluster, tmp_path):
    found = dict(results(tiny_work.work, tiny(tmp_path, task5=1), dask=cluster.scheduler_address))
    assert squares(found.items()) == SQUARES
    killed, other = tiny_work.begun(tmp_path, 5)
    assert killed != other  # both take part, though all results may be of one of them:
    for k in range(COUNT):  # those that the killed worker still held are computed again
        first, *again = tiny_work.begun(tmp_path, k)
        assert not again or (first == killed and len(again) == 1)


def test_what_work_raises_on_dask_is_raised(cluster):
    with pytest.raises(ValueError, match="not 3"):
        list(results(tiny_work.refuse, [3], dask=cluster.scheduler_address))


def test_workers_without_the_package_are_refused(cluster, monkeypatch):
    monkeypatch.setattr("bayescal.storage.workers.PACKAGE", "bayescal-of-elsewhere")
    with pytest.raises(BayescalError, match="a worker lacks bayescal-of-elsewhere; install"):
        list(results(tiny_work.refuse, [3], dask=cluster.scheduler_address))
