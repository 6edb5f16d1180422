"""Linear problems that the tests of the engine share: sessions of every kind, linearised without a fit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from sessions import with_columns

from bayescal.arm.motion import Term
from bayescal.arm.transforms import rpy_matrix, rpy_of
from bayescal.dataset import Dataset, Noise, Target
from bayescal.effects import EFFECTS, Circumstances, Parameter
from bayescal.effects.gravity import masses
from bayescal.effects.location import Driver, Site
from bayescal.estimate import Estimate, linearise, unit_weights
from bayescal.gap.linear.evidence import Bank, Projected, project, weigh_sets
from bayescal.gap.linear.problem import Problem, Slopes, of_certificate
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.outcome.where import Scale, places
from bayescal.gap.search.beam import Search
from bayescal.gap.search.candidates import Candidates, candidates, extended
from bayescal.gap.search.cells import cells
from bayescal.gap.search.makers import Cell, arguments
from bayescal.gap.search.unknown import Pool
from bayescal.gap.search.verdict import Decision, decide
from bayescal.model import build
from bayescal.model.scene import Scene
from factors.kind import turned

BASELINE = ("geometry", "compliance")


def log_bayes(p: Projected, sets: Sequence[np.ndarray]) -> np.ndarray:
    """Log Bayes factors (len(sets), scales) of adding sets of a projected pool's columns, by prior scale."""
    return weigh_sets(p.state, Bank(p.pool, tuple(sets), p.state.problem.count, p.state.problem.worth))


def unsolved(
    dataset: Dataset, effects: tuple[str, ...] = BASELINE, off: float = 0.1, seed: int = 0
) -> Estimate:
    """A model `off` prior standard deviations from its drawing, as if that were its estimate."""
    model = build(Scene(dataset, oriented=True), effects)
    z = off * np.random.default_rng(seed).standard_normal(model.size)
    weights = unit_weights(model, z)
    rejected, dof = np.zeros(0, int), dict.fromkeys(weights.scale, 10.0)
    return Estimate(model, z, np.eye(model.size), weights, linearise(model, z, weights), 0, rejected, dof)


def with_orientations(dataset: Dataset, seed: int = 0) -> Dataset:
    """A session of one instrument, every second of whose rows reads the drawn flange's orientation too."""
    scene, m = Scene(dataset), dataset.measurements
    home = rpy_matrix(np.asarray(dataset.targets[0].values["rpy"]))
    off = turned(1e-3 * np.random.default_rng(seed).standard_normal((len(m.ids), 3)))
    read = home.T @ scene.flange @ off
    rpy = np.array([rpy_of(r) for r in read])
    rpy[1::2] = np.nan
    return with_columns(dataset, rpy=rpy)


