"""A command that is stopped ends at once, says what is kept, and leaves nothing unfinished."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from cases import ROOT

SESSION = ROOT / "data" / "lrmate200ic-cube"


def hears():
    """A shell's background jobs, and all that they start, ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def started(*line: str) -> subprocess.Popen:
    """A process of Python that has printed that it is ready."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": ""}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, *line], env=environment, preexec_fn=hears, **pipes)
    assert process.stdout.readline() == "ready\n"
    return process


def stopped(process: subprocess.Popen, number: int = signal.SIGINT, left: str = "") -> tuple[int, str]:
    """Exit code and error stream of a process that would run on; `left`: what it still prints."""
    process.send_signal(number)
    try:
        out, err = process.communicate(timeout=120)  # a second on a quiet machine
    finally:
        process.kill()
    assert out == left
    return process.returncode, err


PROGRAM = """
import sys, time
from contextlib import suppress
from bayescal.storage import stopping
from bayescal.cli import entry
def sleep():
    print("ready", flush=True)
    time.sleep(600)
def lost():
    print("ready", flush=True)
    while True:
        with suppress(BaseException):  # as where compiled code calls Python
            time.sleep(600)
def kept():
    with stopping.keeping(lambda: "12 draws are kept"):
        sleep()
def complete():
    stopping.completed("runs/x is complete")
    sleep()
entry.run(lambda: {"sleep": sleep, "lost": lost, "kept": kept, "complete": complete}[sys.argv[1]])
"""


@pytest.mark.parametrize(("what", "number", "said"), [
    ("sleep", signal.SIGINT, "nothing was written"),
    ("sleep", signal.SIGTERM, "nothing was written"),
    ("lost", signal.SIGINT, "nothing was written"),
    ("kept", signal.SIGINT, "12 draws are kept"),
    ("complete", signal.SIGINT, "runs/x is complete"),
])  # fmt: skip
def test_a_stopped_command_says_in_one_line_what_is_kept(what, number, said):
    code, err = stopped(started("-c", PROGRAM, what), number)
    assert (code, err) == (128 + number, f"bayescal: stopped; {said}\n")


def test_a_stopped_command_does_not_wait_for_the_end_of_python():
    """Handlers at exit are called; what Python then frees is not waited for."""
    slow = """
import atexit
class Slow:
    def __del__(self, sleep=time.sleep):
        sleep(600)
slow = Slow()
def sleep():
    atexit.register(print, "handler", file=sys.stderr)
    atexit.register(print, "written")
    print("ready", flush=True)
    time.sleep(600)
entry.run(lambda: sleep)
"""
    code, err = stopped(started("-c", PROGRAM.partition("entry.run")[0] + slow), left="written\n")
    assert (code, err) == (130, "bayescal: stopped; nothing was written\nhandler\n")


def test_a_stop_while_modules_are_imported_has_no_traceback():
    program = """
import sys
from bayescal.cli import main
class Slow:
    def find_spec(self, name, *rest):
        if name == sys.argv[1]:
            print("ready", flush=True)
            import time; time.sleep(600)
sys.meta_path.insert(0, Slow())
main()
"""
    for module in ("bayescal.cli.entry", "typer"):
        code, err = stopped(started("-c", program, module))
        assert (code, err) == (130, "bayescal: stopped; nothing was written\n")


FIT = """
import functools
import bayescal.public.functions as functions
from bayescal.storage import stopping
from bayescal.cli import main
stopping.PATIENCE = 60.0  # on a busy machine the main thread may need more than a second
plain = functions.fit
@functools.wraps(plain)  # the command has its options from the signature
def fit(*given, **options):
    print("ready", flush=True)
    return plain(*given, **options)
functions.fit = fit
main()
"""


def test_a_stopped_fit_leaves_nothing(tmp_path):
    process = started("-c", FIT, "fit", str(SESSION), "--out", str(tmp_path / "new" / "out"))
    assert list(tmp_path.rglob(".out.*"))
    code, err = stopped(process)
    assert (code, err) == (130, "bayescal: stopped; nothing was written\n")
    assert not list(tmp_path.iterdir())


def test_a_working_directory_that_was_removed_is_one_line(tmp_path):
    line = "import os; os.rmdir(os.getcwd()); from bayescal.cli import main; main()"
    (tmp_path / "gone").mkdir()
    place = {"cwd": tmp_path / "gone", "env": os.environ | {"PYTHONPATH": str(ROOT)}}
    done = subprocess.run([sys.executable, "-c", line], **place, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == "bayescal: working directory: it does not exist any more; change to another\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="not possible on this system")
@pytest.mark.parametrize("program", ["print('x')", "print('x' * 100_000)", "print('x'); raise SystemExit(0)"])
def test_a_full_disk_behind_the_output_is_one_line(program):
    line = f"from bayescal.cli import entry\ndef command(): {program}\nentry.run(lambda: command)"
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", line], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr == "bayescal: output: No space left on device; free some space\n"
