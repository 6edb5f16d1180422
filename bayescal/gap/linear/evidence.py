"""Evidence of columns that are added to a fitted hypothesis, averaged over prior scales and noise.

The integral over the noise is compiled: a search needs it for thousands of sets. Over L, the log of the
noise's precision over the state's own: without the columns its density is exp(dof L / 2 - chi2 exp(L) / 2), a
gamma integral. With them, Gauss-Hermite quadrature is centred at its mode and has the width there, about
1 / sqrt(dof / 2): correct to a thousandth of a nat for any number of contacts.

An error that all measurements of one pose share: its size by residuals, and what a measurement is worth.

Three reflectors on a flange are read at one stop of the arm. An error of that stop (an unsteady joint, air)
displaces all three alike, so that they are not three independent measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.special import gammaln

from bayescal.arm.transforms import compiled
from bayescal.estimate import STATED_WORTH
from bayescal.gap.linear.problem import Driven
from bayescal.gap.linear.state import State
from bayescal.gap.settings import LINEAR, SEARCH
from bayescal.statistics import f_sf

TRIED, NEWTON = 8, 5
"""Noise levels among which the mode of the integral is searched, and refinement steps."""
_jit = compiled(error_model="numpy")


@_jit
def gain(values, along, square, log_precision):
    """Log Bayes factor of columns at one log precision of the noise and one squared prior scale.

    `values` (k,) are the eigenvalues of their information, `along` (k,) their squared scores along its
    eigenvectors, both at log precision 0.
    """
    y = math.exp(log_precision)
    by = square * y
    total, product = 0.0, 1.0
    for j in range(len(values)):
        with_it = 1.0 + by * values[j]
        total += along[j] * by * y / with_it
        product *= with_it  # a logarithm of several factors is one logarithm
        if product > 1e100:
            total -= math.log(product)
            product = 1.0
    return 0.5 * (total - math.log(product))


@_jit
def _slopes(values, along, square, log_precision):
    """First and second derivative of `gain` by the log precision."""
    y = math.exp(log_precision)
    by = square * y
    first, second = 0.0, 0.0
    for j in range(len(values)):
        p = by * values[j]
        part = p / (1.0 + p)
        h = along[j] * by * y * (2.0 + p) / (1.0 + p) ** 2
        first += h - part
        second += h * (2.0 + p / (2.0 + p) - 2.0 * part) - part / (1.0 + p)
    return 0.5 * first, 0.5 * second


@_jit
def integrated(values, along, squares, dof, chi2, worth, nodes, log_weights):
    """Log of the integrals (B, S) over the log precision, of B sets of k columns at S squared prior scales.

    Parameters
    ----------
    values, along : np.ndarray, shape (B, k)
        Eigenvalues of the information of each set, and its squared scores along the eigenvectors.
    squares : np.ndarray, shape (S,)
        Squared factors on the prior standard deviations.
    dof, chi2 : float
        Degrees of freedom and chi-square of the noise without the columns.
    worth : float
        Part of `chi2` that no column explains: the stated noise.
    nodes, log_weights : np.ndarray, shape (U,)
        Of the Gauss-Hermite quadrature; of the weights the logarithms.
    """
    out = np.empty((len(values), len(squares)))
    scores, density = np.empty(values.shape[1]), np.empty(len(nodes))
    least = min(worth, chi2)
    lowest = math.log(dof / chi2)
    for b in range(len(values)):
        # columns explain at most chi2 minus the share of the stated noise, which bounds the noise from below
        largest, explained = 1e-300, 0.0
        for value in values[b]:
            largest = max(largest, value)
        for j in range(len(scores)):
            if values[b, j] > 1e-12 * largest:
                explained += along[b, j] / values[b, j]
        # what columns take from the model's prior is no part of chi2: without a limit the integral diverges
        share = min(1.0, (chi2 - least) / max(explained, 1e-300))
        for j in range(len(scores)):
            scores[j] = share * along[b, j]
        highest = math.log(dof / max(chi2 - min(explained, chi2 - least), least))
        for s in range(len(squares)):
            mode, most = lowest, -np.inf
            for i in range(TRIED):
                log_precision = lowest + (highest - lowest) * i / (TRIED - 1)
                bayes = gain(values[b], scores, squares[s], log_precision)
                level = 0.5 * (dof * log_precision - chi2 * math.exp(log_precision)) + bayes
                if level > most:
                    mode, most = log_precision, level
            for _ in range(NEWTON):
                slope, bend = _slopes(values[b], scores, squares[s], mode)
                noise = 0.5 * chi2 * math.exp(mode)
                step = (slope + 0.5 * dof - noise) / max(abs(bend - noise), 1e-3 * dof)
                mode += min(max(step, -0.5), 0.5)
            bend = 0.5 * chi2 * math.exp(mode) - _slopes(values[b], scores, squares[s], mode)[1]
            width = math.sqrt(2.0 / max(bend, 1e-3 * dof))
            most = -np.inf
            for u in range(len(nodes)):
                log_precision = mode + width * nodes[u]
                bayes = gain(values[b], scores, squares[s], log_precision)
                level = 0.5 * (dof * log_precision - chi2 * math.exp(log_precision)) + bayes
                density[u] = level + nodes[u] ** 2 + log_weights[u]
                most = max(most, density[u])
            total = 0.0
            for u in range(len(nodes)):
                total += math.exp(density[u] - most)
            out[b, s] = most + math.log(total) + math.log(width)
    return out


SCALES = np.array(LINEAR.scales)
"""Factors on the prior standard deviations over which evidence is averaged."""
SCALE_PRIOR = -0.5 * (np.log(SCALES) / np.log(LINEAR.scale_spread)) ** 2
SCALE_PRIOR = SCALE_PRIOR - np.log(np.sum(np.exp(SCALE_PRIOR)))
"""Log weights of the factors."""
NODES, _WEIGHTS = np.polynomial.hermite.hermgauss(LINEAR.noise_nodes)
LOG_WEIGHTS = np.log(_WEIGHTS)
"""Of the quadrature over the noise."""
MOST_VALUES = 500_000
"""Values of columns of which products are computed at once: copies that stay in the processor's cache."""


