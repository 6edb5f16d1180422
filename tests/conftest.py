"""The gate: examples, skips, data of others, compiled code; and fixtures that all tests share."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded, as in a command: threads wait

import gc
import inspect
import shutil
import sys
from functools import wraps

import numpy as np
import pytest
import sessions
from cases import undrawn
from hypothesis import HealthCheck, settings
from loops import asserting

from bayescal.arm.chain import Robot
from bayescal.calibration import VALIDATION_DRAWS
from bayescal.reporting import figures as process
from bayescal.reporting.page.build import BROWSERS
from bayescal.robots import load_robot

# no limit of time, and the same examples in every run: `--hypothesis-profile=explore` draws others
settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("repeatable", settings.get_profile("explore"), derandomize=True)
settings.load_profile("repeatable")

FOREIGN = "data of others are not beside the clone"
SKIPS = (
    FOREIGN,
    "no browser: BAYESCAL_BROWSER=none",
    "not possible on this system",
    "not in the extra `test`",
)
"""How the reason of a skip may begin; any other skip is a failure: a broken install must not be green."""

gc.disable()  # until all tests are collected: nothing of them is garbage


def pytest_configure(config):
    config.addinivalue_line("markers", "foreign(path): needs a file or folder in `shared/` beside the clone")
    config.addinivalue_line("markers", "notebook: a long one, which `make notebooks` runs")
    # compiled once for all workers and for the processes that tests start, also of copies of the package
    if hasattr(config, "cache"):
        os.environ.setdefault("NUMBA_CACHE_DIR", str(config.cache.mkdir("numba")))
    # and so is the code of Python, whatever the environment says: a fifth of the time of a command
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False


def pytest_collection_modifyitems(items):
    for item in items:
        if any(not mark.args[0].exists() for mark in item.iter_markers("foreign")):
            item.add_marker(pytest.mark.skip(reason=FOREIGN))


def pytest_collection_finish():
    """The half million objects of the collected tests are not searched for garbage in every test's time."""
    gc.freeze()
    gc.set_threshold(5_000)  # with the usual 700, 3 % of the time of the tests
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    """A test fails where its assertions stand in loops and none of them was reached."""
    call, function = pyfuncitem.obj, inspect.unwrap(pyfuncitem.obj)
    pyfuncitem.obj = wraps(call)(lambda **given: asserting(function, lambda: call(**given)))
    try:
        return (yield)
    finally:
        pyfuncitem.obj = call


def judged(report):
    """A report whose skip has a reason that is not listed, as a failure."""
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = str(report.longrepr[2]).removeprefix("Skipped: ")
        if not reason.startswith(SKIPS):
            report.outcome, report.longrepr = "failed", f"a skip that is not listed in conftest.py: {reason}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    return judged((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report():
    return judged((yield))


def pytest_terminal_summary(terminalreporter):
    """How many tests saw the data of others."""
    count = {
        outcome: sum("foreign" in getattr(r, "keywords", ()) for r in terminalreporter.getreports(outcome))
        for outcome in ("passed", "failed", "skipped")
    }
    if any(count.values()):
        each = ", ".join(f"{number} {outcome}" for outcome, number in count.items())
        terminalreporter.write_line(f"data of others: {each}")


@pytest.fixture(scope="session")
def chromium():
    """Path of Chromium or Chrome: without one a test fails, unless BAYESCAL_BROWSER is "none"."""
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if not found and os.environ.get("BAYESCAL_BROWSER") == "none":
        pytest.skip("no browser: BAYESCAL_BROWSER=none")
    assert found, "no Chromium or Chrome: install one, or set BAYESCAL_BROWSER=none"
    return found


@pytest.fixture(scope="session")
def renewed(tmp_path_factory):
    """A function that brings a page up to date, checks what is around the marks, and returns the new text.

    Its arguments are the two marks, or the module that has them, a function of the path, and the folder of
    the page, if that must not be another.
    """

    def of(marks, update, folder=None):
        begin, end = marks if isinstance(marks, tuple) else (marks.BEGIN, marks.END)
        path = (folder or tmp_path_factory.mktemp("page")) / "page.md"
        path.write_text(f"before\n{begin}\nold\n{end}\nafter\n", encoding="utf-8")
        update(path)
        text = path.read_text(encoding="utf-8")
        assert text.startswith(f"before\n{begin}\n")
        assert text.endswith(f"\n{end}\nafter\n")
        assert "\nold\n" not in text
        return text

    return of


