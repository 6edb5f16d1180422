"""Locks of outputs, temporary folders, files that are written together."""

import errno
import os
import signal
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from cases import ROOT

from bayescal.errors import BayescalError
from bayescal.storage import locks
from bayescal.storage.files import write_together
from bayescal.storage.folders import claimed, whole
from bayescal.storage.locks import alone

BUSY = r"another run \(process \d+\) writes to it; wait for its end, or give another --out"
HOLDS = """
import sys, time
from pathlib import Path
from bayescal.storage.locks import alone
with alone(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def other(tmp_path):
    """Another process that has locked tmp_path/out."""
    line = [sys.executable, "-c", HOLDS, str(tmp_path / "out")]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(line, stdout=subprocess.PIPE, text=True, env=environment)
    process.stdout.readline()
    yield process
    process.kill()
    process.communicate()


def test_a_second_run_is_refused_until_the_first_ends(tmp_path, other):
    out = tmp_path / "out"
    for attempt in (alone(out), claimed(out, "fit.json"), whole(out, "fit.json")):
        with pytest.raises(BayescalError, match=BUSY), attempt:
            pass
    other.send_signal(signal.SIGKILL)
    other.wait()
    with alone(out):
        pass
    assert not list(tmp_path.iterdir())


def test_a_thread_locks_again_and_another_thread_is_refused(tmp_path):
    def attempt():
        with alone(tmp_path / "out"):
            pass

    with alone(tmp_path / "new" / "out"):
        attempt()
        with alone(tmp_path / "new" / "out"):
            pass
        with (
            alone(tmp_path / "out"),
            ThreadPoolExecutor(1) as pool,
            pytest.raises(BayescalError, match="another run writes to it"),
        ):
            pool.submit(attempt).result()
    assert not list(tmp_path.iterdir())


def test_a_created_folder_with_a_result_stays(tmp_path):
    with whole(tmp_path / "runs" / "out", "fit.json") as stage:
        (stage / "fit.json").write_text("{}")
    assert [p.name for p in (tmp_path / "runs").iterdir()] == ["out"]


def in_time(path):
    """Lock a path in a process that must end: its exit code and what it prints."""
    line = "import pathlib, sys; from bayescal.storage.locks import alone; "
    line += "alone(pathlib.Path(sys.argv[1])).__enter__()"
    options = {"capture_output": True, "text": True, "timeout": 120}
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", line, path], env=environment, **options)
    return done.returncode, done.stderr


OTHERS = {
    "pipe": lambda lock: os.mkfifo(lock),
    "device": lambda lock: os.mknod(lock, 0o600 | stat.S_IFCHR, os.makedev(1, 7)),
    "file of the user": lambda lock: lock.write_text("my notes"),
}


@pytest.mark.parametrize("what", OTHERS)
def test_what_has_the_name_of_a_lock_is_refused_and_kept(tmp_path, what):
    lock = tmp_path / ".out.bayescal-lock"
    try:
        OTHERS[what](lock)
    except PermissionError:
        pytest.skip("not possible on this system")
    before = lock.stat()
    code, said = in_time(tmp_path / "out")
    assert code == 1
    what = "it has the name of a lock, and bayescal did not write it"
    assert f"{what}; remove it, or give another --out" in said
    assert lock.stat()[:7] == before[:7]


def test_a_full_disk_does_not_stop_a_lock(tmp_path, monkeypatch):
    attempts = []

    def full(path, *rest, **options):
        attempts.append(path.name)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(locks.Path, "write_text", full)
    with alone(tmp_path / "out"):
        assert attempts == [".out.bayescal-lock"]
        assert [p.name for p in tmp_path.iterdir()] == attempts
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EACCES])
def test_a_file_system_without_locks_is_used_without_and_other_errors_are_one_line(
    tmp_path, monkeypatch, number
):
    def fails(lock):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(locks.FileLock, "acquire", fails)
    if number == errno.ENOLCK:
        with alone(tmp_path / "new" / "out"):
            assert (tmp_path / "new").is_dir()
    else:
        refused = pytest.raises(BayescalError, match="Permission denied; give another --out")
        with refused, alone(tmp_path / "new" / "out"):
            pass
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="not possible on this system")
def test_a_read_only_folder_is_one_line(tmp_path):
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "none", tmp_path], capture_output=True).returncode:
        pytest.skip("not possible on this system")
    try:
        for attempt in (alone(tmp_path / "out"), alone(tmp_path / "new" / "out")):
            with pytest.raises(BayescalError, match="Read-only file system; give another --out"), attempt:
                pass
    finally:
        subprocess.run(["umount", tmp_path], check=True)


def test_parts_of_files_that_killed_processes_left_are_removed(tmp_path):
    file = tmp_path / "arm.urdf"
    own = locks.beside(file, locks.PART).name
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True)
    left = tmp_path / own.replace(f".{os.getpid()}.", f".{int(dead.stdout)}.")
    live = tmp_path / own.replace(f".{os.getpid()}.", f".{os.getppid()}.")
    similar = tmp_path / ".arm.urdf.part"
    for path in (left, live, similar):
        path.touch()
    write_together({file: "<robot/>", tmp_path / "arm.json": "{}"})
    assert {p.name for p in tmp_path.iterdir()} == {live.name, similar.name, "arm.urdf", "arm.json"}
