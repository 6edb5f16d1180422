"""What standards state: conformance to a tolerance (ISO 14253-1), performance of an arm (ISO 9283:1998).

Conformance of distance errors to a tolerance.

The rule is that of ISO 14253-1, in which the uncertainty counts against the party that proves: with a
measured error e, its expanded uncertainty U = k u and a tolerance X, conformance is proven if
abs(e) + U <= X, nonconformance if abs(e) - U > X; in between there is no decision. The edition of 2017
requires by default a probability of conformance of 95 %, which a guard band of 1.65 u gives where X is large
beside u (one-sided; JCGM 106:2012, 8.3). U with a coverage of 95.45 %, the guard band of the editions before
and of calibration certificates, is the stricter of the two (97.7 % one-sided), and is what this program uses.

u and k are those of the uncertainty budget of the error (`assess.budget`), which a report and a certificate
state: noise of the contacts, parameters of the arm, unexplained residuals, and the certificate. u is larger
than that of the measurement alone, so that the rule is conservative: more results are 'not decided'.

Performance of the calibrated arm in the terms of ISO 9283:1998, from validation measurements.

Pose accuracy AP is the distance from the stated pose to the barycentre of the attained poses (7.2.1), pose
repeatability RP = l + 3 S_l of the distances l from that barycentre (7.2.2), distance accuracy AD the mean
attained distance minus the stated one (7.3.2). The stated pose is here that of the calibrated model at the
joint readings. A contact shows the component along the normal of its surface alone.

u is of the measurement: noise of the validation data, location of the target, certificates. The uncertainty
of the arm's parameters is not in it, because the figures describe this arm as it is calibrated.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from bayescal.assess.acceptance import Acceptance
from bayescal.assess.budget import MOST_DOF, Budget
from bayescal.assess.inputs import UNEXPLAINED, Basis
from bayescal.assess.measurand import certified_distances, distances
from bayescal.errors import BayescalError
from bayescal.estimate.families import poses
from bayescal.predict.forecast import Forecast
from bayescal.predict.targets import RowPrediction
from bayescal.predict.validation import DistanceCheck, Validation

PASS, FAIL, OPEN = "PASS", "FAIL", "cannot be decided"


@dataclass(frozen=True)
class Conformance:
    """One distance, certified, and the decision on its error; m."""

    between: tuple[str, str]
    error: float
    expanded: float  # U = k u
    k: float
    probability: float  # that its error is within the tolerance
    decision: str


@dataclass(frozen=True)
class Tolerance:
    """Decisions on a tolerance of distance errors, m."""

    tolerance: float
    decision: str  # of all together
    why: str
    probability: float  # that the error of a distance in the probed volume is within
    expanded: float  # U = k u of such an error
    k: float
    distances: tuple[Conformance, ...]


def conformance(
    tolerance: float, expected: Forecast, checked: Validation, tests: Acceptance,
    budgets: Mapping[tuple[str, str], Budget],
) -> Tolerance:  # fmt: skip
    """Decide whether distance errors are within a tolerance.

    Parameters
    ----------
    tolerance : float
        m, of the absolute error of a distance.
    expected : Forecast
        With u and k of its distances.
    checked : Validation
    tests : Acceptance
        Where the model is not validated, does not explain the machine, is in doubt or rests on priors,
        conformance is not proven. Neither is it without a certified distance.
    budgets : mapping
        Budget of the error of each certified distance (`assess.budget.of_distances`).

    Raises
    ------
    BayescalError
        Where the tolerance is no positive number.
    """
    check_tolerance(tolerance)
    space = expected.workspace
    distances = tuple(_decided(d, tolerance, budgets[d.between]) for d in checked.distances)
    failed = [d for d in distances if d.decision == FAIL]
    undecided = [d for d in distances if d.decision == OPEN]
    of, wide = f"of {len(distances)} certified distances", space.expanded > tolerance
    cases = (
        (failed, FAIL, f"{len(failed)} {of}: error - U > tolerance"),
        (not tests.explains, OPEN, "the model does not explain the machine"),
        (not tests.validated, OPEN, "no validation measurements verify the prediction"),
        (not tests.determined, OPEN, "the prediction rests on priors, not on measurements"),
        (bool(tests.doubts), OPEN, "errors are larger than noise and model predict"),
        (undecided, OPEN, f"{len(undecided)} {of}: error within U of the tolerance"),
        (wide, OPEN, "U of a distance in the probed volume is larger than the tolerance"),
        (not distances, OPEN, "no certified distance was measured; U of one in the probed volume is smaller"),
        (True, PASS, "error + U <= tolerance, for every distance"),
    )
    decision, why = next((decision, why) for applies, decision, why in cases if applies)
    return Tolerance(tolerance, decision, why, space.within(tolerance), space.expanded, space.k, distances)


def check_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that is no positive length, m."""
    if not (np.isfinite(tolerance) and tolerance > 0):
        what = f"a tolerance of {1e3 * tolerance:g} mm"
        raise BayescalError(what, "--tolerance-mm", "give a positive length, in mm")


