"""An error that all measurements of one pose share: its size by residuals, and what a measurement is worth.

Three reflectors on a flange are read at one stop of the arm. An error of that stop (an unsteady joint, air
on the way to the instrument) displaces all three alike, so that they are not three independent measurements.
"""

from __future__ import annotations

import numpy as np

from bayescal.distributions import f_sf
from bayescal.gap.linear.state import State
from bayescal.gap.settings import LINEAR


def shared_variance(state: State, gradient: np.ndarray, poses: np.ndarray) -> float:
    """Variance of a displacement that all measurements of a pose share, in units of their own noise.

    Analysis of variance with random effects. The residuals of a pose are r = G e + noise, with e (3,) the
    displacement of the pose and G (n, 3) the directions of the residuals. The part of r in the span of G
    varies between poses, the rest within them; the fit leaves less of either, by the leverage of its rows.
    The variance is 0 where an F test does not show one.

    Parameters
    ----------
    state : State
        A hypothesis that explains what depends on the poses; what it leaves out counts as shared error.
    gradient : np.ndarray, shape (L, 3)
        Derivatives of the lengths by a displacement.
    poses : np.ndarray, shape (L,)
        Number of the pose of each.
    """
    p = state.problem
    used = np.flatnonzero(state.weight[: p.lengths] > 0)
    several = np.array([len(np.unique(c)) for c in _split(p.contact[used], poses[used])]) > 1
    weight = np.sqrt(p.base[used])[:, None] / state.kappa
    slopes = weight * (state.design[used] @ np.linalg.cholesky(state.covariance))
    r, g = state.residual[used] / state.kappa, gradient[used]
    g = g / np.maximum(np.linalg.norm(g, axis=1), 1e-300)[:, None]
    between = within = ranks = 0.0
    spare, total = np.zeros(2), 0.0
    groups = [
        own for own, some in zip(_split(np.arange(len(used)), poses[used]), several, strict=True) if some
    ]
    for own in groups:
        left, size, _ = np.linalg.svd(g[own], full_matrices=False)
        basis = left[:, size > LINEAR.dependent * size[0]]
        shared = float(np.sum((basis.T @ r[own]) ** 2))
        leverage = float(np.sum((basis.T @ slopes[own]) ** 2))
        between, within = between + shared, within + float(np.sum(r[own] ** 2)) - shared
        spare += (
            basis.shape[1] - leverage,
            len(own) - basis.shape[1] - float(np.sum(slopes[own] ** 2)) + leverage,
        )
        ranks, total = ranks + basis.shape[1], total + float(np.sum(size**2))
    if not groups or np.min(spare) < 1.0 or within <= 0:
        return 0.0
    ratio = (between / spare[0]) / (within / spare[1])
    if float(f_sf(ratio, *spare)) > LINEAR.shared:
        return 0.0
    return (ratio - 1.0) * ranks / total


def worth(
    variance: float, contact: np.ndarray, lengths: int, gradient: np.ndarray, poses: np.ndarray
) -> np.ndarray:
    """Independent residuals that each residual is worth, (C,), if its pose shares an error.

    The mean of n measurements with a shared variance t beside their own of 1 has the variance (1 + n t) / n;
    of independent ones with the same total it would be (1 + t) / n. A pose of measurements in different
    directions has as many as share a direction. An orientation is worth 1.

    Parameters
    ----------
    variance : float
        From `shared_variance`.
    contact : np.ndarray, shape (C,)
        Number of the contact of each residual.
    lengths : int
        L, number of the first of these that are lengths.
    gradient, poses
        See `shared_variance`.
    """
    out = np.ones(len(contact))
    g = gradient / np.maximum(np.linalg.norm(gradient, axis=1), 1e-300)[:, None]
    for own in _split(np.arange(lengths), poses):
        size = np.linalg.svd(g[own], compute_uv=False)
        alike = float(np.sum(size**2)) / int(np.sum(size > LINEAR.dependent * size[0]))
        out[own] = (1.0 + variance) / (1.0 + alike * variance)
    return out


def _split(values: np.ndarray, label: np.ndarray) -> list[np.ndarray]:
    """Values by label."""
    order = np.argsort(label, kind="stable")
    ends = np.cumsum(np.unique(label, return_counts=True)[1])[:-1]
    return np.split(values[order], ends)
