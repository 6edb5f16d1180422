"""Golden runs: what a user sees of all commands on 12 sessions, recorded, and two recordings compared.

    python -m analysis.golden record OUT [--only NAME] [--code PATH] [--shared PATH] [--workers 2]
    python -m analysis.golden compare A B

A recording holds for each command its exit code, its terminal output and the files that it wrote or changed.
In a comparison every printed digit must agree; numbers with more than 9 significant digits agree to 9.

Not recorded, because it is not reproducible or not the same on another machine: lines of progress, paths
of the machine, versions in texts, `software` and `seconds` of JSON files, columns `seconds` of tables,
checksums in `.bayescal-files.json` (of pictures and NetCDF), the attributes of NetCDF (times and versions).
Of pictures the size in pixels is recorded, of a page the text and the data of its figures.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from html.parser import HTMLParser
from itertools import zip_longest
from pathlib import Path
from typing import Any

import h5py
import numpy as np

HERE = Path(__file__).resolve().parents[1]
CASES: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_name("golden_commands.toml").read_text())
DIGITS = 9
SHOWN = 5
"""Differing lines that are printed of a file."""
DROPPED = {"software", "seconds"}
FROM_TESTS = ("ur5e_scene.xml", "dcc.xsd", "SI_Format.xsd")
"""Files of the tests that commands read, in whatever folder they are."""
PROGRESS = re.compile(r"^.* \d+ %, \d+ s$\n?", re.MULTILINE)
VERSIONS = re.compile(r"\b(?:bayescal|run by) \d+(?:\.\d+)+(?:, \w+ \d+(?:\.\d+)+)*")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")
SCRIPT = re.compile(r"<script([^>]*)>(.*?)</script>", re.DOTALL)


class Text(HTMLParser):
    """The text of a page, a line for each piece."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []
        self.hidden = False

    def handle_starttag(self, tag: str, attrs: object) -> None:
        """Styles are no text."""
        self.hidden = tag == "style"

    def handle_data(self, data: str) -> None:
        """A piece of text."""
        if data.strip() and not self.hidden:
            self.lines.append(" ".join(data.split()))


def without_versions(value: object) -> object:
    """A JSON value without what depends on the machine."""
    if isinstance(value, dict):
        if value.get("schema") == "bayescal-files/1":
            return sorted(value["files"])
        return {k: without_versions(v) for k, v in value.items() if k not in DROPPED}
    return [without_versions(v) for v in value] if isinstance(value, list) else value


def json_text(content: bytes) -> str:
    """A JSON file with a number in each line."""
    return json.dumps(without_versions(json.loads(content)), indent=1, ensure_ascii=False)


def page_text(content: bytes) -> str:
    """The text of a page, then the data of its figures."""
    page = content.decode()
    text = Text()
    text.feed(SCRIPT.sub("", page))
    data = [json_text(s.encode()) for kind, s in SCRIPT.findall(page) if "application/json" in kind]
    return "\n".join([*text.lines, *data])


def picture_size(content: bytes) -> str:
    """Width and height of a PNG."""
    return "{} x {} pixels".format(*struct.unpack(">II", content[16:24]))


READERS: dict[str, Callable[[bytes], str]] = {
    ".json": json_text,
    ".html": page_text,
    ".png": picture_size,
    ".svg": lambda _: "a figure",
    ".pdf": lambda _: "a document",
}
"""Files that are not recorded as they are; others are text."""


def arrays(path: Path) -> dict[str, Any]:
    """The arrays of a NetCDF file; texts as text."""
    found: dict[str, Any] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            values = item[()]
            found[name] = values.astype(str) if values.dtype.kind in "OS" else np.asarray(values)

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def untimed(text: str) -> str:
    """A table whose last column is `seconds` without that column."""
    lines, width = text.split("\n"), None
    for k, line in enumerate(lines):
        width = line.rindex("seconds") if line.endswith("  seconds") else width if line.strip() else None
        lines[k] = line if width is None else line[:width].rstrip()
    return "\n".join(lines)


