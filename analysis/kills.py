"""Commands killed at random times (`kill -9`): what remains is nothing, the earlier result, or the new one.

Half of the kills come at any time of a command, the other half while it writes. Every second run has an
earlier result in its folder. After each kill the files are compared with their list, and the next command's
first step must leave nothing beside them. Processes that the killed command had started must end too.

A run that ends before its kill does not count. What the commands need, and what each kill left, are kept in
`--out`: an interrupted run continues where it stopped, and a larger number of kills adds to it.

Run from the top of the project: ``python -m analysis.kills --kills 100 --seed 0 --out runs/kills``.
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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from bayescal.arm.motion import NominalArm
from bayescal.robots import load_robot
from bayescal.storage.folders import LIST, claimed
from bayescal.storage.locks import CHECKPOINT

TOP = Path(__file__).parents[1]
SESSION = TOP / "data" / "lrmate200ic-cube"
RUN, LOG, TIMES = "run", "log.csv", "seconds.json"
SIDECAR = ".bayescal.json"
HARD = 9
"""SIGKILL."""
WRITING = 1.5
"""Seconds within which a command is killed after its first unfinished file has appeared, at most."""
POLL = 0.002
"""Seconds between looks for an unfinished file."""
ENDING = 20.0
"""Seconds within which the processes that a killed command had started must end."""
ATTEMPTS = 5
"""Runs for each kill, at most: a run may end before its kill."""


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
            *("fanuc-lrmate200ic", "--noise", "0.02 mm", "--tcp", "60 0 120 mm", "--out", "imported"),
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


def prepared(folder: Path, names: Sequence[str]) -> dict[str, float]:
    """Write what commands need and a result of each into `folder`, where they are kept; seconds of each.

    Raises
    ------
    SystemExit
        If a command fails without a kill.
    """
    needs = {need for name in names for need in COMMANDS[name].needs}
    folder.mkdir(parents=True, exist_ok=True)
    if LOG in needs and not (folder / LOG).exists():
        write_log(folder / LOG)
    if RUN in needs and not (folder / RUN).exists():
        words = ("fit", str(SESSION), "--samples", "0", "--no-pictures", "--out", RUN)
        ended(Command(words, RUN), folder)
    times = folder / TIMES
    seconds = json.loads(times.read_text(encoding="utf-8")) if times.exists() else {}
    for name in names:
        if name not in seconds:
            seconds[name] = ended(COMMANDS[name], folder)
            times.write_text(json.dumps(seconds), encoding="utf-8")
    return seconds


def write_log(path: Path) -> None:
    """A log of 40 poses."""
    robot, _ = load_robot("fanuc-lrmate200ic")
    arm = NominalArm(robot, np.array([0.06, 0.0, 0.12]))
    readings = np.random.default_rng(1).uniform(-0.6, 0.6, (40, 6))
    points = 1e3 * arm.ball(arm.frames(readings))
    lines = ["Point,A1,A2,A3,A4,A5,A6,X,Y,Z"]
    for k, row in enumerate(np.column_stack([np.degrees(readings), points])):
        lines.append(f"p{k}," + ",".join(f"{value:.6f}" for value in row))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def ended(command: Command, folder: Path) -> float:
    """Run a command to its end; the seconds that it took."""
    begin = time.monotonic()
    if call(command, folder).wait():
        raise SystemExit(f"{command.words[0]} fails without a kill")
    return time.monotonic() - begin


def call(command: Command, folder: Path) -> subprocess.Popen[bytes]:
    """Start a command in a folder, as the first process of a group."""
    return subprocess.Popen(
        [sys.executable, "-m", "bayescal.cli", *command.words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(TOP)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
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
    """Names of what is unfinished in a folder, except the checkpoint from which a fit continues."""
    names = (p.name for p in folder.iterdir())
    return sorted(name for name in names if name.startswith(".") and not name.endswith(CHECKPOINT))


def killed(command: Command, folder: Path, wait: float, writing: bool) -> bool:
    """Start a command and kill it; whether it was still running.

    Raises
    ------
    SystemExit
        If a process that it had started does not end.
    """
    process = call(command, folder)
    if writing:
        while process.poll() is None and not any(name.endswith(".part") for name in hidden(folder)):
            time.sleep(POLL)
    try:
        process.wait(wait)
    except subprocess.TimeoutExpired:
        process.kill()
    code, begin = process.wait(), time.monotonic()
    while group_runs(process.pid):
        if time.monotonic() - begin > ENDING:
            os.killpg(process.pid, HARD)
            raise SystemExit(f"{command.words[0]}: a process that it had started does not end")
        time.sleep(POLL)
    return code == -HARD


def group_runs(group: int) -> bool:
    """Whether a process of a group is alive."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def copied(source: Path, target: Path) -> None:
    """Copy a file or a folder, if it is there."""
    if source.is_dir():
        shutil.copytree(source, target)
    elif source.is_file():
        shutil.copyfile(source, target)


def attempt(
    command: Command, top: Path, ready: Path, earlier: bool, wait: float, writing: bool
) -> tuple[str, ...]:
    """Kill a command once, over an `earlier` result that `ready` has; findings, by name."""
    folder = Path(tempfile.mkdtemp(dir=top))
    for name in {*command.needs, *((command.out, command.out + SIDECAR) if earlier else ())}:
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
    """Kill the commands in turn, until `count` kills came in time; findings of each command, counted.

    Parameters
    ----------
    names : sequence of str
        Keys of `COMMANDS`.
    count, seed : int
        Number of kills, and seed of their times.
    top : Path
        A folder of its own for the prepared runs and the list of kills; what it contains is not repeated.
    """
    ready, record = top / "ready", top / f"{seed}-{'-'.join(names)}.jsonl"
    seconds = prepared(ready, names)
    lines = record.read_text(encoding="utf-8").splitlines(True) if record.exists() else []
    done = [json.loads(line) for line in lines if line.endswith("\n")]
    record.write_text("".join(json.dumps(own) + "\n" for own in done), encoding="utf-8")
    found: dict[str, Counter[str]] = {name: Counter() for name in names}
    for name, *own in done:
        found[name].update(own)
    with record.open("a", encoding="utf-8") as log:
        for k in range(len(done), ATTEMPTS * count):
            if sum(own["killed"] for own in found.values()) >= count:
                break
            name, *own = names[k % len(names)], "runs", *one(names, k, seed, seconds, top)
            found[name].update(own)
            log.write(json.dumps([name, *own]) + "\n")
            log.flush()
    return found


def one(names: Sequence[str], k: int, seed: int, seconds: Mapping[str, float], top: Path) -> tuple[str, ...]:
    """Run `k`: the command, the time of its kill, and whether there is an earlier result; its findings."""
    rng = np.random.default_rng([seed, k])
    name, turn = names[k % len(names)], k // len(names)
    writing, earlier = bool(turn % 2), bool(turn // 2 % 2)
    wait = float(rng.uniform(0, min(WRITING, seconds[name]) if writing else seconds[name]))
    if writing:
        wait *= float(rng.uniform()) ** 2  # most of the files are written soon
    return attempt(COMMANDS[name], top, top / "ready", earlier, wait, writing)


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
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/kills"),
        help="folder of inputs and results, from which a later run continues",
    )
    asked = parser.parse_args()
    found = kills(asked.commands, asked.kills, asked.seed, asked.out.resolve())
    print(table(found))
    if any(own["DAMAGED"] for own in found.values()):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
