"""A case of the fuzzer: damage a seed, run a command in this process, judge what it did."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import typer

from analysis.fuzz.commands import COMMANDS, chosen, command
from analysis.fuzz.mutations import PLAUSIBLE, STRUCTURE, Files, damaged, pick
from analysis.fuzz.seeds import datasets

SECONDS, WAITING = 10, 240
"""s of processor time, and in all, after which a command hangs: a busy machine is slow, a pipe needs none."""
LONGEST = 400
"""Characters of a message."""
REPORTED = ("FAILED: ", "refused by fit")
"""Words by which `verify` and `check` report, with exit code 1, what is wrong with a file."""
STATED = "no target has a solution; its column `reason` states why"
"""What `compensate` says of the table that it wrote, with exit code 1."""
ABSURD = 100.0
"""Times the residuals of the seed from which on a fit must say something."""
SMALL = 5.0
"""µm, of residuals that are compared: those of a seed may be zero."""
FIT = ("fit", "--samples", "0", "--no-pictures")
CHECKED = ("tiny",)
"""Seeds with too few rows for a fit."""
PER_SEED = (("check", 0.96), ("fit", 0.037), ("gap", 0.003))


@dataclass(frozen=True)
class Verdict:
    """What happened. `kind` is ``accepted``, ``refused`` or ``FAIL``; `why` the class of a failure."""

    seed: int
    case: str
    changes: tuple[str, ...]
    kind: str
    why: str = ""
    message: str = ""
    seconds: float = field(default=0.0, compare=False)
    """Of processor time."""


class Hang(BaseException):
    """The time is over; no handler of the program catches it."""


def _alarm(*_: object) -> None:
    raise Hang


def _children() -> float:
    """Processor time of processes that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@cache
def _built(app: typer.Typer) -> object:
    """The command line, which `typer` builds again at each call."""
    return _build(app)


_build = typer.main.get_command


@dataclass(frozen=True)
class Ran:
    """Exit code, error and output text of a command, and what it should not have done."""

    code: int
    error: str
    output: str
    trouble: str


def run(arguments: list[str], seconds: float = SECONDS) -> Ran:
    """The command line in this process, with a limit of time."""
    from bayescal.cli import main

    out, err, trouble, code = io.StringIO(), io.StringIO(), "", 0
    children = _children()
    before = {number: signal.signal(number, _alarm) for number in (signal.SIGALRM, signal.SIGPROF)}
    with (
        warnings.catch_warnings(record=True) as warned,
        mock.patch.object(sys, "argv", ["bayescal", *arguments]),
        mock.patch.object(typer.main, "get_command", _built),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        warnings.simplefilter("always")
        try:
            signal.setitimer(signal.ITIMER_PROF, seconds)
            signal.setitimer(signal.ITIMER_REAL, WAITING)
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except Hang:
            trouble = f"hang over {seconds} s"
        except BaseException as error:
            trouble = f"traceback: {_place(error)}"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)
            if not trouble and _children() - children > seconds:
                trouble = f"hang over {seconds} s in another process"
            for number, handler in before.items():
                signal.signal(number, handler)
    ours = [w for w in warned if issubclass(w.category, (RuntimeWarning, UserWarning))]
    if ours and not trouble:
        first = ours[0]
        trouble = f"warning: {Path(first.filename).name}:{first.lineno} {str(first.message)[:80]}"
    return Ran(code, err.getvalue(), out.getvalue(), trouble)


def _place(error: BaseException) -> str:
    """Kind of an exception, and the innermost place in this repository."""
    frames = [
        f
        for f in traceback.extract_tb(error.__traceback__)
        if "/bayescal/" in f.filename or "/factors/" in f.filename
    ]
    at = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    return f"{type(error).__name__} in {at}: {' '.join(str(error).split())[:80]}"


