"""Figures of a second process: the same bytes, and none of its failures is seen."""

import subprocess
import sys

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


def started(*line):
    return subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


@pytest.mark.parametrize("program", ["raise SystemExit(3)", "import sys; sys.stdin.close()"])
def test_a_process_that_fails_is_replaced(ready, monkeypatch, program):
    monkeypatch.setattr(process, "_start", lambda: started(sys.executable, "-c", program))
    calls = drawn_here(monkeypatch)
    with process.drawing_beside():
        assert process.begun({"schema": FIT})() == {"a.png": b"here"}
    assert len(calls) == 1


def test_a_process_that_hangs_is_replaced_and_ended(ready, monkeypatch):
    line = (sys.executable, "-c", "import sys, time; sys.stdin.buffer.read(); time.sleep(60)")
    processes = []
    monkeypatch.setattr(process, "_start", lambda: processes.append(started(*line)) or processes[0])
    monkeypatch.setattr(process, "PATIENCE", 0.2)
    drawn_here(monkeypatch)
    with process.drawing_beside():
        assert process.begun({"schema": FIT})() == {"a.png": b"here"}
    assert processes[0].poll() is not None


def test_a_process_that_is_not_asked_ends(ready, monkeypatch):
    processes = []
    start = process._start
    monkeypatch.setattr(process, "_start", lambda: processes.append(start()) or processes[0])
    with pytest.raises(KeyError), process.drawing_beside():
        raise KeyError
    assert processes[0].poll() is not None
    assert not process._waiting


@pytest.mark.parametrize(
    ("cores", "imported", "wanted"), [(1, False, True), (2, True, True), (2, False, False)]
)
def test_no_process_where_it_is_of_no_use(ready, monkeypatch, cores, imported, wanted):
    monkeypatch.setattr(process, "cores", lambda: cores)
    monkeypatch.setattr(process, "_start", lambda: pytest.fail("started"))
    if imported:
        monkeypatch.setitem(sys.modules, "matplotlib", None)
    with process.drawing_beside(wanted):
        assert not process._waiting
