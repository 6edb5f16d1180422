"""Knock-out on real sessions: whether a part that is taken out of the model is named, and the gap shrinks.

Run from the top of the project:
``python -m analysis.knock_out --real ../shared/data/real --out docs/knock_out.md --workers 2``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.knock_out_page import MARKS, right, table
from analysis.pages import published
from analysis.records import Record, completed, real_arguments, real_folders
from bayescal.dataset import Dataset, read_dataset
from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.gap.diagnose import Explained, explain
from bayescal.gap.examine import where
from bayescal.gap.outcome.magnitude import expects, noise_floor
from bayescal.gap.search.refit import model_name, refit
from bayescal.model import with_parameters
from bayescal.model.options import FitOptions, Part
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.errors import ValidationErrors, kept
from bayescal.statistics import rms

UM, MM = 1e6, 1e3
TABLE = "held out"
"""First heading of the table of validation errors in the README of a session."""


class Task(NamedTuple):
    """A session's whole model, or that model without something, and with more effects than usual."""

    folder: Path
    without: str = ""  # "" for nothing, "compliance", "geometry at joint 4"
    beside: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Of its record."""
        return " | ".join([self.folder.name, self.without or "whole", *self.beside])


def usual(dataset: Dataset) -> tuple[str, ...]:
    """The model that is calibrated: with compliance where the robot file gives masses."""
    return ("geometry",) if dataset.robot.masses is None else ("geometry", "compliance")


def made(task: Task) -> Record:
    """The record of a task."""
    start = time.process_time()
    dataset = read_dataset(task.folder)
    found = knocked(dataset, task.without, task.beside) if task.without else whole(dataset, task.folder)
    seconds = round(time.process_time() - start, 1)
    return found | {"session": task.folder.name, "without": task.without, "seconds": seconds}


def whole(dataset: Dataset, folder: Path) -> Record:
    """Model levels of a session from nominal to all named effects, and the remaining error."""
    scene, effects = Scene(dataset), usual(dataset)
    found = explain(scene, effects)
    members, after, known = found.last.decision.members, found.after, found.last.candidates
    noise = noise_floor(found.final, after.main).sd
    levels = [("nominal", estimate(with_parameters(scene, (), ())))]
    levels += [(effects[k - 1], calibrated(scene, effects[:k])) for k in range(1, len(effects))]
    levels += [(effects[-1], found.first.fitted)]
    for k, member in enumerate(members, start=1):
        levels.append((model_name(member, known), refit(found.last.fitted, known, members[:k])))
    places = where(found.first, found.last, found.promoted, noise)
    left = next((w for w in places if not w.explained_by), None)
    geometry = [p for p in found.first.fitted.model.parameters if p.effect == "geometry"]
    joints = [j for j in range(1, dataset.robot.n + 1) if any(_row(j).holds(p) for p in geometry)]
    return {
        "robot": dataset.robot.name,
        "model": list(effects),
        "joints": joints,
        "named": [model_name(m, known) for m in members],
        "verdict": found.verdict.kind,
        "footnotes": list(found.verdict.footnotes),
        "levels": [{"adds": name} | sizes(validation_errors(fitted)) for name, fitted in levels],
        "noise_um": UM * noise,
        "validation_um": UM * rms(after.residual[kept(after) & (after.group == after.main)]),
        "left": None if left is None else {
            "place": f"{left.site}, {left.driver}",
            "rms_um": UM * left.rms,
            "share": left.share,
            "family_p_value": left.family_p_value,
        },
        "yardsticks": yardsticks(folder / "README.md"),
    }  # fmt: skip


def _row(joint: int) -> Part:
    return Part.of(f"geometry at joint {joint}")


def sizes(held: ValidationErrors) -> Record:
    """Mean, RMS and maximum of the validation errors of contacts (size) and points (length), mm."""
    out = {}
    for kind in np.unique(held.kind):
        mine = held.kind == kind
        square = np.bincount(np.unique(held.rows[mine], return_inverse=True)[1], held.residual[mine] ** 2)
        size = MM * np.sqrt(square)
        out[str(kind)] = {
            "count": len(size),
            "mean_mm": float(np.mean(size)),
            "rms_mm": float(np.sqrt(np.mean(size**2))),
            "max_mm": float(np.max(size)),
        }
    return out


def yardsticks(readme: Path) -> list[Record]:
    """The table of validation errors, mm, in the README of a session; empty where there is none."""
    if not readme.exists():
        return []
    cells = [
        [cell.strip(" *") for cell in line.strip().strip("|").split("|")]
        for line in readme.read_text(encoding="utf-8").splitlines()
        if line.startswith("|")
    ]
    first = next((k for k, row in enumerate(cells) if row[0].startswith(TABLE)), len(cells))
    rows = [dict(zip(cells[first], row, strict=False)) for row in cells[first + 2 :]]
    label = cells[first][0] if rows else ""
    return [{"model": row.pop(label)} | {k: float(v) for k, v in row.items()} for row in rows]


def knocked(dataset: Dataset, without: str, beside: Sequence[str] = ()) -> Record:
    """Take something out of a session's model, and see whether the diagnosis puts it back."""
    scene = Scene(dataset)
    effects = (*usual(dataset), *beside)
    known = calibrated(scene, effects)
    parts = (Part.of(without),) if " at " in without else ()
    found = explain(scene, tuple(e for e in effects if e != without), FitOptions(parts))
    verdict = found.verdict
    effect = without.partition(" at ")[0]
    largest = max(
        (abs(float(known.z[k])), p.name)
        for k, p in enumerate(known.model.parameters)
        if (parts[0].holds(p) if parts else p.effect == effect)
    )
    visible, strength = lost(known, found.first.fitted)
    decision, pool = found.last.decision, found.last.pool
    best = max(found.first.decision.alone, key=lambda f: f.gain, default=None)
    leader = decision.weighed[0]
    return {
        "beside": list(beside),
        "verdict": verdict.kind,
        "named": [{"effect": n.effect, "site": n.site, "probability": n.probability} for n in verdict.named],
        "probability": verdict.probability.get(effect, 0.0),
        "missing": verdict.missing.get(effect, ""),
        "footnotes": list(verdict.footnotes),
        "largest": {"name": largest[1], "prior_sds": largest[0]},
        "visible_um": UM * visible,
        "lambda": strength,
        "place": "" if best is None else f"{pool.cells[best.cell].site}, {pool.cells[best.cell].driver}",
        "leading": list(leader.effects),
        "claimed_nats": leader.log_evidence if leader.effects == ("unknown",) else 0.0,
        "possible_nats": possible(known, found),
        "validation": reductions(known, found),
    }


