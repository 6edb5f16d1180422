"""`bayescal --help` answers at once: the libraries that compute are loaded by the commands that use them.

The promise is 0.4 s. What is tested is its cause, which does not depend on how busy the machine is.
"""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("numpy", "scipy", "gtsam", "matplotlib", "numba", "rich", "yaml", "emcee", "arviz", "xarray", "h5py")
COMMANDS = (
    "fit",
    "gap",
    "compare",
    "simulate",
    "import",
    "budget",
    "export",
    "verify",
    "compensate",
    "plan",
    "init",
    "report",
    "schema",
    "check",
    "robots",
)

PROGRAM = """
import contextlib, io, sys
from bayescal.cli import main
said = io.StringIO()
for words in {requests}:
    sys.argv = ["bayescal", *words, "--help"]
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        main()
print((said.getvalue().count("Usage: "), sorted(sys.modules)))
"""


def loaded(*requests: tuple[str, ...]) -> set[str]:
    """The modules that are loaded once the help of each of `requests` has been printed by one process."""
    program = PROGRAM.format(requests=requests)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    printed, modules = ast.literal_eval(done.stdout)
    assert printed == len(requests), done.stdout
    return set(modules)


def test_help_loads_no_library_that_computes():
    # pydantic too: bayescal declares its files with it, and loading it takes a tenth of a second
    assert loaded(()).isdisjoint({*HEAVY, "pydantic", "bayescal.dataset", "bayescal.robots"})


def test_help_of_every_command_loads_no_library_that_computes():
    # here typer may load pydantic for itself, to convert arguments
    assert loaded(*((name,) for name in COMMANDS)).isdisjoint({*HEAVY, "bayescal.dataset", "bayescal.robots"})


def test_every_command_is_asked():
    from bayescal.cli import app

    named = {c.name or c.callback.__name__ for c in app.registered_commands if c.callback}
    assert named | {g.name for g in app.registered_groups} == set(COMMANDS)


def test_every_module_with_a_command_is_listed():
    from bayescal.cli import commands

    modules = Path(commands.__file__).parent.glob("*.py")
    with_app = {p.stem for p in modules if "from bayescal.cli.root import app" in p.read_text("utf-8")}
    assert with_app - {"commands"} == {m for m in with_app if m in vars(commands)}


@pytest.mark.parametrize("library", ["numpy", "pydantic"])
def test_a_library_loaded_too_early_would_be_seen(library, tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(f"import {library}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    assert library in loaded(())
