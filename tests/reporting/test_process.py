"""Figures of a second process: the same bytes, and none of its failures is seen."""

import os
import signal
import sys
from multiprocessing import active_children

import pytest

import bayescal.reporting.figures as process
from bayescal.reporting.figures.figures import FIT


@pytest.fixture
def ready(monkeypatch):
    """A machine with two cores and a process without Matplotlib, as a command finds it."""
    monkeypatch.setattr(process, "cores", lambda: 2)
    monkeypatch.delitem(sys.modules, "matplotlib", raising=False)


def drawn_here(monkeypatch):
    calls = []
    monkeypatch.setattr(process, "figures_of", lambda *given: calls.append(given) or {"a.png": b"here"})
    return calls


def test_a_process_that_was_killed_is_replaced(ready, monkeypatch):
    calls = drawn_here(monkeypatch)
    with process.drawing_beside():
        (second,) = active_children()
        second.kill()
        assert process.begun({"schema": FIT})() == {"a.png": b"here"}
    assert len(calls) == 1


def test_a_process_that_fails_is_replaced(ready, monkeypatch):
    calls = drawn_here(monkeypatch)
    with process.drawing_beside():
        assert process.begun({"schema": "of nothing"})() == {"a.png": b"here"}
    assert len(calls) == 1


def test_a_process_that_hangs_is_replaced_and_ended(ready, monkeypatch):
    monkeypatch.setattr(process, "PATIENCE", 0.2)
    drawn_here(monkeypatch)
    with process.drawing_beside():
        (second,) = active_children()
        os.kill(second.pid, signal.SIGSTOP)
        assert process.begun({"schema": FIT})() == {"a.png": b"here"}
    assert not second.is_alive()


def test_a_process_that_is_not_asked_ends(ready):
    def fails():
        with process.drawing_beside():
            second.extend(active_children())
            raise KeyError

    second = []
    with pytest.raises(KeyError):
        fails()
    assert [one.is_alive() for one in second] == [False]
    assert not process._waiting


@pytest.mark.parametrize(
    ("cores", "imported", "wanted"), [(1, False, True), (2, True, True), (2, False, False)]
)
def test_no_process_where_it_is_of_no_use(ready, monkeypatch, cores, imported, wanted):
    monkeypatch.setattr(process, "cores", lambda: cores)
    monkeypatch.setattr(process, "Pipe", lambda: pytest.fail("started"))
    if imported:
        monkeypatch.setitem(sys.modules, "matplotlib", None)
    with process.drawing_beside(wanted):
        assert not process._waiting
