"""Model levels: validation errors from the nominal model to the named effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.estimate import Estimate
from bayescal.gap.result import Step
from bayescal.gap.settings import OUTCOME
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.errors import ValidationErrors, kept


def model_levels(
    levels: Sequence[tuple[tuple[str, ...], Estimate]],
    held: Sequence[ValidationErrors] | None = None,
    fair: np.ndarray | None = None,
) -> tuple[Step, ...]:
    """Validation errors of model levels, each with the change in log predictive density.

    Parameters
    ----------
    levels : sequence of (effects, Estimate)
        Of one session, the nominal model first.
    held : sequence of ValidationErrors, optional
        Validation errors of each level, if already computed.
    fair : np.ndarray of bool, shape (R,), optional
        Residuals that are used, the same for all levels; default: all but those gross under the last two.
    """
    held = [validation_errors(e) for _, e in levels] if held is None else held
    if fair is None:
        fair = kept(*held[-2:]) if len(held) > 2 else kept(held[-1])
    out: list[Step] = []
    before: np.ndarray | None = None
    for (effects, _), h in zip(levels, held, strict=True):
        density, block = log_predictive(h)
        gain, se = (0.0, 0.0) if before is None else difference(density - before, block)
        before = density
        distances = float(np.sqrt(np.mean(h.distances.error**2))) if len(h.distances.error) else float("nan")
        out.append(
            Step(
                effects,
                _rms(h, fair & (h.group == h.main)),
                distances,
                _rms(h, fair & (h.kind == "points")),
                gain,
                se,
            )
        )
    return tuple(out)


def log_predictive(held: ValidationErrors) -> tuple[np.ndarray, np.ndarray]:
    """Log predictive density of every validation contact, (C,), nats, and its block label (C,).

    Normal with the joint covariance that the model predicts, mixed with a share of gross contacts. No contact
    is rejected here: the density of a gross contact is the same for all models, so that no single slip
    decides between two models, and an overconfident model gains nothing from rows that it does not explain.
    """
    j = held.joint
    normal = -0.5 * (j.chi2 + j.logdet + j.size * np.log(2 * np.pi))
    good = normal + np.log1p(-OUTCOME.gross_share)
    gross = -j.size * np.log(OUTCOME.gross_width) + np.log(OUTCOME.gross_share)
    return np.logaddexp(good, gross), held.block[j.first]


def difference(gain: np.ndarray, block: np.ndarray) -> tuple[float, float]:
    """Sum of gains (C,) and its standard error, by the scatter of the sums over blocks."""
    sums = np.bincount(np.unique(block, return_inverse=True)[1], gain)
    se = float(np.sqrt(len(sums)) * np.std(sums, ddof=1)) if len(sums) > 1 else float("nan")
    return float(np.sum(gain)), se


def _rms(held: ValidationErrors, mine: np.ndarray) -> float:
    return float(np.sqrt(np.mean(held.residual[mine] ** 2))) if np.any(mine) else float("nan")
