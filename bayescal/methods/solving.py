"""Least squares without priors: which parameters are identifiable, and two ways to find them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares

from bayescal.errors import BayescalError
from bayescal.estimate import check_within_reach
from bayescal.methods.method import Solution
from bayescal.methods.system import System

SAME = 1e-6
"""Share of a target's column that no other explains, below which it counts as rounding."""
CONDITION = 1e3
"""Largest condition number of the scaled columns: ten times what Schroeer et al. allow for good results."""
UNSEEN = 1e-3
"""Residual standard deviations, over all rows, by which a parameter moves them if off by its tolerance."""
ROUNDS = 60
RESTED = 1e-5
"""Residual standard deviations that the last step of an iteration may still move the rows, rms."""


@dataclass(frozen=True)
class Estimable:
    """Identifiable unknowns: `kept` (K,) indices of the arm's unknowns, and the condition number."""

    kept: np.ndarray
    condition: float


def without(columns: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
    """What is left of columns (R, ...) once those of other unknowns (R, T) are taken out."""
    if not nuisance.shape[1]:
        return columns
    scale = np.linalg.norm(nuisance, axis=0)
    left, size, _ = np.linalg.svd(nuisance / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = left[:, size > SAME * size[0]]
    return columns - basis @ (basis.T @ columns)


def estimable(system: System, x: np.ndarray) -> Estimable:
    """Which unknowns of the arm are identifiable, with unknown targets.

    QR of the scaled columns with pivoting, as base parameters are found (Khalil and Gautier): the largest
    remaining column is kept while the condition number allows; the others stay nominal.
    """
    if not system.arm:
        return Estimable(np.zeros(0, int), float("nan"))
    _, jacobian = system(x)
    scale = np.linalg.norm(jacobian, axis=0)
    columns = without(jacobian[:, : system.arm], jacobian[:, system.arm :])
    seen = scale[: system.arm] * system.model.sd > UNSEEN
    columns = np.where(seen, columns / np.where(seen, scale[: system.arm], 1.0), 0.0)
    _, order = qr(columns, mode="r", pivoting=True)
    for count in range(min(columns.shape), 0, -1):
        kept = np.sort(order[:count])
        length = np.linalg.norm(columns[:, kept], axis=0)
        if length.min() > SAME and (condition := np.linalg.cond(columns[:, kept] / length)) < CONDITION:
            return Estimable(kept, float(condition))
    return Estimable(np.zeros(0, int), float("nan"))


def solution(system: System, x: np.ndarray, known: Estimable) -> Solution:
    """What was found, in the model's parameters.

    Raises
    ------
    BayescalError
        Where that is no arm any more.
    """
    model, values = system.model, x[: system.arm]
    check_within_reach(model, (values - model.shift) / model.sd)
    held = tuple(p.name for k, p in enumerate(model.parameters) if k not in known.kept)
    return Solution(model, values, held, known.condition)


def levenberg(system: System) -> Solution:
    """Non-linear least squares of all identifiable unknowns (MINPACK, columns scaled by their length).

    Raises
    ------
    BayescalError
        Where it does not come to rest.
    """
    start = np.zeros(system.size)
    known = estimable(system, start)
    moved = np.concatenate([known.kept, np.arange(system.arm, system.size)])

    def at(part: np.ndarray) -> np.ndarray:
        x = start.copy()
        x[moved] = part
        return x

    def residual(part: np.ndarray) -> np.ndarray:
        return system(at(part))[0]

    def slopes(part: np.ndarray) -> np.ndarray:
        return system(at(part))[1][:, moved]

    check_enough(system, len(moved))
    found = least_squares(
        residual, start[moved], slopes,
        method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=40 * ROUNDS,
    )  # fmt: skip
    if found.status == 0 or not np.all(np.isfinite(found.x)):
        raise BayescalError("the least squares did not converge")
    return solution(system, at(found.x), known)


def linear_steps(system: System) -> Solution:
    """Linear least squares step by step: the arm by its scaled identification Jacobian, then the targets.

    What the targets take up is taken out of residuals and Jacobian before the arm's step; after it the
    targets are found again with the arm held. No step is damped.

    Raises
    ------
    BayescalError
        Where the steps do not shrink.
    """
    x = _targets(system, np.zeros(system.size))
    known = estimable(system, x)
    check_enough(system, len(known.kept) + system.size - system.arm)
    for _ in range(ROUNDS):
        r, jacobian = system(x)
        stacked = without(np.column_stack([jacobian[:, known.kept], r]), jacobian[:, system.arm :])
        columns, left = stacked[:, :-1], stacked[:, -1]
        scale = np.linalg.norm(columns, axis=0)
        step = np.linalg.lstsq(columns / scale, left, rcond=None)[0] / scale
        if not np.all(np.isfinite(step)):
            break
        x = x.copy()
        x[known.kept] -= step
        x = _targets(system, x)
        if np.sqrt(np.mean((columns @ step) ** 2)) < RESTED:
            return solution(system, x, known)
    raise BayescalError("the linear steps do not converge")


def _targets(system: System, x: np.ndarray) -> np.ndarray:
    """The targets found from their rows with the arm held."""
    for _ in range(ROUNDS if system.size > system.arm else 0):
        r, jacobian = system(x)
        step = np.linalg.lstsq(jacobian[:, system.arm :], r, rcond=None)[0]
        x = np.concatenate([x[: system.arm], x[system.arm :] - step])
        if np.sqrt(np.mean((jacobian[:, system.arm :] @ step) ** 2)) < RESTED:
            break
    return x


def check_enough(system: System, unknowns: int) -> None:
    """Refuse fewer rows than unknowns.

    Raises
    ------
    BayescalError
        With both numbers.
    """
    rows = len(system(np.zeros(system.size))[0])
    if rows < unknowns:
        raise BayescalError(f"{rows} equations are too few for {unknowns} unknowns")