@cache
def _warmed(name: str, arguments: tuple[str, ...]) -> None:
    """Run a command on files that are whole: what it compiles and imports counts for no case."""
    files = command(name)[0] if name in COMMANDS else datasets()[name]
    with tempfile.TemporaryDirectory(prefix="bayescal-fuzz-") as folder:
        where, out = Path(folder) / "in", Path(folder) / "out"
        out.mkdir()
        _write(files, where)
        run(_filled(arguments, where, out), 10 * SECONDS)


def _filled(arguments: tuple[str, ...], where: Path, out: Path) -> list[str]:
    return [a.replace("{in}", str(where)).replace("{out}", str(out)) for a in arguments]


def case(number: int, seed: int, folder: Path) -> Verdict:
    """Case `number` of a seed of the whole run; the same numbers give the same case."""
    rng = np.random.default_rng([seed, number])
    shutil.rmtree(folder, ignore_errors=True)
    where, out, here = folder / "in", folder / "out", folder / "here"
    for path in (where, out, here):
        path.mkdir(parents=True)
    group = rng.choice(["damage", "plausible", "structure", "command"], p=[0.40, 0.02, 0.08, 0.50])
    baseline = None
    if group == "command" or (group == "structure" and rng.random() < 0.5):
        name = chosen(rng)
        files, arguments = command(name)
    else:
        name = pick(rng, sorted(datasets()))
        files = datasets()[name]
        arguments = _of_dataset("fit" if group == "plausible" else _weighted(rng), name)
    changes: list[str] = []
    if group == "plausible":
        changes = [pick(rng, sorted(PLAUSIBLE))]
        changed = PLAUSIBLE[changes[0]](files)
        baseline = name if changed != files and name not in CHECKED else None
        files = changed
    elif group != "structure":
        files, changes = damaged(files, rng)
    _warmed(name, arguments)
    _write(files, where)
    if group == "structure":
        change = pick(rng, sorted(STRUCTURE))
        STRUCTURE[change](where, rng)
        changes = [change]
    before = _state(folder)
    with contextlib.chdir(here):
        start = time.process_time() + _children()
        ran = run(_filled(arguments, where, out))
        used = round(time.process_time() + _children() - start, 2)
    if ran.code == 128 + signal.SIGTERM:  # the whole run is stopped
        raise SystemExit(ran.code)
    kind, why = judged(ran, out, folder)
    after = _state(folder)
    if after != before and kind != "FAIL":
        touched = sorted(k for k in before.keys() | after.keys() if before.get(k) != after.get(k))
        kind, why = "FAIL", f"touched {touched[0].partition('/')[0]}"
    if kind == "accepted" and baseline is not None and (silent := _silent(baseline, out / "run", folder)):
        kind, why = "FAIL", f"silent: {changes[0]} of {name}, {silent}"
    title = name if name in COMMANDS else f"{name} {arguments[0]}"
    return Verdict(seed, title, tuple(changes), kind, why, ran.error[-LONGEST:], used)


def _weighted(rng: np.random.Generator) -> str:
    return str(rng.choice([k for k, _ in PER_SEED], p=[p for _, p in PER_SEED]))


def _of_dataset(name: str, seed: str) -> tuple[str, ...]:
    """Arguments of a command of a dataset; one with too few rows for a fit is only checked."""
    if name == "check" or seed in CHECKED:
        return "check", "{in}"
    return name, "{in}", *({"fit": FIT[1:]}.get(name, ())), "--model", "joint", "--out", "{out}/run"


def _write(files: Files, folder: Path) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _state(folder: Path) -> dict[str, str]:
    """What is in a folder, except for the output: names, kinds and hashes."""
    found = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if not name.startswith("out"):
            regular = path.is_file() and not path.is_symlink() and os.access(path, os.R_OK)
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest() if regular else str(path.is_symlink())
    return found


