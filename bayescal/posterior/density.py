"""Log density of the whitened parameters and the noise scale, and its linearised approximation.

A point x is (z, log kappa): kappa multiplies the stated noise; groups of noise keep the ratio of
their estimated scales. Contacts rejected by the estimate are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from bayescal.estimate import STATED_WORTH, Estimate, linearise
from bayescal.model import ARM, Turned

BINS = 2001
REACH = 9.0  # standard deviations of log kappa that the grid covers on either side


class Density:
    """Log posterior density, vectorised over walkers: ``density(x)`` of x (W, D + 1) is (W,)."""

    def __init__(self, estimate: Estimate) -> None:
        model = estimate.model
        self.estimate, self.model = estimate, model
        kept = [b.rows[estimate.weights.row[b.name] > 0] for b in model.blocks]
        self.blocks = [model.part(b, rows) for b, rows in zip(model.blocks, kept, strict=True)]
        # ball centres of all contacts are computed together, orientations separately
        touching = [b.rows for b in self.blocks if not isinstance(b, Turned)]
        self._motion = model.motion(np.concatenate(touching))
        ends = np.cumsum([len(rows) for rows in kept])
        self._at = [slice(end - len(rows), end) for end, rows in zip(ends, kept, strict=True)]
        scale = estimate.weights.scale
        main = max(scale, key=lambda g: sum(b.residuals for b in self.blocks if b.group == g))
        self.kappa = scale[main]  # the estimate's
        self.ratio = {g: s / self.kappa for g, s in scale.items()}
        self.inverse_sigma = []
        for b, full in zip(self.blocks, model.blocks, strict=True):
            row = np.tile(estimate.weights.row[b.name], full.kind.rows)
            inverse = np.sqrt(row) / (estimate.weights.sigma[b.name] * self.ratio[b.group])
            self.inverse_sigma.append(inverse[row > 0].reshape(full.kind.rows, -1))
        self.count = sum(float(np.sum(estimate.weights.row[b.name])) * b.kind.rows for b in model.blocks)

    @property
    def size(self) -> int:
        """Length of a point: D + 1."""
        return self.model.size + 1

    def whitened(self, z: np.ndarray) -> tuple[list[np.ndarray], dict[str, np.ndarray]]:
        """Residuals of every block at z (W, D), in standard uncertainties at kappa 1, and all target states.

        Shape for a block: (W, rows of its kind, contacts that were not rejected).
        """
        slices = self.model.slices
        values = self.model.deviations(z[:, slices[ARM]])
        p = self._motion.points(values)
        residuals, states = [], {}
        for block, at, inverse in zip(self.blocks, self._at, self.inverse_sigma, strict=True):
            states[block.target] = block.state(z[:, slices[block.target]])
            seen = block.seen(values) if isinstance(block, Turned) else p[..., at]
            r = block.kind.residual(states[block.target], seen)
            if len(block.contact_index):
                r = r + (values[:, block.contact_index] @ block.contact)[:, None, :]
            residuals.append(r * inverse)
        return residuals, states

    def misfit(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Chi-squared of the contacts at kappa 1, and of certificates and prior, at z (W, D): (W,), (W,)."""
        residuals, states = self.whitened(z)
        contacts = np.zeros(len(z))
        for r in residuals:
            contacts += np.einsum("wkc,wkc->w", r, r)
        values = self.model.deviations(z[:, self.model.slices[ARM]])
        rest = np.einsum("wd,wd->w", z, z)
        for constraint in self.model.constraints:
            r, _ = constraint.linearise(values, *(states[name] for name in constraint.targets))
            rest += np.einsum("wk,wk->w", r, r)
        return contacts, rest

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Log density up to a constant, (W,), at points x (W, D + 1)."""
        contacts, rest = self.misfit(x[:, :-1])
        log_kappa = x[:, -1]
        with np.errstate(over="ignore", invalid="ignore"):
            out = -(self.count + STATED_WORTH) * log_kappa - 0.5 * rest
            out -= 0.5 * (contacts + STATED_WORTH) * np.exp(-2.0 * log_kappa)
        return np.where(np.isfinite(out), out, -np.inf)


@dataclass(frozen=True)
class Linearised:
    """The density with the model linearised at the estimate; draws and evaluation are exact.

    The noise scale is drawn from its closed-form marginal on a grid, the parameters from their normal
    distribution given the scale. A generalised eigendecomposition makes it diagonal for every scale.
    """

    centre: np.ndarray  # (D,) the estimate
    basis: np.ndarray  # (D, D) V with V' P V = 1 and V' A V = diag(eigenvalues)
    inverse: np.ndarray  # (D, D) its inverse
    eigenvalues: np.ndarray  # (D,) information of the contacts at kappa 1, relative to the rest
    pull: np.ndarray  # (D,) gradient of the contacts' half chi-squared, in the basis
    push: np.ndarray  # (D,) gradient of half chi-squared of prior and certificates, in the basis
    edges: np.ndarray  # (BINS + 1,) of log kappa
    log_mass: np.ndarray  # (BINS,) log density in each bin

    @classmethod
    def of(cls, density: Density) -> Linearised:
        """Linearise a density at its estimate."""
        estimate = density.estimate
        # at kappa 1, with the row weights of the density
        unit = linearise(density.model, estimate.z, replace(estimate.weights, scale=density.ratio))
        contacts = sum(s.stop - s.start for s in unit.of_block.values())
        jc, jt = unit.jacobian[:contacts], unit.jacobian[contacts:]
        rc, rt = unit.residual[:contacts], unit.residual[contacts:]
        eigenvalues, basis = eigh(jc.T @ jc, np.eye(density.model.size) + jt.T @ jt)
        eigenvalues = np.maximum(eigenvalues, 0.0)
        pull, push = basis.T @ (jc.T @ rc), basis.T @ (jt.T @ rt + estimate.z)
        inverse = np.linalg.inv(basis)
        chi2 = float(rc @ rc)
        spread = 1.0 / np.sqrt(2.0 * max(density.count - density.model.size + STATED_WORTH, 4.0))
        edges = np.log(density.kappa) + REACH * spread * np.linspace(-1.0, 1.0, BINS + 1)
        middle = 0.5 * (edges[1:] + edges[:-1])
        inverse_square = np.exp(-2.0 * middle)[:, None]
        precision = 1.0 + eigenvalues * inverse_square
        gain = (pull * inverse_square + push) ** 2 / precision
        log_mass = (
            -(density.count + STATED_WORTH) * middle
            - 0.5 * (chi2 + STATED_WORTH) * inverse_square[:, 0]
            + 0.5 * np.sum(gain - np.log(precision), axis=1)
        )
        log_mass -= log_mass.max()
        log_mass -= np.log(np.sum(np.exp(log_mass)) * (edges[1] - edges[0]))
        return cls(estimate.z, basis, inverse, eigenvalues, pull, push, edges, log_mass)

    def _given(self, log_kappa: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means and precisions (W, D) in the basis, given the scale."""
        inverse_square = np.exp(-2.0 * log_kappa)[:, None]
        precision = 1.0 + self.eigenvalues * inverse_square
        return -(self.pull * inverse_square + self.push) / precision, precision

    def draw(
        self, count: int, rng: np.random.Generator | np.random.RandomState, spread: float = 1.0
    ) -> np.ndarray:
        """Independent points (count, D + 1); `spread` is a factor on the standard deviation of parameters."""
        width = self.edges[1] - self.edges[0]
        cumulative = np.cumsum(np.exp(self.log_mass) * width)
        bins = np.searchsorted(cumulative, rng.uniform(size=count) * cumulative[-1])
        log_kappa = self.edges[np.minimum(bins, BINS - 1)] + width * rng.uniform(size=count)
        mean, precision = self._given(log_kappa)
        y = mean + spread * rng.standard_normal(size=mean.shape) / np.sqrt(precision)
        return np.column_stack([self.centre + y @ self.basis.T, log_kappa])

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Log density (W,) of `draw` at points x (W, D + 1), up to a constant."""
        log_kappa = x[:, -1]
        bins = np.floor((log_kappa - self.edges[0]) / (self.edges[1] - self.edges[0])).astype(int)
        inside = (bins >= 0) & (bins < BINS)
        y = (x[:, :-1] - self.centre) @ self.inverse.T
        mean, precision = self._given(np.where(inside, log_kappa, self.edges[0]))
        out = self.log_mass[np.clip(bins, 0, BINS - 1)]
        out = out + 0.5 * np.sum(np.log(precision) - precision * (y - mean) ** 2, axis=1)
        return np.where(inside, out, -np.inf)
