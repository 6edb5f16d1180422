"""Prior widths by evidence: families of parameters that are larger than their stated prior makes likely.

The priors of an arm's parameters are those of usual arms. Where the parameters of a family are several prior
standard deviations from their means, the estimate is pulled towards the means, and its uncertainty is too
small. Each family f then has a factor s_f >= 1 on its prior standard deviations, by the evidence (MacKay
1992, Neural Computation 4, 415). With C the covariance of the estimate z under the stated priors and
W = 1 - C, z is W times the true unknowns plus an error of covariance N, that of measurements, certificates
and of the discrepancy:

    z ~ N(0, W S W' + N),  N = stated covariance - C C,  S = diag(s_f^2) of the arm, 1 of the targets

for every S, as the estimator is the same. log s_f has a normal hyperprior. The factors are used only where
they gain `TOLD` nats together: the stated priors stay otherwise. No width is reduced, as data that could tell
it leave little to the prior.

Parameters that are many prior standard deviations off are cheaper to fit by larger noise, and N then hides
their widths. Where the residuals are much larger than the stated noise, fits with all widths times one of
`COMMON` are therefore compared first, by the evidence of the measurements with the noise of each fit. The
most probable one tells the widths of the families, S in units of its priors; they are used if their fit is
more probable still.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np
from scipy.optimize import minimize

from bayescal.errors import FAILURES
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.estimate import Estimate, fitted_level
from bayescal.estimate.moments import likelihood, shifts
from bayescal.estimate.solver import STATED_WORTH
from bayescal.model.block import ARM
from bayescal.model.options import STATED, FitOptions, family
from bayescal.model.scene import Scene
from bayescal.statistics import grouped

TOLD, LEAST = 4.0, 1.0
"""Nats that factors together must gain over none, odds of 50, and each of them over its stated width
(convention)."""
SPREAD = float(np.log(3.0))
"""Standard deviation of the logarithm of a factor, a priori: a factor of three is usual (assumed)."""
LARGEST = 30.0
"""Largest factor: beyond it a value of the robot file is wrong, or a unit."""
COMMON, LARGE = (3.0, 10.0, 30.0), 3.0
"""Factors on the widths of all families, which are compared where the residuals are more than `LARGE` times
the stated noise (conventions)."""
SMALLEST = 1e-9
"""Share of the largest variance of a direction below which the estimate says nothing of it."""


@dataclass(frozen=True)
class Width:
    """A family of parameters with a wider prior than stated."""

    family: str
    factor: float
    nats: float  # gain of log evidence, hyperprior included
    parameters: tuple[str, ...]

    @property
    def words(self) -> str:
        """The width as a sentence."""
        return (
            f"the {self.family} are larger than their prior makes likely: fitted with {self.factor:.2g} "
            f"times its width ({self.nats:+.0f} nats)"
        )


@dataclass(frozen=True)
class Spread:
    """The estimate of P parameters of the arm, and its covariance by errors of each kind."""

    z: np.ndarray  # (P,)
    noise: np.ndarray  # (P, P) N, and the part of the targets and of parameters without a family
    by_family: tuple[np.ndarray, ...]  # (P, P) each: W W' of the members

    @classmethod
    def of(
        cls, fitted: Estimate, covariance: np.ndarray, members: Sequence[np.ndarray],
        wide: Sequence[float] | None = None,
    ) -> Spread:  # fmt: skip
        """Of an estimate with its stated covariance (D, D); `members` are the places of each family.

        `wide` are the factors on their stated widths that the estimate has, 1 by default.
        """
        arm, c = fitted.model.slices[ARM], fitted.covariance
        by = (np.eye(len(c)) - c)[arm]
        others = np.setdiff1d(np.arange(len(c)), np.concatenate([np.zeros(0, int), *members]))
        noise = (covariance - c @ c)[arm, arm] + by[:, others] @ by[:, others].T
        wide = wide or [1.0] * len(members)
        parts = [by[:, index] @ by[:, index].T / w**2 for index, w in zip(members, wide, strict=True)]
        # in units of the estimate's spread under the stated priors, in the directions that it has
        values, vectors = np.linalg.eigh(noise + sum(parts))
        kept = values > SMALLEST * values[-1]
        white = (vectors[:, kept] / np.sqrt(values[kept])).T
        return cls(white @ fitted.z[arm], white @ noise @ white.T, tuple(white @ p @ white.T for p in parts))

    def loss(self, log_factors: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log evidence of factors (F,), with the hyperprior, and its slopes (F,)."""
        square = np.exp(2.0 * log_factors)
        spread = self.noise + sum(s * p for s, p in zip(square, self.by_family, strict=True))
        inverse = np.linalg.inv(spread)
        pull = inverse @ self.z
        value = 0.5 * (np.linalg.slogdet(spread)[1] + self.z @ pull + np.sum((log_factors / SPREAD) ** 2))
        slopes = [s * (np.sum(inverse * p) - pull @ p @ pull)
                  for s, p in zip(square, self.by_family, strict=True)]  # fmt: skip
        return float(value), np.array(slopes) + log_factors / SPREAD**2

    def uncertainty(self, log_factors: np.ndarray, free: Sequence[int]) -> np.ndarray:
        """Variances of the free log factors, by their expected information and the hyperprior."""
        square = np.exp(2.0 * log_factors)
        spread = self.noise + sum(s * p for s, p in zip(square, self.by_family, strict=True))
        by = [2.0 * square[k] * np.linalg.solve(spread, self.by_family[k]) for k in free]
        information = [[0.5 * np.sum(a * b.T) for b in by] for a in by]
        return np.diag(np.linalg.inv(np.array(information) + np.eye(len(by)) / SPREAD**2))

    def best(self, free: Sequence[int]) -> tuple[np.ndarray, float]:
        """Most probable log factors (F,) of which only those of some families are `free`, and their loss."""
        limits = [(0.0, float(np.log(LARGEST)) if k in free else 0.0) for k in range(len(self.by_family))]
        optimum = minimize(self.loss, np.zeros(len(limits)), jac=True, bounds=limits, method="L-BFGS-B")
        return optimum.x, float(optimum.fun)


