"""The linear problem of a log: products of whitened columns, estimates and evidence from these alone.

Columns are low-passed once and kept at their own rate; a noise model whitens them, and from there on only
their products are needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from tempfile import TemporaryFile

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from bayescal.motion.noise import Noise
from bayescal.motion.settings import NOISE
from bayescal.motion.signals import Signals, each
from bayescal.motion.terms import Column, Term, assembled

Block = Callable[[], np.ndarray]
"""Gives columns, in single precision."""


class Temporary:
    """A file without a name for columns, mapped when they are asked for: an hour of log has 10^9 bytes."""

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115 (closed with the last block)

    def __del__(self) -> None:
        self._file.close()

    def put(self, x: np.ndarray) -> Block:
        """Append columns (M, k)."""
        start, shape = self._file.tell(), x.shape
        if not x.size:  # nothing cannot be mapped
            return lambda: np.empty(shape, np.float32)
        self._file.write(np.ascontiguousarray(x, np.float32).data)
        self._file.flush()
        return lambda: np.asarray(np.memmap(self._file, np.float32, "r", start, shape))


Columns = Callable[[Signals], Iterable[Column]]
Sparse = Sequence[Mapping[int, Block]]
"""Columns (M, k) by motion, of each channel that has them."""


@dataclass(frozen=True)
class Part:
    """Low-passed rows of one motion: residuals (M, C); of each channel the terms that act, (M, K).

    Both have the weights (M, C) of the rows.
    """

    signals: Signals
    weight: np.ndarray
    residual: np.ndarray
    numbers: tuple[np.ndarray, ...]
    blocks: tuple[tuple[Block, ...], ...]  # of columns
    wider: float | np.ndarray = 1.0  # noise of this motion over that of the others, of each channel

    def of(self, channel: int) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (K,) of the terms that act in a channel, and their columns (M, K)."""
        blocks = [block() for block in self.blocks[channel]]
        return self.numbers[channel], blocks[0] if len(blocks) == 1 else np.hstack(blocks)

    @property
    def channels(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The same of each channel."""
        return map(self.of, range(len(self.numbers)))

    @cached_property
    def missing(self) -> tuple[np.ndarray, ...]:
        """Rows of each channel in which its joint rests."""
        return tuple(np.flatnonzero(w < NOISE.there) for w in self.weight.T)

    def whitened(self, noise: Noise, x: np.ndarray, channel: int) -> np.ndarray:
        """Rows (M, ...) of a channel without their predictable part, in units of the noise."""
        white = noise.without(noise.whitened(x, channel), self.missing[channel], channel)
        return white / np.broadcast_to(self.wider, len(self.numbers))[channel]


@dataclass(frozen=True)
class Table:
    """The terms of a model of torques, and their columns in every motion."""

    terms: tuple[Term, ...]
    parts: tuple[Part, ...]

    @cached_property
    def acting(self) -> dict[str, frozenset[int]]:
        """Channels in which each term acts, in any motion."""
        there = np.zeros((len(self.terms), len(self.parts[0].numbers)), bool)
        for part in self.parts:
            for channel, numbers in enumerate(part.numbers):
                there[numbers, channel] = True
        channels = (frozenset(np.flatnonzero(row).tolist()) for row in there)
        return dict(zip((term.name for term in self.terms), channels, strict=True))

    def of_role(self, *roles: str) -> Table:
        """The motions of some roles."""
        return Table(self.terms, tuple(p for p in self.parts if p.signals.role in roles))

    def wider(self, role: str, factor: np.ndarray) -> Table:
        """The table with more noise in the motions of a role, by a factor of each channel."""
        parts = (replace(p, wider=factor) if p.signals.role == role else p for p in self.parts)
        return Table(self.terms, tuple(parts))

    def extended(self, further: Sequence[tuple[Sequence[Term], Sparse]]) -> Table:
        """The table with further terms, each set with its columns."""
        starts = np.cumsum([len(self.terms), *(len(terms) for terms, _ in further)])
        parts = []
        for m, part in enumerate(self.parts):
            numbers, values = list(part.numbers), list(part.blocks)
            for (terms, columns), first in zip(further, starts.tolist(), strict=False):
                for c, x in columns[m].items():
                    numbers[c] = np.r_[numbers[c], first + np.arange(len(terms))].astype(int)
                    values[c] = (*values[c], x)
            parts.append(replace(part, numbers=tuple(numbers), blocks=tuple(values)))
        return Table((*self.terms, *(t for terms, _ in further for t in terms)), tuple(parts))

    def residuals(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """What values of terms leave of the residuals (M, C), by motion."""
        vector = np.array([values.get(term.name, 0.0) for term in self.terms])
        return [
            part.residual - np.column_stack([x @ vector[k] for k, x in part.channels]) for part in self.parts
        ]


def predicted(table: Table, fit: Fit, names: Sequence[str]) -> list[np.ndarray]:
    """What some terms of a fit predict in each motion (M, C)."""
    residuals = table.residuals({name: fit.values[name] for name in names})
    return [part.residual - r for part, r in zip(table.parts, residuals, strict=True)]


def tabulated(parts: Sequence[Signals], columns: Columns, residual: Callable[[Signals], np.ndarray]) -> Table:
    """The columns of some motions."""
    out, put = list[Part](), Temporary().put
    terms: tuple[Term, ...] = ()
    for s in each(parts):
        names, numbers, values = assembled(columns(s), s)
        terms = tuple(names)
        weight = np.tile(s.weight, len(values) // s.log.n)
        kept = [s.kept(x * w[:, None]).astype(np.float32) for x, w in zip(values, weight.T, strict=True)]
        acting = [np.any(x, axis=0) for x in kept]  # many functions of time are 0 in a motion
        chosen = tuple(np.array(k, int)[there] for k, there in zip(numbers, acting, strict=True))
        rows = tuple((put(np.compress(there, x, axis=1)),) for x, there in zip(kept, acting, strict=True))
        out.append(Part(s, s.kept(weight), s.kept(residual(s) * weight), chosen, rows))
    return Table(terms, tuple(out))


@dataclass(frozen=True)
class Normal:
    """Normal equations of K terms: `gram` (K, K), `score` (K,), and chi-square (C,) of channels."""

    terms: tuple[Term, ...]
    gram: np.ndarray
    score: np.ndarray
    chi2: np.ndarray

    @property
    def index(self) -> dict[str, int]:
        """Number of each term by its name."""
        return {term.name: k for k, term in enumerate(self.terms)}


@dataclass(frozen=True)
class Further:
    """What another measurement tells of K parameters, SI: information (K, K), score (K,) at nominal."""

    names: tuple[str, ...]
    information: np.ndarray
    score: np.ndarray

    def beside(self, p: Normal) -> Normal:
        """Normal equations with this measurement too."""
        chosen = np.array([p.index[name] for name in self.names])
        sd = np.array([p.terms[k].sd for k in chosen])
        gram, score = p.gram.copy(), p.score.copy()
        gram[np.ix_(chosen, chosen)] += self.information * np.outer(sd, sd)
        score[chosen] += self.score * sd
        return replace(p, gram=gram, score=score)


def joined(a: Normal, b: Normal) -> Normal:
    """Normal equations of the motions of both."""
    return Normal(a.terms, a.gram + b.gram, a.score + b.score, a.chi2 + b.chi2)


def normal(table: Table, noise: Noise, before: Normal | None = None) -> Normal:
    """Normal equations of all motions of a table, in units of the terms' prior standard deviations.

    `before` has those of the first terms of the table: only products with the others are then computed.
    """
    size, first = len(table.terms), 0
    sd = np.array([t.sd for t in table.terms])
    gram, score, chi2 = np.zeros((size, size)), np.zeros(size), np.zeros(len(noise.sd))
    if before is not None:
        first, chi2 = len(before.terms), before.chi2
        gram[:first, :first], score[:first] = before.gram, before.score
    for part in table.parts:
        for j, (chosen, x) in enumerate(part.channels):
            new = chosen >= first
            if not np.any(new):
                continue
            white = part.whitened(noise, x, j) * sd[chosen]
            y = part.whitened(noise, part.residual[:, j], j)
            border = white[:, new].T @ white
            gram[np.ix_(chosen[new], chosen)] += border
            gram[np.ix_(chosen[~new], chosen[new])] += border[:, ~new].T
            score[chosen[new]] += white[:, new].T @ y
            if before is None:
                chi2[j] += y @ y
    return Normal(table.terms, gram, score, chi2)


@dataclass(frozen=True)
class Fit:
    """Terms fitted with their priors: `z` (k,) and `covariance` in units of prior standard deviations."""

    normal: Normal
    chosen: np.ndarray  # (k,) numbers of terms
    scales: np.ndarray  # (k,) factors on the prior standard deviations
    factor: tuple[np.ndarray, bool]
    z: np.ndarray
    log_evidence: float  # up to a constant of the data

    @property
    def covariance(self) -> np.ndarray:
        """Of `z`."""
        return cho_solve(self.factor, np.eye(len(self.z)))

    @property
    def vector(self) -> np.ndarray:
        """Estimates (K,) of all terms in units of their prior standard deviations, 0 of those not fitted."""
        out = np.zeros(len(self.normal.terms))
        out[self.chosen] = self.z * self.scales
        return out

    @property
    def names(self) -> list[str]:
        """Names (k,) of the terms."""
        return [self.normal.terms[k].name for k in self.chosen]

    @property
    def sd(self) -> np.ndarray:
        """Prior standard deviations (k,), SI, scaled."""
        return np.array([self.normal.terms[k].sd for k in self.chosen]) * self.scales

    @property
    def values(self) -> dict[str, float]:
        """Estimates in SI by the names of terms."""
        return dict(zip(self.names, (self.z * self.sd).tolist(), strict=True))

    @property
    def u(self) -> dict[str, float]:
        """Standard uncertainties of `values`."""
        u = np.sqrt(np.diag(self.covariance)) * self.sd
        return dict(zip(self.names, u.tolist(), strict=True))

    def followed(self, table: Table) -> Iterator[list[np.ndarray]]:
        """Of each motion and channel columns (M, k) in units of the standard uncertainties of estimates.

        Their products are the covariance of what the estimates add to the rows.
        """
        size = np.zeros(len(table.terms))
        size[self.chosen] = self.sd
        place = np.zeros(len(table.terms), int)
        place[self.chosen] = np.arange(len(self.chosen))
        for part in table.parts:
            out = []
            for numbers, x in part.channels:
                in_fit = size[numbers] > 0.0
                rows = np.zeros((len(self.chosen), len(x)))
                rows[place[numbers[in_fit]]] = (x[:, in_fit] * size[numbers[in_fit]]).T
                out.append(solve_triangular(self.factor[0], rows, lower=True).T)
            yield out

    def chi2(self, other: Normal | None = None) -> float:
        """Chi-square that the estimates leave, of these rows or of others."""
        p = other or self.normal
        z = self.z * self.scales
        part = p.gram[np.ix_(self.chosen, self.chosen)]
        return float(np.sum(p.chi2) - 2.0 * z @ p.score[self.chosen] + z @ part @ z)


def fitted(p: Normal, chosen: Sequence[int] | np.ndarray, scales: np.ndarray | None = None) -> Fit:
    """Fit some terms, with normal priors about 0."""
    chosen = np.asarray(chosen, int)
    scales = np.ones(len(chosen)) if scales is None else scales
    information = p.gram[np.ix_(chosen, chosen)] * np.outer(scales, scales)
    factor = cho_factor(information + np.eye(len(chosen)), lower=True)
    score = p.score[chosen] * scales
    z = cho_solve(factor, score)
    evidence = 0.5 * float(score @ z) - float(np.sum(np.log(np.diag(factor[0]))))
    return Fit(p, chosen, scales, factor, z, evidence)


def gains(fit: Fit, sets: Sequence[np.ndarray], scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log Bayes factors (S, scales) of adding sets of terms to a fit, each with its prior scaled.

    Also the information (S,) of each set beside the fit, per squared prior standard deviation: its trace.
    """
    p = fit.normal
    blocks = [p.gram[np.ix_(chosen, chosen)] for chosen in sets]
    return added(fit, (blocks, p.gram[fit.chosen], p.score), sets, scales)


Dots = tuple[list[np.ndarray], np.ndarray, np.ndarray]
"""Products of whitened columns: of each set with itself; of all P columns with the terms of a fit (k, P), and
with the residual (P,)."""


def added(
    fit: Fit, dots: Dots, sets: Sequence[np.ndarray], scales: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """As `gains`, of sets of any columns.

    Parameters
    ----------
    fit : Fit
    dots : Dots
    sets : sequence of np.ndarray
        Numbers of the columns of each set.
    scales : np.ndarray
        Factors on the prior standard deviations of the columns.
    """
    blocks, cross, score = dots
    half = solve_triangular(fit.factor[0], cross * fit.scales[:, None], lower=True)
    score = score - (cross * fit.scales[:, None]).T @ fit.z
    out, size = np.empty((len(sets), len(scales))), np.array([len(chosen) for chosen in sets])
    trace = np.empty(len(sets))
    squares = scales[:, None, None] ** 2
    for count in np.unique(size):
        rows = np.flatnonzero(size == count)
        chosen = np.array([sets[k] for k in rows.tolist()])  # (B, count)
        part = np.moveaxis(half[:, chosen], 0, 1)  # (B, D, count)
        beside = np.array([blocks[k] for k in rows.tolist()]) - np.swapaxes(part, 1, 2) @ part
        values, vectors = np.linalg.eigh(beside)
        values = np.maximum(values, 0.0)
        along = np.einsum("bij,bi->bj", vectors, score[chosen]) ** 2
        by = squares * values
        out[rows] = 0.5 * np.sum(squares * along / (1.0 + by) - np.log1p(by), axis=2).T
        trace[rows] = np.sum(values, axis=1)
    return out, trace
