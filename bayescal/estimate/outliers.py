"""One rule for outliers: which measurements no noise explains.

A measurement of k rows (one contact, the three coordinates of a point) is judged as a whole, by the
chi-square of its k residuals under their predicted covariance. A residual of the fit varies less than the
noise, by the leverage H of its rows: sigma^2 (I - H). One that was left out varies more: sigma^2 (I + H).

The scale of the noise comes first from the median of all chi-squares, which outliers hardly move, then from
the measurements that are kept. Either is itself uncertain by its degrees of freedom, so a chi-square is
compared with the F distribution. The stated noise counts as `STATED_WORTH` of these, as in the estimate. A
session of clean normal noise loses `FALSE_REJECTIONS` measurements on average, however few contacts it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, fdtrc

from bayescal.estimate.solver import STATED_WORTH, Evaluations, Weights, by_group, linearise, solve
from bayescal.model.model import Model
from bayescal.statistics import f_isf, f_noncentrality

TAIL = 4.0
"""Degrees of freedom of the Student t that weighs measurements while outliers are sought."""
ROUNDS = 25
"""At most so many reweightings."""
HARD_ROUNDS = 10
"""At most so many fits with measurements left out."""
SAME_SCALE = 0.1
"""Relative difference of two noise scales at which a fit with the one serves for the other (convention)."""
CONTRADICTED = 0.01
"""Probability of a noise scale, by the stated noise, below which this does not count (convention)."""
FALSE_REJECTIONS = 0.01
"""Measurements of clean normal noise that a session loses as outliers on average."""
POWER = 0.8
"""Probability with which a gross error that is called detectable is rejected (Baarda 1968)."""
MEDIAN_WORTH = 0.37
"""Degrees of freedom that a residual is worth to a scale from the median: its efficiency, normal noise."""
LEAST_SPARE = 1e-3
"""Share of a residual's variance that the fit leaves, below which it is taken for this share: rounding."""


