"""Unknown errors: any response of a joint times functions of any quantity of the log, in one joint or all."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN, Ranges
from bayescal.motion.effects import BASE, LOG, TOOL, Form, joint
from bayescal.motion.linear import Fit, Table, added
from bayescal.motion.noise import Noise
from bayescal.motion.quantities import Argument, Kept, arguments, kept, responses
from bayescal.motion.ripple import Waves
from bayescal.motion.search import SCALE_PRIOR, SCALES
from bayescal.motion.terms import TRACKING, Operating, channel, displaced, kinds

MOVES = "a torque of the arm"
"""Setting of a product under which a servo moves: it is no error of the torques' measurement."""
Dots = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Products of columns: with themselves (P, P), with the terms of a fit (k, P), with the residual (P,)."""


@dataclass(frozen=True)
class Product:
    """A response times functions of a quantity, at joints (from 0)."""

    form: Form
    response: str
    argument: int
    joints: tuple[int, ...]
    moves: tuple[bool, ...]  # whether the servo of each moves under it


Gains = list[tuple[Product, float]]
"""Products, each with its log Bayes factor."""


@dataclass(frozen=True)
class Bank:
    """Quantities and whitened products, over the motions of a table."""

    table: Table
    noise: Noise
    rows: tuple[Kept, ...]
    given: tuple[tuple[Argument, ...], ...]  # quantities of each motion
    size: np.ndarray  # (n,) N m, standard deviation of one function
    white: tuple[np.ndarray, ...]  # of each joint (R, P), in units of this standard deviation
    tracked: tuple[np.ndarray, ...]  # the same of its tracking, where a servo moves under them
    residual: tuple[np.ndarray, ...]  # of each channel (R,)

    @classmethod
    def of(cls, table: Table, noise: Noise, at: Operating, r: Ranges, waves: Waves, size: np.ndarray) -> Bank:
        """All products."""
        signals = [part.signals for part in table.parts]
        rows = tuple(kept(s, at, r) for s in signals)
        given = tuple(tuple(arguments(s, at, r, k, waves)) for s, k in zip(signals, rows, strict=True))
        log = signals[0].log
        white, tracked = [], []
        for j in range(log.n):
            columns = [
                np.column_stack([by[name][:, None] * a.functions for a in of_motion for name in a.times])
                for by, of_motion in zip((responses(k, j) for k in rows), given, strict=True)
            ]
            white.append(np.concatenate([noise.whitened(c, j) for c in columns]) * size[j])
            if TRACKING in kinds(log):
                t = channel(log, TRACKING, j)
                pairs = zip(columns, signals, strict=True)
                moved = [displaced(log, s.step * s.every, c, j) for c, s in pairs]
                tracked.append(np.concatenate([noise.whitened(c, t) for c in moved]) * size[j])
        residual = [
            np.concatenate([noise.whitened(part.residual[:, j], j) for part in table.parts])
            for j in range(table.parts[0].residual.shape[1])
        ]
        return cls(table, noise, rows, given, size, tuple(white), tuple(tracked), tuple(residual))

    @property
    def kinds(self) -> list[tuple[int, str]]:
        """Number of the quantity, and response, of each set of columns."""
        return [(k, name) for k, a in enumerate(self.given[0]) for name in a.times]

    @cached_property
    def sets(self) -> tuple[np.ndarray, ...]:
        """Numbers of the columns of each set."""
        ends = np.cumsum([0, *(self.given[0][k].functions.shape[1] for k, _ in self.kinds)])
        return tuple(np.arange(low, high) for low, high in itertools.pairwise(ends))

    def gains(self, fit: Fit) -> Gains:
        """Log Bayes factor of each product beside a fit, averaged over scales.

        Quantities that belong to no joint may act in all: the evidence of each joint for it then adds up.
        """
        n, sets = len(self.white), self.sets
        nats, moves = np.empty((n, len(sets))), np.zeros((n, len(sets)), bool)
        for j, white in enumerate(self.white):
            products = self._products(fit, j, white)
            odds = [0.0 if self.given[0][k].only in (None, j) else -np.inf for k, _ in self.kinds]
            nats[j] = _averaged(fit, products, sets) + odds
            if self.tracked:
                t = channel(self.table.parts[0].signals.log, TRACKING, j)
                gram, cross, score = self._products(fit, t, self.tracked[j])
                both = products[0] + gram, products[1] + cross, products[2] + score
                beside = _averaged(fit, both, sets) + odds
                moves[j], nats[j] = beside > nats[j], np.logaddexp(nats[j], beside) - np.log(2.0)
        out = []
        for i, (k, name) in enumerate(self.kinds):
            a = self.given[0][k]
            driver = f"{name} times {a.name}" if name else a.name
            for j in range(len(self.white)):
                value = float(nats[j, i]) + a.log_prior
                moved = (bool(moves[j, i]),)
                form = Form(UNKNOWN, joint(j), driver, MOVES if moved[0] else "")
                out.append((Product(form, name, k, (j,), moved), value))
            if a.joint is None:
                every = np.logaddexp(0.0, nats[:, i]) - np.log(2.0)
                joints = tuple(np.flatnonzero(nats[:, i] > 0.0).tolist())
                if len(joints) > 1:
                    site = self._site(a, every)
                    value = float(np.sum(every)) + a.log_prior
                    moved = tuple(moves[list(joints), i].tolist())
                    form = Form(UNKNOWN, site, driver, MOVES if any(moved) else "")
                    out.append((Product(form, name, k, joints, moved), value))
        return out

    def _products(self, fit: Fit, c: int, white: np.ndarray) -> Dots:
        """Products of columns of a channel with their own set, the terms of a fit, and the residual."""
        gram = np.zeros((white.shape[1], white.shape[1]))
        for k in self.sets:
            part = slice(k[0], k[-1] + 1)
            gram[part, part] = white[:, part].T @ white[:, part]
        return gram, self.whitened(c, fit.chosen).T @ white, self.residual[c] @ white

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
                torque = self.size[j] * responses(k, j)[p.response][:, None] * given[p.argument].functions
                x[:, j, i * count : (i + 1) * count] = torque
                if p.moves[i]:
                    s = part.signals
                    t = channel(s.log, TRACKING, j)
                    x[:, t, i * count : (i + 1) * count] = displaced(s.log, s.step * s.every, torque, j)
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


def _averaged(fit: Fit, products: Dots, sets: Sequence[np.ndarray]) -> np.ndarray:
    """Log Bayes factors of sets of columns beside a fit, averaged over scales."""
    gram, cross, score = products
    return np.asarray(logsumexp(added(fit, gram, cross, score, sets, SCALES)[0] + SCALE_PRIOR, axis=1))