def lost(known: Estimate, without: Estimate) -> tuple[float, float]:
    """What the rest of a model cannot take up of what it lacks, at the fitted data: rms, m, and lambda."""
    moved, over = [], []
    for full, bare in zip(known.model.blocks, without.model.blocks, strict=True):
        keep = known.weights.row[full.target] > 0
        apart = (known.residuals(full) - without.residuals(bare))[:, keep]
        sigma = known.weights.sigma[full.target].reshape(full.kind.rows, -1)[:, keep]
        moved.append(apart.ravel())
        over.append((apart / (sigma * known.weights.scale[full.group])).ravel())
    moved, over = np.concatenate(moved), np.concatenate(over)
    return rms(moved), float(np.sum(over**2))


def possible(known: Estimate, found: Explained) -> float:
    """Nats that the fitted measurements gain where their residuals shrink to those of the whole model."""
    null = found.first.search.hypotheses[frozenset()].state
    scale = known.weights.scale[found.before.main]
    return null.problem.count * float(np.log(null.kappa / scale))


def reductions(known: Estimate, found: Explained) -> Record:
    """RMS validation errors, µm: before, after, of the complete model; and those that the refit expects."""
    whole, before, after = validation_errors(known), found.before, found.after
    fair = kept(whole, before, after)
    out = {}
    for kind in np.unique(before.kind):
        mine = fair & (before.kind == kind)
        first, last = expects(before.residual[mine], after.residual[mine], after.sd[mine])
        out[str(kind)] = {
            "before_um": UM * rms(before.residual[mine]),
            "after_um": UM * rms(after.residual[mine]),
            "whole_um": UM * rms(whole.residual[mine]),
            "predicted_before_um": UM * first,
            "predicted_after_um": UM * last,
        }
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the records that are missing, and the page of all."""
    parser = real_arguments("knock_out", __doc__, workers=2)
    parser.add_argument("--joints", default="", help="joints to take out, comma separated [default: all]")
    given = parser.parse_args(arguments)

    def run(tasks: list[Task], what: str) -> list[Record]:
        return completed(given.runs / "records.json", {t.key: t for t in tasks}, made, given.workers, what)

    folders = real_folders(given.real, given.sessions)
    only = {int(j) for j in given.joints.split(",") if j.strip()}
    models = run([Task(f) for f in folders], "whole models")
    named = {f: tuple(r["named"]) for f, r in zip(folders, models, strict=True)}
    out = [Task(f, what) for f, r in zip(folders, models, strict=True) for what in parts_out(r, only)]
    parts = run(out, "knock-outs")
    again = [
        t._replace(beside=named[t.folder])
        for t, r in zip(out, parts, strict=True)
        if not right(r) and named[t.folder]
    ]
    beside = run(again, "with what was named in the model")
    published(table([*models, *parts, *beside]), given.out, MARKS, new=True)


def parts_out(model: Record, only: set[int]) -> list[str]:
    """Parts to take out of a complete model: the compliance, and the geometry of each joint."""
    joints = [j for j in model["joints"] if not only or j in only]
    compliance = [e for e in model["model"] if e == "compliance"]
    return compliance + [str(_row(j)) for j in joints]


if __name__ == "__main__":  # worker processes import this module too
    main()
