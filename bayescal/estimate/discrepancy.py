"""Uncertainty of an estimate where the model is not the machine (Kennedy and O'Hagan 2001).

Errors of quantities that a model holds at their stated values: masses and centres of mass.

The error of such an input has a known prior (`effects.gravity`), but no unknown in the fit. With A and H the
biases of the parameters and the residuals that a standard error of each would leave, whitened, and e the
residuals, the errors f have the posterior covariance (1 + H'H)^-1 and the mean mu = (1 + H'H)^-1 H'e. The
estimate stays, so that its error by the masses has the second moment A V A', V = (1 + H'H)^-1 + mu mu'. Over
the prior, mu'mu has the mean k = tr(1 - (1 + H'H)^-1). An effect that a model lacks may look like a large
error of masses: mu'mu is limited to k + 2 (2 k)^1/2, as of a chi-square.

The stated uncertainty: the solver's covariance, widened by what a discrepancy could cause.

The estimate stays. With C the solver's covariance, P0 the information of priors and certificates, J and G the
whitened columns of the parameters and of the functions of `families`, and Lambda their variances (`size`):

    A = C J' G                            error of the parameters by a unit of each function
    C P0 C + w S + A Lambda A'            stated covariance of the parameters
    (G - J A) Lambda (G - J A)'           of a prediction: the function and the parameters that it biased

Errors of stated masses act in the same way, by columns of known variance: `inputs`. A family has a variance
only where the residuals show more than masses within their uncertainty could do.

S is the scatter over the poses in place of C J' J C, so that rows of one pose do not count as independent,
and w the share of the residual variance that the discrepancy leaves. Where w S + A Lambda A' is less than
C J' J C, it is raised to it: no uncertainty is stated smaller than the solver's. An estimate with the
functions as further unknowns predicts worse elsewhere; this one is unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects import Parameter
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.gravity import masses
from bayescal.estimate import moments
from bayescal.estimate.estimate import Estimate
from bayescal.estimate.families import Family, families, linearised_with, model_with, poses, with_compliances
from bayescal.estimate.solver import root
from bayescal.estimate.unexplained import Unexplained, unexplained
from bayescal.model import ARM
from bayescal.statistics import balanced_normals

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
    joint: np.ndarray | None = None  # (K, K) covariance of the first, if they were estimated with this fit

    @classmethod
    def of(
        cls, names: Sequence[str], slopes: np.ndarray, h: np.ndarray, e: np.ndarray,
        joint: np.ndarray | None = None,
    ) -> Inputs:  # fmt: skip
        """From the columns `h` (R, L) that a fit leaves of the errors, and its residuals `e` (R,)."""
        return cls(tuple(names), slopes, h.T @ h, h.T @ e, joint)

    def together(self, other: Inputs) -> Inputs:
        """The same errors by the residuals of two fits; slopes of this one."""
        return replace(self, information=self.information + other.information, score=self.score + other.score)

    @cached_property
    def posterior(self) -> np.ndarray:
        """Covariance of the errors by their prior and the residuals, (L, L)."""
        if self.joint is None:
            return np.linalg.inv(np.eye(len(self.names)) + self.information)
        k = len(self.joint)
        across = -self._others @ self.information[k:, :k] @ self.joint
        others = self._others - across @ self.information[:k, k:] @ self._others
        return np.block([[self.joint, across.T], [across, others]])

    @cached_property
    def _others(self) -> np.ndarray:
        """Covariance of the errors that were not estimated with this fit, given those that were."""
        k = 0 if self.joint is None else len(self.joint)
        return np.linalg.inv(np.eye(len(self.names) - k) + self.information[k:, k:])

    @cached_property
    def mean(self) -> np.ndarray:
        """Mean mu (L,) of the errors; 0 of those that are at their estimate."""
        k = 0 if self.joint is None else len(self.joint)
        return np.concatenate([np.zeros(k), self._others @ self.score[k:]])

    @cached_property
    def mixing(self) -> np.ndarray:
        """Root M (L, L) of their second moment: V = M M'."""
        mean, dof = self.mean, self.dof
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
        for start in range(0, len(h), moments.AT_ONCE):
            part = slice(start, start + moments.AT_ONCE)
            columns[part] -= h[part] @ explained
        return columns, e - h @ self.mean


def inputs(fitted: Estimate) -> list[Parameter]:
    """The errors of masses of a fitted model; none without a compliance, or without masses."""
    model = fitted.model
    if all(p.effect != COMPLIANCE.name for p in model.parameters):
        return []
    return masses(with_compliances(model.scene.circumstances(), fitted))


