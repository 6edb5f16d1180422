"""Sets of changes: their evidence, a beam search over them, and probabilities.

A member of a set is an item and the sessions that have its changed value: all from one on, or one alone. Its
evidence is averaged over factors on the prior of its size, given the other members at their most probable.

Amplitudes of a set, and their covariance with what is not known beside it. The set of most evidence and the
variances of most evidence are single points, and a covariance at them is too small. First order in each: the
variance of one family of model errors has a grid of values, weighted by their evidence; other sets that have
the same change count by their probability; and the change of a spring is in proportion to the torque, which
the stated masses give.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.changes.joint import Joint
from bayescal.changes.linear import LEAST, PER_MOMENT, Errors, Evidence, integrated
from bayescal.effects import Parameter, confusable
from bayescal.effects.gravity import masses
from bayescal.gap.linear.evidence import log_sum
from bayescal.gap.settings import VERDICT

SCALES = np.array([1 / 300, 0.01, 1 / 30, 0.1, 0.3, 1.0, 3.0, 10.0])
"""Factors on the usual size of a change over which evidence is averaged (assumed)."""
FREE = 100.0
"""The factor with which a change is estimated: its prior has no part in the result."""
NONE = 0.5
"""Prior probability that nothing changed (convention)."""
SHARES = {"base": 0.15, "target": 0.05, "tool": 0.15, "arm": 0.3, "effect": 0.25, "unknown": 0.1}
"""Prior probability of the kinds of a single change, shared by their items (assumed)."""
WIDTH, DEPTH = 8, 16
"""Sets that are extended, and the most members."""
SURE, NAMED = 0.95, 0.9
"""Probability of a change, and of a name, from which on they are stated (convention)."""
LISTED = 0.05
"""Least probability of an item that is listed, where it is in no class (convention)."""


@dataclass(frozen=True)
class Member:
    """An item that changed, and the sessions (numbers from 0) that have its other value."""

    item: int
    sessions: tuple[int, ...]

    def weights(self, count: int) -> np.ndarray:
        """Factors (S - 1,) on the value of each later session relative to the first."""
        first = 0 in self.sessions
        return np.array([(k in self.sessions) - first for k in range(1, count)], float)


@dataclass(frozen=True)
class Weighed:
    """A set of changes, each with the factor on its prior, and its log posterior density."""

    members: tuple[Member, ...]
    scales: tuple[float, ...]
    score: float
    probability: float = 0.0


@dataclass(frozen=True)
class Search:
    """All sets that were evaluated, the most probable first."""

    evidence: Evidence
    weighed: tuple[Weighed, ...]

    @property
    def best(self) -> Weighed:
        """The most probable set."""
        return self.weighed[0]

    @property
    def log_evidence(self) -> float:
        """Log evidence of all sets together, over that of no change."""
        return float(np.logaddexp.reduce([w.score for w in self.weighed]))

    @cached_property
    def same(self) -> float:
        """Probability that nothing changed."""
        return sum(w.probability for w in self.weighed if not w.members)

    @cached_property
    def probability(self) -> Mapping[Member, float]:
        """Marginal probability of every member."""
        out: dict[Member, float] = {}
        for w in self.weighed:
            for m in w.members:
                out[m] = out.get(m, 0.0) + w.probability
        return out


def options(e: Evidence) -> list[Member]:
    """Every item with every pattern of sessions: changed from one on, or in one alone."""
    count = len(e.joint.sessions)
    later = [tuple(range(k, count)) for k in range(1, count)]
    alone = [(k,) for k in range(count) if (k,) not in later and count > 2]
    compared = [i for i, item in enumerate(e.joint.items) if item.name not in e.joint.scattered]
    return [Member(i, s) for i in compared for s in (*later, *alone)]


def selector(e: Evidence, member: Member) -> np.ndarray:
    """Columns (K, k) of the parameters of a member."""
    weights = member.weights(len(e.joint.sessions))
    count = len(e.joint.items[member.item].parameters)
    out = np.zeros((len(e.columns), count))
    for weight, columns in zip(weights, e.places[member.item], strict=True):
        out[columns, np.arange(count)] = weight
    return out


def selectors(e: Evidence, members: Sequence[Member]) -> np.ndarray:
    """Columns (K, k) of the parameters of several members."""
    return np.column_stack([np.zeros((len(e.columns), 0)), *(selector(e, m) for m in members)])


def log_priors(e: Evidence, every: Sequence[Member]) -> dict[Member, float]:
    """Log of the prior share of every member among single changes."""

    def kind(m: Member) -> str:
        item = e.joint.items[m.item]
        return item.kind if item.kind != "setup" else item.site.kind.replace("face", "target")

    kinds = [kind(m) for m in every]
    return {
        m: float(np.log(SHARES.get(k, SHARES["arm"]) / kinds.count(k)))
        for m, k in zip(every, kinds, strict=True)
    }


def gains(information: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Log evidence (scales,) of columns with information (k, k) and score (k,), by `SCALES`."""
    values, vectors = np.linalg.eigh(information)
    values, along = np.maximum(values, 0.0), (vectors.T @ score) ** 2
    square = SCALES[:, None] ** 2
    with_it = 1.0 + square * values
    return 0.5 * np.sum(along * square / with_it - np.log(with_it), axis=1)


