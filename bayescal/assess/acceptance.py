"""Tests of the model by residuals, validation and rejected measurements, and conformance to a tolerance.

Each test compares a figure with its posterior prediction from noise, parameters and certificates, including
their correlations. The tests share a probability of a false alarm (Bonferroni), so that a correct model
fails any of them with a probability of at most `LEVEL`.

Conformance of a distance error is decided by the rule of ISO 14253-1. In this rule the uncertainty counts
against the party that proves: with a measured error e, its expanded uncertainty U = k u and a tolerance X,
conformance is proven if abs(e) + U <= X, nonconformance if abs(e) - U > X; in between there is no decision.
The edition of 2017 requires by default a probability of
conformance of 95 %, which a guard band of 1.65 u gives where X is large beside u (one-sided; JCGM 106:2012,
8.3). U with a coverage of 95.45 %, the guard band of the editions before and of calibration certificates, is
the stricter of the two (97.7 % one-sided), and is what this program uses.

u and k are those of the uncertainty budget of the error (`assess.budget`), which a report and a certificate
state: noise of the contacts, parameters of the arm, unexplained residuals, and the certificate. u is larger
than that of the measurement alone, so that the rule is conservative: more results are 'not decided'.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri, stdtr

from bayescal.assess.budget import MOST_DOF, Budget
from bayescal.assess.shared_causes import LEVEL as LEVEL_SHARED
from bayescal.assess.shared_causes import SharedCause
from bayescal.dataset import Dataset
from bayescal.dataset.consistency import CHANCE, planned
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.estimate.bounds import CHANCE as RIGID
from bayescal.estimate.bounds import negative, square
from bayescal.estimate.unexplained import Unexplained
from bayescal.predict.forecast import Forecast
from bayescal.predict.validation import DistanceCheck, RowCheck, Validation
from bayescal.statistics import chi2_isf, chi2_sf, poisson_sf, rms

LEVEL = 0.01
"""Chance that a correct model fails any of the tests (that of shared causes has a level of its own)."""
EXPLAINED = "calibrated; model explains validation data"
CONTRADICTED = "model does not explain the machine: run bayescal gap"
DOUBTED = "calibrated; but errors are larger than noise and model predict: run bayescal gap"
UNVERIFIED = "not verified: no validation measurements"
UNDETERMINED = "not determined by these measurements: the prediction rests on priors"
NOT_MADE = "no calibration: contacts of a plan that were not made"
PLANNED = "planned_poses"
"""The test of contacts that have the readings of a plan."""
SHARED = "shared_cause"
"""The test of what rejected measurements share."""
NOT_PHYSICAL = "negative"
"""The test of positive parameters: it fails only."""
CAUSE = "the model lacks an effect, or masses are wrong: run bayescal gap"
"""What a value that is significantly negative comes from, and what to do."""
NAMED = 2
"""Negative values that the sentence names, the most significant first."""
KNOWN = 1.05
"""Factor by which a noise may exceed that stated before a fit that passes all tests says so (assumed)."""
FEWEST_DISTANCES = 3
"""Distances whose mean error is tested."""
FALSE_REJECTIONS = 0.01
"""Validation measurements of normal noise that are left out of the test of all as outliers, on average."""
MORE_OUTLIERS = 1e-3
"""Chance of more such rows, at the share of rows that the fit rejected, below which all of them count."""


@dataclass(frozen=True)
class Check:
    """A test: a figure in units of its prediction, its limit, and the probability of such a value."""

    test: str
    value: float
    limit: float
    p_value: float
    level: float  # the test fails below
    words: str  # what was measured against what was predicted

    @property
    def passed(self) -> bool:
        """Whether the model passes the test."""
        return self.p_value >= self.level


@dataclass(frozen=True)
class Acceptance:
    """All tests of a fit, and what rejected measurements share."""

    checks: tuple[Check, ...]
    causes: tuple[SharedCause, ...]
    validated: bool  # there are validation measurements
    rejected: float = 0.0  # share of the fitted measurements
    determined: bool = True  # the predicted distance error rests on rows, not on priors
    doubts: tuple[Check, ...] = ()  # what no test shows that allows for a poor statement of the noise

    @property
    def failed(self) -> tuple[Check, ...]:
        """The tests that the model fails."""
        return tuple(c for c in self.checks if not c.passed)

    @property
    def verdict(self) -> str:
        """In one line."""
        if self.unmade:
            return NOT_MADE
        if not self.explains:
            return CONTRADICTED
        if not self.determined:
            return UNDETERMINED
        if not self.validated:
            return UNVERIFIED
        return DOUBTED if self.doubts else EXPLAINED

    @property
    def unmade(self) -> str:
        """Which contacts have the readings of a plan, in words; "" if none."""
        return next((c.words for c in self.failed if c.test == PLANNED), "")

    @property
    def explains(self) -> bool:
        """Whether nothing contradicts the model."""
        return not self.failed

    @property
    def usable(self) -> bool:
        """Whether validation measurements agree with a model that the rows determine."""
        return self.explains and self.determined and self.validated and not self.doubts


@dataclass(frozen=True)
class _Figure:
    test: str
    value: float
    p_value: float
    limit: Callable[[float], float]  # of `value`, at a chance of a false alarm
    words: str


def acceptance(
    left: Unexplained,
    checked: Validation,
    causes: Sequence[SharedCause] = (),
    rejected: float = 0.0,
    dataset: Dataset | None = None,
) -> Acceptance:
    """Test a fit.

    Parameters
    ----------
    left : Unexplained
        What the fit leaves.
    checked : Validation
        Of the same fit, predicted without any widening by its own errors.
    causes : sequence of SharedCause
        What rejected measurements share.
    rejected : float
        Share of the fitted measurements that were rejected: as many of the validation data may be outliers.
    dataset : Dataset, optional
        The session, whose contacts are tested for readings of a plan.
    """
    figures = [_noise(left), *_validation(checked, None if causes else rejected)]
    level = LEVEL / len(figures)
    checks = [Check(f.test, f.value, f.limit(level), f.p_value, level, f.words) for f in figures]
    checks += [
        Check(SHARED, len(c.rows) / c.rejected, c.size / c.count, c.p_value, LEVEL_SHARED, c.words)
        for c in causes
    ]
    if dataset is not None and (unmade := planned(dataset)) and unmade.certain:
        words = unmade.words(dataset)
        checks.insert(0, Check(PLANNED, len(unmade.rows), 0.0, unmade.chance, CHANCE, words))
    validated = bool(checked.planes or checked.distances or checked.points or checked.turns)
    doubts = tuple(d for d in _doubts(left, checked, None if causes else rejected) if not d.passed)
    return Acceptance(tuple(checks), tuple(causes), validated, rejected, doubts=doubts)


def _doubts(left: Unexplained, checked: Validation, rejected: float | None) -> Iterator[Check]:
    """Tests beyond those of a correct model: the stated noise at its word, and every target alone.

    Half of the level is that of the noise, half that of all targets.
    """
    if left.repeats is None:
        ratio, limit = left.fitted / left.stated, KNOWN * np.sqrt(chi2_isf(LEVEL / 2, left.dof) / left.dof)
        p = float(chi2_sf(left.dof * (ratio / KNOWN) ** 2, left.dof))
        yield Check("noise", ratio, float(limit), p, LEVEL / 2, left.words)
    empty = replace(checked, planes=(), points=(), turns=())
    alone = [(p, replace(empty, planes=(p,))) for p in checked.planes]
    alone += [(p, replace(empty, points=(p,))) for p in checked.points]
    for part, of_target in alone if len(alone) > 1 else ():
        for test, r, predicted in _sets(of_target, rejected):
            found = _chi_square("target", f"{test} on {part.target}", r, predicted, 1e6, "µm")
            level = LEVEL / 2 / len(alone)
            yield Check(found.test, found.value, found.limit(level), found.p_value, level, found.words)


def not_physical(found: Estimate, covariance: np.ndarray) -> tuple[Check, ...]:
    """The test of positive parameters below zero, by the stated covariance (D, D), where it fails."""
    model, count = found.model, len(found.model.parameters)
    sd = np.sqrt(np.diag(covariance)[:count]) * model.sd
    below = sorted(negative(model.parameters, found.arm, sd), key=lambda n: n.value / n.u)
    if clear := [n for n in below if n.significant]:
        value, limit = -clear[0].value / clear[0].u, clear[0].limit
        p, level = float(ndtr(-value)), float(ndtr(-limit))
        how = f"negative by more than {limit:.2g} u, which is not physical"
    else:
        clear, level = below, RIGID
        of_all = square(found, covariance, [n.parameter for n in below])
        p = float(chi2_sf(of_all, len(below))) if len(below) > 1 else 1.0
        if p >= level:
            return ()
        value, limit = np.sqrt([of_all / len(below), chi2_isf(level, len(below)) / len(below)]).tolist()
        how = "negative together beyond their u, which is not physical"
    what = ", ".join(f"{n.parameter} {n.figures}" for n in clear[:NAMED])
    what += f" and {len(clear) - NAMED} more" if len(clear) > NAMED else ""
    return (Check(NOT_PHYSICAL, value, limit, p, level, f"{how}: {what}; {CAUSE}"),)


def widened(left: Unexplained, checked: Validation, tests: Acceptance) -> Unexplained:
    """What is unexplained, m a coordinate, with what validation measurements show beyond their prediction.

    Of a test that failed, the mean square error beyond the predicted one; half of it for distances, which
    have the error of two points. The largest counts.
    """
    failed = {c.test for c in tests.failed}
    beyond = [0.0]
    for test, r, predicted in _sets(checked, None if tests.causes else tests.rejected):
        if f"validation_{test}" in failed and test != "orientations":
            beyond.append(float(np.mean(r**2) - np.mean(np.var(predicted, axis=0))))
    if failed & {"validation_distances", "mean_distance_error"}:
        error, predicted = _errors(checked.distances)
        beyond.append(0.5 * float(np.mean(error**2) - np.mean(np.var(predicted, axis=0))))
    return replace(left, excess=float(np.sqrt(left.excess**2 + max(beyond))))


def _noise(left: Unexplained) -> _Figure:
    return _Figure("residuals", left.fitted / left.floor, left.p_value, left.limit, left.words)


def _validation(checked: Validation, rejected: float | None) -> Iterator[_Figure]:
    units = {"orientations": (180e3 / np.pi, "mdeg")}
    for test, r, predicted in _sets(checked, rejected):
        factor, unit = units.get(test, (1e6, "µm"))
        yield _chi_square(f"validation_{test}", test, r, predicted, factor, unit)
    if checked.distances:
        error, predicted = _errors(checked.distances)
        yield _chi_square("validation_distances", "distances", error, predicted, 1e6, "µm")
        if len(error) >= FEWEST_DISTANCES:
            sd = float(np.std(np.mean(predicted, axis=1)))
            value = float(np.mean(error)) / sd
            same = max(np.sum(error > 0), np.sum(error < 0))
            signs = "all" if same == len(error) else f"{same} of {len(error)}"
            words = (
                f"mean distance error {1e6 * np.mean(error):+.1f} µm with a predicted standard deviation of "
                f"{1e6 * sd:.1f} µm; {signs} errors have the same sign"
            )
            p = 2.0 * float(ndtr(-abs(value)))
            yield _Figure("mean_distance_error", abs(value), p, lambda a: float(-ndtri(a / 2)), words)


def _chi_square(
    name: str, of: str, r: np.ndarray, predicted: np.ndarray, factor: float, unit: str
) -> _Figure:
    """Mean square error over the predicted one, (C,) against draws (S, C).

    Predictions have the parameters in common: the mean square is a multiple of a chi-square whose effective
    degrees of freedom follow from the variance of the draws' own (Satterthwaite 1946).
    """
    sd = np.std(predicted, axis=0)
    statistic, draws = float(np.mean((r / sd) ** 2)), np.mean((predicted / sd) ** 2, axis=1)
    mean = float(np.mean(draws))
    dof = 2.0 * mean**2 / float(np.var(draws))
    words = (
        f"{of} of validation measurements: RMS error {factor * rms(r):.1f} {unit} against "
        f"{factor * rms(sd):.1f} {unit} predicted"
    )
    p = float(chi2_sf(dof * statistic / mean, dof))
    limit = lambda a: float(np.sqrt(chi2_isf(a, dof) / dof))  # noqa: E731
    return _Figure(name, float(np.sqrt(statistic / mean)), p, limit, words)


def _sets(checked: Validation, rejected: float | None) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Residuals (C,) and their draws (S, C) by kind of validation measurement, without outliers.

    `rejected` is the share of outliers among the fitted measurements; None: no row is an outlier.
    """
    kinds: dict[str, tuple[RowCheck, ...]] = {
        "contacts": checked.planes, "points": checked.points, "orientations": checked.turns
    }  # fmt: skip
    for test, parts in kinds.items():
        if not parts:
            continue
        kept = [(p.residuals.reshape(-1, p.residuals.shape[-1]), p.predicted) for p in parts]
        r = np.concatenate([r for r, _ in kept], axis=1)  # (rows, C)
        predicted = np.concatenate([d.reshape(len(d), *one.shape) for one, d in kept], axis=2)
        tail = chi2_sf(np.sum((r / np.std(predicted, axis=0)) ** 2, axis=0), len(r))
        out = tail < FALSE_REJECTIONS / len(tail)
        if rejected is None or poisson_sf(np.sum(out) - 1, rejected * len(out) + 1.0) < MORE_OUTLIERS:
            out = np.zeros_like(out)
        yield test, r[:, ~out].ravel(), predicted[:, :, ~out].reshape(len(predicted), -1)


def _errors(distances: tuple[DistanceCheck, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Errors (D,) of distances and their joint draws (S, D)."""
    error = np.array([d.error for d in distances])
    return error, np.stack([d.predicted for d in distances], axis=1)


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
        Where the model is not validated, does not explain the machine, or rests on priors, conformance is
        not proven.
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
        (undecided, OPEN, f"{len(undecided)} {of}: error within U of the tolerance"),
        (wide, OPEN, "U of a distance in the probed volume is larger than the tolerance"),
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
