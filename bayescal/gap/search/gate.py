"""The last test: an effect that increases validation errors is not named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from bayescal.gap.outcome.levels import difference, log_predictive
from bayescal.gap.settings import GATE
from bayescal.predict.crossvalidation import LEFT_OUT
from bayescal.predict.errors import ValidationErrors, kept


def worse(before: ValidationErrors, after: ValidationErrors) -> str:
    """How a refit increased the validation errors, as text; "" where it did not."""
    if before.how != LEFT_OUT:
        gain, se = difference(log_predictive(after)[0] - log_predictive(before)[0], log_predictive(before)[1])
        fair = kept(before, after)
        old, new = (float(np.sqrt(np.mean(h.residual[fair] ** 2))) for h in (before, after))
        unlikely = gain < -GATE.loss and (np.isnan(se) or gain < -GATE.errors * se) and new > old
        if unlikely or new > GATE.worse * old:
            return f"validation RMS from {1e6 * old:.1f} to {1e6 * new:.1f} µm"
    if len(before.distances.error):
        old, new = (float(np.sqrt(np.mean(h.distances.error**2))) for h in (before, after))
        expected = float(np.sqrt(np.mean(before.distances.predicted_sd() ** 2)))
        if new > GATE.grown * max(old, expected):
            return f"distance RMS from {1e6 * old:.1f} to {1e6 * new:.1f} µm"
    return ""


M = TypeVar("M")
F = TypeVar("F")


@dataclass(frozen=True)
class Confirmed(Generic[M, F]):
    """Effects that the validation data admit, their refit, and the effects that were withheld, with why."""

    members: tuple[M, ...]
    fitted: F
    errors: ValidationErrors
    withheld: tuple[tuple[M, str], ...]


def confirmed(
    members: Sequence[M],
    refit: Callable[[Sequence[M]], tuple[F, ValidationErrors]],
    before: ValidationErrors,
) -> Confirmed[M, F]:
    """Withhold effects until the validation errors are no larger than without any.

    Each removal is tried: the effect is withheld without which the validation data are restored, or, where no
    single removal restores them, without which they are most probable.

    Parameters
    ----------
    members : sequence
        Named effects.
    refit : callable
        Fits some of them, and returns the fit with its validation errors.
    before : ValidationErrors
        Without any of them.
    """
    members = tuple(members)
    fitted, errors = refit(members)
    withheld: list[tuple[M, str]] = []
    while members and (reason := worse(before, errors)):
        tried = []
        for k, member in enumerate(members):
            rest = members[:k] + members[k + 1 :]
            own, left = refit(rest)
            rank = (not worse(before, left), validation_gain(before, left), k)
            tried.append((rank, member, rest, own, left))
        _, removed, members, fitted, errors = max(tried, key=lambda t: t[0])
        withheld.append((removed, reason))
    return Confirmed(members, fitted, errors, tuple(withheld))


def validation_gain(before: ValidationErrors, after: ValidationErrors) -> float:
    """Gain of log predictive density, nats, of validation contacts, and of distances jointly."""
    contacts = float(np.sum(log_predictive(after)[0] - log_predictive(before)[0]))
    return contacts + _density(after) - _density(before)


def _density(held: ValidationErrors) -> float:
    """Log density, nats, of the distance errors under N(0, C)."""
    d = held.distances
    if not len(d.error):
        return 0.0
    covariance = d.by_parameters @ d.by_parameters.T + d.by_noise @ d.by_noise.T + np.diag(d.u**2)
    values, vectors = np.linalg.eigh(covariance)
    # three distances between centres on one line are dependent: no direction is known better than to 1 nm
    values = np.maximum(values, 1e-18)
    along = vectors.T @ d.error
    return float(-0.5 * np.sum(along**2 / values + np.log(2 * np.pi * values)))