def informed(fitted: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """What a fit tells of the masses of the links, for any other parameters and load: information and score.

    With G the columns of the errors and C the covariance of the D unknowns, the information is
    G'G - G'J C J'G: all residuals, certificates and priors count, not the prior of the masses. At the
    estimate the other slopes vanish, so that the score is -G'e.

    Returns
    -------
    information : np.ndarray, shape (4n, 4n)
        Of relative errors of masses and errors of centres (m), link by link; zeros if masses have no part.
    score : np.ndarray, shape (4n,)
    """
    held, size = inputs(fitted), 4 * fitted.model.scene.dataset.robot.n
    if not held:
        return np.zeros((size, size)), np.zeros(size)
    sd = np.array([p.sd for p in held])
    j, g, e, _ = linearised_with(fitted, list(held))
    information = g.T @ (g - j @ (fitted.covariance @ (j.T @ g)))
    score = -g.T @ e
    load = np.linalg.solve(information[size:, size:] + np.eye(len(held) - size), information[size:, :size])
    information = information[:size, :size] - information[:size, size:] @ load
    score = score[:size] - load.T @ score[size:]
    return information / np.outer(sd[:size], sd[:size]), score / sd[:size]


def _joint(fitted: Estimate, held: Sequence[Parameter]) -> np.ndarray | None:
    """The covariance of the masses that were estimated with a fit, in their standard uncertainties."""
    covariance = fitted.model.scene.dataset.robot.mass_covariance
    if covariance is None or not held:
        return None
    sd = np.array([p.sd for p in held[: len(covariance)]])
    return covariance / np.outer(sd, sd)


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
        Parameter("", "1", tuple(Term(*site, of_site[k]) for site, of_site in zip(sites, every, strict=True)),
                  1.0, effect=MASSES)
        for k in range(mixing.shape[1])
    ]  # fmt: skip


LEAST_WHITE = 0.1
"""Smallest share of the residual variance that stays noise (assumed)."""

ROWS = 8192
"""Residuals whose columns are held in memory twice."""


