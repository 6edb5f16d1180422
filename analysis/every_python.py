"""The test suite on every Python that the project supports and this machine has: `make test-all`.

Each version has an environment of its own, `.venv-3.12`, made by the Makefile; with the version of Python the
line of ArviZ changes (0.x below 3.12, 1.x from 3.12 on). Needs no package: any Python from 3.11 on runs it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROGRAM = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"


def supported(text: str) -> list[str]:
    """Versions of Python, '3.11' and later, that a pyproject.toml classifies as supported."""
    found = tomllib.loads(text)["project"]["classifiers"]
    return [
        m[1] for line in found if (m := re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", line))
    ]


def works(program: str, version: str) -> bool:
    """Whether a program is that version of Python, and makes environments. A shim of pyenv may be neither."""
    try:
        done = subprocess.run(
            [program, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0 and done.stdout.strip() == version


def interpreter(version: str, usable: Callable[[str, str], bool] = works) -> str | None:
    """A Python of a version: on the PATH, or of pyenv (the newest)."""
    name = f"python{version}"
    on_path = [shutil.which(name, path=folder) for folder in os.get_exec_path()]
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    own = sorted(pyenv.glob(f"{version}.*/bin/{name}"), key=lambda p: (len(str(p)), str(p)), reverse=True)
    candidates = [p for p in on_path if p] + [str(p) for p in own]
    return next((p for p in candidates if usable(p, version)), None)


def installed(python: Path, package: str) -> str:
    """The version of a package in an environment, or 'none'."""
    program = f"from importlib.metadata import version; print(version({package!r}))"
    done = subprocess.run([str(python), "-c", program], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "none"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the suite on each version, and say which are missing; 1 if it failed on any."""
    parser = argparse.ArgumentParser(prog="python -m analysis.every_python", description=__doc__)
    parser.add_argument("--tests", default="", help="arguments of pytest, such as 'tests/robots -k urdf'")
    given = parser.parse_args(arguments)
    result: dict[str, str] = {}
    for version in supported((ROOT / "pyproject.toml").read_text(encoding="utf-8")):
        python, folder = interpreter(version), f".venv-{version}"
        if python is None:
            result[version] = "missing on this machine"
            continue
        print(f"Python {version}: {python}, environment {folder}", flush=True)
        command = ["make", "test", f"PYTHON={python}", f"VENV={folder}", f"TESTS={given.tests}"]
        done = subprocess.run(command, cwd=ROOT, env=_clean(), check=False)
        line = installed(ROOT / folder / "bin" / "python", "arviz")
        result[version] = f"{'failed' if done.returncode else 'passed'}, with ArviZ {line}"
    for version, words in result.items():
        print(f"Python {version}: {words}")
    return int(any(words.startswith("failed") for words in result.values()))


def _clean() -> dict[str, str]:
    """The environment without what would mix that of one Python with another."""
    return {
        k: v
        for k, v in os.environ.items()
        if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "MAKEFLAGS")
    }


if __name__ == "__main__":
    sys.exit(main())
