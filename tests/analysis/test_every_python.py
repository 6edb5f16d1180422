"""`make test-all`: which Pythons are supported, which the machine has, and what is run with each."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from cases import ROOT

from analysis import every_python

PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
HERE = "{}.{}".format(*sys.version_info)


def test_supported_versions_are_those_that_can_be_installed():
    versions = every_python.supported(PROJECT)
    first, end = re.fullmatch(
        r">=3\.(\d+),<3\.(\d+)", tomllib.loads(PROJECT)["project"]["requires-python"]
    ).groups()
    assert versions == [f"3.{minor}" for minor in range(int(first), int(end))]


def program(folder: Path, version: str) -> str:
    folder.mkdir(parents=True)
    path = folder / f"python{version}"
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return str(path)


def test_a_python_is_looked_for_on_the_path_and_then_in_pyenv(tmp_path, monkeypatch):
    """A shim on the PATH is passed over where it does not work; of several of pyenv the newest is taken."""
    shim = program(tmp_path / "shims", "3.12")
    old, new = (program(tmp_path / f"pyenv/versions/3.12.{k}/bin", "3.12") for k in (9, 10))
    monkeypatch.setenv("PATH", str(tmp_path / "shims"))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    assert every_python.interpreter("3.12", lambda path, _: True) == shim
    assert every_python.interpreter("3.12", lambda path, _: path != shim) == new
    assert every_python.interpreter("3.12", lambda path, _: path == old) == old
    assert every_python.interpreter("3.12", lambda path, _: False) is None
    assert every_python.interpreter("3.13", lambda path, _: True) is None


def test_a_program_works_if_it_is_that_version(tmp_path):
    assert every_python.works(sys.executable, HERE)
    assert not every_python.works(sys.executable, "3.2")
    assert not every_python.works(program(tmp_path / "none", "3.12"), "3.12")
    assert not every_python.works(str(tmp_path / "absent"), "3.12")


@pytest.mark.parametrize(("code", "words"), [(0, "passed"), (2, "failed")])
def test_each_version_is_tested_and_the_missing_are_said(monkeypatch, capsys, code, words):
    made = []
    monkeypatch.setattr(every_python, "interpreter", lambda v: None if v == "3.12" else f"/opt/python{v}")
    monkeypatch.setattr(every_python, "installed", lambda python, package: "1.2")
    monkeypatch.setenv("PYTHONPATH", "elsewhere")

    def run(command, env, **options):
        made.append(command)
        assert "PYTHONPATH" not in env
        return SimpleNamespace(returncode=code if "VENV=.venv-3.13" in command else 0)

    monkeypatch.setattr(every_python.subprocess, "run", run)
    assert every_python.main(["--tests", "tests/robots"]) == bool(code)
    assert [c[3] for c in made] == ["VENV=.venv-3.11", "VENV=.venv-3.13"]
    assert all(c[:2] == ["make", "test"] and c[4] == "TESTS=tests/robots" for c in made)
    said = capsys.readouterr().out
    assert "Python 3.12: missing on this machine" in said
    assert "Python 3.11: passed, with ArviZ 1.2" in said
    assert f"Python 3.13: {words}" in said


def test_make_hands_on_python_environment_and_tests():
    """What `make test` would run, of another Python in an environment of its own."""
    command = [
        "make",
        "--no-print-directory",
        "--dry-run",
        "test",
        "VENV=.venv-none",
        "PYTHON=python9",
        "TESTS=tests/robots -k urdf",
    ]
    environment = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "TESTS")}
    said = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert "python9 -m venv .venv-none" in said
    assert said.rstrip().endswith(
        ".venv-none/bin/python -m pytest --numprocesses 2 --dist worksteal tests/robots -k urdf"
    )