def averaged(gain: np.ndarray) -> float:
    """Log of the mean over factors."""
    return float(log_sum(gain) - np.log(len(gain)))


def search(e: Evidence) -> Search:
    """Search the most probable sets of changes."""
    every = options(e)
    prior = log_priors(e, every)
    select = {m: selector(e, m) for m in every}
    weighed: dict[frozenset[Member], Weighed] = {frozenset(): Weighed((), (), float(np.log(NONE)))}
    front = [weighed[frozenset()]]
    for _ in range(DEPTH):
        for w in front:
            for new in _extended(e, w, every, prior, select):
                key = frozenset(new.members)
                if key not in weighed or weighed[key].score < new.score:
                    weighed[key] = new
        size = len(front[0].members) + 1
        larger = [w for w in weighed.values() if len(w.members) == size]
        front = sorted(larger, key=lambda w: -w.score)[:WIDTH]
        best = max(w.score for w in weighed.values())
        if not front or front[0].score < best - 5.0:
            break
    leader = max(weighed.values(), key=lambda w: w.score)
    ranked = sorted((_softened(e, w, leader) for w in weighed.values()), key=lambda w: -w.score)
    density = np.exp(np.array([w.score for w in ranked]) - ranked[0].score)
    share = density / density.sum()
    return Search(
        e, tuple(Weighed(w.members, w.scales, w.score, float(p)) for w, p in zip(ranked, share, strict=True))
    )


def _softened(e: Evidence, w: Weighed, leader: Weighed) -> Weighed:
    """A set that has a confusable effect in place of one of the leading set: its score is nearer to that."""
    differs = set(w.members) ^ set(leader.members)
    items = [e.joint.items[m.item] for m in differs]
    if len(w.members) != len(leader.members) or len(items) != 2 or items[0].site != items[1].site:
        return w
    if not confusable(items[0].effect, items[1].effect):
        return w
    return replace(w, score=leader.score - VERDICT.soft * (leader.score - w.score))


def _extended(
    e: Evidence, w: Weighed, every: Sequence[Member], prior: Mapping[Member, float],
    select: Mapping[Member, np.ndarray],
) -> Iterator[Weighed]:  # fmt: skip
    """A set with one more member, for every one that it may have."""
    by = [select[m] * s for m, s in zip(w.members, w.scales, strict=True)]
    g, s, _ = integrated(e.information, e.score, np.column_stack([np.zeros((len(e.columns), 0)), *by]))
    for m in every:
        if any((m.item == other.item and len(e.joint.sessions) == 2) or m == other for other in w.members):
            continue
        places = np.flatnonzero(np.any(select[m], axis=1))
        block = select[m][places]
        gain = gains(block.T @ g[np.ix_(places, places)] @ block, block.T @ s[places])
        scale = float(SCALES[int(np.argmax(gain))])
        score = w.score + averaged(gain) + prior[m] + float(np.log(1.0 - NONE))
        yield Weighed((*w.members, m), (*w.scales, scale), score)


VALUES = 9
"""Of the variance of a family, from none to that of its unit amplitudes, in equal ratios and equally probable
before the measurements (assumed)."""
COUNTED = 1e-4
"""Share of the probability of a change from which on a set that has it counts (convention)."""