def log_sum(x: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Logarithm of the sum of exponentials; SciPy's takes far longer for small arrays."""
    most = np.max(x, axis=axis, keepdims=True)
    total = np.log(np.sum(np.exp(x - most), axis=axis))
    return total + (np.squeeze(most, axis=axis) if axis is not None else most.item())


@dataclass(frozen=True)
class Projected:
    """A pool of columns (R, K), projected off the parameters of a state.

    `across` (D, K) are products of the parameters' columns and these, `weighted` (R, K) whitened columns.
    """

    state: State
    pool: np.ndarray  # (R, K)
    weighted: np.ndarray  # (R, K)
    across: np.ndarray  # (D, K)
    solved: np.ndarray  # (D, K) covariance times across
    score: np.ndarray  # (K,)

    def information(self, columns: np.ndarray) -> np.ndarray:
        """G (k, k) = X'MX of some columns."""
        x = self.weighted[:, columns]
        return x.T @ x - self.across[:, columns].T @ self.solved[:, columns]


def project(state: State, pool: np.ndarray) -> Projected:
    """Project a pool of columns, at the state's weights and noise."""
    count = state.problem.count
    whiten = np.sqrt(state.weight)
    whiten[:count] /= state.kappa
    weighted = pool * whiten[:, None]
    design = state.design * whiten[:, None]
    across = design.T @ weighted
    # at the optimum the gradient of the state's parameters is zero: the projected score is X'r
    score = -(weighted.T @ (state.residual * whiten))
    return Projected(state, pool, weighted, across, state.covariance @ across, score)


@dataclass(frozen=True)
class Bank:
    """Columns (R, K) and sets of them whose evidence is often evaluated, with their constant products.

    `jacobian` (R, D) is that of the states over which they are evaluated, if all have the same.
    """

    columns: np.ndarray | Driven
    sets: tuple[np.ndarray, ...]
    count: int  # rows that are contacts
    worth: np.ndarray | None = None  # (C,) see `Problem`
    jacobian: np.ndarray | None = None

    @cached_property
    def by_jacobian(self) -> tuple[np.ndarray, np.ndarray]:
        """Products (D, K) with the Jacobian, over contacts, by what each is worth, and constraints."""
        assert self.jacobian is not None
        worth, count = np.zeros(len(self.jacobian)), self.count
        worth[:count] = 1.0 if self.worth is None else self.worth
        constraints = self.jacobian[count:].T @ self.columns[count:, :]
        return (self.jacobian * worth[:, None]).T @ self.columns, constraints

    def across(self, state: State, weight: np.ndarray) -> np.ndarray:
        """Products (D + k, K) with the design of a state, by its row weights (R,) over the noise."""
        p = state.problem
        if p.jacobian is not self.jacobian:
            return (state.design * weight[:, None]).T @ self.columns
        contacts, constraints = self.by_jacobian
        excluded = np.flatnonzero(state.weight[: self.count] == 0)
        gone = (p.jacobian[excluded] * p.base[excluded, None]).T @ self.columns[excluded, :]
        further = p.pool[:, state.columns] * (weight[:, None] * state.scales)
        of_model = (contacts - gone) / state.kappa**2 + constraints
        return np.concatenate([of_model, further.T @ self.columns])

    @cached_property
    def groups(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """By size k: sets (B,), indices of columns (B, k), X'X over contacts and constraints (B, k, k)."""
        size, out = np.array(list(map(len, self.sets)), int), []
        for k in np.unique(size).tolist():
            members = np.flatnonzero(size == k)
            indices = np.array([self.sets[i] for i in members], int).reshape(len(members), k)
            out.append((members, indices, *self._products(indices)))
        return out

    def _products(self, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """X'X (B, k, k) over contacts, by what each is worth, and constraints, of B sets `indices` (B, k)."""
        contacts, constraints = (np.empty((*indices.shape, indices.shape[1])) for _ in range(2))
        step = max(MOST_VALUES // max(indices.shape[1] * self.columns.shape[0], 1), 1)
        for first in range(0, len(indices), step):
            part = slice(first, first + step)
            x = self.columns[:, indices[part].ravel()].T.reshape(*indices[part].shape, -1)
            of_contacts, of_constraints = x[..., : self.count], x[..., self.count :]
            across = of_contacts if self.worth is None else of_contacts * self.worth
            np.matmul(across, np.swapaxes(of_contacts, 1, 2), out=contacts[part])
            np.matmul(of_constraints, np.swapaxes(of_constraints, 1, 2), out=constraints[part])
        return contacts, constraints


def weigh_sets(state: State, bank: Bank) -> np.ndarray:
    """Log Bayes factors (len(sets), scales) of adding sets of columns to a state, by prior scale."""
    return weighed_sets(state, bank)[0]


def weighed_sets(state: State, bank: Bank) -> tuple[np.ndarray, np.ndarray]:
    """The same, and of it what the data would not show (len(sets), scales); see `undetected`."""
    count = bank.count
    weight = state.weight.copy()
    weight[:count] /= state.kappa**2
    across = bank.across(state, weight)
    score, solved = -((state.residual * weight) @ bank.columns), state.covariance @ across
    excluded = np.flatnonzero(state.weight[:count] == 0)
    gone, worth = bank.columns[excluded, :], state.problem.base[excluded]
    out, size = np.empty((len(bank.sets), len(SCALES))), np.empty(len(bank.sets))
    for members, indices, contacts, constraints in bank.groups:
        in_sets = gone[:, indices]  # (rows left out, B, k)
        lost = np.einsum("rbi,rbj->bij", in_sets * worth[:, None, None], in_sets)
        a, s = across.T[indices], solved.T[indices]
        information = (contacts - lost) / state.kappa**2 + constraints - a @ np.swapaxes(s, 1, 2)
        out[members] = _factors(state, information, score[indices])
        size[members] = np.trace(information, axis1=1, axis2=2)
    return out, undetected(out, size[:, None])


def undetected(nats: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Log Bayes factors by scale of what the data would not show, at most 0; -inf of what they would.

    That is of an expected lambda below `SEARCH.detectable`. `size` is that lambda at the scale 1.
    """
    return np.where(size * SCALES**2 < SEARCH.detectable, np.minimum(nats, 0.0), -np.inf)


def weigh_clusters(state: State, column: np.ndarray, clusters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log Bayes factors (scales,) of a random error that is drawn anew in each cluster of rows; `undetected`.

    Columns of clusters hardly overlap (within an image): their information is diagonal. What the parameters
    of the state absorb is neglected: little of each of many clusters, and the result is too small by it.

    Parameters
    ----------
    state : State
    column : np.ndarray, shape (R,)
        Whitened motion of the rows by an error of one prior standard deviation.
    clusters : np.ndarray, shape (C,)
        Cluster of each row of a contact.
    """
    count, images = state.problem.count, state.problem.images
    motion = column[:count] if images is None else images.coloured(column[:count])
    weight, residual = state.weight[:count] / state.kappa**2, state.residual[:count]
    if images is None:
        information, score = (np.bincount(clusters, weight * motion * x) for x in (motion, residual))
    else:
        each = images.each(csr_array((motion, (np.arange(count), clusters))))
        information, score = each.power(2).T @ weight, each.T @ (weight * residual)
    nats = _factors_along(state, information[None], score[None] ** 2)[0]
    return nats, undetected(nats, information.sum(keepdims=True))


def _factors(state: State, information: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Log Bayes factors (B, scales) from information (B, k, k) and scores (B, k), integrated over noise."""
    if not score.shape[1]:
        return np.zeros((len(score), len(SCALES)))
    values, vectors = np.linalg.eigh(information)
    return _factors_along(state, values, np.einsum("bij,bi->bj", vectors, score) ** 2)


def _factors_along(state: State, values: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Log Bayes factors (B, scales) from eigenvalues of information (B, k) and squared scores along them."""
    count, dof, worth = state.problem.count, state.dof, STATED_WORTH / state.kappa**2
    chi2 = float(np.sum(state.weight[:count] * state.residual[:count] ** 2)) / state.kappa**2 + worth
    with_it = integrated(np.maximum(values, 0.0), along, SCALES**2, dof, chi2, worth, NODES, LOG_WEIGHTS)
    return with_it - (gammaln(dof / 2) - dof / 2 * np.log(chi2 / 2))


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
        group for group, some in zip(_split(np.arange(len(used)), poses[used]), several, strict=True) if some
    ]
    for group in groups:
        directions, size, _ = np.linalg.svd(g[group], full_matrices=False)
        basis = directions[:, size > LINEAR.dependent * size[0]]
        shared = float(np.sum((basis.T @ r[group]) ** 2))
        leverage = float(np.sum((basis.T @ slopes[group]) ** 2))
        between, within = between + shared, within + float(np.sum(r[group] ** 2)) - shared
        spare += (
            basis.shape[1] - leverage,
            len(group) - basis.shape[1] - float(np.sum(slopes[group] ** 2)) + leverage,
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
    for group in _split(np.arange(lengths), poses):
        size = np.linalg.svd(g[group], compute_uv=False)
        alike = float(np.sum(size**2)) / int(np.sum(size > LINEAR.dependent * size[0]))
        out[group] = (1.0 + variance) / (1.0 + alike * variance)
    return out


def _split(values: np.ndarray, label: np.ndarray) -> list[np.ndarray]:
    """Values by label."""
    order = np.argsort(label, kind="stable")
    ends = np.cumsum(np.unique(label, return_counts=True)[1])[:-1]
    return np.split(values[order], ends)
