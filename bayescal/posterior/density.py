"""Log density of the whitened parameters and of the noise scale of each group.

A point x is (z, log kappa of every noise group), the main group first: kappa multiplies the stated noise of
its group. Contacts rejected by the estimate are left out.
"""

from __future__ import annotations

import numpy as np

from bayescal.estimate import STATED_WORTH, Estimate
from bayescal.model import ARM, Turned
from bayescal.model.length_blocks import noise_groups

MOST_VALUES = 4_000_000
"""Rows times points whose residuals are held in memory at a time: 100 MB of ball centres."""


class Density:
    """Log posterior density, vectorised over walkers: ``density(x)`` of x (W, D + G) is (W,)."""

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
        self.groups = noise_groups(model)
        self.kappa = np.array([estimate.weights.scale[g] for g in self.groups])  # (G,) the estimate's
        member = np.array([[b.group == g for g in self.groups] for b in self.blocks], float)
        self.member = member.reshape(len(self.blocks), len(self.groups))  # 1 where a block is of a group
        self.inverse_sigma, numbers = [], []
        for b, full in zip(self.blocks, model.blocks, strict=True):
            row = np.tile(estimate.weights.row[b.name], full.kind.rows)
            inverse = np.sqrt(row) / estimate.weights.sigma[b.name]
            self.inverse_sigma.append(inverse[row > 0].reshape(full.kind.rows, -1))
            numbers.append(float(np.sum(row)))
        self.count = np.array(numbers) @ self.member  # (G,) residuals

    @property
    def at_once(self) -> int:
        """Number of points whose residuals are held in memory."""
        return max(MOST_VALUES // max(sum(len(b.rows) for b in self.blocks), 1), 1)

    @property
    def size(self) -> int:
        """Length of a point: D + G."""
        return self.model.size + len(self.groups)

    def whitened(self, z: np.ndarray) -> tuple[list[np.ndarray], dict[str, np.ndarray]]:
        """Residuals of every block at z (W, D), in stated standard uncertainties, and all target states.

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
        """Chi-squared of each group's contacts at stated noise (W, G), and of certificates and prior (W,).

        At z (W, D).
        """
        residuals, states = self.whitened(z)
        contacts = np.zeros((len(z), len(self.groups)))
        for r, member in zip(residuals, self.member, strict=True):
            contacts += np.einsum("wkc,wkc->w", r, r)[:, None] * member
        values = self.model.deviations(z[:, self.model.slices[ARM]])
        rest = np.einsum("wd,wd->w", z, z)
        for constraint in self.model.constraints:
            r, _ = constraint.linearise(values, *(states[name] for name in constraint.targets))
            rest += np.einsum("wk,wk->w", r, r)
        return contacts, rest

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Log density up to a constant, (W,), at points x (W, D + G)."""
        if len(x) > self.at_once:
            return np.concatenate([self(x[k : k + self.at_once]) for k in range(0, len(x), self.at_once)])
        contacts, rest = self.misfit(x[:, : self.model.size])
        log_kappa = x[:, self.model.size :]
        with np.errstate(over="ignore", invalid="ignore"):
            of_scales = (self.count + STATED_WORTH) * log_kappa
            of_scales += 0.5 * (contacts + STATED_WORTH) * np.exp(-2.0 * log_kappa)
            out = -0.5 * rest - np.sum(of_scales, axis=1)
        return np.where(np.isfinite(out), out, -np.inf)
