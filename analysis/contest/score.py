"""The score of an entry: validation errors, coverage of stated intervals, log score of the names."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from math import log
from pathlib import Path
from typing import Any

import numpy as np

from analysis.contest.entry import Entry, Names, read_entry
from analysis.contest.session import Session, located, read, residuals_of

FLOOR = 1e-4
"""Least probability that counts, as in the blind check."""
Z95 = 1.959964


@dataclass(frozen=True)
class Figures:
    """Of one entry; mm, or nan (None in JSON) where a figure is not defined."""

    task: str
    tool: str
    rows: int  # validation rows
    mean: float  # of the lengths of the residuals
    rms: float
    maximum: float
    distances: int  # between centres that only validation rows determine
    distance_rms: float
    inside95: float  # share of components within 1.96 u
    interval_score: float  # mean over components of the 95 % interval score, smaller is better
    log_score: float  # nats, of the names
    right: float  # 1 if the most probable set is the true one
    seconds: float


def hidden(out: Path, task: str) -> tuple[Session, dict[str, Any] | None]:
    """A task with its hidden readings, and its truth, None where there is none."""
    answers = json.loads((out / "answers" / f"{task}.json").read_text(encoding="utf-8"))
    return read(out / "tasks" / task).with_readings(answers["readings"]), answers["truth"]


def figures(session: Session, entry: Entry, truth: dict[str, Any] | None = None) -> Figures:
    """Score an entry by a session with the readings of its `validate` rows."""
    targets = located(session, entry.points)
    alone = {name for name in targets if session.role[session.locating(name)[0]] == "validate"}
    # a sphere that its own contacts locate is scored by its distances
    kept = {n: s for n, s in targets.items() if n not in alone or session.targets[n]["kind"] != "sphere"}
    found = list(residuals_of(session, entry.points, kept, "validate")) or [
        (np.zeros(0, int), np.zeros((0, 1)))
    ]
    sizes = np.concatenate([np.linalg.norm(r, axis=1) for _, r in found])
    parts = [(np.abs(r), np.repeat(entry.u[rows][:, None], r.shape[1], axis=1)) for rows, r in found]
    r, u = (np.concatenate([part[k].ravel() for part in parts]) for k in (0, 1))
    states = np.isfinite(u)
    r, u = r[states], u[states]
    away = [
        float(np.linalg.norm(targets[a]["centre"] - targets[b]["centre"])) - c["distance_mm"]
        for c in session.certificates
        if c["kind"] == "distance" and set(c["between"]) <= alone
        for a, b in [c["between"]]
    ]
    return Figures(
        session.name,
        entry.tool,
        len(sizes),
        float(np.mean(sizes)) if len(sizes) else np.nan,
        rms(sizes),
        float(np.max(sizes)) if len(sizes) else np.nan,
        len(away),
        rms(np.array(away)),
        float(np.mean(r <= Z95 * u)) if len(r) else np.nan,
        float(np.mean(2 * Z95 * u + 2 / 0.05 * np.maximum(r - Z95 * u, 0))) if len(r) else np.nan,
        *(of_names(entry.names, truth) if truth else (np.nan, np.nan)),
        entry.seconds,
    )


def rms(x: np.ndarray) -> float:
    """Root mean square; nan of nothing."""
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")


def of_names(names: Names | None, truth: dict[str, Any]) -> tuple[float, float]:
    """Log probability of the truth, nats, and whether the most probable set is true; nan without names.

    The events are those of the blind check: an outside cause is any set with `unknown`, everything else
    exactly the set of true effects.
    """
    if names is None:
        return np.nan, np.nan
    true = frozenset(truth["effects"])

    def holds(said: frozenset[str]) -> bool:
        return "unknown" in said if "unknown" in true else said == true

    p = sum(q for said, q in names.items() if holds(said))
    best = max(names, key=lambda said: names[said], default=None)
    return log(max(p, FLOOR)), float(best is not None and holds(best))


def scored(out: Path) -> list[dict[str, Any]]:
    """Figures of every entry in a folder of tasks, by task and tool; a bad entry is refused."""
    records = []
    for folder in sorted((out / "tasks").iterdir()):
        session, truth = hidden(out, folder.name)
        for path in sorted((out / "entries" / folder.name).glob("*.json")):
            found = figures(session, read_entry(path, folder.name, session.ids), truth)
            values = {
                k: None if isinstance(v, float) and np.isnan(v) else v for k, v in asdict(found).items()
            }
            group = json.loads((folder / "task.json").read_text(encoding="utf-8"))["group"]
            tracked = bool(np.isfinite(session.xyz).any())
            group += "" if group == "real" else ", tracker" if tracked else ", contacts"
            records.append({"group": group, "truth": truth, **values})
    return records
