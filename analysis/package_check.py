"""Wheel and source distribution in empty environments: build, install, calibrate outside of the repository.

``python -m analysis.package_check`` (`make package-check`). It downloads the dependencies. The last run is of
an installation and a home that cannot be written: compiled code is then not kept, and the result is the same.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SESSION = ROOT / "data" / "lrmate200ic-cube"
AS_USER = ("setpriv", "--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-all")
"""Prefix with which root, too, cannot write what is read-only."""


def run(*words: str | Path, **options) -> str:
    """Run a program; its output."""
    print("$", *words, flush=True)
    done = subprocess.run([str(w) for w in words], text=True, stdout=subprocess.PIPE, **options)
    if done.returncode:
        sys.exit(f"{done.stdout}\nexit code {done.returncode}")
    return done.stdout


def environment(folder: Path, *packages: str | Path) -> Path:
    """A new environment with packages; its folder of programs."""
    venv.create(folder, with_pip=True)
    limits = ("-c", ROOT / "constraints.txt")
    run(folder / "bin" / "pip", "install", "--quiet", *limits, *packages)
    return folder / "bin"


def calibrate(programs: Path, out: Path, home: Path, prefix: tuple[str, ...] = ()) -> float:
    """Calibrate the example session with the installed program, in a folder of its own; an estimate, mm."""
    out.mkdir()
    variables = {"HOME": str(home), "PATH": os.environ["PATH"], "OPENBLAS_NUM_THREADS": "1"}
    words = (*prefix, programs / "bayescal", "fit", SESSION, "--samples", "0", "--out", out / "run")
    run(*words, env=variables, cwd=out)
    record = json.loads((out / "run" / "fit.json").read_text(encoding="utf-8"))
    return next(p["estimate"] for p in record["parameters"] if p["name"] == "a2")


def _compiled(packages: list[Path]) -> list[Path]:
    """Compiled code that numba keeps in packages."""
    return [path for package in packages for path in package.rglob("*.nb?")]


def main() -> None:
    """Check both distributions."""
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        tools = environment(top / "tools", "hatchling")
        run(tools / "hatchling", "build", "-d", top / "dist", cwd=ROOT)
        (wheel,), (source,) = (top / "dist").glob("*.whl"), (top / "dist").glob("*.tar.gz")
        home = top / "home"
        home.mkdir()
        found = {"wheel": calibrate(environment(top / "wheel", wheel), top / "a", home)}
        found["source"] = calibrate(environment(top / "source", source), top / "b", home)
        site = next((top / "wheel" / "lib").glob("python*/site-packages"))
        packages = [site / "bayescal", site / "factors"]
        for kept in _compiled(packages):
            kept.unlink()
        closed = [home, *packages, *(p for package in packages for p in package.rglob("*") if p.is_dir())]
        for one in closed:
            one.chmod(0o555)
        prefix = AS_USER if os.geteuid() == 0 and shutil.which(AS_USER[0]) else ()
        found["read-only"] = calibrate(top / "wheel" / "bin", top / "c", home, prefix)
        kept = _compiled(packages)
        for one in closed:
            one.chmod(0o755)
    print(found)
    if len(set(found.values())) > 1 or kept:
        sys.exit("the installations differ, or the read-only one was written")


if __name__ == "__main__":
    main()
