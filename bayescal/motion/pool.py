"""All columns of a diagnosis, of the baseline and of every candidate, and the search over them.

Unknown errors: any response of a joint times functions of any quantity of the log, in one joint or all.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.special import logsumexp

from bayescal.logs import Log
from bayescal.logs.types import LINK, TORQUE, TRACKING, VALIDATE
from bayescal.motion.effects import BASE, LOG, TOOL, Form, Scale, Waves, in_all_joints, joint
from bayescal.motion.estimate import Estimate
from bayescal.motion.linear import Dots, Fit, Normal, Part, Sparse, Table, added, fitted, normal, tabulated
from bayescal.motion.noise import Noise
from bayescal.motion.quantities import RESPONSES, UNKNOWN, Argument, Kept, Ranges, candidates, quantities
from bayescal.motion.search import SCALE_PRIOR, SCALES, Search
from bayescal.motion.settings import CELLS, FORMS, SEARCH, SIGNALS
from bayescal.motion.signals import Signals, each, low_passed
from bayescal.motion.terms import Column, Operating, Term, by_channel, channel, displaced
from bayescal.storage.temporary import Block, Temporary

MOVES, BEHIND = "a torque of the arm", "an angle behind the gear"
"""Settings of a product: under its torque a servo moves, so that it is no error of the torques' measurement;
and it is an error of the positions behind a gear."""


@dataclass(frozen=True)
class Product:
    """A response times functions of a quantity, at joints (from 0)."""

    form: Form
    response: str
    argument: int
    joints: tuple[int, ...]
    moves: tuple[bool, ...]  # whether the servo of each moves under it
    kind: str = TORQUE  # of the residuals in which it is


Gains = list[tuple[Product, float]]
"""Products, each with its log Bayes factor."""


@dataclass(frozen=True)
class Bank:
    """Products over the motions of a table; of a long log they are computed again in each pass."""

    table: Table
    noise: Noise
    model: Operating
    ranges: Ranges
    waves: Waves
    size: np.ndarray  # (n,) N m, standard deviation of one function; of an angle it is `FORMS.deflection`

    def motions(self) -> Iterator[tuple[Part, Kept, tuple[Argument, ...]]]:
        """Every motion, with the signals and quantities that errors may depend on."""
        if sum(len(p.signals.time) for p in self.table.parts) > SIGNALS.long:
            yield from self._computed()
        else:
            yield from self._stored

    def _computed(self) -> Iterator[tuple[Part, Kept, tuple[Argument, ...]]]:
        for part, s in zip(self.table.parts, each([p.signals for p in self.table.parts]), strict=True):
            yield part, *quantities(s, self.model, self.ranges, self.waves)

    @cached_property
    def _stored(self) -> tuple[tuple[Part, Kept, tuple[Argument, ...]], ...]:
        return tuple(self._computed())

    @cached_property
    def first(self) -> tuple[Argument, ...]:
        """The quantities, with the functions of the first motion."""
        return next(self.motions())[2]

    @cached_property
    def kinds(self) -> tuple[tuple[int, str], ...]:
        """Number of the quantity, and response, of each set of columns."""
        return tuple((k, name) for k, a in enumerate(self.first) for name in a.times)

    def gains(self, fit: Fit) -> Gains:
        """Log Bayes factor of each product beside a fit, averaged over scales.

        Quantities that belong to no joint may act in all: the evidence of each joint for it then adds up.
        """
        n, log = len(self.size), self.table.parts[0].signals.log
        sets = consecutive([self.first[k].functions.shape[1] for k, _ in self.kinds])
        dots = self._dots(fit, sets)
        nats, moves = np.empty((n, len(sets))), np.zeros((n, len(sets)), bool)
        behind = np.empty_like(nats)
        for j in range(n):
            odds = [0.0 if self.first[k].only in (None, j) else -np.inf for k, _ in self.kinds]
            nats[j] = averaged(fit, dots[j], sets) + odds
            if LINK in log.kinds:
                behind[j] = averaged(fit, dots[channel(log, LINK, j)], sets) + odds
            if TRACKING in log.kinds:
                (blocks, cross, score), (more, with_more, at_more) = dots[j], dots[channel(log, TRACKING, j)]
                both = [x + y for x, y in zip(blocks, more, strict=True)], cross + with_more, score + at_more
                beside = averaged(fit, both, sets) + odds
                moves[j], nats[j] = beside > nats[j], np.logaddexp(nats[j], beside) - np.log(2.0)
        out = []
        for i, (k, _) in enumerate(self.kinds):
            for j in range(n):
                out.append((self._product(i, joint(j), (j,), (bool(moves[j, i]),)), nats[j, i]))
                if LINK in log.kinds:
                    out.append((self._product(i, joint(j), (j,), (False,), LINK), behind[j, i]))
            every = np.logaddexp(0.0, nats[:, i]) - np.log(2.0)
            joints = tuple(np.flatnonzero(nats[:, i] > 0.0).tolist())
            if self.first[k].joint is None and len(joints) > 1:
                moved = tuple(moves[list(joints), i].tolist())
                out.append((self._product(i, self._site(self.first[k], every), joints, moved), np.sum(every)))
        return [(p, float(value) + self.first[p.argument].log_prior) for p, value in out]

    def _product(
        self, i: int, site: str, joints: tuple[int, ...], moves: tuple[bool, ...], kind: str = TORQUE
    ) -> Product:
        """The product of a set of columns, of `kinds`, at a site."""
        k, name = self.kinds[i]
        driver = f"{name} times {self.first[k].name}" if name else self.first[k].name
        setting = BEHIND if kind == LINK else MOVES if any(moves) else ""
        return Product(Form(UNKNOWN, site, driver, setting), name, k, joints, moves, kind)

    def _dots(self, fit: Fit, sets: Sequence[np.ndarray]) -> dict[int, Dots]:
        """By channel, products of the columns of its joint."""
        out: dict[int, Dots] = {}
        for part, k, given in self.motions():
            s, log = part.signals, part.signals.log
            for j in range(len(self.size)):
                by = {name: response(k, j) for name, response in RESPONSES.items()}
                x = np.column_stack([by[name][:, None] * given[i].functions for i, name in self.kinds])
                weight = part.weight[:, j, None]  # of every kind of residuals
                self.count(out, part, fit, j, self.size[j] * weight * x, sets)
                if LINK in log.kinds:
                    self.count(out, part, fit, channel(log, LINK, j), FORMS.deflection * weight * x, sets)
                if TRACKING in log.kinds:
                    moved, there = np.zeros_like(x), np.any(x, axis=0)
                    torque = self.size[j] * weight * x[:, there]
                    moved[:, there] = weight * displaced(s, s.step * s.every, torque, j)
                    self.count(out, part, fit, channel(log, TRACKING, j), moved, sets)
        return out

    def count(
        self, out: dict[int, Dots], part: Part, fit: Fit, c: int, x: np.ndarray, sets: Sequence[np.ndarray],
        into: int | None = None,
    ) -> None:  # fmt: skip
        """Add products of columns (M, P) of a channel in one motion to those of the channel, or of `into`."""
        key, sizes = c if into is None else into, list(map(len, sets))
        if key not in out:
            nothing = np.zeros((len(fit.chosen), x.shape[1])), np.zeros(x.shape[1])
            out[key] = [np.zeros((size, size)) for size in sizes], *nothing
        blocks, cross, score = out[key]
        there = np.flatnonzero(np.any(x, axis=0))  # many functions of time are 0 in a motion
        white = part.whitened(self.noise, x[:, there], c)
        cross[:, there] += self._whitened(part, c, fit.chosen).T @ white
        score[there] += part.whitened(self.noise, part.residual[:, c], c) @ white
        bounds = np.searchsorted(there, np.cumsum([0, *sizes]))
        for block, k, low, high in zip(blocks, sets, bounds[:-1], bounds[1:], strict=True):
            acting = there[low:high] - k[0]
            block[acting[:, None], acting] += white[:, low:high].T @ white[:, low:high]

    def _whitened(self, part: Part, c: int, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """Whitened columns of some terms in a channel of a motion, in units of prior standard deviations."""
        numbers, columns = part.of(c)
        place = {number: k for k, number in enumerate(numbers.tolist())}
        x = np.zeros((len(part.residual), len(chosen)))
        there = [k for k, number in enumerate(chosen) if number in place]
        x[:, there] = columns[:, [place[chosen[k]] for k in there]]
        return part.whitened(self.noise, x, c) * np.array([self.table.terms[k].sd for k in chosen])

    def _site(self, a: Argument, nats: np.ndarray) -> str:
        """Of an error in several joints: an oscillation is of what carries the arm or what it carries."""
        if not a.moves:
            return LOG
        half = len(nats) // 2
        return BASE if np.sum(nats[:half]) > np.sum(nats[half:]) else TOOL

    def columns(self, p: Product) -> Sparse:
        """Columns of a product, N m and rad."""
        count = self.first[p.argument].functions.shape[1]
        out, put = list[dict[int, Block]](), Temporary().put
        for part, k, given in self.motions():
            s, of_motion = part.signals, dict[int, np.ndarray]()
            for i, j in enumerate(p.joints):
                size = self.size[j] if p.kind == TORQUE else FORMS.deflection
                values = size * RESPONSES[p.response](k, j)[:, None] * given[p.argument].functions
                channels = {channel(s.log, p.kind, j): values}
                if p.moves[i]:
                    moved = displaced(s, s.step * s.every, part.weight[:, j, None] * values, j)
                    channels[channel(s.log, TRACKING, j)] = moved
                for c, x in channels.items():
                    of_motion[c] = np.zeros((len(x), count * len(p.joints)), np.float32)
                    of_motion[c][:, i * count : (i + 1) * count] = part.weight[:, c, None] * x
            out.append({c: put(x) for c, x in of_motion.items()})
        return out


def consecutive(sizes: Sequence[int]) -> tuple[np.ndarray, ...]:
    """Numbers of the columns of consecutive sets."""
    return tuple(np.arange(low, high) for low, high in itertools.pairwise(np.cumsum([0, *sizes])))


def averaged(fit: Fit, dots: Dots, sets: Sequence[np.ndarray]) -> np.ndarray:
    """Log Bayes factors of sets of columns beside a fit, averaged over scales."""
    return np.asarray(logsumexp(added(fit, dots, sets, SCALES)[0] + SCALE_PRIOR, axis=1))


@dataclass(frozen=True)
class Unlisted:
    """Columns of a form that is no candidate of the search: a product or a relative."""

    form: Form
    terms: tuple[Term, ...]
    columns: Sparse


@dataclass(frozen=True)
class Pool:
    """The estimate of the baseline, what candidates depend on, and their columns in all motions."""

    estimate: Estimate
    scale: Scale
    ranges: Ranges
    forms: Mapping[Form, tuple[str, ...]]  # the terms of each
    table: Table
    extra: Mapping[Form, tuple[str, ...]] = field(default_factory=dict)  # of forms beside the search

    @classmethod
    def of(cls, estimate: Estimate) -> Pool:
        """The candidates beside an estimate."""
        model, parts = estimate.model, estimate.parts
        loads = [float(np.mean(s.payload[s.payload > 0.0])) for s in parts if np.any(s.payload > 0.0)]
        speed = np.sqrt(np.mean(np.concatenate([s.dq for s in parts]) ** 2, axis=0))
        friction = np.abs(model.coulomb) + speed * np.abs(model.viscous)
        ranges = Ranges(parts, model)
        waves = waves_of(estimate, ranges)
        scale = Scale(estimate.rms, friction, float(np.mean(loads)) if loads else 0.0, waves)

        def every(s: Signals) -> Iterable[Column]:
            yield from estimate.columns(s)
            yield from ((term, column) for _, term, column in candidates(s, model, scale, ranges))

        forms: dict[Form, tuple[str, ...]] = {}
        for form, term, _ in candidates(parts[0], model, scale, ranges):
            forms[form] = (*forms.get(form, ()), term.name)
        table = tabulated(parts, every, estimate.residual)
        return cls(estimate, scale, ranges, forms | in_all_joints(forms), table)

    def extended(self, further: Sequence[Unlisted]) -> Pool:
        """The pool with columns of further forms."""
        extra = {u.form: tuple(t.name for t in u.terms) for u in further}
        table = self.table.extended([(u.terms, u.columns) for u in further])
        return replace(self, table=table, extra=dict(self.extra) | extra)

    def bank(self, noise: Noise) -> Bank:
        """Quantities and products over all motions."""
        size = CELLS.size * self.scale.friction
        return Bank(self.table, noise, self.estimate.model, self.ranges, self.scale.waves, size)

    def search(self, p: Normal) -> Search:
        """The search over the motions of some normal equations."""
        taken = set(chain.from_iterable([*self.forms.values(), *self.extra.values()]))
        base = tuple(t.name for t in self.table.terms if t.name not in taken)
        return Search(p, tuple(self.forms.items()), base, {"ripple": self.scale.waves.spread}, self.extra)

    def unfiltered(
        self, values: Mapping[str, float], role: str = VALIDATE
    ) -> Iterator[tuple[Signals, np.ndarray]]:
        """Motions of a role, with what values of terms leave of their torques (N, n), N m.

        A delay shifts the torque, and not its noise: by low-passed torques.
        """
        beside = {name: values[name] for name in chain.from_iterable(self.extra.values()) if name in values}
        parts = self.table.of_role(role).parts
        for part, s in zip(parts, each([p.signals for p in parts]), strict=True):
            smooth, model = s.changed(torque=low_passed(s.torque, s.step, s.band)), self.estimate.model
            residual = self.estimate.residual(smooth)
            for term, column in self._chosen(smooth, values.keys()):
                if value := values.get(term.name, 0.0):
                    for j, part_of_term in by_channel(term, column):
                        residual[:, j] -= value * part_of_term
            # without the other channels
            residual = s.unfiltered(residual[:, : s.log.n] + model.measured(s) - model.measured(smooth))
            if beside:
                explained = part.residual - Table(self.table.terms, (part,)).residuals(beside)[0]
                rows, all_rows = s.kept(s.time), s.unfiltered(s.time)
                every = [np.interp(all_rows, rows, x) for x in explained[:, : s.log.n].T]
                residual = residual - np.column_stack(every)
            yield s, residual

    def _chosen(self, s: Signals, names: Collection[str]) -> Iterable[Column]:
        """Columns of the baseline, and of candidates with some names."""
        yield from self.estimate.columns(s)
        unknown = any(n.startswith(UNKNOWN) for n in names)
        every = candidates(s, self.estimate.model, self.scale, self.ranges, unknown)
        yield from ((term, column) for _, term, column in every if term.name in names)


def waves_of(estimate: Estimate, ranges: Ranges) -> Waves:
    """Scan a grid of waves a turn, and multiples of a turn of the motor where the gear ratio is known."""
    table, noise = estimate.table(), estimate.noise
    residuals = table.residuals(fitted(normal(table, noise), np.arange(len(table.terms))).values)
    kinds = ("", *SEARCH.in_proportion)
    steady, changing, in_proportion, tried = [], [], [], 0
    log = table.parts[0].signals.log
    kept = [Kept.of(p.signals, estimate.model, ranges) for p in table.parts]
    for j in range(log.n):
        waves = _grid(log, j, float(np.ptp(np.concatenate([k.q[:, j] for k in kept]))))
        score, size = np.zeros((len(kinds), len(waves)), complex), np.zeros((len(kinds), len(waves)))
        loose = np.zeros(len(waves))
        for p, r, k in zip(table.parts, residuals, kept, strict=True):
            s = p.signals
            x = s.kept(np.exp(1j * s.q[:, j : j + 1] * waves) * s.weight[:, j : j + 1])
            y = p.whitened(noise, r[:, j], j)
            for i, kind in enumerate(kinds):
                white = p.whitened(noise, x * RESPONSES[kind](k, j)[:, None], j)
                for rows in np.array_split(np.arange(len(y)), SEARCH.pieces if not kind else 1):
                    along, square = white[rows].conj().T @ y[rows], np.sum(np.abs(white[rows]) ** 2, axis=0)
                    score[i] += along
                    size[i] += square
                    loose += np.abs(along) ** 2 / np.maximum(square, 1.0) if not kind else 0.0
        strength = np.abs(score) ** 2 / np.maximum(size, 1.0)
        steady += [(j, float(waves[k])) for k in _peaks(strength[0], SEARCH.ripples)]
        changing += [(j, float(waves[k])) for k in _peaks(loose, SEARCH.changing)]
        best = zip(SEARCH.in_proportion, strength[1:], strict=True)
        in_proportion += [(j, float(waves[k]), kind) for kind, x in best for k in _peaks(x, 1)]
        tried += len(waves)

    def share(chosen: Sequence[object], of: int) -> float:
        return float(np.log(max(len(chosen), 1) / of))

    responding = share(in_proportion, tried * len(SEARCH.in_proportion))
    both = share(steady, tried), tuple(changing), share(changing, tried)
    return Waves(tuple(steady), *both, tuple(in_proportion), responding)


def _grid(log: Log, j: int, turned: float) -> np.ndarray:
    """Waves a turn that are tried at a joint which turned by an angle, rad."""
    low, high, part = SEARCH.waves
    waves = np.arange(low, high, max(part * 2.0 * np.pi / max(turned, 1e-3), part))
    gear = log.mechanism.gear_ratio[j]
    if np.isnan(gear):
        return waves
    of_motor = np.array(SEARCH.of_motor) * abs(gear)
    return np.unique(np.r_[waves, of_motor[of_motor > high]])


def _peaks(x: np.ndarray, count: int) -> list[int]:
    """The largest local maxima."""
    return [k for k in np.argsort(-x).tolist() if x[k] == np.max(x[max(k - 2, 0) : k + 3])][:count]
