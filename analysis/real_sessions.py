"""Fit, validation and diagnosis of every real session: the validation errors of each model level.

Run from the top of the project:
``python -m analysis.real_sessions --real ../shared/data/real --out docs/real_sessions.md``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.knock_out import usual
from analysis.pages import published
from analysis.real_sessions_page import MARKS, table
from analysis.records import Record, completed, real_arguments, real_folders
from bayescal.calibration import VALIDATION_DRAWS, fit
from bayescal.dataset import Dataset, read_dataset
from bayescal.effects import parameters_of
from bayescal.effects.selection import plain
from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.estimate.unexplained import FORM, unexplained
from bayescal.gap.diagnose import explain
from bayescal.gap.search.refit import model_name
from bayescal.model import with_parameters
from bayescal.model.scene import Scene
from bayescal.posterior import gaussian
from bayescal.predict.crossvalidation import inside95
from bayescal.predict.forecast import DistanceErrors, forecast
from bayescal.predict.validation import Validation, validate
from factors.contacts import FixedPoint

MM, UM = 1e3, 1e6
NOMINAL, BASE_TOOL, WITH_FORM, NAMED = "nominal", "base+tool", "form", "named"
BOUND_TO_ITS_SESSION = ("step",)
"""Effects that say when something happened: they do not apply to other contacts."""


class Task(NamedTuple):
    """A complete session, or a session whose contacts at one location are used for validation."""

    folder: Path
    place: str = ""
    named: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Of its record."""
        return " | ".join([self.folder.name, *([self.place] if self.place else [])])


def made(task: Task) -> Record:
    """The record of a task."""
    start = time.process_time()
    dataset = read_dataset(task.folder)
    found = unseen(dataset, task.place, task.named) if task.place else whole(dataset)
    seconds = round(time.process_time() - start, 1)
    return {"session": task.folder.name, "place": task.place} | found | {"seconds": seconds}


def whole(dataset: Dataset) -> Record:
    """Model levels of a session, from the nominal model to the effects that `gap` names."""
    scene, effects = Scene(dataset), usual(dataset)
    fitted = fit(dataset, effects, samples=0)
    found = explain(scene, effects)
    verdict = found.verdict
    named = [model_name(m, found.last.candidates) for m in found.last.decision.members]
    levels: list[tuple[str, Estimate]] = [(BASE_TOOL, base_and_tool(scene))]
    levels += [(effects[k - 1], calibrated(scene, effects[:k])) for k in range(1, len(effects))]
    levels += [(effects[-1], found.first.fitted)]
    if FORM in fitted.final.effects:
        levels += [(WITH_FORM, fitted.final.estimate)]
    if named:
        levels += [(NAMED, found.final)]
    return {
        "robot": dataset.robot.name,
        "verdict": verdict.kind,
        "names": named,
        "levels": [as_in_the_files(scene), *(level(what, e) for what, e in levels)],
        "places": places(scene),
        "warnings": list(fitted.warnings),
    }


def base_and_tool(scene: Scene) -> Estimate:
    """Tools and targets fitted, the arm nominal."""
    tools = parameters_of((), scene.circumstances(scene.rows("calibrate")))
    return estimate(with_parameters(scene, (), tools))


def as_in_the_files(scene: Scene) -> Record:
    """Residuals of the validation measurements where nothing is fitted."""
    model = with_parameters(scene, (), ())
    rows, sizes = scene.rows("validate"), {}
    for t in np.unique(scene.dataset.measurements.target[rows]):
        block = model.block(int(t), scene.rows_of(int(t), rows))
        r = block.residual(np.zeros(0), np.zeros(block.size))
        sizes.setdefault(_kind(len(r)), []).append(np.linalg.norm(r, axis=0))
    return {"model": NOMINAL} | {what: of(np.concatenate(parts)) for what, parts in sizes.items()}


def level(what: str, found: Estimate) -> Record:
    """Validation errors of an estimate, the share within its 95 % intervals, and its distances."""
    draws = gaussian(found, 0, VALIDATION_DRAWS)
    left = unexplained(found)
    checked = validate(found, draws.flat, draws.kappa, left.excess)
    expected = forecast(found, draws.flat, checked, left.excess)
    return {
        "model": what,
        **errors(checked),
        "distances": [_distances(d) for d in expected.every],
        "prior_share": expected.prior_share,
    }