def posterior(e: Evidence, members: Sequence[Member]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (K, k) of a set of changes, and mean (k,) and covariance (k, k) of their amplitudes."""
    by, mean, covariance = _given(e, members, [FREE] * len(members))
    return by, mean, covariance + _by_errors(e, by, mean, covariance)


def _given(
    e: Evidence, members: Sequence[Member], scales: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `posterior`, by factors on the priors of the members, at the variances of most evidence."""
    by = selectors(e, members)
    counts = [len(e.joint.items[m.item].parameters) for m in members]
    a = by.T @ e.information @ by + np.diag(np.repeat(np.array(scales, float) ** -2, counts))
    scale = 1.0 / np.sqrt(np.diag(a))
    covariance = np.linalg.inv(a * np.outer(scale, scale)) * np.outer(scale, scale)
    return by, covariance @ (by.T @ e.score), covariance


def _by_errors(e: Evidence, by: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """What the unknown variances of model errors add to the covariance (k, k) of a set."""
    out = np.zeros_like(covariance)
    for f in e.errors:
        variances = np.geomspace(LEAST, max(1.0, f.variance), VALUES)
        gain, share, score, slopes = _at_variances(f, variances, by, mean, covariance)
        weight = np.exp(gain - np.max(gain))
        weight /= np.sum(weight)
        shifts = (share * score) @ slopes.T
        out += (slopes * np.maximum(weight @ share, 0.0)) @ slopes.T + (shifts.T * weight) @ shifts
    return out


def _at_variances(
    f: Errors, variances: np.ndarray, by: np.ndarray, mean: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Log evidence (V,) of variances of a family over that of its own, beside a set of changes.

    And of each direction of its k errors: its share (V, k) in their covariance, its score (k,), and the
    slopes (m, k) of the changes by it.
    """
    across = by.T @ f.across
    slopes = covariance @ across
    values, vectors = np.linalg.eigh(f.information - across.T @ slopes)
    score, slopes = vectors.T @ (f.score - across.T @ mean), slopes @ vectors
    step = (variances - f.variance)[:, None]
    odds = np.maximum(1.0 + step * values, np.finfo(float).tiny)
    share = step / odds
    return 0.5 * np.sum(score**2 * share - np.log(odds), axis=1), share, score, slopes


def log_odds(sets: Search) -> Mapping[str, float]:
    """Log odds of each family of model errors, that it has its variance rather than none."""
    e = sets.evidence
    given = posterior(e, sets.best.members)
    gains_of = [-float(_at_variances(f, np.array([LEAST]), *given)[0][0]) for f in e.errors]
    return dict(zip(e.variances, gains_of, strict=False))


def set_with(sets: Search, m: Member) -> Weighed:
    """The most probable set that has a member."""
    return next(w for w in sets.weighed if m in w.members)


def by_sets(sets: Search, m: Member) -> np.ndarray:
    """What the other sets that have a member add to the variances (k,) of its parameters."""
    e, count = sets.evidence, len(sets.evidence.joint.items[m.item].parameters)

    def moments(w: Weighed) -> tuple[np.ndarray, np.ndarray]:
        scales = [FREE if other == m else s for other, s in zip(w.members, w.scales, strict=True)]
        _, mean, covariance = _given(e, w.members, scales)
        first = sum(len(e.joint.items[k.item].parameters) for k in w.members[: w.members.index(m)])
        return mean[first : first + count], np.diag(covariance)[first : first + count]

    least = COUNTED * sets.probability[m]
    every = [w for w in sets.weighed if m in w.members and w.probability >= least]
    means, variances = map(np.array, zip(*map(moments, every or [set_with(sets, m)]), strict=True))
    weight = np.array([w.probability for w in every] or [1.0])
    added = (variances - variances[0]) + (means - means[0]) ** 2
    return np.maximum(weight @ added / np.sum(weight), 0.0)


def by_masses(joint: Joint, p: Parameter) -> float:
    """Relative standard uncertainty of the change of a spring by the stated masses; 0 of others."""
    if p.driver.kind != "torque" or not p.unit.endswith(PER_MOMENT):
        return 0.0
    c, (term, *_) = joint.circumstances, p.terms
    torque = np.asarray(term.driver)[c.fitted]
    torque = torque - np.mean(torque)
    shares = [
        error.sd * float(torque @ np.asarray(t.driver)[c.fitted]) / float(torque @ torque)
        for error in masses(replace(c, compliances={p.name: 1.0}))
        for t in error.terms
        if (t.frame, t.axis) == (term.frame, term.axis)
    ]
    return float(np.linalg.norm(shares))
