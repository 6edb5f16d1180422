"""The diagnosis of a log: which effects explain what the baseline leaves, and what they are worth on others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.special import logsumexp

from bayescal.logs import Log
from bayescal.logs.types import CALIBRATE, VALIDATE
from bayescal.motion.cells import UNKNOWN, Ranges, cells
from bayescal.motion.effects import Form, FormColumn, Scale, columns
from bayescal.motion.estimate import Estimate, estimated, of_role
from bayescal.motion.linear import Table, normal, tabulated
from bayescal.motion.noise import Noise, noise_of
from bayescal.motion.search import Hypothesis, Search
from bayescal.motion.settings import NOISE
from bayescal.motion.signals import Signals, all_signals
from bayescal.motion.terms import Column


@dataclass(frozen=True)
class Verdict:
    """What is said: kind, effects, and probabilities by name."""

    kind: str
    effects: tuple[str, ...]
    probability: Mapping[str, float]
    credible: tuple[str, ...]


@dataclass(frozen=True)
class MotionGap:
    """A diagnosis of a joint log."""

    estimate: Estimate
    search: Search
    hypotheses: tuple[Hypothesis, ...]
    verdict: Verdict
    before: np.ndarray  # (n,) N m, RMS of the torque residual on validation motions
    after: np.ndarray


@dataclass(frozen=True)
class Pool:
    """All columns of a diagnosis."""

    estimate: Estimate
    scale: Scale
    ranges: Ranges
    waves: tuple[tuple[int, float], ...]

    def candidates(self, s: Signals) -> Iterable[FormColumn]:
        """Columns of effects and cells."""
        at = self.estimate.at
        return chain(columns(s, at, self.scale, self.waves), cells(s, at, self.scale, self.ranges))

    def every(self, s: Signals) -> Iterable[Column]:
        """Columns of the baseline and of all candidates."""
        yield from self.estimate.columns(s)
        yield from ((term, column) for _, term, column in self.candidates(s))

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

    def search(self, noise: Noise) -> Search:
        """The search over the motions of role `calibrate`, at some noise."""
        forms = self.forms()
        taken = set(chain.from_iterable(forms.values()))
        base = tuple(t.name for t in self.table.terms if t.name not in taken)
        return Search(normal(self.table.of_role(CALIBRATE), noise), tuple(forms.items()), base)

    def unfiltered(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """What values of terms leave of the torques of validation motions (N, n), N m."""
        out = []
        for s in of_role(self.estimate.parts, VALIDATE):
            left = self.estimate.residual(s).copy()
            for term, column in self.every(s):
                if value := values.get(term.name, 0.0):
                    if column.ndim == 2:
                        left -= value * column
                    else:
                        left[:, term.joint] -= value * column
            out.append(s.unfiltered(left))
        return out


def diagnose(log: Log) -> MotionGap:
    """Diagnose a joint log."""
    estimate = estimated(all_signals(log))
    at = estimate.at
    friction = np.abs(at.coulomb) + 0.3 * np.abs(at.viscous)
    loads = [float(np.mean(s.payload[s.payload > 0.0])) for s in estimate.parts if np.any(s.payload > 0.0)]
    scale = Scale(estimate.rms, friction, float(np.mean(loads)) if loads else 0.0)
    pool = Pool(estimate, scale, Ranges(estimate.parts, at), ())
    noise = estimate.noise
    for _ in range(NOISE.repeats):
        search = pool.search(noise)
        hypotheses = search.run()
        fit = search.fit(hypotheses[0].members)
        taken = np.full(log.n, len(fit.chosen) / log.n)
        noise = noise_of(pool.table.of_role(CALIBRATE).residuals(fit.values), taken)
    search = pool.search(noise)
    hypotheses = search.run()
    verdict = decide(search, hypotheses)
    named = next(h for h in hypotheses if set(h.names) == set(verdict.effects))
    before, after = (rms(pool.unfiltered(search.fit(m).values)) for m in ((), named.members))
    return MotionGap(estimate, search, hypotheses, verdict, before, after)


def rms(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Root mean square (n,) of parts (N, n)."""
    return np.sqrt(np.mean(np.concatenate(list(parts)) ** 2, axis=0))


def decide(search: Search, hypotheses: tuple[Hypothesis, ...]) -> Verdict:
    """Probabilities of all hypotheses, and what is named."""
    weight = np.array([h.score for h in hypotheses])
    weight = np.exp(weight - logsumexp(weight))
    probability = {
        name: float(np.sum(weight[[name in h.names for h in hypotheses]])) for name in search.by_effect
    }
    probability["null"] = float(np.sum(weight[[not h.names for h in hypotheses]]))
    sure = [n for n in probability if n not in (UNKNOWN, "null") and probability[n] > 0.5]
    if probability[UNKNOWN] > 0.5:
        kind = "named+unexplained" if sure else "unknown"
    else:
        kind = "named" if sure else "null" if not hypotheses[0].members else "ambiguous"
    credible = tuple(sorted((n for n in probability if probability[n] > 0.1), key=lambda n: -probability[n]))
    return Verdict(kind, tuple(sure), probability, credible)
