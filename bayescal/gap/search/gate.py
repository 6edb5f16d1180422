"""The last tests of names, by validation data: their density, the predicted change, contradiction."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.estimate.solver import factored, solved
from bayescal.gap.outcome.magnitude import log_predictive
from bayescal.gap.settings import GATE
from bayescal.predict.crossvalidation import BLOCKED, BY_REGION, IMAGES_LEFT_OUT, LEFT_OUT, VALIDATED
from bayescal.predict.errors import CentreDistances, ValidationErrors
from bayescal.statistics import chi2_sf, f_sf

Tests = tuple[ValidationErrors, ...]
"""Validation errors of one fit: of the validation data, or with blocks, and with regions, left out."""
Refit = Callable[[Sequence[Any]], tuple[Any, Tests]]
"""Fits some effects, and returns the fit with its validation errors."""
LEFT = {
    **dict.fromkeys((VALIDATED, LEFT_OUT), ("the validation data", "validation contacts")),
    IMAGES_LEFT_OUT: ("images that are left out", "corners of images that are left out"),
    BLOCKED: ("blocks of poses and time that are left out", "contacts of blocks that are left out"),
    BY_REGION: ("regions of the joints that are left out", "contacts in joint regions that are left out"),
}
"""What was not fitted, as a whole and its contacts."""


@dataclass(frozen=True)
class Share:
    """Share of the change predicted by a name that the validation contacts show: 1 if true, 0 if spurious."""

    value: float
    u: float  # standard uncertainty, from the scatter over poses and stretches of time

    @property
    def missing(self) -> bool:
        """Whether less than half of the change is there, and all of it would contradict the data."""
        return self.value < GATE.half and 1.0 - self.value > GATE.sure * self.u


UNTESTED = Share(1.0, np.inf)
"""Of a change that the validation contacts do not show."""


@dataclass(frozen=True)
class Aside:
    """An effect that fails a test by validation data."""

    member: Any
    cost: float  # nats that the validation data lose by it
    share: Share
    how: str = VALIDATED  # as of `ValidationErrors`
    refused: str = ""  # why it cannot be fitted

    @property
    def words(self) -> str:
        """The failed test."""
        if self.refused:
            return f"explains the calibration rows but cannot be fitted ({self.refused})"
        text, (data, contacts) = "explains the calibration rows but ", LEFT[self.how]
        if self.cost > GATE.loss or not self.share.missing:
            return f"{text}makes {data} less probable, by {self.cost:.1f} nats"
        shown = f"{self.share.value:.2f} ± {self.share.u:.2f}"
        return f"{text}{contacts} show {shown} of the change that it predicts"


@dataclass(frozen=True)
class Confirmed:
    """Effects that the validation data admit, and their refit."""

    members: tuple[Any, ...]
    fitted: Any
    errors: ValidationErrors
    withheld: tuple[Aside, ...]
    unclaimed: tuple[Aside, ...] = ()  # of members that are certain
    replaced: tuple[tuple[Aside, Any], ...] = ()  # what fails, and a member that is the same effect otherwise


def confirmed(
    members: Sequence[Any],
    refit: Refit,
    before: Tests,
    certain: Callable[[Any], bool] = lambda member: False,
    instead: Callable[[Sequence[Any], Any], Sequence[Any]] = lambda members, member: (),
) -> Confirmed:
    """Withhold effects until each of the others passes both tests by validation data.

    Each effect is removed alone. It fails if it costs more than `GATE.loss`, or if the change that it
    predicts is `missing`; the one that costs most is withheld first. Where only all of them together cost as
    much, it is the one whose removal helps most. A certain effect stays a member, because the calibration
    data prove it: it only does not extrapolate to the validation data. The others are then tested without it.
    An effect without which the others cannot be fitted passes. Where all of them cannot be fitted, the last
    is withheld. An effect that fails is first replaced by the form, if any, by which validation data gain.

    Parameters
    ----------
    members : sequence
        Named effects.
    refit : callable
        Fits some of them, and returns the fit with its validation errors; raises `BayescalError` where they
        cannot be fitted.
    before : tuple of ValidationErrors
        Without any of them.
    certain : callable
        Whether an effect is certain by the calibration data.
    instead : callable
        Other forms of one of some effects that the calibration data do not exclude.
    """
    tested: tuple[Any, ...] = tuple(members)
    aside: list[Aside] = []
    replaced: list[tuple[Aside, Any]] = []
    while tested:
        errors = _errors(refit, tested)
        if isinstance(errors, BayescalError):
            aside.append(Aside(tested[-1], np.inf, UNTESTED, refused=errors.what))
            tested = tested[:-1]
            continue
        subsets = [tested[:k] + tested[k + 1 :] for k in range(len(tested))]
        alone = [
            _alone(m, before, _errors(refit, subset), errors)
            for m, subset in zip(tested, subsets, strict=True)
        ]
        all_of_them = -gain(before[0], before[0], errors[0])
        failing = [k for k, a in enumerate(alone) if a.cost > GATE.loss or a.share.missing]
        if not failing and all_of_them <= GATE.loss:
            break
        k = max(failing or range(len(alone)), key=lambda k: alone[k].cost)
        first = failing and all(tested[k] is not new for _, new in replaced)
        new = _otherwise(tested, k, before, refit, instead) if first else None
        if new is not None:
            replaced.append((alone[k], new))
            members, tested = (tuple(new if m is tested[k] else m for m in of) for of in (members, tested))
            continue
        aside.append(alone[k] if failing else replace(alone[k], cost=all_of_them))
        tested = subsets[k]
    withheld = tuple(a for a in aside if a.refused or not certain(a.member))
    unclaimed = tuple(a for a in aside if not a.refused and certain(a.member))
    kept = tuple(m for m in members if all(m is not a.member for a in withheld))
    while kept and isinstance(errors := _errors(refit, kept), BayescalError):  # with certain ones, untested
        withheld = (*withheld, Aside(kept[-1], np.inf, UNTESTED, refused=errors.what))
        unclaimed = tuple(a for a in unclaimed if a.member is not kept[-1])
        kept = kept[:-1]
    fitted, errors = refit(kept)
    used = tuple((a, new) for a, new in replaced if any(new is m for m in kept))
    return Confirmed(kept, fitted, errors[0], withheld, unclaimed, used)


def _otherwise(
    tested: tuple[Any, ...], k: int, before: Tests, refit: Refit, instead: Callable[..., Sequence[Any]]
) -> Any | None:
    """The form of the k-th effect by which validation data gain most beside the others, if by any.

    The best of n forms must gain more than log n: by chance alone one of them gains as much.
    """
    less, forms = _errors(refit, tested[:k] + tested[k + 1 :]), instead(tested, tested[k])
    best = Aside(None, -float(np.log(max(len(forms), 1))), UNTESTED)
    for member in forms:
        more = _errors(refit, (*tested[:k], member, *tested[k + 1 :]))
        if not isinstance(more, BayescalError):
            one = _alone(member, before, less, more)
            best = best if one.share.missing else min(best, one, key=lambda a: a.cost)
    return best.member


def _errors(refit: Refit, members: Sequence[Any]) -> Tests | BayescalError:
    """Validation errors of a refit, or why these effects cannot be fitted."""
    try:
        return refit(members)[1]
    except BayescalError as error:
        return error


def _alone(member: Any, before: Tests, less: Tests | BayescalError, more: Tests) -> Aside:
    """What an effect costs, and the share of its predicted change in the test that it fails."""
    if isinstance(less, BayescalError):  # the others are fitted with it only
        return Aside(member, -np.inf, UNTESTED, more[0].how)
    cost = -gain(before[0], less[0], more[0])
    tests = [(share(a, b), b.how) for a, b in zip(less, more, strict=True)]
    failed = (test for test in tests if test[0].missing and cost <= GATE.loss)  # a cost is of the first
    return Aside(member, cost, *next(failed, tests[0]))


def gain(before: ValidationErrors, less: ValidationErrors, more: ValidationErrors) -> float:
    """Log density, nats, of validation contacts and distances that a refit gains by further effects.

    Contacts and distances are each jointly normal with the covariance that a refit predicts. A refit states
    a change with a standard uncertainty of a share `GATE.form` only, because the form of an effect is not
    known better: for distances, this error may also be common to all. A contact that is gross under either
    refit counts by itself, in a mixture with gross contacts.

    Parameters
    ----------
    before : ValidationErrors
        Of the baseline.
    less, more : ValidationErrors
        Of the refits with some effects, and with the same and further ones.
    """
    steps = (before, less), (before, less, more)
    old, new = (_distances([h.distances for h in way]) for way in steps)
    total = new - old
    if before.how != LEFT_OUT:  # contacts that are left out one by one share errors with their neighbours
        odd = less.gross | more.gross
        old, new = (_contacts(way, ~odd) for way in steps)
        alone = np.isin(less.joint.rows, less.rows[odd])
        total += new - old + float(np.sum((log_predictive(more)[0] - log_predictive(less)[0])[alone]))
    return total


def share(less: ValidationErrors, more: ValidationErrors) -> Share:
    """Regression of the residuals without a name on the change that the name predicts.

    A true effect removes what it predicts. A name that fits other errors of the calibration rows predicts
    changes that have nothing to do with the residuals of the validation data. Unlike log densities, this
    does not depend on the size of the noise: other unmodelled errors only widen its uncertainty, which is
    that of clustered rows (sandwich estimator).

    Parameters
    ----------
    less, more : ValidationErrors
        Of the refits without a name and with it.
    """
    use = ~(less.gross | more.gross)
    noise = less.noise[use]
    r = less.residual[use] / noise
    change = r - more.residual[use] / noise
    if less.fold is not None:
        r, change = _whitened(less, use, np.stack([r, change]))
    size = float(change @ change)
    _, block = np.unique(less.block[use], return_inverse=True)
    count = len(np.unique(block))
    if less.how == LEFT_OUT or count < GATE.blocks or size < GATE.visible:
        return UNTESTED
    value = float(change @ r) / size
    scores = np.bincount(block, change * (r - value * change))
    return Share(value, float(np.sqrt(scores @ scores * count / (count - 1))) / size)


def contradiction(before: ValidationErrors, after: ValidationErrors) -> float:
    """Probability of validation errors as large as those of a refit, by its own prediction.

    The smaller of that of distances and that of contacts (chi-square with the full covariance; F for the
    uncertainty of the noise), times their number. Contacts that are gross before or after are left out.
    """
    p = []
    if len(after.distances.error):
        covariance = _covariance([before.distances, after.distances])
        p.append(float(chi2_sf(_square(covariance, after.distances.error), len(after.distances.error))))
    fair = ~(before.gross | after.gross)
    if before.how == VALIDATED and np.any(fair):
        chi2, _ = _low_rank((before, after), fair)
        count, dof = int(np.sum(fair)), after.dof.get(after.main, np.inf)
        p.append(float(chi2_sf(chi2, count) if np.isinf(dof) else f_sf(chi2 / count, count, dof)))
    return min(1.0, len(p) * min(p)) if p else 1.0


def _contacts(way: Sequence[ValidationErrors], mine: np.ndarray) -> float:
    """Log density of some residuals of the last of a series of refits."""
    total = 0.0
    for fold in _folds(way[-1]):
        chi2, logdet = _low_rank(way, mine & fold)
        total -= 0.5 * (chi2 + logdet + float(np.sum(mine & fold)) * float(np.log(2 * np.pi)))
    return total


def _folds(h: ValidationErrors) -> list[np.ndarray]:
    """Residuals (R,) that one fit predicts, for every fit."""
    return [np.ones(len(h.rows), bool)] if h.fold is None else [h.fold == k for k in np.unique(h.fold)]


def _whitened(h: ValidationErrors, use: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (K, R of `use`) in units of the noise, whitened by the covariance that the fits predict.

    A fit without a block may hardly determine some directions, in which residuals of the block are large.
    """
    out = values.copy()
    for fold in _folds(h):
        mine = fold[use]
        by = h.by_parameters[use][mine] / h.noise[use][mine, None]
        # (1 + B B')^-1/2 by the eigenvalues of B'B: a region may have thousands of rows
        eigenvalues, vectors = np.linalg.eigh(by.T @ by)
        eigenvalues, along = np.maximum(eigenvalues, 0.0), values[:, mine] @ by @ vectors
        shrunk = -1.0 / (np.sqrt(1.0 + eigenvalues) * (1.0 + np.sqrt(1.0 + eigenvalues)))
        out[:, mine] += (along * shrunk) @ vectors.T @ by.T
    return out


