"""Products over all motions: what an error that is in no list may be in proportion to, and may vary with.

A response of a joint, or what an error of the base or of the tool does in all joints, times functions of any
quantity of the log.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from bayescal.logs.types import LINK, TORQUE, TRACKING
from bayescal.motion.effects import BASE, LOG, TOOL, Form, Waves, joint
from bayescal.motion.linear import Block, Dots, Fit, Part, Sparse, Table, Temporary, added
from bayescal.motion.noise import Noise
from bayescal.motion.quantities import RESPONSES, UNKNOWN, Argument, Kept, Ranges, quantities
from bayescal.motion.search import SCALE_PRIOR, SCALES
from bayescal.motion.settings import FORMS, SIGNALS
from bayescal.motion.signals import each
from bayescal.motion.terms import ALL, Operating, channel, displaced

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
    terms: tuple[str, ...] = ()  # of an effect of the whole arm, in place of a response: each with its values


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
    wide: Mapping[Form, tuple[str, ...]]  # effects of the whole arm, with their terms

    def motions(self) -> Iterator[tuple[Part, Kept, tuple[Argument, ...]]]:
        """Every motion, with the signals and quantities that errors may depend on."""
        long = sum(len(p.signals.time) for p in self.table.parts) > SIGNALS.long
        return self._computed() if long else iter(self._stored)

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

    @cached_property
    def _wide_kinds(self) -> tuple[tuple[Form, int], ...]:
        """Effect of the whole arm, and number of the quantity, of each set of columns."""
        return tuple((form, k) for form in self.wide for k, a in enumerate(self.first) if _suits(a, form))

    @cached_property
    def _wide_sets(self) -> tuple[np.ndarray, ...]:
        kinds = self._wide_kinds
        return consecutive([len(self.wide[form]) * self.first[k].functions.shape[1] for form, k in kinds])

    def gains(self, fits: Sequence[Fit]) -> list[Gains]:
        """Log Bayes factor of each product beside each fit, averaged over scales.

        Quantities that belong to no joint may act in all: the evidence of each joint for it then adds up.
        """
        sets = consecutive([self.first[k].functions.shape[1] for k, _ in self.kinds])
        names = list(dict.fromkeys(itertools.chain.from_iterable(fit.names for fit in fits)))
        out, place = [], {name: k for k, name in enumerate(names)}
        dots = self._dots(names, sets)
        for fit in fits:
            rows = [place[name] for name in fit.names]
            chosen = {c: (blocks, cross[rows], score) for c, (blocks, cross, score) in dots.items()}
            out.append(self._beside(fit, chosen, sets))
        return out

    def _beside(self, fit: Fit, dots: Mapping[int, Dots], sets: Sequence[np.ndarray]) -> Gains:
        """The gains beside one fit, with products of its terms."""
        n, log = len(self.size), self.table.parts[0].signals.log
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
            if self.first[k].site == LOG and len(joints) > 1:
                moved = tuple(moves[list(joints), i].tolist())
                out.append((self._product(i, self._site(self.first[k], every), joints, moved), np.sum(every)))
        of_arm = averaged(fit, dots[ALL], self._wide_sets) if ALL in dots else ()
        for (form, k), value in zip(self._wide_kinds, of_arm, strict=False):
            driver = f"{form.driver} times {self.first[k].name}"
            product = Product(Form(UNKNOWN, form.site, driver), "", k, (), (), terms=self.wide[form])
            out.append((product, value))
        return [(p, float(value) + self.first[p.argument].log_prior) for p, value in out]

    def _product(
        self, i: int, site: str, joints: tuple[int, ...], moves: tuple[bool, ...], kind: str = TORQUE
    ) -> Product:
        """The product of a set of columns, of `kinds`, at a site."""
        k, name = self.kinds[i]
        driver = f"{name} times {self.first[k].name}" if name else self.first[k].name
        setting = BEHIND if kind == LINK else MOVES if any(moves) else ""
        return Product(Form(UNKNOWN, site, driver, setting), name, k, joints, moves, kind)

    def _dots(self, names: Sequence[str], sets: Sequence[np.ndarray]) -> dict[int, Dots]:
        """By channel, products of the columns of its joint with themselves and with those of terms.

        Under `ALL` those of effects of the whole arm.
        """
        out: dict[int, Dots] = {}
        for part, k, given in self.motions():
            s, log = part.signals, part.signals.log
            for j in range(len(self.size)):
                by = {name: response(k, j) for name, response in RESPONSES.items()}
                x = np.column_stack([by[name][:, None] * given[i].functions for i, name in self.kinds])
                weight = part.weight[:, j, None]  # of every kind of residuals
                self.count(out, part, names, j, self.size[j] * weight * x, sets)
                if LINK in log.kinds:
                    self.count(out, part, names, channel(log, LINK, j), FORMS.deflection * weight * x, sets)
                if TRACKING in log.kinds:
                    moved, there = np.zeros_like(x), np.any(x, axis=0)
                    torque = self.size[j] * weight * x[:, there]
                    moved[:, there] = weight * displaced(s, s.step * s.every, torque, j)
                    self.count(out, part, names, channel(log, TRACKING, j), moved, sets)
            for c in range(len(part.numbers)):
                every = self._columns(part, c, list(itertools.chain.from_iterable(self.wide.values())))
                if np.any(every):
                    widths = np.cumsum([len(names) for names in self.wide.values()])[:-1]
                    of = dict(zip(self.wide, np.split(every, widths, axis=1), strict=True))
                    each_set = [_each_by_each(of[form], given[k].functions) for form, k in self._wide_kinds]
                    self.count(out, part, names, c, np.hstack(each_set), self._wide_sets, into=ALL)
        return out

    def count(
        self, out: dict[int, Dots], part: Part, names: Sequence[str], c: int, x: np.ndarray,
        sets: Sequence[np.ndarray], into: int | None = None,
    ) -> None:  # fmt: skip
        """Add products of columns (M, P) of a channel in one motion to those of the channel, or of `into`."""
        key, sizes = c if into is None else into, list(map(len, sets))
        if key not in out:
            nothing = np.zeros((len(names), x.shape[1])), np.zeros(x.shape[1])
            out[key] = [np.zeros((size, size)) for size in sizes], *nothing
        blocks, cross, score = out[key]
        there = np.flatnonzero(np.any(x, axis=0))  # many functions of time are 0 in a motion
        white = part.whitened(self.noise, x[:, there], c)
        fitted_terms = self._columns(part, c, names)
        cross[:, there] += part.whitened(self.noise, fitted_terms, c).T @ white
        score[there] += part.whitened(self.noise, part.residual[:, c], c) @ white
        bounds = np.searchsorted(there, np.cumsum([0, *sizes]))
        for block, k, low, high in zip(blocks, sets, bounds[:-1], bounds[1:], strict=True):
            acting = there[low:high] - k[0]
            block[acting[:, None], acting] += white[:, low:high].T @ white[:, low:high]

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {term.name: k for k, term in enumerate(self.table.terms)}

    def _columns(self, part: Part, c: int, names: Sequence[str]) -> np.ndarray:
        """Columns (M, k) of some terms in a channel of a motion, in units of prior standard deviations."""
        numbers, columns = part.of(c)
        place = {number: k for k, number in enumerate(numbers.tolist())}
        x, chosen = np.zeros((len(part.residual), len(names))), [self._numbers[name] for name in names]
        there = [k for k, number in enumerate(chosen) if number in place]
        x[:, there] = columns[:, [place[chosen[k]] for k in there]]
        return x * np.array([self.table.terms[k].sd for k in chosen])

    def _site(self, a: Argument, nats: np.ndarray) -> str:
        """Of an error in several joints: an oscillation is of what carries the arm or what it carries."""
        if not a.moves:
            return LOG
        half = len(nats) // 2
        return BASE if np.sum(nats[:half]) > np.sum(nats[half:]) else TOOL

    def channels(self, p: Product) -> frozenset[int]:
        """Channels of the residuals in which a product is."""
        if p.terms:
            return frozenset(range(len(self.table.parts[0].numbers)))
        log = self.table.parts[0].signals.log
        moved = [(TRACKING, j) for j, moves in zip(p.joints, p.moves, strict=True) if moves]
        return frozenset(channel(log, kind, j) for kind, j in [*((p.kind, j) for j in p.joints), *moved])

    def columns(self, p: Product) -> Sparse:
        """Columns of a product, N m and rad."""
        count = self.first[p.argument].functions.shape[1]
        out, put = list[dict[int, Block]](), Temporary().put
        for part, k, given in self.motions():
            s, of_motion = part.signals, dict[int, np.ndarray]()
            for c in range(len(part.numbers)) if p.terms else ():
                of_motion[c] = _each_by_each(self._columns(part, c, p.terms), given[p.argument].functions)
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


def _suits(a: Argument, form: Form) -> bool:
    """Whether an error of the whole arm may vary with a quantity.

    An effect of the list with its own, of its site, those of joints and of the log; another with its own.
    """
    its = a.site == form.site
    if form.effect == UNKNOWN:
        return its
    return not a.log_prior and (its or a.times == tuple(RESPONSES))


def _each_by_each(x: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """Products (M, k f) of all columns (M, k) and all functions (M, f)."""
    return np.asarray((x[:, :, None] * functions[:, None, :]).reshape(len(x), -1))


def consecutive(sizes: Sequence[int]) -> tuple[np.ndarray, ...]:
    """Numbers of the columns of consecutive sets."""
    return tuple(np.arange(low, high) for low, high in itertools.pairwise(np.cumsum([0, *sizes])))


def averaged(fit: Fit, dots: Dots, sets: Sequence[np.ndarray]) -> np.ndarray:
    """Log Bayes factors of sets of columns beside a fit, averaged over scales."""
    return np.asarray(logsumexp(added(fit, dots, sets, SCALES)[0] + SCALE_PRIOR, axis=1))