def errors(checked: Validation) -> Record:
    """Sizes of all validation errors by kind, and their share within the 95 % intervals."""
    out = {}
    for what, checks in (("planes", checked.planes), ("points", checked.points)):
        if checks:
            sizes = [np.linalg.norm(np.atleast_2d(c.residuals), axis=0) for c in checks]
            inside = [inside95(c.residuals, c.predicted).ravel() for c in checks]
            out[what] = of(np.concatenate(sizes)) | {"inside95": float(np.mean(np.concatenate(inside)))}
    return out


def _kind(rows: int) -> str:
    return "planes" if rows == 1 else "points"


def of(size: np.ndarray) -> Record:
    """Count, mean, rms and largest of errors, m, in mm."""
    return {
        "count": len(size),
        "mean_mm": MM * float(np.mean(size)),
        "rms_mm": MM * float(np.sqrt(np.mean(size**2))),
        "max_mm": MM * float(np.max(size)),
    }


def _distances(d: DistanceErrors) -> Record:
    return {
        "over": d.over,
        "predicted_rms_um": UM * d.rms,
        "predicted_interval95_um": [UM * end for end in d.interval],
        "measured_rms_um": None if d.measured is None else UM * d.measured,
    }


def places(scene: Scene) -> list[str]:
    """Places of a session of sockets: what their targets' names say before the last dot."""
    fixed = [t.name for t in scene.dataset.targets if t.kind == "fixed-point"]
    return list(dict.fromkeys(name.rpartition(".")[0] for name in fixed if "." in name))


def unseen(dataset: Dataset, place: str, named: Sequence[str]) -> Record:
    """A place that no fit has seen: its contacts' distances from their mean, and that of its two sockets.

    All other places' rows are fitted. The names of further effects come from the whole session.
    """
    m = dataset.measurements
    there = np.array([t.name.rpartition(".")[0] == place for t in dataset.targets])[m.target]
    scene = Scene(replace(dataset, measurements=replace(m, role=np.where(there, "validate", "calibrate"))))
    effects = usual(dataset)
    further = tuple(n for n in named if plain(n) not in BOUND_TO_ITS_SESSION)
    models: list[tuple[str, Callable[[], Estimate]]] = [
        (NOMINAL, lambda: estimate(with_parameters(scene, (), ())))
    ]
    for k in range(1, len(effects) + 1):
        models.append((effects[k - 1], lambda k=k: calibrated(scene, effects[:k])))  # type: ignore[misc]
    if further:
        models.append((NAMED, lambda: calibrated(scene, (*effects, *further))))
    return {"levels": [{"model": what} | scatter(make()) for what, make in models]}


def scatter(found: Estimate) -> Record:
    """Of the validate rows of sockets: errors about each socket's mean, and of the distances certified."""
    scene, model = found.model.scene, found.model
    rows = scene.rows("validate")
    values = model.deviations(found.z[: len(model.parameters)])
    means, sizes = {}, []
    for t in np.unique(scene.dataset.measurements.target[rows]):
        own = scene.rows_of(int(t), rows)
        if isinstance(scene.kind(int(t), own), FixedPoint):
            p = model.motion(own).points(values)
            centre = p.mean(axis=1)
            means[scene.dataset.targets[t].name] = centre
            sizes.append(np.linalg.norm(p - centre[:, None], axis=0))
    off = [
        abs(float(np.linalg.norm(means[c.targets[0]] - means[c.targets[1]])) - c.distance)
        for c in scene.dataset.certificates
        if c.kind == "distance" and c.distance is not None and means.keys() >= set(c.targets)
    ]
    return of(np.concatenate(sizes)) | {"distance_mm": MM * float(np.mean(off)) if off else None}


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the records that are missing, and the page of all."""
    given = real_arguments("real_sessions", __doc__).parse_args(arguments)

    def run(tasks: list[Task], what: str) -> list[Record]:
        return completed(given.runs / "records.json", {t.key: t for t in tasks}, made, given.workers, what)

    folders = real_folders(given.real, given.sessions)
    sessions = run([Task(f) for f in folders], "sessions")
    apart = [
        Task(f, place, tuple(r["names"]))
        for f, r in zip(folders, sessions, strict=True)
        for place in r["places"]
    ]
    published(table(sessions, run(apart, "places")), given.out, MARKS, new=True)


if __name__ == "__main__":  # worker processes import this module too
    main()
