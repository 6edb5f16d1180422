"""Figures of a second process: the same bytes, and none of its failures is seen."""

import sys
import time

import pytest

import bayescal.reporting.figures as process
from bayescal.reporting.figures.figures import FIT
from bayescal.storage.workers import kill


@pytest.fixture
def ready(monkeypatch):
    """A machine with two cores and a process without Matplotlib, as a command finds it."""
    monkeypatch.setattr(process, "cores", lambda: 2)
    monkeypatch.delitem(sys.modules, "matplotlib", raising=False)


def drawn_here(monkeypatch):
    calls = []
    monkeypatch.setattr(process, "figures_of", lambda *given: calls.append(given) or {"a.png": b"here"})
    return calls


def waiting():
    """The process that is ready, and what it was given to do."""
    (pool,) = process._waiting
    return pool, list(pool._processes.values())


def test_a_process_that_was_killed_is_replaced(ready, monkeypatch):
    calls = drawn_here(monkeypatch)
    with process.drawing_beside():
        kill(waiting()[0])
        assert process.begun({"schema": FIT})() == {"a.png": b"here"}
    assert len(calls) == 1


def test_a_process_that_fails_is_replaced(ready, monkeypatch):
    begun = process.begun
    with process.drawing_beside():
        wait = begun({"schema": "of nothing"})  # which has no figures
        calls = drawn_here(monkeypatch)
        assert wait() == {"a.png": b"here"}
    assert len(calls) == 1


def test_a_process_that_hangs_is_replaced_and_ended(ready, monkeypatch):
    monkeypatch.setattr(process, "PATIENCE", 0.2)
    drawn_here(monkeypatch)
    with process.drawing_beside():
        pool, processes = waiting()
        pool.submit(time.sleep, 60)
        assert process.begun({"schema": FIT})() == {"a.png": b"here"}
    assert not any(one.is_alive() for one in processes)


def test_a_process_that_is_not_asked_ends(ready):
    def fails():
        with process.drawing_beside():
            processes.extend(waiting()[1])
            raise KeyError

    processes = []
    with pytest.raises(KeyError):
        fails()
    assert processes
    assert not any(one.is_alive() for one in processes)
    assert not process._waiting


@pytest.mark.parametrize(
    ("cores", "imported", "wanted"), [(1, False, True), (2, True, True), (2, False, False)]
)
def test_no_process_where_it_is_of_no_use(ready, monkeypatch, cores, imported, wanted):
    monkeypatch.setattr(process, "cores", lambda: cores)
    monkeypatch.setattr(process, "ProcessPoolExecutor", lambda *given: pytest.fail("started"))
    if imported:
        monkeypatch.setitem(sys.modules, "matplotlib", None)
    with process.drawing_beside(wanted):
        assert not process._waiting
