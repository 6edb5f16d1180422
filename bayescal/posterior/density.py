"""Log density of the whitened parameters and of the noise scale of each group.

A point x is (z, log kappa of every noise group), the main group first: kappa multiplies the stated noise of
its group. Contacts rejected by the estimate are left out.

Log likelihood and replicated residuals of each fitted row under the posterior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.estimate import STATED_WORTH, Estimate
from bayescal.estimate.correlated import Decorrelation
from bayescal.model import ARM
from bayescal.model.block import Oriented
from bayescal.model.model import noise_groups

MOST_VALUES = 4_000_000
"""Rows times points whose residuals are held in memory at a time: 100 MB of ball centres."""
OF_POSE = 16
"""The same of a row that depends on a pose: its matrices and their temporary products."""


class Density:
    """Log posterior density, vectorised over walkers: ``density(x)`` of x (W, D + G) is (W,)."""

    def __init__(self, estimate: Estimate) -> None:
        model = estimate.model
        self.estimate, self.model = estimate, model
        kept = [b.rows[estimate.weights.row[b.name] > 0] for b in model.blocks]
        self.blocks = [model.part(b, rows) for b, rows in zip(model.blocks, kept, strict=True)]
        # ball centres of all contacts are computed together, poses separately
        touching = [np.zeros(0, int) if isinstance(b, Oriented) else b.rows for b in self.blocks]
        self._motion = model.motion(np.concatenate(touching))
        ends = np.cumsum([len(rows) for rows in touching])
        self._columns = [slice(end - len(rows), end) for end, rows in zip(ends, touching, strict=True)]
        self.groups = noise_groups(model)
        self.kappa = np.array([estimate.weights.scale[g] for g in self.groups])  # (G,) the estimate's
        member = np.array([[b.group == g for g in self.groups] for b in self.blocks], float)
        self.member = member.reshape(len(self.blocks), len(self.groups))  # 1 where a block is of a group
        self.inverse_sigma, self.apart, numbers = [], list[Decorrelation | None](), []
        for b, full in zip(self.blocks, model.blocks, strict=True):
            row = np.tile(estimate.weights.row[b.name], full.kind.rows)
            inverse = np.sqrt(row) / estimate.weights.sigma[b.name]
            self.inverse_sigma.append(inverse[row > 0].reshape(full.kind.rows, -1))
            shared = estimate.weights.shared.get(b.name)
            self.apart.append(None if shared is None else shared[row > 0].decorrelated())
            numbers.append(float(np.sum(row)))
        self.count = np.array(numbers) @ self.member  # (G,) residuals

    @property
    def at_once(self) -> int:
        """Number of points whose residuals are held in memory."""
        values = sum(len(b.rows) * (OF_POSE if isinstance(b, Oriented) else 1) for b in self.blocks)
        return max(MOST_VALUES // max(values, 1), 1)

    @property
    def size(self) -> int:
        """Length of a point: D + G."""
        return self.model.size + len(self.groups)

    def whitened(self, z: np.ndarray) -> tuple[list[np.ndarray], dict[str, np.ndarray]]:
        """Residuals of every block at z (W, D), in stated standard uncertainties, and all target states.

        As they are: what rows share is not taken out.

        Shape for a block: (W, rows of its kind, contacts that were not rejected).
        """
        slices = self.model.slices
        values = self.model.deviations(z[:, slices[ARM]])
        p = self._motion.points(values)
        residuals, states = [], {}
        for block, columns, inverse in zip(self.blocks, self._columns, self.inverse_sigma, strict=True):
            z_target = z[:, slices[block.target]]
            states[block.target] = state = block.state(z_target)
            posed = isinstance(block, Oriented)
            points = p[..., columns]
            r = block.residual(values, z_target) if posed else block.residual_of(points, values, state)
            residuals.append(r * inverse)
        return residuals, states

    def misfit(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Chi-squared of each group's contacts at stated noise (W, G), and of certificates and prior (W,).

        At z (W, D).
        """
        residuals, states = self.whitened(z)
        contacts = np.zeros((len(z), len(self.groups)))
        for r, member, apart in zip(residuals, self.member, self.apart, strict=True):
            if apart is not None:
                r = apart.white(r.reshape(len(r), -1).T).T[:, None]
            contacts += np.einsum("wkc,wkc->w", r, r)[:, None] * member
        values = self.model.deviations(z[:, self.model.slices[ARM]])
        chi2_prior = np.einsum("wd,wd->w", z, z)
        for constraint in self.model.constraints:
            r, _ = constraint.linearise(values, *(states[name] for name in constraint.targets))
            chi2_prior += np.einsum("wk,wk->w", r, r)
        return contacts, chi2_prior

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Log density up to a constant, (W,), at points x (W, D + G)."""
        if len(x) > self.at_once:
            return np.concatenate([self(x[k : k + self.at_once]) for k in range(0, len(x), self.at_once)])
        contacts, chi2_prior = self.misfit(x[:, : self.model.size])
        log_kappa = x[:, self.model.size :]
        with np.errstate(over="ignore", invalid="ignore"):
            of_scales = (self.count + STATED_WORTH) * log_kappa
            of_scales += 0.5 * (contacts + STATED_WORTH) * np.exp(-2.0 * log_kappa)
            out = -0.5 * chi2_prior - np.sum(of_scales, axis=1)
        return np.where(np.isfinite(out), out, -np.inf)


UM = 1e6
PRIOR = 0x9A10
"""Second word of the seed of prior draws."""
CHUNK = 64
"""Number of draws per call of the density, as in the sampler."""
PARTS = 8
"""Parts in which residuals are computed of a session that is too large for so many draws: of its points."""


@dataclass(frozen=True)
class Pointwise:
    """The fitted measurements without outliers, with their log likelihood and replicated residuals.

    `log_likelihood` (S, C) is a density of the residuals of a row in µm and µrad. `replicated` (S, C), µm, is
    the residual of simulated data at the estimate. Both vary by more than their seventh figure from draw to
    draw: single precision. `observed` (C,), m, is the residual of the measured data. The residual is signed
    where a row has a single one, and a vector length where it has several; of a full pose it is that of the
    point.
    """

    rows: np.ndarray  # (C,) rows of the session
    log_likelihood: np.ndarray
    replicated: np.ndarray
    observed: np.ndarray


def pointwise(estimate: Estimate, z: np.ndarray, kappa: np.ndarray, rng: np.random.Generator) -> Pointwise:
    """Log likelihoods and replicated residuals of the fitted measurements.

    Parameters
    ----------
    estimate : Estimate
        Rows that were excluded as outliers are omitted.
    z : np.ndarray, shape (S, D)
        Draws of the whitened parameters.
    kappa : np.ndarray, shape (S, G)
        Noise scales of the same draws, in the order of `noise_groups`.
    rng : np.random.Generator
        Of the noise of replicated data.
    """
    density = Density(estimate)
    blocks = density.blocks
    rows = np.unique(np.concatenate([b.rows for b in blocks]))
    columns = [np.searchsorted(rows, b.rows) for b in blocks]
    here, _ = density.whitened(estimate.z[None])
    log_likelihood = np.empty((len(z), len(rows)), np.float32)
    replicated = np.full((len(z), len(rows)), np.nan, np.float32)
    observed = np.full(len(rows), np.nan)
    pointlike = [k for k, b in enumerate(blocks) if b.name == b.target]
    for k in pointlike:
        observed[columns[k]] = _size(here[k][0] / density.inverse_sigma[k])
    chunk = min(CHUNK, density.at_once)
    for start in range(0, len(z), chunk):
        part = slice(start, start + chunk)
        terms = np.zeros((len(z[part]), len(rows)))
        for k, r in enumerate(_whitened(density, z[part])):
            inverse = density.inverse_sigma[k]
            scale = kappa[part, density.groups.index(blocks[k].group), None, None]
            term = np.log(1e-6 * inverse / np.sqrt(2.0 * np.pi) / scale) - 0.5 * (r / scale) ** 2
            terms[:, columns[k]] += term.sum(axis=1)
            if k in pointlike:
                anew = here[k] - r + scale * rng.standard_normal(r.shape)
                replicated[part, columns[k]] = UM * _size(anew / inverse)
        log_likelihood[part] = terms
    return Pointwise(rows, log_likelihood, replicated, observed)


def _whitened(density: Density, z: np.ndarray) -> list[np.ndarray]:
    """Residuals of every block at z (W, D) as of `Density.whitened`; points of few draws are held at once."""
    few = max(density.at_once // PARTS, 1)
    if len(z) <= few:
        return density.whitened(z)[0]
    out = [np.empty((len(z), *inverse.shape)) for inverse in density.inverse_sigma]
    for k in range(0, len(z), few):
        for residuals, part in zip(out, density.whitened(z[k : k + few])[0], strict=True):
            residuals[k : k + few] = part
    return out


def _size(residuals: np.ndarray) -> np.ndarray:
    """The single residual of each row, or the length of several, (..., C), of (..., rows of the kind, C)."""
    return residuals[..., 0, :] if residuals.shape[-2] == 1 else np.linalg.norm(residuals, axis=-2)


def prior_draws(size: int, groups: int, chains: int, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the prior: z (chains, draws, size), and logs of the noise scales (chains, draws, groups).

    Only the parameters have a prior; certificates between targets are data. The prior of each noise scale
    gives the stated noise the weight of `STATED_WORTH` contacts.
    """
    rng = np.random.default_rng([seed, PRIOR])
    z = rng.standard_normal((chains, draws, size))
    return z, -0.5 * np.log(rng.chisquare(STATED_WORTH, (chains, draws, groups)) / STATED_WORTH)