def freed(residual: np.ndarray, leverage: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Chi-squares (C,) of measurements under the covariance that a fit predicts of their residuals.

    Parameters
    ----------
    residual : np.ndarray, shape (C, k)
        Over the standard uncertainty of the noise.
    leverage : np.ndarray, shape (C, k, k)
        X Cov X' of each measurement's rows at full weight.
    weight : np.ndarray, shape (C,)
        Weight that each had in the fit: 0 where it was left out.

    Notes
    -----
    The error of a prediction from all other measurements is (I - w H)^-1 r, of covariance I + H (I - w H)^-1;
    their quadratic form is r' [(I - w H) (I + (1 - w) H)]^-1 r. Where the fit leaves nearly nothing of a
    residual, its eigenvalues have a limit.
    """
    if residual.shape[1] > 2:  # a solution takes a fifth of the time of the eigenvalues
        spared = weight * np.trace(leverage, axis1=1, axis2=2) < 1.0 - LEAST_SPARE
        out, one = np.empty(len(residual)), np.eye(residual.shape[1])
        r, h, w = residual[spared], leverage[spared], weight[spared, None, None]
        covariance = (one - w * h) @ (one + (1.0 - w) * h)
        out[spared] = np.einsum("ci,ci->c", r, np.linalg.solve(covariance, r[..., None])[..., 0])
        out[~spared] = _limited(residual[~spared], leverage[~spared], weight[~spared])
        return out
    return _limited(residual, leverage, weight)


def _limited(residual: np.ndarray, leverage: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The chi-squares of `freed` by eigenvalues, each with at least `LEAST_SPARE` of its variance left."""
    if residual.shape[1] == 1:
        share, square = leverage[:, 0], residual**2
    elif residual.shape[1] == 2:  # in closed form: of many, `eigh` takes far longer
        (x, y), ((a, b), (_, c)) = residual.T, np.moveaxis(leverage, 0, -1)
        size, whole = np.hypot((a - c) / 2, b), (x * x + y * y) / 2
        apart = ((a - c) * (x * x - y * y) / 4 + b * x * y) / np.maximum(size, np.finfo(float).tiny)
        ends = ((a + c) / 2, size), (whole, apart)
        share, square = (np.stack([middle - half, middle + half], axis=1) for middle, half in ends)
    else:
        share, turn = np.linalg.eigh(leverage)
        square = np.einsum("cij,ci->cj", turn, residual) ** 2
    w, share = weight[:, None], np.clip(share, 0.0, None)
    return np.sum(square / (np.maximum(1.0 - w * share, LEAST_SPARE) * (1.0 + (1.0 - w) * share)), axis=1)


def scale(chi2: np.ndarray, rows: np.ndarray | int, taken: float = 0.0, share: float = 0.5) -> float:
    """Robust scale of the noise, by the median (or another quantile) of the chi-squares of measurements.

    Parameters
    ----------
    chi2 : np.ndarray, shape (C,)
        Of each measurement, at noise scale 1.
    rows : np.ndarray, shape (C,), or int
        Of each measurement.
    taken : float
        Degrees of freedom that the fit took up, where the chi-squares are not `freed` of their leverage.
    share : float
        Of the measurements that the quantile does not exceed.
    """
    rows = np.broadcast_to(np.asarray(rows, float), chi2.shape)
    expected = chdtri(rows[:1], 1.0 - share)
    if np.any(rows != rows[:1]):  # else one value for all: sorting takes longer than all the rest
        sizes, which = np.unique(rows, return_inverse=True)
        expected = chdtri(sizes, 1.0 - share)[which]
    usual = np.quantile(chi2 / expected, share)
    total = float(np.sum(rows))
    spare = max(total - taken, 0.25 * total)
    return max(float(np.sqrt(usual * total / spare)), 1e-3)


def student_weights(chi2: np.ndarray, rows: np.ndarray | int, scale: float) -> np.ndarray:
    """Weights (C,) of measurements with chi-squares (C,) of so many rows each, were noise Student t."""
    return (TAIL + rows) / (TAIL + chi2 / scale**2)


def limit(rows: np.ndarray) -> np.ndarray:
    """Chi-square (C,) beyond which measurements of so many rows are outliers where the noise is known."""
    return chdtri(np.asarray(rows, float), FALSE_REJECTIONS / max(len(rows), 1))


def rejected(
    chi2: np.ndarray,
    rows: np.ndarray | int,
    scale: np.ndarray | float = 1.0,
    dof: float = np.inf,
    included: np.ndarray | bool = False,
    worth: float = 0.0,
) -> np.ndarray:
    """Which measurements (C,) are outliers: those that noise exceeds `FALSE_REJECTIONS` times a session.

    Parameters
    ----------
    chi2 : np.ndarray, shape (C,)
        Of each measurement, at noise scale 1.
    rows : np.ndarray, shape (C,), or int
        Of each measurement.
    scale : float, or np.ndarray, shape (C,)
        Of the noise.
    dof : float
        Degrees of freedom that the scale stands on; infinite where it is known.
    included : np.ndarray of bool, shape (C,), or bool
        Whether the scale was estimated with the measurement itself, which is then taken out of it.
    worth : float
        Degrees of freedom that the stated noise (scale 1) has in addition, unless the scale contradicts it.
    """
    rows = np.broadcast_to(np.asarray(rows, float), chi2.shape)
    size, level = chi2 / scale**2, FALSE_REJECTIONS / max(len(chi2), 1)
    if np.isinf(dof):
        return size > limit(rows)
    if worth:
        worth = worth if np.all(fdtrc(dof, worth, np.square(scale)) > CONTRADICTED) else 0.0
    dof_others = np.maximum(dof - rows * included, 1e-3) + worth
    # what a row takes up is shared by prior and other groups: without it less than nothing may seem left
    chi2_others = np.maximum(dof - size * included, 1e-12) + worth / scale**2
    return fdtrc(rows, dof_others, size / rows * dof_others / chi2_others) < level


def detectable(rows: int, dof: float, count: int) -> float:
    """Noncentrality with which a measurement is rejected with probability `POWER`.

    Parameters
    ----------
    rows : int
        Of the measurement.
    dof : float
        Degrees of freedom of the residuals of its noise group, its own among them.
    count : int
        Measurements of the noise group.
    """
    dof_others = max(dof - rows, 1e-3) + STATED_WORTH
    return float(f_noncentrality(POWER, rows, dof_others, f_isf(FALSE_REJECTIONS / count, rows, dof_others)))


@dataclass(frozen=True)
class Judged:
    """Measurements of one noise, and what a fit left of them."""

    chi2: np.ndarray  # (C,) freed of leverage, at noise scale 1
    square: np.ndarray  # (C,) sum of the squared residuals as they are, at noise scale 1
    taken: np.ndarray  # (C,) trace of the leverage
    rows: np.ndarray  # (C,)
    weight: np.ndarray  # (C,) that each had in the fit

    @classmethod
    def of(cls, parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Judged:
        """Judge parts of C measurements of k rows, one after another.

        Each part has residuals (C, k) over the standard uncertainty of the noise, their leverage (C, k, k) at
        full weight, and the weights (C,) that they had in the fit.
        """
        each = []
        for r, leverage, weight in parts:
            square, taken = np.sum(r**2, axis=1), np.trace(leverage, axis1=1, axis2=2)
            each.append((freed(r, leverage, weight), square, taken, np.full(len(r), r.shape[1]), weight))
        return cls(*map(np.concatenate, zip(*each, strict=True)))

    @property
    def dof(self) -> float:
        """Degrees of freedom that the fit leaves to the noise."""
        return max(float(np.sum(self.weight * (self.rows - self.taken))), 1e-3)

    @property
    def robust(self) -> float:
        """Scale of the noise by the median, and at least what the stated noise leaves of it.

        With hardly more rows than unknowns the median of what is left says nothing of the noise: it may be
        zero, and a fit would run through a few contacts. The stated noise is worth `STATED_WORTH` contacts:
        residuals of zero would leave the scale that is the limit.
        """
        least = np.sqrt(STATED_WORTH / (STATED_WORTH + self.dof))
        return max(scale(self.chi2, self.rows), float(least))

    @property
    def hard(self) -> bool:
        """Whether the fit kept some measurements and left out the others."""
        return bool(np.all((self.weight == 1.0) | (self.weight == 0.0)))

    @property
    def scale(self) -> float:
        """Scale of the noise: of those that were kept, with the stated noise; robust after other fits."""
        if not self.hard:
            return self.robust
        kept = float(np.sum(self.square[self.weight == 1.0]))
        return float(np.sqrt((STATED_WORTH + kept) / (STATED_WORTH + self.dof)))

    def rescales(self, scale: float) -> bool:
        """Whether the measurements that were kept have another noise than the scale of their fit."""
        return self.hard and abs(float(np.log(self.scale / scale))) > SAME_SCALE

    def student_weights(self) -> np.ndarray:
        """Weights (C,) for another fit, were noise Student t."""
        return student_weights(self.chi2, self.rows, self.robust)

    def outliers(self) -> np.ndarray:
        """Which measurements (C,) are rejected.

        After a fit with Student t weights they are judged by the robust scale. After one that kept some and
        left out others, by the scale of those that were kept.
        """
        kept = self.weight == 1.0
        if not self.hard:
            dof = MEDIAN_WORTH * self.dof
            return rejected(self.chi2, self.rows, self.robust, dof, worth=STATED_WORTH)
        size = np.sqrt(float(np.sum(self.square[kept])) / self.dof)
        return rejected(self.chi2, self.rows, max(size, 1e-3), self.dof, kept, STATED_WORTH)


def judged(
    model: Model, z: np.ndarray, weights: Weights, covariance: np.ndarray, evaluations: Evaluations
) -> dict[str, Judged]:
    """All measurements of a fit by noise group, in the order of the group's blocks."""
    linear = linearise(model, z, weights.full, evaluations)
    out = {}
    for group, blocks in by_group(model).items():
        parts = []
        for b in blocks:
            rows, count = linear.of_block[b.name], len(b.rows)
            r = linear.residual[rows].reshape(-1, count).T * weights.scale[group]
            shape = (r.shape[1], count, model.size)  # a model without unknowns has no columns
            solved = (linear.jacobian[rows] @ covariance).reshape(shape)
            leverage = np.einsum("icd,jcd->cij", solved, linear.jacobian[rows].reshape(shape))
            parts.append((r, leverage, weights.row[b.name]))
        out[group] = Judged.of(parts)
    return out


def without_outliers(
    model: Model, z: np.ndarray, weights: Weights, evaluations: Evaluations
) -> tuple[np.ndarray, Weights, int]:
    """Student t reweighting until the fit rests, then the measurements that are rejected left out."""
    z, covariance, iterations = solve(model, weights, z, evaluations)
    for _ in range(ROUNDS):
        judgements = judged(model, z, weights, covariance(), evaluations)
        row = {g: of_group.student_weights() for g, of_group in judgements.items()}
        weights, before = _reweighted(model, weights, row, judgements), z
        z, covariance, more = solve(model, weights, z, evaluations)
        iterations += more
        if np.max(np.abs(z - before), initial=0.0) < 1e-3:
            break
    for _ in range(HARD_ROUNDS):
        judgements = judged(model, z, weights, covariance(), evaluations)
        # leverage at another scale misjudges where priors determine as much as contacts: fit at it first
        changed = any(of_group.rescales(weights.scale[g]) for g, of_group in judgements.items())
        row = {
            g: of_group.weight if changed else 1.0 - of_group.outliers() for g, of_group in judgements.items()
        }
        old, weights = weights, _reweighted(model, weights, row, judgements)
        if not changed and all(np.array_equal(w, old.row[name]) for name, w in weights.row.items()):
            break
        z, covariance, more = solve(model, weights, z, evaluations)
        iterations += more
    return z, weights, iterations


def _reweighted(
    model: Model, weights: Weights, row: Mapping[str, np.ndarray], judgements: Mapping[str, Judged]
) -> Weights:
    """Weights with those of measurements by noise group, and the groups' scales."""
    of_block: dict[str, np.ndarray] = {}
    for group, blocks in by_group(model).items():
        ends = np.cumsum([len(b.rows) for b in blocks])[:-1]
        of_block |= {b.name: w for b, w in zip(blocks, np.split(row[group], ends), strict=True)}
    return replace(weights, row=of_block, scale={g: of_group.scale for g, of_group in judgements.items()})