def _low_rank(way: Sequence[ValidationErrors], mine: np.ndarray) -> tuple[float, float]:
    """Chi-square of some residuals, and the log determinant of their covariance (diagonal and low rank)."""
    held = way[-1]
    variance = held.noise[mine] ** 2 + sum(c**2 for c in _changes([h.residual[mine] for h in way]))
    by, r = held.by_parameters[mine] / np.sqrt(variance)[:, None], held.residual[mine] / np.sqrt(variance)
    factor = factored(np.eye(by.shape[1]) + by.T @ by)
    along = by.T @ r
    chi2 = float(r @ r - along @ solved(factor, along))
    return chi2, float(np.sum(np.log(variance)) + 2.0 * np.sum(np.log(np.diag(factor))))


def _distances(way: Sequence[CentreDistances]) -> float:
    """Log density of the distances of the last of a series of refits."""
    error = way[-1].error
    if not len(error):
        return 0.0
    covariance = _covariance(way)
    return -0.5 * (_square(covariance, error) + float(np.linalg.slogdet(2 * np.pi * covariance)[1]))


def _covariance(way: Sequence[CentreDistances]) -> np.ndarray:
    """Covariance (D, D), m2, of the distances of the last of a series of refits."""
    d = way[-1]
    by = np.hstack([d.by_parameters, d.by_noise, d.by_certificates])
    out = by @ by.T
    for change in _changes([other.error for other in way]):
        out = out + np.diag(change**2) + np.outer(change, change)
    # three distances between centres on one line are dependent
    return out + GATE.rounding**2 * np.eye(len(out))


def _changes(errors: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Standard uncertainty of the form of each change in a series of refits."""
    return [GATE.form * (b - a) for a, b in itertools.pairwise(errors)]


def _square(covariance: np.ndarray, r: np.ndarray) -> float:
    return float(r @ np.linalg.solve(covariance, r))
