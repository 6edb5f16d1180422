"""Run folders: nothing of the user's is lost, and there is always one complete result."""

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from cases import ROOT, refused

from bayescal.storage import locks
from bayescal.storage.folders import LIST, check_free, whole

FIT = "fit.json"


def run(folder: Path, text: str, meanwhile=lambda: None) -> None:
    with whole(folder, FIT) as stage:
        (stage / FIT).write_text(text)
        meanwhile()
        (stage / "sub").mkdir()
        (stage / "sub" / "more.txt").write_text(text)


def held(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): p.read_text() for p in folder.rglob("*") if p.is_file()}


def test_an_earlier_result_is_replaced(tmp_path):
    out = tmp_path / "new" / "out"
    run(out, "first")
    out.chmod(0o750)
    run(out, "second")
    assert out.stat().st_mode & 0o777 == 0o750
    assert {k: v for k, v in held(out).items() if k != LIST} == {FIT: "second", "sub/more.txt": "second"}
    assert [p.name for p in out.parent.iterdir()] == ["out"]
    (out / FIT).unlink()  # what was removed is no loss
    run(out, "third")
    assert (out / FIT).read_text() == "third"


FOREIGN = {
    "a user's file": lambda out: (out / "thesis.txt").write_text("years"),
    "a file in a folder of ours": lambda out: (out / "sub" / "thesis.txt").write_text("years"),
    "a folder": lambda out: (out / "plots").mkdir(),
    "a changed result": lambda out: (out / FIT).write_text("first, and my notes"),
    "a link": lambda out: (out / "link").symlink_to(out / FIT),
    "a file that is linked in place of ours": lambda out: (
        (out / "sub" / "more.txt").rename(out.parent / "kept"),
        (out / "sub" / "more.txt").symlink_to(out.parent / "kept"),
    ),
    "a marker without our list": lambda out: (out / LIST).unlink(),
    "a list that is none": lambda out: (out / LIST).write_text("[]"),
}


@pytest.mark.parametrize("change", FOREIGN)
def test_what_is_not_ours_is_kept(tmp_path, change):
    out = tmp_path / "out"
    run(out, "first")
    FOREIGN[change](out)
    before = held(out)
    for attempt in (lambda: check_free(out, FIT), lambda: run(out, "second")):
        assert "--out" in refused("contains files that bayescal did not write: ", attempt).remedy
    assert held(out) == before


def test_a_dataset_with_a_result_of_that_name_is_kept(tmp_path):
    """`fit` into the dataset's own folder, or where a fit.json is by chance."""
    for name in (FIT, "dataset.yaml", "measurements.csv"):
        (tmp_path / name).write_text("mine")
    refused(r"did not write: dataset\.yaml", lambda: run(tmp_path, "second"))
    assert len(held(tmp_path)) == 3


def test_a_refusal_names_the_files(tmp_path):
    out = tmp_path / "out"
    run(out, "first")
    refused("the result of another command, without gap", lambda: check_free(out, "gap.json"))
    (out / FIT).write_text("changed")
    for name in "abcd":
        (out / name).touch()
    refused(r"did not write: a, b, c, \.\.\.", lambda: check_free(out, FIT))
    for name in "abcd":
        (out / name).unlink()
    refused(r"did not write: fit\.json \(changed\)", lambda: check_free(out, FIT))


def test_a_file_that_comes_while_it_runs_is_kept(tmp_path):
    out = tmp_path / "out"
    run(out, "first")
    refused(r"notes\.txt", lambda: run(out, "second", lambda: (out / "notes.txt").write_text("mine")))
    assert held(out)[FIT] == "first"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_failed_run_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError):
        run(tmp_path / "out", "half", lambda: 1 / 0)
    assert not list(tmp_path.iterdir())


KILLED = """
import os, sys
from pathlib import Path
from bayescal.storage import folders
from test_folders import run, held
os.fsync = lambda handle: None  # a process that ends loses nothing; a machine would
top = Path(sys.argv[1])
def killed(k, act):
    'Whether a child process that ends before its k-th system call on files ended so.'
    child = os.fork()
    if not child:
        left = k
        def count(event, args):
            nonlocal left
            if event in EVENTS or (event == "open" and args[0] != 0):
                left -= 1
                if left < 0:
                    os._exit(9)
        sys.addaudithook(count)
        act()
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
EVENTS = {f"os.{name}" for name in ("rename", "remove", "rmdir", "mkdir", "scandir", "listdir", "chmod")}
k, seen = 0, set()
while True:
    out = top / f"{k}" / "out"
    run(out, "first")
    ended = killed(k, lambda: run(out, "second"))
    there = (out / "fit.json").is_file()
    with folders.claimed(out, "fit.json"):  # the next command
        pass
    now = held(out)
    texts = {v for name, v in now.items() if name != folders.LIST}
    assert len(now) == 3 and len(texts) == 1 and texts <= {"first", "second"}, (k, now)
    assert [p.name for p in out.parent.iterdir()] == ["out"], (k, list(out.parent.iterdir()))
    run(out, "third")
    assert held(out)["fit.json"] == "third"
    seen |= texts | ({"aside"} if not there else set())
    if not ended:
        break
    k += 1
print(k, *sorted(seen))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="not possible on this system")
def test_killed_before_any_system_call(tmp_path):
    paths = os.pathsep.join(map(str, (ROOT, ROOT / "tests", Path(__file__).parent)))
    environment, line = os.environ | {"PYTHONPATH": paths}, [sys.executable, "-c", KILLED, str(tmp_path)]
    done = subprocess.run(line, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    count, *seen = done.stdout.split()
    assert int(count) > 25  # kills, one before each call
    assert seen == ["aside", "first", "second"]


def test_staging_of_live_and_of_other_hosts_is_left(tmp_path, monkeypatch):
    out = tmp_path / "out"
    run(out, "first")
    own = locks.beside(out, locks.PART).name
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True)
    names = {
        "live": re.sub(rf"\.{os.getpid()}\.", f".{os.getppid()}.", own),
        "mine": own,
        "elsewhere": own.replace(f".out.{socket.gethostname()}.", ".out.elsewhere."),
        "dead": re.sub(rf"\.{os.getpid()}\.", f".{int(dead.stdout)}.", own),
        "reborn": own.replace(locks.TOKEN, "0" * 8),
        "another folder's": own.replace(".out.", ".out.2."),
    }
    for name in names.values():
        (tmp_path / name).mkdir()
    check_free(out, FIT)
    left = {what for what, name in names.items() if (tmp_path / name).exists()}
    assert left == set(names) - {"dead", "reborn"}


def test_the_list_says_what_was_written(tmp_path):
    run(tmp_path / "out", "first")
    found = json.loads((tmp_path / "out" / LIST).read_text())
    assert found["schema"] == "bayescal-files/1"
    assert set(found["files"]) == {FIT, "sub/more.txt"}