@dataclass(frozen=True)
class Stated:
    """An estimate with its stated uncertainty."""

    plain: Estimate
    wide: Estimate  # of a model with the functions as further parameters, at zero; covariance of all
    index: np.ndarray  # (D,) places of the plain estimate's unknowns in z of the wide one
    slopes: Mapping[str, np.ndarray]  # A (D, K) by family
    variances: Mapping[str, float]  # Lambda by family; 0 where the residuals show nothing
    white: float  # w
    noise: np.ndarray  # (D, M) changes of the unknowns by independent errors of poses: w S is noise noise'
    noise_rows: np.ndarray  # (M,) a row of the session of each of these errors
    dof: Mapping[str, float]  # effective degrees of freedom of the variances
    inputs: Inputs  # errors of masses: the last parameters of the wide model's arm, mixed to unit variance
    chance: Mapping[str, float]  # that noise shows as much of a family

    @property
    def families(self) -> tuple[str, ...]:
        """Families that have a variance."""
        return tuple(name for name, size in self.variances.items() if size > 0)

    def share(self, family: str) -> np.ndarray:
        """Variance (D,) of each unknown by a family."""
        return self.variances[family] * np.sum(self.slopes[family] ** 2, axis=1)

    @property
    def parameter_shares(self) -> Mapping[str, float]:
        """Mean share of the stated variances of the arm's parameters by family, masses too, largest first."""
        arm = self.plain.model.slices[ARM]
        total = np.diag(self.covariance)[arm]
        if not len(total):
            return {}
        mean = {name: float(np.mean(self.share(name)[arm] / total)) for name in self.families}
        if self.inputs.names:
            mean[MASSES] = float(np.mean(self.inputs.variances[arm] / total))
        return dict(sorted(mean.items(), key=lambda item: -item[1]))

    @property
    def covariance(self) -> np.ndarray:
        """Stated covariance of the unknowns, (D, D), before the prior limits it."""
        return self.wide.covariance[np.ix_(self.index, self.index)]

    @property
    def sd(self) -> np.ndarray:
        """Stated standard deviations of z, (D,)."""
        return np.linalg.norm(self.limit @ root(self.covariance), axis=1)

    @property
    def limited(self) -> np.ndarray:
        """Stated covariance (D, D), no wider than the prior: that of `sd` and of `reported` draws."""
        by = self.limit @ root(self.covariance)
        return by @ by.T

    def draws(self, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draws (S, D') of all unknowns of `wide`, from draws z (S, D) of the plain posterior.

        Deviations from the estimate are stretched to the covariance C P0 C + w S by the linear map that moves
        them least (optimal transport of normal distributions), and the functions' biases are added.
        """
        plain, size = root(self.plain.covariance), len(self.wide.z) - len(self.index)
        functions = balanced_normals(rng, len(z), size, z)
        extra = np.setdiff1d(np.arange(len(self.wide.z)), self.index)
        across = self.wide.covariance[np.ix_(self.index, extra)]
        target = self.covariance - across @ across.T
        # in coordinates in which the plain covariance is one, the map is the root of the target's
        inverse = np.linalg.pinv(plain)
        stretch = plain @ _symmetric_root(inverse @ target @ inverse.T) @ inverse
        out = np.zeros((len(z), len(self.wide.z)))
        out[:, extra] = functions
        out[:, self.index] = self.plain.z + (z - self.plain.z) @ stretch.T + functions @ across.T
        return out

    def reported(self, draws: np.ndarray) -> np.ndarray:
        """Draws (S, D) of the plain estimate's unknowns, from `draws`, no wider than the prior."""
        return self.plain.z + (draws[:, self.index] - self.plain.z) @ self.limit.T

    def remaining(self, residuals: Unexplained) -> Unexplained:
        """Unexplained residual without the part that the discrepancy explains."""
        square = residuals.excess**2 - (1.0 - self.white) * residuals.fitted**2
        return replace(residuals, excess=float(np.sqrt(max(square, 0.0))))

    @property
    def limit(self) -> np.ndarray:
        """Map (D, D) of deviations that limits their covariance to the prior's."""
        values, vectors = np.linalg.eigh(self.covariance)
        return (vectors / np.sqrt(np.maximum(values, 1.0))) @ vectors.T


def stated(fitted: Estimate, functions: Sequence[Family] | None = None) -> Stated:
    """State the uncertainty of an estimate.

    Parameters
    ----------
    fitted : Estimate
    functions : sequence of Family, optional
        Default: those of the fitted data. Estimates from parts of one session are comparable if all have the
        functions of the whole.
    """
    model = fitted.model

    def every() -> Sequence[Family]:
        """Made anew each time: of a large session their drivers take as much memory as their columns."""
        return families(model.scene.circumstances()) if functions is None else functions

    smooth = every()
    held = inputs(fitted)
    names = [f.name for f in smooth]
    family = np.repeat(np.arange(len(smooth)), np.array([len(f.parameters) for f in smooth], int))
    further = [*(p for f in smooth for p in f.parameters), *held]
    del smooth
    j, g, e, rows = linearised_with(fitted, further)
    pose = poses(model.scene.dataset.measurements, rows)
    c = fitted.covariance
    by = j @ c
    a = by.T @ g
    for start in range(0, len(g), ROWS):
        part = slice(start, start + ROWS)
        g[part] -= j[part] @ a
    errors = Inputs.of(
        [p.name for p in held], a[:, len(family) :], g[:, len(family) :], e, _joint(fitted, held)
    )
    a = a[:, : len(family)]
    # in place: of a large session the columns are the largest array
    h, residual = errors.without(g[:, : len(family)], g[:, len(family) :], e)
    level = moments.LIKELY if unexplained(fitted).excess else moments.CHANCE / max(len(names), 1)
    spare = len(e) - float(np.sum(by * j)) - errors.dof
    shown, chance = moments.variances(h, residual, pose, family, spare, level)
    explained = float(np.einsum("rk,rk->k", h, h) @ shown[family]) / len(h) if len(family) else 0.0
    white = 1.0 - min(explained, 1.0 - LEAST_WHITE)
    size = np.maximum(moments.UNSEEN * shown, [fitted.least.get(name, 0.0) for name in names])
    kept = np.flatnonzero(size[family] > 0)
    sd = np.sqrt(size[family[kept]])
    sizes = dict(zip(names, size.tolist(), strict=True))
    dof = {
        name: moments.degrees_of_freedom(h[:, family == k])
        for k, (name, own_size) in enumerate(zip(names, size, strict=True))
        if own_size > 0
    }
    del g, h  # of a large session more than all that follows
    further = [*(sized(every(), sizes) if len(kept) else ()), *mixed(held, errors.mixing)]
    wide, index, extra = model_with(model, further)
    z, covariance = np.zeros(wide.size), np.zeros((wide.size, wide.size))
    z[index] = fitted.z
    bias = a[:, kept] * sd
    noise, of = moments.scatter_factor(c, j, e, pose)
    noise = np.sqrt(white) * noise
    least = moments.complement(by, noise @ noise.T + bias @ bias.T)
    noise, of = np.concatenate([noise, least], axis=1), np.concatenate([of, np.arange(len(j))])
    bias = np.concatenate([bias, errors.slopes @ errors.mixing], axis=1)
    covariance[np.ix_(index, index)] = c - by.T @ by + noise @ noise.T + bias @ bias.T
    covariance[np.ix_(index, extra)] = -bias
    covariance[np.ix_(extra, index)] = -bias.T
    covariance[extra, extra] = 1.0
    slopes = {name: a[:, family == k] for k, name in enumerate(names)}
    widened = replace(fitted, model=wide, z=z, covariance=covariance)
    return Stated(fitted, widened, index, slopes, sizes, white, noise, rows[of], dof, errors,
                  dict(zip(names, chance.tolist(), strict=True)))  # fmt: skip


def sized(functions: Sequence[Family], variances: Mapping[str, float]) -> list[Parameter]:
    """The functions of families that have a variance, with their standard deviations."""
    return [
        replace(p, sd=p.sd * float(np.sqrt(variances[f.name])))
        for f in functions
        if variances[f.name] > 0
        for p in f.parameters
    ]


def _symmetric_root(matrix: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