def widths(
    fitted: Estimate, covariance: np.ndarray, wide: Mapping[str, float] | None = None,
    among: Collection[str] | None = None,
) -> tuple[Width, ...]:  # fmt: skip
    """The families whose values tell a wider prior than the stated one; none usually.

    Parameters
    ----------
    fitted : Estimate
    covariance : np.ndarray, shape (D, D)
        Stated covariance of its unknowns, z, at least that of the solver.
    wide : mapping, optional
        Factors on the stated widths of families that the estimate has.
    among : collection of str, optional
        Families that may be wider; by default all.
    """
    families = families_of(fitted)
    free = [k for k, name in enumerate(families) if among is None or name in among]
    if not free:
        return ()
    has = [(wide or {}).get(name, 1.0) for name in families]
    names, members = list(families), list(families.values())
    spread = Spread.of(fitted, covariance, [np.array(index) for index in members], has)
    factors, loss = spread.best(free)
    if spread.loss(np.zeros(len(families)))[0] - loss < TOLD:
        return ()
    gains = {k: spread.best([f for f in free if f != k])[1] - loss for k in free}
    while free and min(gains.values()) < LEAST:
        del free[free.index(min(gains, key=lambda k: gains[k]))]
        factors, loss = spread.best(free)
        gains = {k: spread.best([f for f in free if f != k])[1] - loss for k in free}
    # the root of the mean square of a factor, whose logarithm is normal
    mean = np.exp(factors[free] + spread.uncertainty(factors, free)) if free else np.zeros(0)
    return tuple(
        Width(names[k], float(factor), gain, tuple(fitted.model.parameters[i].name for i in members[k]))
        for factor, (k, gain) in zip(mean, gains.items(), strict=True)
    )


