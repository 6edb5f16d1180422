"""All columns of a diagnosis, of the baseline and of every candidate, and the search over them.

Unknown errors: any response of a joint times functions of any quantity of the log, in one joint or all.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from bayescal.logs import Log
from bayescal.logs.types import SERVO, VALIDATE
from bayescal.motion.bank import Bank
from bayescal.motion.effects import BASE, TOOL, Form, Scale, Waves, in_all_joints
from bayescal.motion.estimate import Estimate
from bayescal.motion.expected import widened
from bayescal.motion.linear import Normal, Sparse, Table, fitted, normal, tabulated
from bayescal.motion.noise import Noise
from bayescal.motion.quantities import RESPONSES, UNKNOWN, Kept, Ranges, candidates
from bayescal.motion.search import Search
from bayescal.motion.settings import CELLS, SEARCH
from bayescal.motion.signals import Signals, each, low_passed
from bayescal.motion.terms import ALL, Column, Term, by_channel


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
        if parts[0].log.torque_kind == SERVO:
            table = widened(model, table, estimate.noise)
        return cls(estimate, scale, ranges, forms | in_all_joints(forms), table)

    def extended(self, further: Sequence[Unlisted]) -> Pool:
        """The pool with columns of further forms."""
        extra = {u.form: tuple(t.name for t in u.terms) for u in further}
        table = self.table.extended([(u.terms, u.columns) for u in further])
        return replace(self, table=table, extra=dict(self.extra) | extra)

    def bank(self, noise: Noise, members: Collection[Form] = ()) -> Bank:
        """Quantities and products over all motions; of links those of `members` alone (cost)."""
        size, model = CELLS.size * self.scale.friction, self.estimate.model
        terms = {t.name: t for t in self.table.terms}
        wide = {
            form: names for form, names in self.forms.items()
            if all(terms[name].channel == ALL for name in names)
            and (form.site in (BASE, TOOL) or form in members)
        }  # fmt: skip
        return Bank(self.table, noise, model, self.ranges, self.scale.waves, size, wide)

    def search(self, p: Normal) -> Search:
        """The search over the motions of some normal equations."""
        taken = set(chain.from_iterable([*self.forms.values(), *self.extra.values()]))
        base = tuple(t.name for t in self.table.terms if t.name not in taken)
        spread = {"ripple": self.scale.waves.spread}
        return Search(p, tuple(self.forms.items()), base, spread, self.extra, self.table.acting)

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