def judged(ran: Ran, out: Path, folder: Path) -> tuple[str, str]:
    """``accepted``, ``refused`` or ``FAIL`` with the class of the failure."""
    if ran.trouble:
        return "FAIL", ran.trouble
    lines = ran.error.strip().splitlines()
    failed = ran.code == 1 and not lines and any(word in ran.output for word in REPORTED)
    if ran.code == 0 or failed:
        return _accepted(ran, out, folder)
    if ran.code != 1:
        return "FAIL", f"exit code {ran.code}: {lines[-1][:60] if lines else ''}"
    if len(lines) != 1 or not lines[0].startswith("bayescal: "):
        return "FAIL", f"{len(lines)} lines: {lines[0][:60] if lines else ''}"
    text = lines[0].replace(str(folder), "")
    if not text.isprintable() and not text.replace("\xa0", " ").isprintable():
        return "FAIL", f"control characters: {text[:80]!r}"
    if len(text) > LONGEST:
        return "FAIL", f"message of {len(text)} characters: {text[:60]}"
    if not re.search(r"\.\w+|[`'(]|--", text):
        return "FAIL", f"names no place: {text[:80]}"
    if (
        re.search(r"\b(nan|inf)\b", re.sub(r"([`']).*?\1", "", text))
        and "finite" not in text
        and "not a number" not in text
    ):
        return "FAIL", f"a number that is not finite: {text[:80]}"
    wrote = sorted(p.name for p in out.iterdir() if p.name != "here")
    if wrote and STATED not in lines[0]:
        return "FAIL", f"a refused command wrote {wrote[0]}"
    return "refused", ""


def _accepted(ran: Ran, out: Path, folder: Path) -> tuple[str, str]:
    if re.search(r"[\x00-\x08\x0b-\x1f\x7f]", ran.output + ran.error):
        return "FAIL", "control characters in the output"
    names = _names(folder / "in")
    numbers = re.finditer(r"(?<![\w`'])(nan|-?inf)(?![\w`'])", ran.output)
    if found := next((m for m in numbers if m[0] not in names), None):
        return (
            "FAIL",
            f"{found[0]} in the output: {ran.output[max(0, found.start() - 40) : found.end()][-60:]!r}",
        )
    for path in sorted(out.rglob("*.json")):
        if "/dataset" in path.relative_to(out).as_posix():
            continue
        try:
            json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
        except ValueError as error:
            return "FAIL", f"{path.name}: {error}"
    return "accepted", ""


def _names(folder: Path) -> set[str]:
    """Which of the words for numbers that are not finite are names of a user: keys of YAML, names of XML."""
    files = (p for p in sorted(folder.rglob("*")) if p.suffix in (".yaml", ".urdf", ".xacro", ".xml"))
    text = b"\n".join(p.read_bytes() for p in files if p.is_file() and os.access(p, os.R_OK))
    found = re.findall(rb"""(?<![^\s{,])(?:(nan|-?inf):|name(?:="|: ["']?)(nan|-?inf)\b)""", text)
    return {word.decode() for pair in found for word in pair if word}


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is written")


_BASE: dict[str, tuple[float, set[str]]] = {}


def _silent(name: str, run_folder: Path, folder: Path) -> str:
    """What is wrong with a fit of plausible wrong values that says no more than that of the true ones."""
    if name not in _BASE:
        where, out = folder / "base", folder / "out" / "base"
        where.mkdir()
        _write(datasets()[name], where)
        ran = run([FIT[0], str(where), *FIT[1:], "--model", "joint", "--out", str(out)], 6 * SECONDS)
        _BASE[name] = _said(out) if ran.code == 0 else (math.inf, set())
    base, codes = _BASE[name]
    size, more = _said(run_folder)
    return f"residuals {size / base:.0f} times larger" if size > ABSURD * base and not more - codes else ""


def _said(folder: Path) -> tuple[float, set[str]]:
    """RMS of residuals, µm, and the limitations that a fit states."""
    record = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    rows = [r for r in record["residuals"] if r["rms_um"] is not None]
    total = sum(r["count"] * r["rms_um"] ** 2 for r in rows) / max(1, sum(r["count"] for r in rows))
    return max(math.sqrt(total), SMALL), {f["code"] for f in record["findings"] if f["severity"] != "note"}


def as_json(verdict: Verdict, number: int) -> str:
    return json.dumps({"number": number, **asdict(verdict)})