@pytest.fixture(autouse=True, scope="session")
def _undrawn():
    """Figures of a run are not drawn, nor by a second process, but `with drawn()`: each takes .3 s.

    A fit predicts with a quarter of the usual draws, which are a third of its time.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, "cores", lambda: 1)
        patch.setattr(process, "figures_of", undrawn)
        patch.setattr("bayescal.calibration.VALIDATION_DRAWS", 500)
        yield


@pytest.fixture(scope="module")
def usual_draws():
    """Fits of the module predict with as many draws as in a command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.calibration.VALIDATION_DRAWS", VALIDATION_DRAWS)
        yield


@pytest.fixture(scope="session")
def lrmate() -> Robot:
    """The built-in robot."""
    return load_robot("fanuc-lrmate200ic")[0]


def written_out(model, constraint, z: np.ndarray) -> np.ndarray:
    """A constraint's residuals at z: of its targets' states, less what its paper is said to be wrong by."""
    states = [model.block_of[name].state(z[model.slices[name]]) for name in constraint.targets]
    r, _ = constraint.function(*states)
    values = dict(zip(model.names, model.physical(z), strict=True))
    certified_values = model.scene.circumstances(model.scene.rows("calibrate")).certified_values
    mine = [p for p in certified_values if p.certificates == constraint.numbers]
    assert len(constraint.numbers) == 1
    return r - np.array([values.get(f"artefact {p.name}", 0.0) / p.u for p in mine])


def searching_little():
    """A plan's search tries few configurations and places: contacts are as free, and fewer are found."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"FIRST": 20, "HOMES": 2, "PROBES": 8}.items():  # of spheres that validate
            patch.setattr(f"bayescal.planning.search.{name}", value)
        patch.setattr("bayescal.probing.motions.HUBS", 16)  # raised configurations, for ways around
        patch.setattr("bayescal.probing.motions.CHAINED", ((16, 10),))
        yield


quick_search = pytest.fixture(searching_little, name="quick_search")
quick_searches = pytest.fixture(searching_little, name="quick_searches", scope="module")


@pytest.fixture(scope="session")
def tie_residuals():
    """Whitened residuals of a certificate."""
    return written_out


@pytest.fixture(scope="session")
def cube():
    """Maker of cube sessions."""
    return sessions.cube


@pytest.fixture(scope="session")
def tracker():
    """Maker of tracker sessions."""
    return sessions.tracker


@pytest.fixture
def command(monkeypatch, capsys):
    """The command line in this process: exit code, output and error text for its arguments."""
    from bayescal.cli import main

    monkeypatch.setattr("bayescal.cli.root.EVERY", 3600.0)  # no lines of progress on a busy machine

    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["bayescal", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


@pytest.fixture
def output_of(command):
    """What a command prints that succeeds."""

    def of(*arguments):
        code, text, error = command(*arguments)
        assert code == 0, error
        return text

    return of


@pytest.fixture
def error_of(command):
    """The only line of a command that refuses."""

    def of(*arguments):
        code, _, error = command(*arguments)
        assert (code, error.count("\n")) == (1, 1), error
        return error

    return of


IDLE = {f"distributed.worker.memory.{of}": False for of in ("target", "spill", "pause", "terminate")}
IDLE |= {"distributed.worker.profile.enabled": False, "distributed.admin.tick.interval": "2s"}
IDLE |= {"distributed.admin.system-monitor.interval": "10s"}
"""Settings of Dask with which a cluster without work takes 1 % of a core, not 9 %."""


def local_cluster(workers: int, processes: bool):
    """A cluster of Dask on this machine, whose workers have one thread each."""
    import dask
    import distributed

    with (
        dask.config.set(IDLE),
        distributed.LocalCluster(
            workers, threads_per_worker=1, processes=processes, protocol="tcp://", dashboard_address=None
        ) as found,
    ):
        yield found


@pytest.fixture(scope="session")
def cluster():
    """Two worker processes of Dask."""
    yield from local_cluster(2, True)


@pytest.fixture
def thread_of_dask():
    """A worker of Dask in this process, which has imported all; tasks are sent to it all the same."""
    yield from local_cluster(1, False)
