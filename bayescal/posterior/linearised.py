"""The posterior with the model linearised at the estimate: draws, and their density in closed form.

Given the noise scales the parameters are normal. The scale of each noise group is drawn from its marginal on
a grid, with the scales of the other groups at their estimates: with one group this is exact; with several,
the scales are correlated only through the parameters that both groups determine.

Draws of the posterior, and those of its Gaussian approximation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from bayescal.estimate import STATED_WORTH, Estimate, linearise
from bayescal.posterior.density import Density
from bayescal.statistics import balanced_normals

BINS = 2001
REACH = 9.0
"""Standard deviations of log kappa that a grid covers on either side."""
CHUNK = 256
"""Draws of several groups at a time: each has a covariance of its own."""

Random = np.random.Generator | np.random.RandomState


Quadratic = tuple[np.ndarray, np.ndarray]
"""Half a chi-squared about the estimate: information (D, D), gradient (D,)."""


@dataclass(frozen=True)
class Scale:
    """One noise scale, with all others given: its marginal, and the parameters given it.

    A generalised eigendecomposition makes the information diagonal for every scale.
    """

    basis: np.ndarray  # (D, D) V with V' P V = 1 and V' A V = diag(eigenvalues)
    inverse: np.ndarray  # (D, D) its inverse
    eigenvalues: np.ndarray  # (D,) information of the group at kappa 1, relative to the rest
    pull: np.ndarray  # (D,) gradient of the group's half chi-squared at kappa 1, in the basis
    push: np.ndarray  # (D,) gradient of the rest, in the basis
    edges: np.ndarray  # (BINS + 1,) of log kappa
    log_mass: np.ndarray  # (BINS,) log density in each bin

    @classmethod
    def of(cls, group: Quadratic, chi2: float, count: float, others: Quadratic, kappa: float) -> Scale:
        """Build it from the part of a group with `count` residuals, and all other parts.

        Parameters
        ----------
        group : Quadratic
            Of the group at kappa 1; `chi2` is its value at the estimate.
        chi2 : float
        count : float
            Residuals of the group.
        others : Quadratic
            Of prior, certificates and other groups.
        kappa : float
            Estimated scale, about which the grid lies.
        """
        eigenvalues, basis = eigh(group[0], others[0])
        eigenvalues = np.maximum(eigenvalues, 0.0)
        pull, push = basis.T @ group[1], basis.T @ others[1]
        spread = 1.0 / np.sqrt(2.0 * max(count - len(basis) + STATED_WORTH, 4.0))
        edges = np.log(kappa) + REACH * spread * np.linspace(-1.0, 1.0, BINS + 1)
        middle = 0.5 * (edges[1:] + edges[:-1])
        inverse_square = np.exp(-2.0 * middle)[:, None]
        precision = 1.0 + eigenvalues * inverse_square
        gain = (pull * inverse_square + push) ** 2 / precision
        log_mass = (
            -(count + STATED_WORTH) * middle
            - 0.5 * (chi2 + STATED_WORTH) * inverse_square[:, 0]
            + 0.5 * np.sum(gain - np.log(precision), axis=1)
        )
        log_mass -= log_mass.max()
        log_mass -= np.log(np.sum(np.exp(log_mass)) * (edges[1] - edges[0]))
        return cls(basis, np.linalg.inv(basis), eigenvalues, pull, push, edges, log_mass)

    def given(self, log_kappa: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means and precisions (W, D) of the parameters in the basis, given the scale (W,)."""
        inverse_square = np.exp(-2.0 * log_kappa)[:, None]
        precision = 1.0 + self.eigenvalues * inverse_square
        return -(self.pull * inverse_square + self.push) / precision, precision

    def draw(self, count: int, rng: Random) -> np.ndarray:
        """Draws (count,) of log kappa."""
        width = self.edges[1] - self.edges[0]
        cumulative = np.cumsum(np.exp(self.log_mass) * width)
        bins = np.searchsorted(cumulative, rng.uniform(size=count) * cumulative[-1])
        return self.edges[np.minimum(bins, BINS - 1)] + width * rng.uniform(size=count)

    def __call__(self, log_kappa: np.ndarray) -> np.ndarray:
        """Log density (W,) of `draw`; -inf beyond the grid."""
        bins = np.floor((log_kappa - self.edges[0]) / (self.edges[1] - self.edges[0])).astype(int)
        inside = (bins >= 0) & (bins < BINS)
        return np.where(inside, self.log_mass[np.clip(bins, 0, BINS - 1)], -np.inf)