def families_of(fitted: Estimate) -> dict[str, list[int]]:
    """The places of the parameters of each family of a fitted model."""
    every = enumerate(map(family, fitted.model.parameters))
    return grouped((name, k) for k, name in every if name)


def log_evidence(fitted: Estimate, left_out: np.ndarray) -> float:
    """Log density of the measurements under a model, at the estimated noise (Laplace), less a constant.

    Parameters
    ----------
    fitted : Estimate
    left_out : np.ndarray of int
        Rows of the session that do not count, in all estimates that are compared.
    """
    weights, ends = fitted.weights, [part.stop for part in fitted.linear.of_block.values()]
    constraints = fitted.linear.residual[max(ends, default=0) :]
    square = fitted.z @ fitted.z + constraints @ constraints
    out = 0.5 * np.linalg.slogdet(fitted.covariance)[1] - 0.5 * square
    for block in fitted.model.blocks:
        kept, scale = ~np.isin(block.rows, left_out), weights.scale[block.group]
        kept = np.tile(kept, block.kind.rows)
        white = (fitted.residuals(block).ravel() / (scale * weights.sigma[block.name]))[kept]
        if block.name in weights.shared:
            apart = weights.shared[block.name][kept].decorrelated()
            white, out = apart.white(white), out + apart.log_det
        out -= 0.5 * np.sum(white**2) + white.size * np.log(scale)
    out -= STATED_WORTH * sum(np.log(k) + 0.5 / k**2 for k in weights.scale.values())
    return float(out)


Widened = tuple[Estimate, FitOptions, tuple[Width, ...]]
"""A fit with wider priors, its options, and the widths."""


def _by_noise(
    fitted: Estimate, scene: Scene, effects: tuple[str, ...], options: FitOptions
) -> Widened | None:
    """The fit with wider priors that larger noise hides; None where the stated ones are as probable."""
    families = families_of(fitted)
    if not families or max(fitted.weights.scale.values(), default=1.0) < LARGE:
        return None

    def refitted(widening: Mapping[str, float]) -> tuple[Estimate, FitOptions] | None:
        wider = replace(options, widths=widening)
        try:
            return fitted_level(scene, effects, wider), wider
        except FAILURES:  # no length is known, or the solution is out of reach
            return None

    tried = ((by, refitted(dict.fromkeys(families, by))) for by in COMMON)
    fits = {by: fit for by, fit in tried if fit is not None}
    left_out = np.unique(np.concatenate([fitted.rejected, *(f.rejected for f, _ in fits.values())]))
    before = log_evidence(fitted, left_out)
    gains = {by: log_evidence(f, left_out) - before - 0.5 * (np.log(by) / SPREAD) ** 2
             for by, (f, _) in fits.items()}  # fmt: skip
    by = max(gains, key=gains.__getitem__, default=1.0)
    if gains.get(by, 0.0) < TOLD:
        return None
    common, wider = fits[by]
    individual = widths(common, stated(common).covariance, dict.fromkeys(families, by))
    if individual and (fit := refitted(factors(individual))):
        paid = sum(np.log(w.factor) ** 2 for w in individual) / (2.0 * SPREAD**2)
        if log_evidence(fit[0], left_out) - before - paid > gains[by]:
            return *fit, individual
    names = common.model.parameters
    wide_families = (
        Width(name, by, gains[by], tuple(names[k].name for k in index)) for name, index in families.items()
    )
    return common, wider, tuple(wide_families)