def decide(error: float, expanded: float, tolerance: float) -> str:
    """PASS, FAIL or not decided, by ISO 14253-1 with a guard band of U."""
    if abs(error) + expanded <= tolerance:
        return PASS
    return FAIL if abs(error) - expanded > tolerance else OPEN


def _decided(d: DistanceCheck, tolerance: float, b: Budget) -> Conformance:
    low, high = ((end - d.error) / b.u for end in (-tolerance, tolerance))
    p = float(np.diff(stdtr(min(b.dof, MOST_DOF), (low, high)))[0])
    return Conformance(d.between, d.error, b.expanded, b.k, p, decide(d.error, b.expanded, tolerance))


CYCLES, POSES = 30, 5
"""Cycles and poses of the standard."""
FEWEST_CYCLES = 3
"""Repeats of a pose from which on a repeatability is stated."""


@dataclass(frozen=True)
class Figure:
    """One figure over `count` poses or distances; m. `u` is that of the mean, `u_max` of the maximum."""

    symbol: str
    words: str
    count: int
    mean: float
    maximum: float
    u: float | None = None
    u_max: float | None = None


@dataclass(frozen=True)
class Iso9283:
    """Figures in the terms of the standard, and what differs from its procedure."""

    figures: tuple[Figure, ...]
    differs: tuple[str, ...]


@dataclass(frozen=True)
class _Poses:
    """Errors at one target: `error` (P, k) of the barycentres, and the pose (C,) of each row."""

    error: np.ndarray
    pose: np.ndarray
    scatter: tuple[np.ndarray, ...]  # distances from the barycentre, of each pose

    def along(self, way: np.ndarray) -> np.ndarray:
        """Sum over poses of the errors' components along `way` (P, k), as slopes (k C,) by the residuals."""
        size = np.bincount(self.pose, minlength=len(self.error))
        return (way / size[:, None])[self.pose].T.ravel()


def iso9283(basis: Basis) -> Iso9283:
    """Figures from all validation measurements; none without such rows."""
    points = [r for r in basis.prepared.rows if r.block.kind.rows == 3]
    planes = [r for r in basis.prepared.rows if r.block.kind.rows == 1]
    figures = [
        *_accuracy(basis, points, "AP", "pose accuracy (position)"),
        *_accuracy(basis, planes, "AP n", "pose accuracy, component along the normal of the surface"),
        *_distance_accuracy(basis),
    ]
    return Iso9283(tuple(figures), tuple(_differs(basis, points + planes)) if figures else ())


def _accuracy(basis: Basis, parts: list[RowPrediction], symbol: str, words: str) -> Iterator[Figure]:
    each = [(r, _by_pose(basis, r)) for r in parts]
    if not each:
        return
    size = np.concatenate([np.linalg.norm(p.error, axis=1) for _, p in each])
    mean_square, largest, of_largest = 0.0, -1.0, 0.0
    for r, p in each:
        length = np.linalg.norm(p.error, axis=1)
        way = p.error / np.where(length > 0, length, 1.0)[:, None]
        mean_square += _variance(basis, r, p.along(way) / len(size))
        k = int(np.argmax(length))
        if length[k] > largest:
            only = np.where(np.arange(len(way))[:, None] == k, way, 0.0)
            largest, of_largest = float(length[k]), _variance(basis, r, p.along(only))
    u, u_max = np.sqrt([mean_square, of_largest]).tolist()
    yield Figure(symbol, words, len(size), float(np.mean(size)), largest, u, u_max)
    repeats = [d for _, p in each for d in p.scatter if len(d) >= FEWEST_CYCLES]
    if repeats:
        rp = np.array([np.mean(d) + 3.0 * np.std(d, ddof=1) for d in repeats])
        words = "pose repeatability (position)" + (", component along the normal" if symbol != "AP" else "")
        yield Figure(symbol.replace("AP", "RP"), words, len(rp), float(rp.mean()), float(rp.max()))


