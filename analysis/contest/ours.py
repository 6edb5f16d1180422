"""Entries of bayescal, of the survey's methods, and of a stepwise selection of its effects."""

from __future__ import annotations

import csv
import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np

from analysis.blind.skill import independent
from analysis.contest import session
from analysis.contest.entry import Names
from analysis.contest.tasks import XYZ, Rows, csv_of
from bayescal.arm import chain as reference
from bayescal.assess.inputs import Basis
from bayescal.calibration import basis_of, fit, predicted_draws
from bayescal.dataset import Dataset, read_dataset
from bayescal.effects import parameters_of
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.gap.diagnose import diagnose
from bayescal.gap.linear.problem import Slopes, of_certificate
from bayescal.gap.result import Verdict
from bayescal.gap.search.beam import Member
from bayescal.gap.search.candidates import Variant, candidates
from bayescal.gap.search.refit import refit
from bayescal.methods import METHODS
from bayescal.methods.published import NOMINAL, OURS, Method
from bayescal.model import ARM, Model, build, with_parameters
from bayescal.model.equilibrium import standing_model
from bayescal.model.scene import Scene
from bayescal.posterior import approximate
from bayescal.predict.targets import prepared
from bayescal.predict.validation import validate

MM = 1e3
UNUSED = "skip"
"""Role of `validate` rows while a tool fits: they stay in the session and are neither fitted nor tested."""
LEAST = 1e-4
MOST_STEPS = 4


@dataclass(frozen=True)
class Answer:
    """Positions (N, 3), u (N,) where stated, mm; names where stated."""

    points: np.ndarray
    u: np.ndarray | None = None
    names: Names | None = None


@dataclass(frozen=True)
class Given:
    """A task as bayescal reads it: `whole` with its roles, `fitted` with `validate` rows unused."""

    folder: Path
    whole: Dataset
    fitted: Dataset
    baseline: tuple[str, ...]

    @property
    def usual(self) -> tuple[str, ...]:
        """Geometry, and compliance where there are masses."""
        return ("geometry",) if self.whole.robot.masses is None else ("geometry", "compliance")


