"""Tails of the usual distributions, root mean squares, groups, and seeds of streams of random numbers.

Tails are those of `scipy.special`: `scipy.stats` takes a second to import. Each takes arrays. Without degrees
of freedom there is no distribution: NaN, as `scipy.stats` has it.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from math import nan
from typing import Any, TypeVar

import numpy as np
from scipy import special

Values = Any
"""A number or an array of numbers; all arguments broadcast."""
Label = TypeVar("Label", bound=Hashable)
Value = TypeVar("Value")


def rms(x: np.ndarray, of_none: float = nan) -> float:
    """Root mean square of values of any shape."""
    return float(np.sqrt(np.mean(x**2))) if x.size else of_none


def grouped(pairs: Iterable[tuple[Label, Value]]) -> dict[Label, list[Value]]:
    """Values by label, both in the order in which they come."""
    out: dict[Label, list[Value]] = {}
    for label, value in pairs:
        out.setdefault(label, []).append(value)
    return out


def decimals_of(u: float) -> int:
    """Decimals with which a positive uncertainty has two significant digits; below zero before the point."""
    decimals = 1 - int(np.floor(np.log10(u)))
    return 1 - int(np.floor(np.log10(round(u, decimals))))  # 0.0996 has become 0.10


def chi2_sf(x: Values, dof: Values) -> Any:
    """Probability that chi-square exceeds x."""
    return np.where(np.asarray(dof) > 0, special.chdtrc(dof, np.maximum(x, 0.0)), np.nan)


def chi2_isf(p: Values, dof: Values) -> Any:
    """Value that chi-square exceeds with probability p."""
    return special.chdtri(dof, p)


def f_noncentrality(p: Values, dof: Values, dof_below: Values, x: Values) -> Any:
    """Noncentrality with which F exceeds x with probability p."""
    return special.ncfdtrinc(dof, dof_below, 1.0 - np.asarray(p), x)


def f_sf(x: Values, dof: Values, dof_below: Values) -> Any:
    """Probability that F exceeds x; `dof_below` is of the denominator."""
    return special.fdtrc(dof, dof_below, np.maximum(x, 0.0))


def f_isf(p: Values, dof: Values, dof_below: Values) -> Any:
    """Value that F exceeds with probability p."""
    return special.fdtri(dof, dof_below, 1.0 - np.asarray(p))


def t_sf(x: Values, dof: Values) -> Any:
    """Probability that Student's t exceeds x."""
    return special.stdtr(dof, -np.asarray(x))


def t_ppf(p: Values, dof: Values) -> Any:
    """Value below which Student's t lies with probability p."""
    return special.stdtrit(dof, p)


def poisson_sf(k: Values, mean: Values) -> Any:
    """Probability of more than k events."""
    return np.where(np.asarray(k) < 0, 1.0, special.pdtrc(np.floor(np.maximum(k, 0)), mean))


def hypergeometric_log_sf(sizes: np.ndarray, total: int, count: int) -> np.ndarray:
    """Log probabilities (G, total + 1) that at least 0, 1, ... of `total` chosen rows are in each group.

    `sizes` (G,) of groups among `count` rows, of which `total` are chosen at random without replacement.
    """
    inside, size = np.arange(total + 1), np.asarray(sizes)[:, None]

    def choose(n: Values, k: Values) -> np.ndarray:
        return special.gammaln(n + 1.0) - special.gammaln(k + 1.0) - special.gammaln(n - k + 1.0)

    possible = (inside <= size) & (total - inside <= count - size)
    k = np.where(possible, inside, np.maximum(total - (count - size), 0))
    mass = choose(size, k) + choose(count - size, total - k) - choose(count, total)
    mass = np.where(possible, mass, -np.inf)
    return np.logaddexp.accumulate(mass[:, ::-1], axis=1)[:, ::-1]


def spawned(seed: int, count: int) -> tuple[int, ...]:
    """Seeds for `count` independent generators; the same seed gives the same result.

    Two generators with the same seed give the same numbers: draws of the posterior and of the noise added
    to them would be correlated (`numpy.random.SeedSequence.spawn`).
    """
    children = np.random.SeedSequence(seed).spawn(count)
    return tuple(int(child.generate_state(1, np.uint64)[0]) for child in children)


def stream(seed: int, *names: str) -> np.random.Generator:
    """An independent generator for each name, so that draws of one part do not change those of another."""
    words = [int.from_bytes(name.encode(), "little") for name in names]
    return np.random.default_rng(np.random.SeedSequence([seed, *words]))


def balanced_normals(
    rng: np.random.Generator, count: int, size: int, beside: np.ndarray | None = None
) -> np.ndarray:
    """Standard normal draws (count, size) whose own mean is 0 and whose own covariance is one.

    Standard deviations of what is linear in them then have no scatter. They are not correlated with the
    columns of `beside` (count, K). Where there are too few draws for that, they are plain ones.
    """
    x = rng.standard_normal((count, size))
    others = np.ones((count, 1)) if beside is None else np.column_stack([np.ones(count), beside])
    if count < 2 * (size + others.shape[1]):
        return x
    basis = np.linalg.qr(others)[0]
    x -= basis @ (basis.T @ x)
    return x @ np.linalg.inv(np.linalg.cholesky(x.T @ x / count)).T
