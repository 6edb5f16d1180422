"""Commands killed at random times (`kill -9`): what remains is nothing, the earlier result, or the new one.

Half of the kills come at any time of a command, the other half while it writes. Every second run has an
earlier result in its folder. After each kill the files are compared with their list, and the next command's
first step must leave nothing beside them.

Run from the top of the project: ``python -m analysis.kills --kills 100 --seed 0``.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from bayescal.arm.nominal import NominalArm
from bayescal.folders import LIST, claimed
from bayescal.robots import load_robot

TOP = Path(__file__).parents[1]
SESSION = TOP / "data" / "lrmate200ic-cube"
RUN, LOG = "run", "log.csv"
SIDECAR = ".bayescal.json"
HARD = 9
"""SIGKILL."""
WRITING = 1.5
"""Seconds within which a command is killed after its first unfinished file has appeared, at most."""
POLL = 0.002
"""Seconds between looks for an unfinished file."""


@dataclass(frozen=True)
class Command:
    """A command that writes `out`, relative to its folder; `marker` identifies a run folder."""

    words: tuple[str, ...]
    out: str
    marker: str = ""  # "" if it writes files instead of a run folder
    needs: tuple[str, ...] = ()  # folders or files of the prepared runs, copied for each attempt


COMMANDS = {
    "fit": Command(("fit", str(SESSION), "--samples", "2000", "--out", "fit"), "fit", "fit.json"),
    "gap": Command(("gap", str(SESSION), "--out", "gap"), "gap", "gap.json"),
    "init": Command(("init", "new", "--robot", "ur5e"), "new", "dataset.yaml"),
    "simulate": Command(
        ("simulate", "--contacts", "60", "--spheres", "0", "--out", "simulated"), "simulated", "truth.json"
    ),
    "import": Command(
        (
            *("import", LOG, "--map", "id=Point, j*=A* deg, x=X mm, y=Y mm, z=Z mm", "--robot"),
            *("fanuc-lrmate200ic", "--noise", "0.02 mm", "--tool", "60 0 120 mm", "--out", "imported"),
        ),
        "imported",
        "dataset.yaml",
        (LOG,),
    ),
    "plan": Command(
        ("plan", str(SESSION), "--contacts", "60", "--candidates", "600", "--out", "plan"),
        "plan",
        "plan.json",
    ),
    "report": Command(("report", RUN), RUN, "fit.json", (RUN,)),
    "export": Command(
        ("export", RUN, "--to", "urdf", "--out", "arm.urdf", "--force"), "arm.urdf", needs=(RUN,)
    ),
}


def prepared(folder: Path, needs: set[str]) -> None:
    """Write what commands need: a fit, and a log of 40 poses."""
    if RUN in needs:
        words = ("fit", str(SESSION), "--samples", "0", "--no-pictures", "--out", RUN)
        call(Command(words, RUN), folder).wait()
    if LOG not in needs:
        return
    robot, _ = load_robot("fanuc-lrmate200ic")
    arm = NominalArm(robot, np.array([0.06, 0.0, 0.12]))
    readings = np.random.default_rng(1).uniform(-0.6, 0.6, (40, 6))
    points = 1e3 * arm.ball(arm.frames(readings))
    lines = ["Point,A1,A2,A3,A4,A5,A6,X,Y,Z"]
    for k, row in enumerate(np.column_stack([np.degrees(readings), points])):
        lines.append(f"p{k}," + ",".join(f"{value:.6f}" for value in row))
    (folder / LOG).write_text("\n".join(lines) + "\n", encoding="utf-8")


def call(command: Command, folder: Path) -> subprocess.Popen[bytes]:
    """Start a command in a folder."""
    return subprocess.Popen(
        [sys.executable, "-m", "bayescal.cli", *command.words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(TOP)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def contents(path: Path) -> dict[str, str]:
    """SHA-256 of a file, or of the files below a folder, by name; none if there is nothing."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    return {p.relative_to(path.parent).as_posix(): sha256(p.read_bytes()).hexdigest() for p in files}


