"""Predicted distance error between two points of the probed workspace, and the origin of its variance.

Small residuals on planes do not validate an arm: a plane gives no information on distances along it.
The main figure of a report is therefore the distance error that the posterior predicts. Where validation
rows measure certified spheres or were read by an instrument, the measured error is reported with it.

The arm in other conditions than those of its session: other poses, another tool, another payload.
"""

from dataclasses import dataclass, replace
from math import nan

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.motion import Motion, NominalArm, Term
from bayescal.dataset import Dataset
from bayescal.dataset.write import taken
from bayescal.effects import parameters_of, possible
from bayescal.estimate import Estimate
from bayescal.estimate.discrepancy import MASSES
from bayescal.estimate.families import EFFECT
from bayescal.estimate.unexplained import FORM
from bayescal.model import Model
from bayescal.model.block import ARM
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import interval95
from bayescal.predict.errors import by_points, evenly, far_pairs, lengths, slopes
from bayescal.predict.validation import Validation
from bayescal.statistics import rms

SPEED = np.radians(10.0)
"""rad/s, m/s: velocity of every joint, in either direction (assumed)."""


def joint_range(robot: Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    """Readings (count, n), SI, evenly over the ranges of all joints, a turn about its zero at most."""
    low, high = robot.limits_within(np.pi).T
    return NominalArm(robot, np.zeros(3)).readings_of(rng.uniform(low, high, (count, robot.n)))


def elsewhere(
    model: Model,
    rows: np.ndarray,
    readings: np.ndarray,
    payload: np.ndarray | None = None,
    offset: np.ndarray | None = None,
) -> Motion:
    """Motion of a fitted arm in other conditions.

    Parameters
    ----------
    model : Model
    rows : np.ndarray of int, shape (N,)
        Rows of the session: each states the tool, the payload and the temperature.
    readings : np.ndarray, shape (N, n)
        Joint readings, rad.
    payload : np.ndarray, shape (N,), optional
        Masses, kg, in place of those of the rows.
    offset : np.ndarray, shape (3,), optional
        Added to the TCP in the flange frame, m.

    Returns
    -------
    Motion
        By the parameters of the model. Those that act on its session alone (a shift at a time, the form of a
        face) move nothing.
    """
    scene = model.scene
    d, m = scene.dataset, scene.dataset.measurements
    count = len(rows)
    direction = np.where(np.indices((count, d.robot.n)).sum(axis=0) % 2, 1.0, -1.0)

    same = taken(m, rows)
    table = replace(
        same,
        role=np.full(count, "calibrate"),
        readings=readings,
        velocity=SPEED * direction,
        command=None,
        torque=None,
        payload=same.payload if payload is None else payload,
    )
    there = Scene(replace(d, measurements=table), compliances=scene.compliances)
    circumstances = there.circumstances()
    named = possible(model.effects, circumstances)
    by_name = {p.name: p for p in parameters_of(named, circumstances, lenient=True)}
    tools = there.tools if offset is None else there.tools + offset
    terms: list[tuple[int, Term]] = []
    for k, parameter in enumerate(model.parameters):
        if parameter.name in by_name:
            terms += [(k, t) for t in by_name[parameter.name].terms if t.frame >= 0]
    return Motion(there.chain, there.q, tools, terms, len(model.parameters))


def point_slopes(model: Model, motion: Motion, values: np.ndarray) -> np.ndarray:
    """Slopes (N, 3, P), m, of the TCP positions of a motion by z of the arm, at deviations (P,), SI."""
    by = by_points(motion, values, motion.points(values))
    return np.ascontiguousarray(np.moveaxis(by, 2, 0)) * model.sd


CENTRES, READINGS = "sphere centres", "readings of the instrument"
"""Points of measured distances, as reports name them."""
POINTS = 40
"""Number of points of the workspace between which distances are predicted, evenly spaced among all rows."""
SMALLEST = 0.01
"""m, assumed: points that are all nearer to each other give no distance; the range of all joints counts."""
RANGE_SEED = 40
"""Of the poses in it."""


@dataclass(frozen=True)
class DistanceErrors:
    """Predicted errors of distances and, where available, measured ones; m.

    `u` and `k` are those of the uncertainty budget of the error of any one of these distances
    (`assess.budget.with_budgets`): the combined standard uncertainty and its coverage factor.
    """

    over: str  # type of the end points
    count: int
    shortest: float
    longest: float
    errors: np.ndarray  # (S, K) by posterior draw
    measured: float | None  # root mean square
    u: float = nan
    k: float = nan

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k u, m."""
        return self.k * self.u

    @property
    def draws(self) -> np.ndarray:
        """Root mean square errors (S,), m, by posterior draw."""
        return _rms(self.errors)

    @property
    def rms(self) -> float:
        """Root mean square error by the draws, m: `u` with their scatter."""
        return rms(self.draws)

    @property
    def interval(self) -> tuple[float, float]:
        """Central 95 % interval of the root mean square error, m."""
        low, high = interval95(self.draws)
        return float(low), float(high)

    def within(self, tolerance: float) -> float:
        """Probability that the error of a distance is within a tolerance, m; 1 without any distance."""
        return float(np.mean(np.abs(self.errors) <= tolerance)) if self.errors.size else 1.0


@dataclass(frozen=True)
class Forecast:
    """Predicted distance errors, and the shares of their variance.

    Of the variance predicted over the workspace, `prior_share` is from the prior (manufacturing tolerances
    that the data did not reduce; the stated u of the size of a board is none), `discrepancy_share` from the
    model discrepancy, `masses_share` from errors of the stated masses, `unexplained_share` from errors of
    single points that neither noise nor parameters explain. The rest is from measurement noise.
    `prior_rms` (m) is the square root of the first part.
    """

    checked: tuple[DistanceErrors, ...]  # also measured, by validation data: sphere centres, instrument
    workspace: DistanceErrors
    prior_rms: float
    prior_share: float
    unexplained_share: float
    discrepancy_share: float = 0.0
    masses_share: float = 0.0

    @property
    def every(self) -> tuple[DistanceErrors, ...]:
        """All of them, the leading ones first."""
        return (*self.checked, self.workspace)

    @property
    def lead(self) -> DistanceErrors:
        """The distances that a summary reports first: measured ones where available."""
        return self.every[0]


def forecast(
    fitted: Estimate, z: np.ndarray, checked: Validation, excess: float, seed: int = 0,
    wide: Estimate | None = None,
) -> Forecast:  # fmt: skip
    """Predict errors of distances.

    Parameters
    ----------
    fitted : Estimate
    z : np.ndarray, shape (S, D)
        Posterior draws.
    checked : Validation
        Of the same draws.
    excess : float
        Standard deviation of the unexplained error, m per coordinate.
    seed : int
        Seed of the draws of the unexplained error.
    wide : Estimate, optional
        The estimate with the functions of a discrepancy as parameters, if the draws have them
        (`estimate.discrepancy.Stated.wide`).
    """
    drawn = fitted if wide is None else wide
    measured = tuple(d for d in (_certified(checked), _read(drawn, checked)) if d is not None)
    workspace, by = _workspace(drawn, z, excess, np.random.default_rng(seed))
    if not by.size:
        return Forecast(measured, workspace, 0.0, 0.0, float(excess > 0))
    arm = drawn.model.slices[ARM]
    total = float(np.mean(np.sum(by @ drawn.covariance[arm, arm] * by, axis=1))) + 2.0 * excess**2
    effect = np.array([p.effect for p in drawn.model.parameters])
    of_functions, of_masses = (
        float(np.mean(np.sum((by @ drawn.covariance[arm, np.flatnonzero(effect == name)]) ** 2, axis=1)))
        for name in (EFFECT, MASSES)
    )
    # C = C J'J C + C C because the prior of z is standard normal: part of the noise, part of the priors
    of_model = np.flatnonzero(~np.isin(effect, (EFFECT, MASSES)))
    spread = by[:, of_model] @ fitted.covariance[fitted.model.slices[ARM]]
    certified = certified_sizes(fitted.model.scene.dataset)
    has_prior = [p.effect != FORM and p.name not in certified for p in fitted.model.parameters]
    prior = float(np.mean(np.sum(spread[:, np.flatnonzero(has_prior)] ** 2, axis=1)))
    total = max(total, 1e-30)
    return Forecast(
        measured, workspace, float(np.sqrt(prior)), prior / total,
        2.0 * excess**2 / total, of_functions / total, of_masses / total,
    )  # fmt: skip


def certified_sizes(dataset: Dataset) -> frozenset[str]:
    """Parameters of the sizes of boards whose u is stated: certified lengths, and no priors of an arm."""
    stated = (t.name for t in dataset.targets if not np.isnan(t.values.get("u_scale", np.nan)).any())
    return frozenset(f"{name} scale {axis}" for name in stated for axis in "xy")


def _certified(checked: Validation) -> DistanceErrors | None:
    if not checked.distances:
        return None
    predicted = np.stack([d.predicted for d in checked.distances], axis=1)
    stated = [d.certified for d in checked.distances]
    measured = _rms(np.array([d.error for d in checked.distances]))
    return DistanceErrors(CENTRES, len(stated), min(stated), max(stated), predicted, float(measured))


def read_pairs(
    scene: Scene, target: str, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Some of the rows in which an instrument read points: which, the points (3, N), m, and far pairs (K, 2).

    None of another target, and where all points are near to each other.
    """
    xyz = scene.dataset.measurements.xyz
    if xyz is None or scene.declared_of(target).reads != "xyz":
        return None
    pick = evenly(len(rows), POINTS)
    points = xyz[rows[pick]].T
    pairs = far_pairs(points)
    return (pick, points, pairs) if np.max(lengths(points, pairs), initial=0.0) >= SMALLEST else None


def _read(fitted: Estimate, checked: Validation) -> DistanceErrors | None:
    """Distances between readings of an instrument in validation measurements, within each target."""
    scene, parts = fitted.model.scene, []
    for p in checked.points:
        rows = scene.rows_of(scene.index[p.target], scene.rows("validate"))
        if (read := read_pairs(scene, p.target, rows)) is not None:
            pick, points, pairs = read
            true = lengths(points, pairs)
            predicted = lengths(points + p.predicted[..., pick], pairs) - true
            parts.append((true, predicted, lengths(points + p.residuals[:, pick], pairs) - true))
    if not parts:
        return None
    true, predicted, error = (np.concatenate([part[k] for part in parts], axis=-1) for k in range(3))
    return DistanceErrors(
        READINGS, len(true), float(true.min()), float(true.max()), predicted,
        float(_rms(error)),
    )  # fmt: skip


@dataclass(frozen=True)
class Workspace:
    """Points of the probed workspace, and the pairs between which distances are predicted.

    `over` is the type of the points.
    """

    motion: Motion  # of the rows
    values: np.ndarray  # (P,) deviations of the arm's parameters, SI
    pairs: np.ndarray  # (K, 2) of the rows
    over: str = "points of the workspace"


def workspace(fitted: Estimate) -> Workspace:
    """Positions of the same tool, evenly among the rows of fitted tools, and pairs that are far apart.

    Rows that have all but one position give no distance: there points over the range of all joints count.
    """
    model, scene = fitted.model, fitted.model.scene
    tool = scene.dataset.measurements.tool
    rows = scene.rows("calibrate", "validate")
    rows = rows[np.isin(tool[rows], tool[scene.rows("calibrate")])]
    rows = rows[evenly(len(rows), POINTS)]
    motion, values = model.motion(rows), fitted.arm
    points, over = motion.points(values), Workspace.over
    if np.max(lengths(points, np.stack(np.triu_indices(len(rows), 1), axis=1)), initial=0.0) < SMALLEST:
        rows = np.resize(rows, POINTS)
        readings = joint_range(scene.dataset.robot, POINTS, np.random.default_rng(RANGE_SEED))
        motion, over = elsewhere(model, rows, readings), "points over the range of all joints"
        points = motion.points(values)
    pairs = far_pairs(points)
    return Workspace(motion, values, pairs[tool[rows[pairs[:, 0]]] == tool[rows[pairs[:, 1]]]], over)


def _workspace(
    fitted: Estimate, z: np.ndarray, excess: float, rng: np.random.Generator
) -> tuple[DistanceErrors, np.ndarray]:
    """Distances between positions of the same tool, and their slopes (K, P) by z of the arm, m."""
    model, space = fitted.model, workspace(fitted)
    true = lengths(space.motion.points(space.values), space.pairs)
    drawn = space.motion.points(model.deviations(z[:, model.slices[ARM]]))
    if excess:
        drawn = drawn + excess * rng.standard_normal(drawn.shape)
    errors = DistanceErrors(
        space.over, len(space.pairs), float(np.min(true, initial=np.inf)),
        float(np.max(true, initial=0.0)), lengths(drawn, space.pairs) - true, None,
    )  # fmt: skip
    if not model.parameters or not len(space.pairs):
        return errors, np.zeros((0, 0))
    return errors, slopes(model, space.motion, space.values, space.pairs)


def _rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square over the last axis."""
    return np.sqrt(np.mean(errors**2, axis=-1))