def opened(folder: Path) -> Given:
    """Read a task. The point of the nominal arm stands for a hidden reading, which no fit uses."""
    with (folder / "measurements.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    kinds = {name: t["kind"] for name, t in session.read(folder).targets.items()}
    hidden = [r for r in rows if kinds[r["target"]] == "instrument" and not r["x_mm"]]
    if hidden:
        seen = [r for r in rows if not any(r is h for h in hidden)]
        fill(rows, _read_with(folder, seen), kinds)
    whole = _read_with(folder, rows)
    m = whole.measurements
    unused = replace(m, role=np.where(m.role == "validate", UNUSED, m.role))
    task = json.loads((folder / "task.json").read_text(encoding="utf-8"))
    return Given(folder, whole, replace(whole, measurements=unused), tuple(task["baseline"]))


def _read_with(folder: Path, rows: Rows) -> Dataset:
    """A task's dataset with other rows."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "task"
        shutil.copytree(folder, copy)
        (copy / "measurements.csv").write_text(csv_of(rows), encoding="utf-8")
        return read_dataset(copy)


def fill(rows: Rows, seen: Dataset, kinds: Mapping[str, str]) -> None:
    """Put the nominal point where nothing is read, in the frame of the other readings."""
    robot, tools = seen.robot, {t.name: t.centre for t in seen.tools}
    q = np.radians([[float(r[f"j{k + 1}_deg"]) for k in range(robot.n)] for r in rows])
    centre = np.array([tools[r.get("tool") or next(iter(tools))] for r in rows])
    p = MM * reference.points(reference.chain_of(robot), reference.link_angles(robot, q), centre)
    for target in (name for name, kind in kinds.items() if kind == "instrument"):
        own = [k for k, r in enumerate(rows) if r["target"] == target]
        read = [k for k in own if rows[k]["x_mm"]]
        xyz = np.array([[float(rows[k][c]) for c in XYZ] for k in read])
        at = session.fitted("instrument", {}, p[read], np.zeros(len(read)), xyz)
        for k in set(own) - set(read):
            point = (p[k] - at["origin"]) @ at["rotation"]
            rows[k].update({c: f"{x:.6f}" for c, x in zip(XYZ, point, strict=True)})


def points_of(model: Model, values: np.ndarray, states: dict[str, np.ndarray] | None = None) -> np.ndarray:
    """Positions (N, 3), mm, in all rows; effects of probe and surface move them along the normal."""
    m = model.scene.dataset.measurements
    out = np.empty((len(m.ids), 3))
    for t in np.unique(m.target).tolist():
        block = model.block(t, np.flatnonzero(m.target == t))
        p = block.seen(values)
        if block.has_direct:
            state = (states or {}).get(block.target, np.zeros(len(block.kind.sd)))
            p = p + block.by_point(state, p)[0] * block.at_contact(values)
        out[block.rows] = p.T
    return MM * out


def points_of_estimate(e: Estimate) -> np.ndarray:
    """Positions by an estimate, in equilibrium under gravity."""
    values = e.model.deviations(e.z[e.model.slices[ARM]])
    states = {b.target: b.state(e.z[e.model.slices[b.target]]) for b in e.model.states}
    return points_of(standing_model(e.model, values), values, states)


def u_of(given: Given, basis: Basis, seed: int = 0) -> np.ndarray:
    """Standard uncertainty (N,), mm, of a component of the residual of each `validate` row, else nan."""
    wide = basis.stated.wide
    scene = replace(wide.model.scene, dataset=given.whole)
    z, kappa = approximate(basis.stated.plain, seed, predicted_draws(given.whole))
    z = basis.stated.draws(z, np.random.default_rng(seed))
    there = replace(wide, model=replace(wide.model, scene=scene))
    known = prepared(there, loose=True, strict=False)
    checked = validate(there, z, kappa * np.sqrt(basis.stated.white), basis.excess, seed, linearised=known)
    out = np.full(len(given.whole.measurements.ids), np.nan)
    for one in (True, False):
        rows = [r.block.rows for r in known.rows if (r.block.kind.rows == 1) is one]
        for where, check in zip(rows, checked.planes if one else checked.points, strict=True):
            spread = np.var(check.predicted.reshape(len(z), -1, len(where)), axis=0)
            out[where] = MM * np.sqrt(spread.mean(axis=0))
    return out


def fitted(given: Given, effects: tuple[str, ...] = ()) -> Answer:
    """The calibration of `bayescal fit`, with its stated uncertainty."""
    found = fit(given.fitted, effects or given.usual, samples=0)
    return Answer(points_of_estimate(found.final.estimate), u_of(given, found.basis))


def diagnosed(given: Given) -> Answer:
    """The refit of `bayescal gap` with the effects that it names, and its probabilities."""
    found = diagnose(given.fitted, given.baseline)
    assert found.arm is not None, "a diagnosis has its refit"
    return Answer(points_of_estimate(found.arm), u_of(given, basis_of(found.arm)), names_of(found.verdict))


def names_of(verdict: Verdict) -> Names:
    """Probabilities of sets: those listed; the rest by the product of the marginals, as the blind check."""
    p = dict(verdict.probability)
    out: Names = {frozenset(): p.pop("null", 0.0), frozenset({"unknown"}): p.pop("unknown", 0.0)}
    for h in verdict.hypotheses:
        if h.effects and "unknown" not in h.effects:
            out[frozenset(h.effects)] = h.probability
    rest = max(1.0 - sum(out.values()), 0.0)
    others = [frozenset(s) for k in (1, 2) for s in combinations(p, k) if frozenset(s) not in out]
    weights = {s: independent(s, p) for s in others}
    total = sum(weights.values())
    out |= {s: rest * w / total for s, w in weights.items() if total > 0 and rest * w / total > LEAST}
    scale = max(sum(out.values()), 1.0)
    return {s: q / scale for s, q in out.items()}


def tool_only(given: Given) -> Answer:
    """Tools and targets fitted, the arm nominal."""
    scene = Scene(given.fitted)
    tools = parameters_of((), scene.circumstances(scene.rows("calibrate")))
    return Answer(points_of_estimate(estimate(with_parameters(scene, (), tools))))


def published(given: Given, method: Method) -> Answer:
    """A method of the survey."""
    scene = Scene(given.fitted)
    if why := method.missing(build(scene, given.usual)):
        raise BayescalError(why)
    found = method.solve(scene, given.usual)
    return Answer(points_of(standing_model(found.model, found.values), found.values))


def stepwise(given: Given) -> Answer:
    """Forward selection of effects by BIC on the linearised problem, then a refit with those selected."""
    scene = Scene(given.fitted, oriented=True)
    base = calibrated(scene, given.baseline)
    c = base.model.scene.circumstances(base.model.scene.rows("calibrate"))
    known = candidates(c, given.baseline)
    slopes = Slopes.of(base, [p for p in known.pool if of_certificate(p)])
    p = slopes.problem(base.z, known.pool, ())
    weight = np.ones(len(p.residual))
    weight[: p.count] = np.concatenate([base.weights.row[b.name] for b in base.model.blocks])[p.contact]
    root = np.sqrt(weight)[:, None]
    count = int(np.sum(weight > 0))

    def bic(columns: list[int]) -> float:
        a = np.vstack(
            [
                root * np.column_stack([p.jacobian, p.pool[:, columns]]),
                np.eye(p.jacobian.shape[1] + len(columns)),
            ]
        )
        b = np.concatenate([-root[:, 0] * p.residual, -p.z, np.zeros(len(columns))])
        rest = b - a @ np.linalg.lstsq(a, b, rcond=None)[0]
        return float(count * np.log(rest @ rest / count) + len(columns) * np.log(count))

    chosen: list[Variant] = []
    best = bic([])
    variants = [v for own in known.variants.values() for v in own]
    for _ in range(MOST_STEPS):
        before = [int(k) for v in chosen for k in v.columns]
        free = [v for v in variants if v.effect not in {w.effect for w in chosen}]
        values = [bic([*before, *map(int, v.columns)]) for v in free]
        if not values or min(values) >= best:
            break
        best = min(values)
        chosen.append(free[int(np.argmin(values))])
    found = refit(base, known, [Member(v, 1.0, 0.0) for v in chosen]) if chosen else base
    return Answer(points_of_estimate(found), names={frozenset(v.effect for v in chosen): 1.0})


TOOLS: dict[str, Callable[[Given], Answer]] = {
    "nominal arm": partial(published, method=NOMINAL),
    "tool and targets": tool_only,
    **{f"survey, {m.name}": partial(published, method=m) for m in METHODS if m not in (NOMINAL, OURS)},
    "stepwise BIC": stepwise,
    "bayescal, geometry": partial(fitted, effects=("geometry",)),
    "bayescal fit": fitted,
    "bayescal gap": diagnosed,
}
