"""Unknown errors: any response of a joint times functions of any quantity of the log, in one joint or all."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN, Ranges
from bayescal.motion.effects import BASE, LOG, TOOL, Form, joint
from bayescal.motion.linear import Fit, Table, added
from bayescal.motion.noise import Noise
from bayescal.motion.quantities import Argument, Kept, arguments, kept, responses
from bayescal.motion.ripple import Waves
from bayescal.motion.search import SCALE_PRIOR, SCALES
from bayescal.motion.terms import Operating


@dataclass(frozen=True)
class Product:
    """A response times functions of a quantity, at joints (from 0)."""

    form: Form
    response: str
    argument: int
    joints: tuple[int, ...]


@dataclass(frozen=True)
class Bank:
    """Quantities and whitened products, over the motions of a table."""

    table: Table
    noise: Noise
    rows: tuple[Kept, ...]
    given: tuple[tuple[Argument, ...], ...]  # quantities of each motion
    size: np.ndarray  # (n,) N m, standard deviation of one function
    white: tuple[np.ndarray, ...]  # of each joint (R, P), in units of this standard deviation
    residual: tuple[np.ndarray, ...]  # of each channel (R,)

    @classmethod
    def of(cls, table: Table, noise: Noise, at: Operating, r: Ranges, waves: Waves, size: np.ndarray) -> Bank:
        """All products."""
        signals = [part.signals for part in table.parts]
        rows = tuple(kept(s, at, r) for s in signals)
        given = tuple(tuple(arguments(s, at, r, k, waves)) for s, k in zip(signals, rows, strict=True))
        white = []
        for j in range(signals[0].log.n):
            columns = [
                np.column_stack([by[name][:, None] * a.functions for a in of_motion for name in a.times])
                for by, of_motion in zip((responses(k, j) for k in rows), given, strict=True)
            ]
            white.append(np.concatenate([noise.whitened(c, j) for c in columns]) * size[j])
        residual = [
            np.concatenate([noise.whitened(part.residual[:, j], j) for part in table.parts])
            for j in range(table.parts[0].residual.shape[1])
        ]
        return cls(table, noise, rows, given, size, tuple(white), tuple(residual))

    def gains(self, fit: Fit) -> list[tuple[Product, float]]:
        """Log Bayes factor of each product beside a fit, averaged over scales.

        Quantities that belong to no joint may act in all: the evidence of each joint for it then adds up.
        """
        kinds = [(k, name) for k, a in enumerate(self.given[0]) for name in a.times]
        size = [self.given[0][k].functions.shape[1] for k, _ in kinds]
        ends = np.cumsum([0, *size])
        sets = [np.arange(low, high) for low, high in itertools.pairwise(ends)]
        nats = np.empty((len(self.white), len(sets)))
        for j, white in enumerate(self.white):
            cross = self.whitened(j, fit.chosen).T @ white
            score = self.residual[j] @ white
            table = added(fit, white.T @ white, cross, score, sets, SCALES)[0]
            odds = [0.0 if self.given[0][k].only in (None, j) else -np.inf for k, _ in kinds]
            nats[j] = logsumexp(table + SCALE_PRIOR, axis=1) + odds
        out = []
        for i, (k, name) in enumerate(kinds):
            a = self.given[0][k]
            driver = f"{name} times {a.name}" if name else a.name
            for j in range(len(self.white)):
                value = float(nats[j, i]) + a.log_prior
                out.append((Product(Form(UNKNOWN, joint(j), driver), name, k, (j,)), value))
            if a.joint is None:
                every = np.logaddexp(0.0, nats[:, i]) - np.log(2.0)
                joints = tuple(np.flatnonzero(nats[:, i] > 0.0).tolist())
                if len(joints) > 1:
                    site = self._site(a, every)
                    value = float(np.sum(every)) + a.log_prior
                    out.append((Product(Form(UNKNOWN, site, driver), name, k, joints), value))
        return out

    def _site(self, a: Argument, nats: np.ndarray) -> str:
        """Of an error in several joints: an oscillation is of what carries the arm or what it carries."""
        if not a.moves:
            return LOG
        half = len(nats) // 2
        return BASE if np.sum(nats[:half]) > np.sum(nats[half:]) else TOOL

    def columns(self, p: Product) -> tuple[np.ndarray, ...]:
        """Columns of a product by motion, (M, C, k), each 0 but in one channel, N m."""
        count = self.given[0][p.argument].functions.shape[1]
        out = []
        for part, k, given in zip(self.table.parts, self.rows, self.given, strict=True):
            x = np.zeros((*part.residual.shape, count * len(p.joints)))
            for i, j in enumerate(p.joints):
                x[:, j, i * count : (i + 1) * count] = (
                    self.size[j] * responses(k, j)[p.response][:, None] * given[p.argument].functions
                )
            out.append(x)
        return tuple(out)

    def whitened(self, j: int, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """Whitened columns (R, k) of some terms at a channel, in units of prior standard deviations."""
        out = []
        for part in self.table.parts:
            place = {number: k for k, number in enumerate(part.numbers[j].tolist())}
            x = np.zeros((len(part.residual), len(chosen)))
            there = [k for k, number in enumerate(chosen) if number in place]
            x[:, there] = part.columns[j][:, [place[chosen[k]] for k in there]]
            out.append(self.noise.whitened(x, j))
        return np.concatenate(out) * np.array([self.table.terms[k].sd for k in chosen])
