"""Errors of quantities that a model holds at their stated values: masses and centres of mass.

The error of such an input has a known prior (`effects.masses`), but no unknown in the fit. With A and H the
biases of the parameters and the residuals that a standard error of each would leave, whitened, and e the
residuals, the errors f have the posterior covariance (1 + H'H)^-1 and the mean mu = (1 + H'H)^-1 H'e. The
estimate stays, so that its error by the masses has the second moment A V A', V = (1 + H'H)^-1 + mu mu'. Over
the prior, mu'mu has the mean k = tr(1 - (1 + H'H)^-1). An effect that a model lacks may look like a large
error of masses: mu'mu is limited to k + 2 (2 k)^1/2, as of a chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects import Circumstances, Parameter
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.masses import masses
from bayescal.estimate.compliances import with_compliances
from bayescal.estimate.discrepancy.size import AT_ONCE
from bayescal.estimate.estimate import Estimate
from bayescal.estimate.linear import root

MASSES = "masses"
"""Name of the errors of masses among the families of a stated uncertainty."""
DEVIATIONS = 2.0
"""Standard deviations by which the sum of squares of errors may exceed its mean (convention)."""


@dataclass(frozen=True)
class Inputs:
    """Errors of L inputs, each in its standard uncertainty, as a fit of D unknowns sees them."""

    names: tuple[str, ...]  # (L,)
    slopes: np.ndarray  # (D, L) A
    information: np.ndarray  # (L, L) H'H
    score: np.ndarray  # (L,) H'e

    @classmethod
    def of(cls, names: Sequence[str], slopes: np.ndarray, h: np.ndarray, e: np.ndarray) -> Inputs:
        """From the columns `h` (R, L) that a fit leaves of the errors, and its residuals `e` (R,)."""
        return cls(tuple(names), slopes, h.T @ h, h.T @ e)

    def together(self, other: Inputs) -> Inputs:
        """The same errors by the residuals of two fits; slopes of this one."""
        return replace(self, information=self.information + other.information, score=self.score + other.score)

    @cached_property
    def posterior(self) -> np.ndarray:
        """Covariance of the errors by their prior and the residuals, (L, L)."""
        return np.linalg.inv(np.eye(len(self.names)) + self.information)

    @cached_property
    def mixing(self) -> np.ndarray:
        """Root M (L, L) of their second moment: V = M M'."""
        mean, dof = self.posterior @ self.score, self.dof
        limit = dof + DEVIATIONS * np.sqrt(2.0 * dof)
        share = min(1.0, limit / max(float(mean @ mean), np.finfo(float).tiny))
        return root(self.posterior + share * np.outer(mean, mean))

    @property
    def variances(self) -> np.ndarray:
        """Variance (D,) of each unknown by the errors."""
        return np.sum((self.slopes @ self.mixing) ** 2, axis=1)

    @property
    def dof(self) -> float:
        """Degrees of freedom that the errors take from the residuals."""
        return float(np.trace(self.posterior @ self.information))

    def without(self, columns: np.ndarray, h: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (R, K), changed in place, and residuals (R,) beyond what the errors may explain of them."""
        if not self.names:
            return columns, e
        explained = self.posterior @ (h.T @ columns)
        for start in range(0, len(h), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            columns[part] -= h[part] @ explained
        return columns, e - h @ (self.posterior @ self.score)


def inputs(fitted: Estimate, circumstances: Circumstances | None = None) -> list[Parameter]:
    """The errors of masses of a fitted model; none without a compliance, or without masses.

    Parameters
    ----------
    fitted : Estimate
    circumstances : Circumstances, optional
        Of other rows than those of the model's scene.
    """
    model = fitted.model
    if all(p.effect != COMPLIANCE.name for p in model.parameters):
        return []
    if circumstances is None:
        circumstances = model.scene.circumstances(model.scene.rows("calibrate"))
    return masses(with_compliances(circumstances, fitted))


def mixed(parameters: Sequence[Parameter], mixing: np.ndarray) -> list[Parameter]:
    """Independent errors of unit variance, each a mixture of L parameters by a column of `mixing` (L, K)."""
    if not parameters:
        return []
    sites = list(dict.fromkeys((t.frame, t.axis) for p in parameters for t in p.terms))
    rows = max(np.size(t.driver) for p in parameters for t in p.terms)
    drivers = np.zeros((len(sites), len(parameters), rows))
    for k, p in enumerate(parameters):
        for t in p.terms:
            drivers[sites.index((t.frame, t.axis)), k] += p.sd * np.asarray(t.driver)
    every = mixing.T @ drivers  # (sites, K, N)
    return [
        Parameter("", "1", tuple(Term(*site, own[k]) for site, own in zip(sites, every, strict=True)), 1.0,
                  effect=MASSES)
        for k in range(mixing.shape[1])
    ]  # fmt: skip
