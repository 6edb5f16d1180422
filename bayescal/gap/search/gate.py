"""The last test of names: whether validation data become less probable by them, or contradict the refit."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bayescal.distributions import chi2_sf, f_sf
from bayescal.gap.outcome.levels import log_predictive
from bayescal.gap.settings import GATE
from bayescal.predict.crossvalidation import LEFT_OUT
from bayescal.predict.distances import CentreDistances
from bayescal.predict.errors import ValidationErrors

M = TypeVar("M")
F = TypeVar("F")


@dataclass(frozen=True)
class Confirmed(Generic[M, F]):
    """Effects that the validation data admit, and their refit."""

    members: tuple[M, ...]
    fitted: F
    errors: ValidationErrors
    withheld: tuple[tuple[M, float], ...]  # with the nats that each costs
    unclaimed: tuple[tuple[M, float], ...] = ()  # members that are certain but cost so many nats


def confirmed(
    members: Sequence[M],
    refit: Callable[[Sequence[M]], tuple[F, ValidationErrors]],
    before: ValidationErrors,
    certain: Callable[[M], bool] = lambda member: False,
) -> Confirmed[M, F]:
    """Withhold effects until none makes the validation data less probable.

    Each effect is removed alone, and the one that costs most is withheld, if it costs more than `GATE.loss`.
    Where only all of them together cost as much, it is the one whose removal helps most. A certain effect
    stays a member, because the calibration data prove it: it only does not extrapolate to the validation
    data. The other effects are then tested without it.

    Parameters
    ----------
    members : sequence
        Named effects.
    refit : callable
        Fits some of them, and returns the fit with its validation errors.
    before : ValidationErrors
        Without any of them.
    certain : callable
        Whether an effect is certain by the calibration data.
    """
    tested: tuple[M, ...] = tuple(members)
    aside: list[tuple[M, float]] = []
    _, errors = refit(tested)
    while tested:
        rest = [tested[:k] + tested[k + 1 :] for k in range(len(tested))]
        without = [refit(own)[1] for own in rest]
        costs = [-gain(before, other, errors) for other in without]
        all_of_them = -gain(before, before, errors)
        if max(*costs, all_of_them) <= GATE.loss:
            break
        k = int(np.argmax(costs))
        aside.append((tested[k], max(costs[k], all_of_them)))
        tested, errors = rest[k], without[k]
    withheld = tuple((m, cost) for m, cost in aside if not certain(m))
    unclaimed = tuple((m, cost) for m, cost in aside if certain(m))
    kept = tuple(m for m in members if all(m is not other for other, _ in withheld))
    fitted, errors = refit(kept)
    return Confirmed(kept, fitted, errors, withheld, unclaimed)


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
    if before.how != LEFT_OUT:
        odd = less.gross | more.gross
        old, new = (_contacts(way, ~odd) for way in steps)
        alone = np.isin(less.joint.rows, less.rows[odd])
        total += new - old + float(np.sum((log_predictive(more)[0] - log_predictive(less)[0])[alone]))
    return total


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
    if before.how != LEFT_OUT and np.any(fair):
        chi2, _ = _low_rank((before, after), fair)
        count, dof = int(np.sum(fair)), after.dof.get(after.main, np.inf)
        p.append(float(chi2_sf(chi2, count) if np.isinf(dof) else f_sf(chi2 / count, count, dof)))
    return min(1.0, len(p) * min(p)) if p else 1.0


def _contacts(way: Sequence[ValidationErrors], mine: np.ndarray) -> float:
    """Log density of some residuals of the last of a series of refits."""
    chi2, logdet = _low_rank(way, mine)
    return -0.5 * (chi2 + logdet + float(np.sum(mine)) * float(np.log(2 * np.pi)))


def _low_rank(way: Sequence[ValidationErrors], mine: np.ndarray) -> tuple[float, float]:
    """Chi-square of some residuals, and the log determinant of their covariance (diagonal and low rank)."""
    held = way[-1]
    own = held.noise[mine] ** 2 + sum(c**2 for c in _changes([h.residual[mine] for h in way]))
    by, r = held.by_parameters[mine] / np.sqrt(own)[:, None], held.residual[mine] / np.sqrt(own)
    factor = cho_factor(np.eye(by.shape[1]) + by.T @ by, lower=True)
    along = by.T @ r
    chi2 = float(r @ r - along @ cho_solve(factor, along))
    return chi2, float(np.sum(np.log(own)) + 2.0 * np.sum(np.log(np.diag(factor[0]))))


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
    out = d.by_parameters @ d.by_parameters.T + d.by_noise @ d.by_noise.T + np.diag(d.u**2)
    for change in _changes([other.error for other in way]):
        out = out + np.diag(change**2) + np.outer(change, change)
    # three distances between centres on one line are dependent
    return out + GATE.rounding**2 * np.eye(len(out))


def _changes(errors: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Standard uncertainty of the form of each change in a series of refits."""
    return [GATE.form * (b - a) for a, b in itertools.pairwise(errors)]


def _square(covariance: np.ndarray, r: np.ndarray) -> float:
    return float(r @ np.linalg.solve(covariance, r))
