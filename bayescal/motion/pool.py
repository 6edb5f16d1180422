"""All columns of a diagnosis, of the baseline and of every candidate, and the search over them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np

from bayescal.logs.types import CALIBRATE, VALIDATE
from bayescal.motion.cells import UNKNOWN, Ranges, cells
from bayescal.motion.effects import Form, FormColumn, Scale, columns
from bayescal.motion.estimate import Estimate, of_role
from bayescal.motion.linear import Table, normal, tabulated
from bayescal.motion.noise import Noise
from bayescal.motion.ripple import waves_of
from bayescal.motion.search import Search
from bayescal.motion.signals import Signals, each
from bayescal.motion.terms import Column, by_channel


@dataclass(frozen=True)
class Pool:
    """The estimate of the baseline, and what candidates depend on."""

    estimate: Estimate
    scale: Scale
    ranges: Ranges

    @classmethod
    def of(cls, estimate: Estimate) -> Pool:
        """The candidates beside an estimate."""
        at, parts = estimate.at, estimate.parts
        loads = [float(np.mean(s.payload[s.payload > 0.0])) for s in parts if np.any(s.payload > 0.0)]
        baseline = tabulated(of_role(parts, CALIBRATE), estimate.columns, estimate.residual)
        waves = waves_of(baseline, estimate.fit().values, estimate.noise)
        speed = np.sqrt(np.mean(np.concatenate([s.dq for s in parts]) ** 2, axis=0))
        friction = np.abs(at.coulomb) + speed * np.abs(at.viscous)
        loaded = float(np.mean(loads)) if loads else 0.0
        return cls(estimate, Scale(estimate.rms, friction, loaded, *waves), Ranges(parts, at))

    def candidates(self, s: Signals) -> Iterable[FormColumn]:
        """Columns of effects and cells."""
        at = self.estimate.at
        return chain(columns(s, at, self.scale), cells(s, at, self.scale, self.ranges))

    def every(self, s: Signals) -> Iterable[Column]:
        """Columns of the baseline and of all candidates."""
        yield from self.estimate.columns(s)
        yield from ((term, column) for _, term, column in self.candidates(s))

    def chosen(self, s: Signals, names: Collection[str]) -> Iterable[Column]:
        """Columns of the baseline, and of candidates with some names."""
        yield from self.estimate.columns(s)
        at = self.estimate.at
        named = columns(s, at, self.scale)
        general = cells(s, at, self.scale, self.ranges) if any(n.startswith(UNKNOWN) for n in names) else ()
        yield from ((term, column) for _, term, column in chain(named, general) if term.name in names)

    @cached_property
    def forms(self) -> dict[Form, tuple[str, ...]]:
        """The terms of each form."""
        out: dict[Form, list[str]] = {}
        for form, term, _ in self.candidates(self.estimate.parts[0]):
            out.setdefault(form, []).append(term.name)
        return {form: tuple(names) for form, names in out.items()}

    @cached_property
    def table(self) -> Table:
        """The columns of all motions."""
        return tabulated(self.estimate.parts, self.every, self.estimate.residual)

    def search(self, noise: Noise, roles: tuple[str, ...] = (CALIBRATE,)) -> Search:
        """The search over the motions of some roles, at some noise."""
        taken = set(chain.from_iterable(self.forms.values()))
        base = tuple(t.name for t in self.table.terms if t.name not in taken)
        p = normal(self.table.of_role(*roles), noise)
        return Search(p, tuple(self.forms.items()), base, {"ripple": self.scale.spread})

    def unfiltered(
        self, values: Mapping[str, float], role: str = VALIDATE
    ) -> Iterator[tuple[Signals, np.ndarray]]:
        """Motions of a role, with what values of terms leave of their torques (N, n), N m."""
        for s in each(of_role(self.estimate.parts, role)):
            left = self.estimate.residual(s).copy()
            for term, column in self.chosen(s, values.keys()):
                if value := values.get(term.name, 0.0):
                    for j, part in by_channel(term, column, s.log, s.step):
                        left[:, j] -= value * part
            yield s, s.unfiltered(left[:, : s.log.n])
