"""Tests of the model by residuals, validation and rejected measurements.

Each test compares a figure with its posterior prediction from noise, parameters and certificates, including
their correlations. The tests share a probability of a false alarm (Bonferroni), so that a correct model
fails any of them with a probability of at most `LEVEL`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.assess import WORDS
from bayescal.assess.shared_causes import LEVEL as LEVEL_SHARED
from bayescal.assess.shared_causes import SharedCause
from bayescal.dataset import Dataset
from bayescal.dataset.consistency import CHANCE, planned
from bayescal.errors import listed
from bayescal.estimate import Estimate
from bayescal.estimate.bounds import CHANCE as RIGID
from bayescal.estimate.bounds import negative, square
from bayescal.estimate.discrepancy import Stated
from bayescal.estimate.scatter import LEAST, Scatter
from bayescal.estimate.unexplained import Unexplained
from bayescal.predict.validation import DistanceCheck, Validation
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
ANEW = 3.0
"""Errors of an image, over the noise of a corner, that may be poses which do not repeat (assumed)."""
CAUSE = "the model lacks an effect, or masses are wrong: run bayescal gap"
"""What a value that is significantly negative comes from, and what to do."""
NAMED = 2
"""Negative values that the sentence names, the most significant first."""
KNOWN = 1.05
"""Factor by which a noise may exceed that stated before a fit that passes all tests says so (assumed)."""
FEWEST_DISTANCES = 3
"""Distances whose mean error is tested."""
VARIED = 1e-3
"""Chance that residuals of a correct model vary with any quantity (convention; none of 65 sessions without an
effect, of three authors, is below 0.01)."""
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


Test = Callable[[float], Check]
"""A test at a level, the chance of a false alarm."""


def acceptance(
    unexplained: Unexplained, checked: Validation, causes: Sequence[SharedCause] = (), rejected: float = 0.0,
    dataset: Dataset | None = None,
) -> Acceptance:  # fmt: skip
    """Test a fit.

    Parameters
    ----------
    unexplained : Unexplained
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
    tests = [_noise(unexplained), *_validation(checked, None if causes else rejected)]
    checks = [test(LEVEL / len(tests)) for test in tests]
    checks += [
        Check(SHARED, len(c.rows) / c.rejected, c.size / c.count, c.p_value, LEVEL_SHARED, c.words)
        for c in causes
    ]
    if dataset is not None and (unmade := planned(dataset)) and unmade.certain:
        words = unmade.words(dataset)
        checks.insert(0, Check(PLANNED, len(unmade.rows), 0.0, unmade.chance, CHANCE, words))
    validated = bool(checked.planes or checked.distances or checked.points or checked.turns)
    doubts = tuple(d for d in _doubts(unexplained, checked, None if causes else rejected) if not d.passed)
    return Acceptance(tuple(checks), tuple(causes), validated, rejected, doubts=doubts)


def _doubts(unexplained: Unexplained, checked: Validation, rejected: float | None) -> Iterator[Check]:
    """Tests beyond those of a correct model: the stated noise at its word, and every target alone.

    Half of the level is that of the noise, half that of all targets.
    """
    if unexplained.repeats is None:
        ratio, dof = unexplained.fitted / unexplained.stated, unexplained.dof
        limit = KNOWN * np.sqrt(chi2_isf(LEVEL / 2, dof) / dof)
        p = float(chi2_sf(dof * (ratio / KNOWN) ** 2, dof))
        yield Check("noise", ratio, float(limit), p, LEVEL / 2, unexplained.words)
    empty = replace(checked, planes=(), points=(), turns=())
    alone = [(p, replace(empty, planes=(p,))) for p in checked.planes]
    alone += [(p, replace(empty, points=(p,))) for p in checked.points]
    for part, of_target in alone if len(alone) > 1 else ():
        for test, r, predicted in _sets(of_target, rejected):
            check_at = _chi_square("target", f"{test} on {part.target}", r, predicted, 1e6, "µm")
            yield check_at(LEVEL / 2 / len(alone))


def anew(scatter: Scatter | None, complete: Estimate) -> Check | None:
    """The errors that every image has anew, where they are larger than those that are known of its readings.

    Up to `ANEW` times the noise of the corners the uncertainty allows for them: poses that do not repeat, the
    camera or an effect may be the cause. A model whose images have larger ones does not explain them.
    """
    if scatter is None or not scatter.beyond:
        return None
    share = np.concatenate([np.sum(s.by**2, axis=1) for s in complete.weights.shared.values()])
    ratio = float(np.sqrt(np.mean(share / (1.0 - share))))
    words = f"{scatter.words}: {ratio:.2g} times the noise of the corners"
    if ratio <= ANEW:
        words += "; U allows for it"
    chance, level = np.exp(-np.array([scatter.nats, LEAST])).tolist()
    return Check("images", ratio, ANEW, chance, level, words)


