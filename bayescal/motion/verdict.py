"""What is said of a log: probabilities of all hypotheses, and the effects that are named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN
from bayescal.motion.linear import Normal
from bayescal.motion.search import Hypothesis, Member, Search
from bayescal.motion.settings import SEARCH, VERDICT

NULL, OTHER = "null", "other"


@dataclass(frozen=True)
class Verdict:
    """The verdict and its probabilities; kinds are those of `bayescal.gap.result.VERDICTS`."""

    kind: str
    named: Hypothesis  # what is named, with its forms
    leading: Hypothesis  # the most probable set
    probability: Mapping[str, float]  # of null, unknown and every effect that was assessed
    credible: tuple[str, ...]  # of the most probable hypotheses with 90 %
    members: Mapping[str, float]  # of a class: causes that the log does not distinguish
    explained: float  # share of the nats of the leading set that its names explain

    @property
    def left_open(self) -> bool:
        """Whether a cause that is not named is at a site that is known."""
        return self.kind in ("unknown", "class", "named+unexplained") and bool(self.leading.members)


def decide(search: Search, hypotheses: tuple[Hypothesis, ...]) -> Verdict:
    """The verdict on hypotheses, the most probable first."""
    score = np.array([h.score for h in hypotheses])
    weight = np.exp(score - logsumexp(score))
    effects = (NULL, UNKNOWN, *search.candidates)
    probability = {
        name: float(np.sum(weight[[name in (h.names or (NULL,)) for h in hypotheses]])) for name in effects
    }
    best = hypotheses[0]
    explained = _explained(best, hypotheses)
    sure = tuple(n for n in best.names if n != UNKNOWN and probability[n] >= VERDICT.sure)
    unknown = probability[UNKNOWN]
    members: dict[str, float] = {}
    if (probability[NULL] >= SEARCH.null_enough and unknown < VERDICT.sure) or not best.names:
        kind, sure = NULL, ()
    elif UNKNOWN in best.names:
        sure = sure if explained >= VERDICT.sure else ()
        kind = "named+unexplained" if sure else "unknown" if unknown >= VERDICT.sure else "ambiguous"
    elif len(best.names) == 1 and probability[best.names[0]] < VERDICT.alone and unknown >= VERDICT.fewest:
        kind, members = "class", _members(best, hypotheses, probability)
    elif len(sure) == len(best.names):
        kind = "named+unexplained" if unknown >= VERDICT.sure else "named"
        for name in sure:  # beside an unknown cause that varies as it does, a name may be its relative
            probability[name] = min(probability[name], 1.0 - 0.5 * unknown)
    else:
        kind, sure = "ambiguous", tuple(n for n in sure if probability[n] >= VERDICT.credible)
    if kind in ("named+unexplained", "class", "unknown"):
        limit = min(explained, VERDICT.beside_unmodelled)
        for name in search.candidates:
            probability[name] = min(probability[name], limit)
    named = Hypothesis(tuple(m for m in best.members if m.form.effect in sure), 0.0, 0.0)
    low, high = 1.0 - VERDICT.stated, VERDICT.stated
    return Verdict(
        kind, named, best, {n: float(np.clip(p, low, high)) for n, p in probability.items()},
        _credible(hypotheses, weight), members, explained,
    )  # fmt: skip


def confirmed(v: Verdict, search: Search, held: Normal) -> Verdict:
    """The verdict without names that withheld motions do not confirm.

    Their gain must not be much less than the size of the name predicts, within its scatter. `held` are
    normal equations of the validation motions. A name that is refused has at most `VERDICT.not_admitted`; an
    unknown cause has what it loses, if there is much evidence of any.
    """
    whole = search.fit(v.named.members)
    kept: list[Member] = []
    refused: list[Member] = []
    for m in v.named.members:
        without = search.fit([o for o in v.named.members if o is not m])
        gain = 0.5 * (without.chi2(held) - whole.chi2(held))
        change = whole.vector - without.vector
        expected = 0.5 * float(change @ held.gram @ change)
        # the gain of a true name is normal: mean and half the variance are what its change predicts
        least = SEARCH.shown * expected - 2.0 * np.sqrt(2.0 * expected)
        (kept if gain > least else refused).append(m)
    if not refused:
        return v
    probability = dict(v.probability)
    strong = v.leading.log_evidence > VERDICT.structure
    takes = UNKNOWN if strong else NULL
    for name in {m.form.effect for m in refused}:
        lost = max(probability[name] - VERDICT.not_admitted, 0.0)
        probability[name] -= lost
        probability[takes] = min(probability[takes] + lost, 1.0)
    named = Hypothesis(tuple(kept), 0.0, 0.0)
    without_names = "unknown" if probability[UNKNOWN] >= VERDICT.sure else "ambiguous" if strong else NULL
    kind = v.kind if kept else without_names
    return replace(v, kind=kind, named=named, probability=probability)


def _explained(best: Hypothesis, hypotheses: tuple[Hypothesis, ...]) -> float:
    """Share of the nats of a set with an unknown cause that its names explain alone."""
    if UNKNOWN not in best.names or best.log_evidence <= 0.0:
        return 1.0
    names = set(best.names) - {UNKNOWN}
    alone = max((h.log_evidence for h in hypotheses if set(h.names) == names), default=0.0)
    return float(np.clip(alone / best.log_evidence, 0.0, 1.0))


def _members(
    best: Hypothesis, hypotheses: tuple[Hypothesis, ...], probability: Mapping[str, float]
) -> dict[str, float]:
    """The leading effect, those that may be in its place, and a cause that is not in the list."""
    leader = best.names[0]
    instead = {n for h in hypotheses if leader not in h.names for n in h.names if n != UNKNOWN}
    likely = sorted(instead, key=lambda n: (-probability[n], n))
    chosen = [leader, *(n for n in likely if probability[n] >= VERDICT.fewest)]
    return {n: probability[n] for n in chosen} | {OTHER: probability[UNKNOWN]}


def _credible(hypotheses: tuple[Hypothesis, ...], weight: np.ndarray) -> tuple[str, ...]:
    """Effects of the most probable hypotheses with 90 % in total."""
    last = int(np.searchsorted(np.cumsum(weight), VERDICT.credible)) + 1
    return tuple(dict.fromkeys(name for h in hypotheses[:last] for name in h.names or (NULL,)))