def normalised(text: str, folders: dict[Path, str]) -> str:
    """Text without paths of the machine, progress and versions."""
    for folder, name in folders.items():
        text = text.replace(str(folder), name)
    return VERSIONS.sub("VERSIONS", PROGRESS.sub("", untimed(text.replace("\r\n", "\n"))))


def keep(source: Path, out: Path, folders: dict[Path, str]) -> None:
    """Record a file that a command wrote."""
    out.parent.mkdir(parents=True, exist_ok=True)
    if source.suffix == ".nc":
        np.savez(
            out.with_name(f"{out.name}.npz"), **{k.replace("/", "|"): v for k, v in arrays(source).items()}
        )
        return
    reader = READERS.get(source.suffix, lambda content: content.decode("utf-8", "backslashreplace"))
    out.write_text(normalised(reader(source.read_bytes()), folders), encoding="utf-8")


def state(folder: Path) -> dict[str, tuple[int, int]]:
    """The files of a folder with what tells whether one was written."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {str(p.relative_to(folder)): (p.stat().st_mtime_ns, p.stat().st_ino) for p in files}


def slug(command: str) -> str:
    """The name of a command's folder."""
    return re.sub(r"[^A-Za-z0-9.=+-]+", "_", command)[:150].strip("_")


def commands(name: str) -> list[str]:
    """The commands of a session."""
    return CASES[name]["commands"].strip().splitlines()


def recorded(name: str, out: Path, code: Path, shared: Path) -> float:
    """Run and record the commands of a session; return the seconds."""
    case, began = CASES[name], time.monotonic()
    shutil.rmtree(out / name, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="golden-") as temporary:
        work = Path(temporary).resolve()
        shutil.copytree(HERE / "analysis" / "golden_inputs", work / "inputs")
        for path in (p for n in FROM_TESTS for p in HERE.glob(f"tests/**/{n}")):
            shutil.copy(path, work / "inputs")
        for key, root in (("shared", shared), ("checkout", HERE)):
            if key in case:
                shutil.copytree(root / case[key], work / name)
        environment = dict(
            os.environ, PYTHONPATH=str(code), COLUMNS="120", NO_COLOR="1", TERM="dumb", TZ="UTC"
        )
        environment |= {f"{library}_NUM_THREADS": "1" for library in THREADS}
        folders = {work: "WORK", code: "CODE", HERE: "CODE", Path(sys.prefix): "PYTHON"}
        for command in commands(name):
            words = shlex.split(command)
            call = words[1:] if words[0] == "python" else ["-m", "bayescal.cli", *words]
            before, to = state(work), out / name / slug(command)
            run = subprocess.run(
                [sys.executable, *call], cwd=work, env=environment, capture_output=True, timeout=900
            )
            to.mkdir(parents=True)
            (to / "exit").write_text(f"{run.returncode}\n")
            (to / "stdout").write_text(normalised(run.stdout.decode(), folders))
            (to / "stderr").write_text(normalised(run.stderr.decode(), folders))
            after = state(work)
            for file in sorted(p for p in after if after[p] != before.get(p)):
                keep(work / file, to / "files" / file, folders)
            gone = sorted(set(before) - set(after))
            (to / "removed").write_text("".join(f"{p}\n" for p in gone))
    return time.monotonic() - began


def same_number(a: str, b: str) -> bool:
    """Whether two printed numbers agree: to the last digit, or to 9 where both have more."""
    if a == b:
        return True
    digits = [len(re.sub(r"[eE].*|\D", "", s).lstrip("0")) for s in (a, b)]
    return max(digits) > DIGITS and math.isclose(float(a), float(b), rel_tol=10.0**-DIGITS)


def same_line(a: str | None, b: str | None) -> bool:
    """Whether two lines agree: their text, and their numbers."""
    if a == b:
        return True
    if a is None or b is None or NUMBER.split(a) != NUMBER.split(b):
        return False
    return all(map(same_number, NUMBER.findall(a), NUMBER.findall(b)))