def with_widths(fitted: Estimate, scene: Scene, effects: tuple[str, ...], options: FitOptions) -> Widened:
    """An estimate under the stated priors, or where its values tell wider ones, the fit under those.

    Priors of the robot file that contradict the data are not used; see `doubted`.

    Parameters
    ----------
    fitted : Estimate
        As `fitted_level` returns it.
    scene : Scene
    effects : tuple of str
    options : FitOptions
        Of the estimate; those of the fit that is returned have its widths.
    """
    if names := doubted(fitted, scene, effects, options):
        options = replace(options, doubted=names)
        fitted = fitted_level(scene, effects, options)
    widened = _by_noise(fitted, scene, effects, options)
    if widened is not None:
        return widened
    likely = widths(fitted, fitted.covariance)
    if not likely:  # the stated covariance is wider, and takes longer
        return fitted, options, ()
    wide_families = widths(fitted, stated(fitted).covariance)
    try:
        wide_families = wide_families or _without_its_errors(likely, scene, effects, options)
        if wide_families:
            wider = replace(options, widths=factors(wide_families))
            return fitted_level(scene, effects, wider), wider, wide_families
    except FAILURES:  # no length is known, or the solution is out of reach: the stated priors hold
        pass
    return fitted, options, ()


def _without_its_errors(
    likely: Sequence[Width], scene: Scene, effects: tuple[str, ...], options: FitOptions
) -> tuple[Width, ...]:
    """Widths of what a session states of cameras and boards, by the covariance of the fit that has them.

    A wrong focal length biases the arm, and its errors look like a discrepancy that hides its evidence. The
    fit with its width has none of these.
    """
    among = {w.family: w.factor for w in likely if w.family in STATED.values()}
    if not among:
        return ()
    wider = fitted_level(scene, effects, replace(options, widths=among))
    return widths(wider, stated(wider).covariance, among, among)


def simpler_level(scene: Scene, effects: tuple[str, ...], options: FitOptions) -> Estimate:
    """A simpler level of a model, with the widths that the model told, or the stated ones if it needs these.

    Parameters
    ----------
    scene : Scene
    effects : tuple of str
    options : FitOptions
        Of the fit of the model, with its widths.
    """
    try:
        return fitted_level(scene, effects, options)
    except FAILURES:
        if not options.widths:
            raise
        return fitted_level(scene, effects, replace(options, widths={}))


def factors(wide_families: Sequence[Width]) -> Mapping[str, float]:
    """Factors of prior standard deviations by family."""
    return {w.family: w.factor for w in wide_families}


def sentences(wide_families: Sequence[Width]) -> tuple[str, ...]:
    """The widths as sentences, one for all families if they have a common factor."""
    if len({(w.factor, w.nats) for w in wide_families}) != 1:
        return tuple(w.words for w in wide_families)
    every = ", ".join(w.family for w in wide_families)
    return (replace(wide_families[0], family=every).words,)


FAR, MOST = 4.0, 6
"""Standard deviations, of prior and data, beyond which a prior of the robot file is not used, and the largest
number of such parameters (conventions)."""


def doubted(fitted: Estimate, scene: Scene, effects: tuple[str, ...], options: FitOptions) -> tuple[str, ...]:
    """Parameters whose priors in the robot file contradict what the data tell with the usual priors.

    A narrow prior that is wrong can be fitted by larger noise, and its width then has no evidence. So what
    the fit under the usual priors tells is compared with it: one parameter, then a second beside it.
    """
    names = [p.name for p in fitted.model.parameters if p.usual is not None]
    if not names:
        return ()
    try:
        usual = fitted_level(scene, effects, replace(options, doubted=tuple(names)))
    except FAILURES:  # with the usual priors the session cannot be fitted
        return ()
    arm, parameters = usual.model.slices[ARM], usual.model.parameters
    information, score = likelihood(
        usual.z[arm], usual.covariance[arm, arm], stated(usual).covariance[arm, arm]
    )
    # the prior of the file, in units of the usual one
    file = {p.name: p for p in fitted.model.parameters}
    mean = np.array([(file[p.name].centre - p.centre) / p.sd for p in parameters])
    sd = np.array([file[p.name].sd / p.sd for p in parameters])
    every = shifts(information, score, mean, np.diag(sd**2), MOST)
    far = takewhile(lambda s: abs(s.ratio) >= FAR and parameters[s.index].name in names, every)
    return tuple(parameters[s.index].name for s in far)