def of_every_kind(dataset: Dataset) -> Dataset:
    """The session with its contacts shared out to targets of every kind, close by."""
    points = Scene(dataset).points
    m = dataset.measurements
    count, planes = len(points), len(dataset.targets)
    kinds = ("sphere", "cylinder", "fixed-point", "distance", "instrument")
    middle, radius = points.mean(axis=0), 3e-3
    values = (
        {"centre": middle, "diameter": 0.02},
        {"point": middle, "axis": np.array([0.6, 0.0, 0.8]), "diameter": 0.03},
        {"centre": middle},
        {"centre": middle + 0.3, "length": float("nan")},
        {"xyz": np.array([2.0, 0.3, 0.5]), "rpy": np.radians([5.0, -3.0, 170.0])},
    )
    targets = [Target(kind, kind, value) for kind, value in zip(kinds, values, strict=True)]
    target = np.where(np.arange(count) % 2, m.target, planes + (np.arange(count) // 2) % len(kinds))
    reads = target == planes + kinds.index("instrument")
    length = np.where(target == planes + kinds.index("distance"), 0.4, np.nan)
    xyz = np.where(reads[:, None], points + radius, np.nan)
    return replace(
        dataset,
        folder=Path(),
        noise=Noise(contact=5e-6, point=8e-6),
        targets=(*dataset.targets, *targets),
        measurements=replace(m, target=target, xyz=xyz, length=length),
    )


def left_by(cell: Cell, axis: str, wanted: np.ndarray, frame: int | None = None) -> float:
    """Least share of a function (N,) that no set of a cell represents along an axis of one frame."""
    shares = []
    for own in cell.sets:
        terms = [t for q in own for t in q.terms]
        x = np.array([t.driver for t in terms if t.axis == axis]).T
        if x.size and {t.frame for t in terms} == {terms[0].frame if frame is None else frame}:
            shares.append(np.sum((wanted - x @ np.linalg.lstsq(x, wanted, rcond=None)[0]) ** 2))
    return min(shares) / np.sum(wanted**2)


def pool_of(cells: Sequence[Cell], columns: np.ndarray, count: int) -> Pool:
    """Pool of cells whose columns (R, K) are in the order of the cells; `count` rows are contacts."""
    sizes = [len(own) for cell in cells for own in cell.sets]
    sets = np.split(np.arange(sum(sizes)), np.cumsum(sizes, dtype=int)[:-1]) if sizes else ()
    owner = np.repeat(np.arange(len(cells)), [len(cell.sets) for cell in cells])
    return Pool(columns, tuple(sets), count, cells=tuple(cells), owner=owner)


@dataclass(frozen=True)
class Bench:
    """A session linearised once, whose residuals can be made up."""

    known: Candidates
    slopes: Slopes
    problem: Problem
    pool: Pool
    circumstances: Circumstances

    @classmethod
    def of(cls, dataset: Dataset) -> "Bench":
        fitted = unsolved(dataset, off=0.0)
        scene = fitted.model.scene
        c = scene.circumstances(scene.rows("calibrate"))
        known, generic = candidates(c, BASELINE), list(cells(c))
        step = EFFECTS["step"]  # a search keeps only the leading rows of those that it tries
        if "step" not in known.variants and step.scan is not None:
            rows = step.scan.values(c)
            known = extended(known, step, [float(row) for row in rows[:: len(rows) // 24]], c)
        slopes = Slopes.of(fitted, [p for p in known.pool if of_certificate(p)])
        pool = pool_of(
            generic,
            slopes.columns([q for cell in generic for own in cell.sets for q in own]),
            len(slopes.contact),
        )
        p = slopes.problem(np.zeros(fitted.model.size), known.pool, masses(c))
        return cls(known, slopes, p, pool, c)

    def made_up(self, seed: int, contribution: np.ndarray | float = 0.0, gross: float = 0.0) -> Problem:
        """The problem with noise, a drawn arm, what is added, and a share of gross contacts."""
        rng = np.random.default_rng(seed)
        p = self.problem
        noise = rng.standard_normal(len(p.residual))
        bad = rng.choice(p.count, round(gross * p.count), replace=False)
        noise[bad] += rng.uniform(8, 80, len(bad)) * rng.choice([-1, 1], len(bad))
        drawn = p.jacobian @ rng.standard_normal(p.jacobian.shape[1])
        return replace(p, residual=noise + drawn + contribution)

    def null(self) -> State:
        """The model as it stands, fitted to no residual at noise 1."""
        p = replace(self.problem, residual=np.zeros_like(self.problem.residual))
        return replace(fit_state(p, (), (), robust=False), kappa=1.0)

    def visible(self, columns: np.ndarray, strength: float, seed: int) -> np.ndarray:
        """A drawn mixture of columns (R, k) of which the model leaves so much, lambda, to be seen."""
        state = self.null()
        covariance = np.linalg.inv(state.design.T @ state.design + np.eye(state.design.shape[1]))
        state = replace(state, covariance=covariance)
        amplitude = np.random.default_rng(seed).standard_normal(columns.shape[1])
        information = project(state, columns).information(np.arange(columns.shape[1]))
        return columns @ amplitude * np.sqrt(strength / (amplitude @ information @ amplitude))

    def of_terms(self, *terms: Term, strength: float, seed: int) -> np.ndarray:
        """Contribution (R,) of an error that the effects do not have, of an amplitude of either sign."""
        return self.visible(self.slopes.columns([Parameter("truth", "", terms, 1e-4)]), strength, seed)

    def of_effect(self, effect: str, strength: float, seed: int = 0, site: str = "") -> np.ndarray:
        """Contribution (R,) of an effect of the pool, at its usual or its middle setting."""
        own = [v for v in self.known.variants[effect] if v.site == site and not isinstance(v.setting, str)]
        chosen = own[0] if own[0].setting is None and len(own) == 1 else own[len(own) // 2]
        return self.visible(self.problem.pool[:, chosen.columns], strength, seed)

    def decided(self, p: Problem) -> tuple[Decision, Search]:
        search = Search(p, self.known)
        search.run()
        return decide(search, self.pool, arguments(self.circumstances)), search

    def decision(self, seed: int, contribution: np.ndarray | float = 0.0, gross: float = 0.0) -> Decision:
        """The decision on a made-up problem."""
        return self.decided(self.made_up(seed, contribution, gross))[0]

    def number(self, site: Site, driver: Driver) -> int:
        """Number of the first generic cell of a site with a driver."""
        return next(k for k, q in enumerate(self.pool.cells) if (q.site, q.driver) == (site, driver))

    def columns(self, number: int) -> np.ndarray:
        """Columns (R, K) of the first set of a generic cell."""
        return self.pool.columns[:, self.pool.sets[int(np.flatnonzero(self.pool.owner == number)[0])]]

    def left_by(
        self, site: Site, driver: Driver, axis: str, wanted: np.ndarray, frame: int | None = None
    ) -> float:
        """Least share of a function that the first cell of a site with a driver does not represent."""
        return left_by(self.pool.cells[self.number(site, driver)], axis, wanted, frame)

    def places(self, decision: Decision) -> list:
        """Where a decision says that something is."""
        size = self.problem.jacobian.shape[1]
        scale = Scale(self.circumstances, 1e-10, size, self.slopes)
        return places(decision.hypothesis, self.pool, self.known.pool, scale)


@cache
def bench_of(maker: Callable, seed: int, count: int) -> Bench:
    """The bench of a session of a maker, linearised once for all tests that change nothing of it."""
    return Bench.of(maker(seed=seed, count=count).dataset)