@dataclass(frozen=True)
class Linearised:
    """The linearised density of the parameters and of the noise scale of every group."""

    centre: np.ndarray  # (D,) the estimate
    scales: tuple[Scale, ...]  # of each group
    information: np.ndarray  # (G, D, D) of each group at kappa 1
    gradient: np.ndarray  # (G, D) of each group at kappa 1
    prior: Quadratic  # of prior and certificates

    @classmethod
    def of(cls, density: Density) -> Linearised:
        """Linearise a density at its estimate."""
        estimate, model = density.estimate, density.model
        stated = replace(estimate.weights, scale=dict.fromkeys(density.groups, 1.0))
        unit = linearise(model, estimate.z, stated)
        of_groups, chi2 = [], []
        for group in density.groups:
            slices = [unit.of_block[b.name] for b in model.blocks if b.group == group]
            j = np.concatenate([unit.jacobian[s] for s in slices])
            r = np.concatenate([unit.residual[s] for s in slices])
            of_groups.append((j.T @ j, j.T @ r))
            chi2.append(float(r @ r))
        first = sum(s.stop - s.start for s in unit.of_block.values())
        j, r = unit.jacobian[first:], unit.residual[first:]
        prior = np.eye(model.size) + j.T @ j, estimate.z + j.T @ r
        at_estimate = [(k**-2 * a, k**-2 * b) for (a, b), k in zip(of_groups, density.kappa, strict=True)]
        scales = []
        for k, q in enumerate(of_groups):
            others = [o for h, o in enumerate(at_estimate) if h != k]
            beside = sum((a for a, _ in others), prior[0]), sum((b for _, b in others), prior[1])
            scales.append(Scale.of(q, chi2[k], float(density.count[k]), beside, float(density.kappa[k])))
        information, gradient = np.array([a for a, _ in of_groups]), np.array([b for _, b in of_groups])
        return cls(estimate.z, tuple(scales), information, gradient, prior)

    def draw(self, count: int, rng: Random, spread: float = 1.0) -> np.ndarray:
        """Independent points (count, D + G); `spread` is a factor on the standard deviation of parameters."""
        return self._points(
            self._log_kappa(count, rng), spread * rng.standard_normal((count, len(self.centre)))
        )

    def balanced(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Points (count, D + G) as of `draw`, from `balanced_normals`."""
        return self._points(self._log_kappa(count, rng), balanced_normals(rng, count, len(self.centre)))

    def _log_kappa(self, count: int, rng: Random) -> np.ndarray:
        return np.stack([s.draw(count, rng) for s in self.scales], axis=1)

    def _points(self, log_kappa: np.ndarray, away: np.ndarray) -> np.ndarray:
        """Points (N, D + G) from scales (N, G) and deviations (N, D) over their standard deviations."""
        if len(self.scales) == 1:
            mean, precision = self.scales[0].given(log_kappa[:, 0])
            z = (mean + away / np.sqrt(precision)) @ self.scales[0].basis.T
        else:
            z = np.concatenate([
                self._drawn(log_kappa[k : k + CHUNK], away[k : k + CHUNK])
                for k in range(0, len(away), CHUNK)
            ])  # fmt: skip
        return np.column_stack([self.centre + z, log_kappa])

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Log density (W,) of `draw` at points x (W, D + G), up to a constant."""
        size = len(self.centre)
        away, log_kappa = x[:, :size] - self.centre, x[:, size:]
        out = np.sum([s(values) for s, values in zip(self.scales, log_kappa.T, strict=True)], axis=0)
        log_kappa = np.where(np.isfinite(out)[:, None], log_kappa, [s.edges[0] for s in self.scales])
        if len(self.scales) == 1:
            mean, precision = self.scales[0].given(log_kappa[:, 0])
            y = away @ self.scales[0].inverse.T
            return out + 0.5 * np.sum(np.log(precision) - precision * (y - mean) ** 2, axis=1)
        mean, root = self._given(log_kappa)
        y = np.einsum("wij,wi->wj", root, away - mean)
        return out + np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)) - 0.5 * y**2, axis=1)

    def _given(self, log_kappa: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means (W, D) and Cholesky factors (W, D, D) of the information, given the scales (W, G)."""
        inverse_square = np.exp(-2.0 * log_kappa)
        information = self.prior[0] + np.tensordot(inverse_square, self.information, axes=1)
        gradient = self.prior[1] + inverse_square @ self.gradient
        mean = -np.linalg.solve(information, gradient[..., None])[..., 0]
        return mean, np.linalg.cholesky(information)

    def _drawn(self, log_kappa: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Parameters (W, D) relative to the estimate, from the scales and standard normals (W, D)."""
        mean, root = self._given(log_kappa)
        return mean + np.linalg.solve(np.swapaxes(root, 1, 2), normal[..., None])[..., 0]


CHAINS = 4


@dataclass(frozen=True)
class Convergence:
    """Effective draws and R-hat of every component, (D,)."""

    ess_bulk: np.ndarray  # effective draws in the bulk
    ess_tail: np.ndarray  # in the tails, of the 5 % and the 95 % quantile
    rhat: np.ndarray  # rank-normalised split R-hat, nan where not sampled

    @property
    def ess(self) -> np.ndarray:
        """Effective draws, the smaller of bulk and tails, (D,)."""
        return np.minimum(self.ess_bulk, self.ess_tail)


@dataclass(frozen=True)
class Draws(Convergence):
    """Draws of the posterior in four chains, with their convergence.

    A chain is an ensemble, its walkers concatenated, so that the autocorrelation of a walker is that of the
    chain. Convergence, of the D components of z and the G noise scales, is computed from these draws as
    ArviZ does.
    """

    z: np.ndarray  # (chains, draws, D)
    log_kappa: np.ndarray  # (chains, draws, G), noise scale of each group over its stated noise
    log_density: np.ndarray  # (chains, draws)
    names: tuple[str, ...]  # of the D components and the noise scales
    acceptance: dict[str, float]  # by move
    moves: str
    steps: int  # of each ensemble after burn-in
    walkers: int
    converged: bool
    complaint: str  # reason, where not converged

    @property
    def flat(self) -> np.ndarray:
        """All draws of z, (chains * draws, D)."""
        chains, draws, size = self.z.shape  # not -1: there may be no components at all
        return self.z.reshape(chains * draws, size)

    @property
    def kappa(self) -> np.ndarray:
        """Noise scales of `flat`, (chains * draws, G), in the order of `noise_groups`."""
        return np.exp(self.log_kappa.reshape(-1, self.log_kappa.shape[-1]))


def scale_names(groups: Sequence[str]) -> tuple[str, ...]:
    """Names of the noise scales: that of the first group is the noise scale of a fit."""
    return tuple(f"noise scale of {g}" if k else "noise scale" for k, g in enumerate(groups))


def approximate(estimate: Estimate, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws z (count, D) of `gaussian` and their noise scales (count, G), without their density."""
    x, size = _linearised(Density(estimate), seed, count), estimate.model.size
    return x[:, :size] + estimate.from_free, np.exp(x[:, size:])


def _linearised(density: Density, seed: int, count: int) -> np.ndarray:
    return Linearised.of(density).balanced(count, np.random.default_rng(seed))


def gaussian(estimate: Estimate, seed: int, count: int = 4000) -> Draws:
    """Draws of the linearised posterior: the Gaussian approximation, with the noise scales unknown.

    They are about the estimate, also where this has parameters at their bound.
    """
    density = Density(estimate)
    x = _linearised(density, seed, count).reshape(CHAINS, -1, density.size)
    x[..., : estimate.model.size] += estimate.from_free
    lp = np.stack([density(part) for part in x])
    every, size = np.full(density.size, float(count)), density.model.size
    return Draws(
        every, every, np.full(density.size, np.nan), x[..., :size], x[..., size:], lp,
        (*estimate.model.names, *scale_names(density.groups)), {},
        "none: independent draws of the linearised posterior", count, 1, True, "",
    )  # fmt: skip