def _by_pose(basis: Basis, r: RowPrediction) -> _Poses:
    """Barycentres of the residuals of each pose."""
    pose = poses(basis.stated.wide.model.scene.dataset.measurements, r.block.rows)
    error = r.in_rows  # (k, C)
    size = np.bincount(pose)
    mean = np.stack([np.bincount(pose, component) for component in error], axis=1) / size[:, None]
    away = np.linalg.norm(error - mean[pose].T, axis=0)
    scatter = tuple(np.split(away[np.argsort(pose, kind="stable")], np.cumsum(size)[:-1]))
    return _Poses(mean, pose, scatter)


def _variance(basis: Basis, r: RowPrediction, by: np.ndarray) -> float:
    """Variance, m2, of a combination `by` (R,) of residuals: their noise, and the location of the target."""
    if r.target is None:
        plain = basis.stated.plain
        jacobian = plain.linear.jacobian[:, plain.model.slices[r.block.target]]
        moved = by @ r.by_z[:, basis.stated.wide.model.slices[r.block.target]]
        at_known_arm = np.linalg.solve(jacobian.T @ jacobian + np.eye(jacobian.shape[1]), moved)
        return float(np.sum((by * r.noise) ** 2) + moved @ at_known_arm)
    moved = by @ r.by_target
    if r.locates_target:
        return float(np.sum(((by + moved @ r.target.gain) * r.noise) ** 2))
    return float(np.sum((by * r.noise) ** 2) + np.sum((moved @ r.target.scatter) ** 2))


def _distance_accuracy(basis: Basis) -> Iterator[Figure]:
    pairs = certified_distances(basis)
    if not pairs:
        return
    m = distances(basis, pairs, "")
    error = np.array(m.values)
    changes = [by for source, by in m.errors if source.group != UNEXPLAINED]
    k = int(np.argmax(np.abs(error)))
    mean = np.sign(error) / len(error)
    u, u_max = (
        float(np.sqrt(sum(np.sum((way @ by) ** 2) for by in changes)))
        for way in (mean, np.eye(len(error))[k])
    )
    size, most = float(np.mean(np.abs(error))), float(np.abs(error[k]))
    yield Figure("AD", "distance accuracy, absolute", len(error), size, most, u, u_max)


def _differs(basis: Basis, parts: list[RowPrediction]) -> Iterator[str]:
    """What differs from the procedure of the standard."""
    scene = basis.stated.wide.model.scene
    d, m = scene.dataset, scene.dataset.measurements
    rows = scene.rows("validate")
    yield "the stated pose is that of the calibrated model at the joint readings, not a commanded pose"
    if parts:
        sizes = np.concatenate([np.bincount(poses(m, r.block.rows)) for r in parts])
        cycles = f"{sizes.min()}" if sizes.min() == sizes.max() else f"{sizes.min()} to {sizes.max()}"
        times = "1 cycle" if cycles == "1" else f"{cycles} cycles"
        yield f"{len(sizes)} poses with {times} each; the standard: {POSES} poses, {CYCLES} cycles"
    if any(r.block.kind.rows == 1 for r in parts):
        yield "contacts with a surface show the component of the error along its normal alone"
    mass = max((t.mass for t in d.tools), default=0.0)
    extra = 0.0 if m.payload is None else float(np.max(m.payload[rows], initial=0.0))
    added = f"up to {extra:.3g} kg additional payload" if extra else "no additional payload"
    load = f"{mass:.3g} kg tool, {added}"
    yield f"load: {load}; the standard: 100 % of the rated load"
    yield "the arm stands still or probes slowly; the standard: 100 % of the rated speed before each pose"
    yield "orientations (AP a, b, c) are not part of these figures"