def differing_arrays(a: Path, b: Path) -> Iterator[str]:
    """What differs between two recorded NetCDF files."""
    with np.load(a) as first, np.load(b) as second:
        for name in sorted({*first, *second}):
            if name not in first or name not in second:
                yield f"{name}: only in {'A' if name in first else 'B'}"
                continue
            x, y = first[name], second[name]
            if x.shape != y.shape or x.dtype != y.dtype:
                yield f"{name}: {x.dtype} {x.shape} | {y.dtype} {y.shape}"
                continue
            numbers = x.dtype.kind in "fc"
            unequal = ~np.isclose(x, y, 10.0**-DIGITS, 0, equal_nan=True) if numbers else x != y
            if unequal.any():
                at = np.argwhere(unequal)[0]
                yield f"{name}: {unequal.sum()} of {x.size}, first at {at}: {x[tuple(at)]} | {y[tuple(at)]}"


def differing_lines(a: Path, b: Path) -> Iterator[str]:
    """The lines that differ between two recorded texts."""
    lines = (p.read_text(encoding="utf-8").splitlines() for p in (a, b))
    for number, (x, y) in enumerate(zip_longest(*lines), 1):
        if not same_line(x, y):
            yield f"line {number}:\n    A {x}\n    B {y}"


def compared(a: Path, b: Path) -> dict[str, list[str]]:
    """What differs between two recordings, by file; a command that crashed differs from what it should be."""
    found = {}
    first, second = ({str(p.relative_to(r)) for p in r.rglob("*") if p.is_file()} for r in (a, b))
    for name in sorted(first | second):
        if name not in first or name not in second:
            found[name] = [f"only in {'A' if name in first else 'B'}"]
            continue
        differing = differing_arrays if name.endswith(".npz") else differing_lines
        if differences := list(differing(a / name, b / name)):
            found[name] = differences
        elif name.endswith("stderr") and "Traceback" in (b / name).read_text(encoding="utf-8"):
            found[name] = ["ends with a traceback in A and B"]
    return found


def record(arguments: argparse.Namespace) -> int:
    """Record the sessions, several at a time."""
    names, code = arguments.only or list(CASES), arguments.code.resolve()
    call = [sys.executable, "-c", "import bayescal; print(bayescal.__file__)"]
    environment = dict(os.environ, PYTHONPATH=str(code))
    found = subprocess.run(call, cwd=code, env=environment, capture_output=True, text=True, check=True).stdout
    if not Path(found.strip()).is_relative_to(code):
        sys.exit(f"{code}: holds no bayescal; imported is {found.strip()}")
    began = time.monotonic()
    with ThreadPoolExecutor(arguments.workers) as pool:
        jobs = {n: pool.submit(recorded, n, arguments.out, code, arguments.shared.resolve()) for n in names}
        for name, job in jobs.items():
            print(f"{name:14} {len(commands(name)):3} commands {job.result():6.0f} s", flush=True)
    print(f"{time.monotonic() - began:.0f} s in all")
    return 0


def compare(arguments: argparse.Namespace) -> int:
    """Print what differs."""
    found = compared(arguments.a, arguments.b)
    for name, differences in found.items():
        print(f"{name}: {len(differences)} differences", *differences[:SHOWN], sep="\n  ")
    print(f"{len(found)} files differ")
    return int(bool(found))


def main() -> int:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(description="Golden runs of all commands.")
    subparsers = parser.add_subparsers(required=True)
    recording = subparsers.add_parser("record", help="run the commands and record what a user sees")
    recording.add_argument("out", type=Path)
    recording.add_argument("--only", action="append", choices=list(CASES), help="a session; repeatable")
    recording.add_argument("--code", type=Path, default=HERE, help="checkout whose bayescal runs")
    shared = Path(os.environ.get("BAYESCAL_SHARED", HERE.parent / "shared"))
    recording.add_argument(
        "--shared", type=Path, default=shared, help="folder with data/worlds-dev, data/real, ..."
    )
    recording.add_argument("--workers", type=int, default=1)
    recording.set_defaults(run=record)
    comparing = subparsers.add_parser("compare", help="print what differs; exit code 1 where something does")
    comparing.add_argument("a", type=Path)
    comparing.add_argument("b", type=Path)
    comparing.set_defaults(run=compare)
    arguments = parser.parse_args()
    return int(arguments.run(arguments))


if __name__ == "__main__":
    sys.exit(main())
