"""Writes the tasks: simulated sessions, and splits of real ones; what is hidden goes to a folder apart.

``tasks/NAME`` holds what a tool may read: dataset.yaml, measurements.csv, the robot, task.json (baseline).
``answers/NAME.json`` holds readings of instruments in `validate` rows, and the true effects where known.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from analysis.blind.make import CONTACTS, Drawn, built
from analysis.contest.session import FEWEST, read
from bayescal.errors import BayescalError
from bayescal.storage.files import json_text
from bayescal.storage.folders import whole

FROZEN = Path(__file__).with_name("frozen.json")
XYZ = ("x_mm", "y_mm", "z_mm")
SPLITS = ("given", "time")
"""Of real sessions, from `halves`: the roles as given; the first half in time calibrates."""
Rows = list[dict[str, str]]


@dataclass(frozen=True)
class Task:
    """Files that a tool may read, by name, and the answers."""

    name: str
    texts: dict[str, str]
    answers: dict[str, Any]


def frozen() -> dict[str, Any]:
    """Seeds of the simulated sessions, and the identity of real ones."""
    out: dict[str, Any] = json.loads(FROZEN.read_text(encoding="utf-8"))
    return out


def written(out: Path, real: Path | None, seed: int | None = None) -> list[str]:
    """Write the tasks that are missing; returns a line for each data set that is not there.

    Parameters
    ----------
    out : Path
    real : Path, optional
        Folder of real sessions.
    seed : int, optional
        Of other simulated sessions than the frozen ones, with the same numbers.

    Raises
    ------
    BayescalError
        If a real session is not the frozen one.
    """
    known, said = frozen(), list[str]()
    drawn = known["simulated"]
    seed = drawn["seed"] if seed is None else seed
    for number in drawn["numbers"]:
        if not (out / "tasks" / simulated_name(seed, number)).exists():
            keep(out, simulated(seed, number, drawn["generator"]))
    for name, identity in known["real"].items():
        folder = None if real is None else real / name
        if folder is None or not folder.is_dir():
            said.append(f"{name} is skipped: not given (source: {identity['repository']})")
            continue
        for task in splits(checked(folder, identity)):
            if not (out / "tasks" / task.name).exists():
                keep(out, task)
    return said


def keep(out: Path, task: Task) -> None:
    """Write a task and its answers."""
    (out / "answers").mkdir(parents=True, exist_ok=True)
    (out / "answers" / f"{task.name}.json").write_text(json_text(task.answers), encoding="utf-8")
    with whole(out / "tasks" / task.name, "task.json") as stage:
        for name, text in task.texts.items():
            (stage / name).write_text(text, encoding="utf-8")
    other = {t["kind"] for t in read(out / "tasks" / task.name).targets.values()} - set(FEWEST)
    if other:
        raise BayescalError(f"targets of kind {', '.join(sorted(other))} are not scored", task.name)


def simulated_name(seed: int, number: int) -> str:
    """Of a task."""
    return f"simulated-{seed}-{number:02d}"


def simulated(seed: int, number: int, generator: int) -> Task:
    """A session of the independent simulator."""
    texts, truth = built(Drawn(seed, number, generator, reserved=False, kind=CONTACTS))
    name, baseline = simulated_name(seed, number), texts.pop("baseline.txt").strip().split(",")
    rows = list(csv.DictReader(io.StringIO(texts["measurements.csv"])))
    texts["measurements.csv"], hidden = hide(rows)
    texts["task.json"] = json_text({"name": name, "group": "simulated", "baseline": baseline})
    known = {key: truth[key] for key in ("kind", "effects", "lambda", "outside") if key in truth}
    return Task(name, texts, {"readings": hidden, "truth": known})


def checked(folder: Path, identity: dict[str, str]) -> Path:
    """A real session, if it is the frozen one."""
    digest = hashlib.sha256((folder / "measurements.csv").read_bytes()).hexdigest()
    if digest != identity["sha256"]:
        where = f"{identity['repository']} at commit {identity['commit']}"
        raise BayescalError(
            f"measurements.csv has SHA-256 {digest[:12]}..., not {identity['sha256'][:12]}...",
            str(folder), f"convert it again from {where}, or leave the folder out",
        )  # fmt: skip
    return folder


def splits(folder: Path) -> Iterator[Task]:
    """A real session with each of `SPLITS`."""
    session = read(folder)
    names = ("dataset.yaml", "robot.yaml", "LICENSE.txt")
    texts = {n: (folder / n).read_text(encoding="utf-8") for n in names if (folder / n).exists()}
    baseline = ["geometry", "compliance"] if "links:" in texts["robot.yaml"] else ["geometry"]
    with (folder / "measurements.csv").open(encoding="utf-8", newline="") as file:
        rows: Rows = list(csv.DictReader(file))
    for split in SPLITS:
        own: Rows = [dict(r) for r in rows]
        if split != "given":
            for k, role in halves(session.role, session.target).items():
                own[k]["role"] = role
        measurements, hidden = hide(own)
        name = f"{folder.name}-{split}"
        task = json_text({"name": name, "group": "real", "baseline": baseline})
        files = {**texts, "measurements.csv": measurements, "task.json": task}
        yield Task(name, files, {"readings": hidden, "truth": None})


def halves(role: np.ndarray, target: np.ndarray) -> dict[int, str]:
    """New roles of the rows whose target has `calibrate` rows: the second half in time validates.

    Whole sockets fall into the half that validates; a target with rows in both halves is divided.
    """
    free = np.flatnonzero(np.isin(target, target[role == "calibrate"]) & (role != "locate"))
    late = len(free) // 2
    return {int(k): "calibrate" if i < late else "validate" for i, k in enumerate(free)}


def hide(rows: Rows) -> tuple[str, dict[str, list[float]]]:
    """The rows as CSV without readings of instruments in `validate` rows, and these readings by id."""
    hidden: dict[str, list[float]] = {}
    for r in rows:
        if r.get("role") == "validate" and r.get("x_mm"):
            hidden[r["id"]] = [float(r[c]) for c in XYZ]
            r.update(dict.fromkeys(XYZ, ""))
    return csv_of(rows), hidden


def csv_of(rows: Rows) -> str:
    """Rows as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