def state(command: Command, folder: Path, before: dict[str, str]) -> str:
    """What a killed command has left: 'nothing', 'earlier', 'new' or 'DAMAGED'."""
    out = folder / command.out
    found = contents(out)
    if found == before:
        return "earlier" if before else "nothing"
    there = {name.partition("/")[2] or name: value for name, value in found.items()}
    try:
        if command.marker:
            expected = json.loads((out / LIST).read_text(encoding="utf-8"))["files"]
        else:
            record = json.loads(out.with_name(out.name + SIDECAR).read_text(encoding="utf-8"))
            expected = {out.name: record["sha256"]}
    except (OSError, ValueError, KeyError):
        return "DAMAGED"
    return "new" if expected == {name: own for name, own in there.items() if name != LIST} else "DAMAGED"


def hidden(folder: Path) -> list[str]:
    """Names of what is unfinished in a folder."""
    return sorted(p.name for p in folder.iterdir() if p.name.startswith("."))


def killed(command: Command, folder: Path, wait: float, writing: bool) -> bool:
    """Start a command and kill it; whether it was still running."""
    process = call(command, folder)
    if writing:
        while process.poll() is None and not any(name.endswith(".part") for name in hidden(folder)):
            time.sleep(POLL)
    try:
        process.wait(wait)
    except subprocess.TimeoutExpired:
        process.kill()
    return process.wait() == -HARD


def copied(source: Path, target: Path) -> None:
    """Copy a file or a folder, if it is there."""
    if source.is_dir():
        shutil.copytree(source, target)
    elif source.is_file():
        shutil.copyfile(source, target)


def attempt(command: Command, top: Path, ready: Path, wait: float, writing: bool) -> tuple[str, ...]:
    """Kill a command once, over an earlier result where `ready` has one; findings, by name."""
    folder = Path(tempfile.mkdtemp(dir=top))
    for name in {*command.needs, command.out, command.out + SIDECAR}:
        copied(ready / name, folder / name)
    before = contents(folder / command.out)
    running = killed(command, folder, wait, writing)
    left, found = hidden(folder), state(command, folder, before)
    if command.marker:
        with claimed(folder / command.out, command.marker):
            pass
        found = "DAMAGED" if hidden(folder) else found
    elif (code := call(command, folder).wait()) or hidden(folder):
        print(
            f"{command.words[0]}: the next command ends with {code}, beside {hidden(folder)}", file=sys.stderr
        )
        found = "DAMAGED"
    shutil.rmtree(folder)
    return (found, *(["killed"] if running else []), *(["left parts"] if left else []))


def kills(names: Sequence[str], count: int, seed: int, top: Path) -> dict[str, Counter[str]]:
    """Kill each of the commands in turn, `count` times in total; findings of each, counted.

    Parameters
    ----------
    names : sequence of str
        Keys of `COMMANDS`.
    count, seed : int
        Number of kills, and seed of their times.
    top : Path
        An empty folder for the runs.
    """
    rng = np.random.default_rng(seed)
    ready, empty = top / "ready", top / "empty"
    ready.mkdir()
    empty.mkdir()
    needs = {need for name in names for need in COMMANDS[name].needs}
    prepared(ready, needs)
    seconds = {}
    for name in names:
        begin = time.monotonic()
        if call(COMMANDS[name], ready).wait():
            raise SystemExit(f"{name} fails without a kill")
        seconds[name] = time.monotonic() - begin
    for need in needs:
        copied(ready / need, empty / need)
    found: dict[str, Counter[str]] = {name: Counter() for name in names}
    for k in range(count):
        name, writing = names[k % len(names)], bool(k // len(names) % 2)
        wait = float(rng.uniform(0, min(WRITING, seconds[name]) if writing else seconds[name]))
        if writing:
            wait *= float(rng.uniform()) ** 2  # most of the files are written soon
        earlier = bool(k // len(names) // 2 % 2)
        found[name].update(attempt(COMMANDS[name], top, ready if earlier else empty, wait, writing))
        found[name]["runs"] += 1
    return found


COLUMNS = ("runs", "killed", "left parts", "nothing", "earlier", "new", "DAMAGED")


def table(found: dict[str, Counter[str]]) -> str:
    """The findings as a table."""
    rows = [("command", *COLUMNS), *((name, *(str(own[c]) for c in COLUMNS)) for name, own in found.items())]
    total = sum(found.values(), Counter())
    rows.append(("total", *(str(total[c]) for c in COLUMNS)))
    return "\n".join("".join(f"{cell:>12}" for cell in row) for row in rows)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = kills(asked.commands, asked.kills, asked.seed, Path(folder))
    print(table(found))
    if any(own["DAMAGED"] for own in found.values()):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
