"""Reasons not to hand out a fitted arm: it did not converge, rests on its priors, or is not physical."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayescal.effects import UNITS, Parameter
from bayescal.effects.tool import TOOL
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.model import ARM

if TYPE_CHECKING:
    from bayescal.calibration import Fit
    from bayescal.gap.result import Gap

REDUCED = 0.5
"""Uncertainty of distances between TCPs, as a share of that of the prior, above which the fit is taken
for not identified (assumed)."""
PAIRS = 400
"""Pairs of poses whose distances are looked at."""


def of_fit(fit: Fit) -> tuple[str, ...]:
    """Reasons against a calibration."""
    sampler = () if fit.draws.converged else (f"the sampler did not converge: {fit.draws.complaint}",)
    reasons = of_estimate(fit.final.estimate, fit.stated.limited)
    if not reasons and not fit.acceptance.determined:
        share = 100 * fit.forecast.prior_share
        reasons = (
            f"{share:.0f} % of the variance of a predicted distance is that of priors, not of measurements",
        )
    return (*sampler, *reasons)


def of_gap(gap: Gap) -> tuple[str, ...]:
    """Reasons against the refit of a diagnosis."""
    assert gap.arm is not None
    assert gap.covariance is not None
    levels = gap.levels[-len(gap.verdict.named) :] if gap.verdict.named else ()
    gains = [
        (n.model, step.delta_elpd) for n, step in zip(gap.verdict.named, levels, strict=False) if n.confirmed
    ]
    return (*of_estimate(gap.arm, gap.covariance), *not_gained(gains))


def not_gained(gains: Sequence[tuple[str, float]]) -> tuple[str, ...]:
    """Names whose gain of log predictive density of the validation measurements, nats, is not positive."""
    return tuple(
        f"{name} does not make the validation data more probable ({nats:+.1f} nats)"
        for name, nats in gains
        if not nats > 0
    )


def of_estimate(found: Estimate, covariance: np.ndarray) -> tuple[str, ...]:
    """Reasons against an estimate, by its stated covariance: its size is not known, or priors decide."""
    if not found.model.knows_length:
        return ("no certified length was fitted: the size of the arm rests on its tolerances",)
    share = _left_of_prior(found, covariance)
    if share > REDUCED:
        what = "the fit is not identified: distances between TCP positions keep"
        return (f"{what} {100 * share:.0f} % of the uncertainty of the priors",)
    return ()


def _left_of_prior(found: Estimate, covariance: np.ndarray) -> float:
    """Uncertainty of distances between TCP positions of the fitted data, over that of the arm's prior."""
    model = found.model
    arm = model.slices[ARM]
    rows = np.concatenate([b.rows for b in model.states])
    if not len(model.parameters) or len(rows) < 2:
        return 0.0
    one, other = np.random.default_rng(0).integers(0, len(rows), (2, PAIRS))
    motion = model.motion(rows)
    p = motion.points(found.arm)
    apart = p[:, one] - p[:, other]
    length = np.linalg.norm(apart, axis=0)
    used = length > 0
    by = np.zeros((len(model.parameters), int(np.sum(used))))
    for axis, u in enumerate(np.eye(3)):
        columns = motion.columns(found.arm, p, np.repeat(u[:, None], len(rows), axis=1))
        by += (columns[:, one[used]] - columns[:, other[used]]) * (apart[axis] / np.maximum(length, 1e-9))[
            used
        ]
    by = by * model.sd[:, None]
    left = np.einsum("pk,pq,qk->k", by, covariance[arm, arm], by, optimize=True)
    # rows of a single position have no distance: nothing is known of any
    return float(np.sqrt(np.sum(left) / np.sum(by**2))) if np.any(by) else 1.0


def negative(parameters: Sequence[Parameter], values: np.ndarray, covariance: np.ndarray) -> Iterator[str]:
    """Physically positive parameters with a negative value."""
    for p, value, variance in zip(parameters, values, np.diag(covariance), strict=True):
        if p.positive and p.effect != TOOL.name and p.nominal + value < 0:
            unit, factor = UNITS[p.unit]
            u = factor * float(np.sqrt(variance))
            at = f"{factor * (p.nominal + value):.3g} {unit.replace('urad', 'µrad')} (u {u:.2g})"
            yield f"{p.name} is negative, which is not physical: {at}"


def check(doubts: Sequence[str], force: bool, done: str = "exported") -> None:
    """Refuse an export with reasons against it; `done` is what is refused, as text.

    Raises
    ------
    BayescalError
        With all reasons, unless `force`.
    """
    if doubts and not force:
        remedy = "--force ignores this; --without EFFECT (or 'compliance at joint 3') fits the session again"
        raise BayescalError("; ".join(doubts), f"not {done}", remedy)