def discrepancy(wide: Stated) -> tuple[Check, ...]:
    """The test of residuals that vary with the pose, time or load as noise does not, where it fails.

    The uncertainty allows for it; the model still lacks an effect.
    """
    if not wide.chance:
        return ()
    family = min(wide.chance, key=lambda name: wide.chance[name])
    p, count = wide.chance[family], len(wide.chance)
    if p >= VARIED / count:
        return ()
    words = f"residuals vary with the {family}, which noise does not (p < {VARIED:g}); U allows for it"
    return (Check("discrepancy", float(-ndtri(p)), float(-ndtri(VARIED / count)), p, VARIED / count, words),)


def not_physical(fitted: Estimate, covariance: np.ndarray) -> tuple[Check, ...]:
    """The test of positive parameters below zero, by the stated covariance (D, D), where it fails."""
    model, count = fitted.model, len(fitted.model.parameters)
    sd = np.sqrt(np.diag(covariance)[:count]) * model.sd
    below = sorted(negative(model.parameters, fitted.arm, sd), key=lambda n: n.value / n.u)
    if clear := [n for n in below if n.significant]:
        value, limit = -clear[0].value / clear[0].u, clear[0].limit
        p, level = float(ndtr(-value)), float(ndtr(-limit))
        how = f"negative by more than {limit:.2g} u, which is not physical"
    else:
        clear, level = below, RIGID
        of_all = square(fitted, covariance, [n.parameter for n in below])
        p = float(chi2_sf(of_all, len(below))) if len(below) > 1 else 1.0
        if p >= level:
            return ()
        value, limit = np.sqrt([of_all / len(below), chi2_isf(level, len(below)) / len(below)]).tolist()
        how = "negative together beyond their u, which is not physical"
    what = listed((f"{n.parameter} {n.figures}" for n in clear), NAMED)
    return (Check(NOT_PHYSICAL, value, limit, p, level, f"{how}: {what}; {CAUSE}"),)


def widened(unexplained: Unexplained, checked: Validation, tests: Acceptance) -> Unexplained:
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
    return replace(unexplained, excess=float(np.sqrt(unexplained.excess**2 + max(beyond))))


def _noise(of: Unexplained) -> Test:
    ratio = of.fitted / of.floor
    return lambda level: Check("residuals", ratio, of.limit(level), of.p_value, level, of.words)


def _validation(checked: Validation, rejected: float | None) -> Iterator[Test]:
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
            sizes = {"error": 1e6 * np.mean(error), "sd": 1e6 * sd}
            words = WORDS["mean_distance_error"].format(signs=signs, **sizes)
            p = 2.0 * float(ndtr(-abs(value)))
            yield lambda a: Check("mean_distance_error", abs(value), float(-ndtri(a / 2)), p, a, words)


def _chi_square(name: str, of: str, r: np.ndarray, predicted: np.ndarray, factor: float, unit: str) -> Test:
    """Mean square error over the predicted one, (C,) against draws (S, C).

    Predictions have the parameters in common: the mean square is a multiple of a chi-square whose effective
    degrees of freedom follow from the variance of the draws' own (Satterthwaite 1946).
    """
    sd = np.std(predicted, axis=0)
    statistic, draws = float(np.mean((r / sd) ** 2)), np.mean((predicted / sd) ** 2, axis=1)
    mean = float(np.mean(draws))
    dof = 2.0 * mean**2 / float(np.var(draws))
    sizes = {"size": factor * rms(r), "predicted": factor * rms(sd)}
    words = WORDS["validation"].format(of=of, unit=unit, **sizes)
    p, value = float(chi2_sf(dof * statistic / mean, dof)), float(np.sqrt(statistic / mean))
    return lambda a: Check(name, value, float(np.sqrt(chi2_isf(a, dof) / dof)), p, a, words)


def _sets(checked: Validation, rejected: float | None) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Residuals (C,) and their draws (S, C) by kind of validation measurement, without outliers.

    `rejected` is the share of outliers among the fitted measurements; None: no row is an outlier. Nor is any
    where most of a kind would be: a majority has no outliers.
    """
    kinds = {"contacts": checked.planes, "points": checked.points, "orientations": checked.turns}
    for test, parts in kinds.items():
        if not parts:
            continue
        kept = [(p.residuals.reshape(-1, p.residuals.shape[-1]), p.predicted) for p in parts]
        r = np.concatenate([r for r, _ in kept], axis=1)  # (rows, C)
        predicted = np.concatenate([d.reshape(len(d), *one.shape) for one, d in kept], axis=2)
        tail = chi2_sf(np.sum((r / np.std(predicted, axis=0)) ** 2, axis=0), len(r))
        out = tail < FALSE_REJECTIONS / len(tail)
        chance = 0.0 if rejected is None else poisson_sf(np.sum(out) - 1, rejected * len(out) + 1.0)
        if chance < MORE_OUTLIERS or np.mean(out) > 0.5:
            out = np.zeros_like(out)
        yield test, r[:, ~out].ravel(), predicted[:, :, ~out].reshape(len(predicted), -1)


def _errors(distances: tuple[DistanceCheck, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Errors (D,) of distances and their joint draws (S, D)."""
    error = np.array([d.error for d in distances])
    return error, np.stack([d.predicted for d in distances], axis=1)
