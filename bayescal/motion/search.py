"""Which effects: a beam search over sets of them, against noise only and causes that are in no list.

What is said of a log: probabilities of all hypotheses, and the effects that are named.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from scipy.special import log_ndtr, logsumexp

from bayescal.motion.effects import EFFECTS, Form
from bayescal.motion.linear import Fit, Normal, fitted, gains
from bayescal.motion.quantities import UNKNOWN
from bayescal.motion.settings import SEARCH, VERDICT

SCALES = np.array(SEARCH.scales)
SCALE_PRIOR = -0.5 * (np.log(SCALES) / np.log(SEARCH.spread)) ** 2
SCALE_PRIOR = SCALE_PRIOR - logsumexp(SCALE_PRIOR)
"""Log weights of the factors on prior standard deviations."""


@dataclass(frozen=True)
class Member:
    """An effect in a hypothesis: its best form and scale."""

    form: Form
    scale: float


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, also with a cause that is not in the list."""

    members: tuple[Member, ...]
    log_evidence: float  # nats over noise only, averaged over forms and scales
    log_prior: float

    @property
    def names(self) -> tuple[str, ...]:
        """The effects, in the order in which they entered, each once."""
        return tuple(dict.fromkeys(m.form.effect for m in self.members))

    @property
    def score(self) -> float:
        """Log of evidence times prior."""
        return self.log_evidence + self.log_prior


@dataclass(frozen=True)
class Search:
    """The normal equations, the forms in them, and what is seen of each."""

    normal: Normal
    forms: tuple[tuple[Form, tuple[str, ...]], ...]  # each with its terms
    base: tuple[str, ...]  # terms of the baseline
    spread: Mapping[str, float]  # log of the share of its settings that became forms, of effects with a scan
    extra: Mapping[Form, tuple[str, ...]] = field(default_factory=dict)  # forms that the search does not add
    acting: Mapping[str, frozenset[int]] = field(default_factory=dict)  # channels of each term; else all

    @cached_property
    def terms(self) -> dict[Form, tuple[str, ...]]:
        """The terms of each form."""
        return dict(self.forms) | dict(self.extra)

    @cached_property
    def sets(self) -> tuple[np.ndarray, ...]:
        """Numbers of the terms of each form."""
        index = self.normal.index
        return tuple(np.array([index[name] for name in names]) for _, names in self.forms)

    @cached_property
    def by_effect(self) -> dict[str, np.ndarray]:
        """Numbers of the forms of each effect."""
        names = np.array([form.effect for form, _ in self.forms])
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}

    @cached_property
    def form_priors(self) -> np.ndarray:
        """Log prior of each form within its effect: sites, then drivers of each, then settings of these.

        One that is in all joints has the prior of the effect at each of them.
        """
        further = [len(terms) - 1 if form.of_each else 0 for form, terms in self.forms]
        out = np.log(SEARCH.again) * np.array(further, float)
        for name, chosen in self.by_effect.items():
            keys = [(f.site, f.driver, f.setting) for f in (self.forms[k][0] for k in chosen)]
            parts = [[len({k[d] for k in keys if k[:d] == key[:d]}) for d in range(3)] for key in keys]
            out[chosen] += self.spread.get(name, 0.0) - np.sum(np.log(parts), axis=1)
        return out

    @cached_property
    def flexible(self) -> np.ndarray:
        """Share of what a form explains that may belong to the form of one with fewer values."""
        return np.array([SEARCH.form * f.of_each for f, _ in self.forms])

    @cached_property
    def scale_priors(self) -> np.ndarray:
        """Log weights (S, scales) of the factors on the prior standard deviations of each form.

        None makes an error of a part larger than the part.
        """
        terms = self.normal.terms
        room = [min(terms[k].most / terms[k].sd for k in chosen) for chosen in self.sets]
        out = np.where(np.maximum(room, SCALES[0])[:, None] >= SCALES, SCALE_PRIOR, -np.inf)
        return np.asarray(out - logsumexp(out, axis=1, keepdims=True))

    def fit(self, members: Sequence[Member] = ()) -> Fit:
        """The baseline and the members, fitted."""
        index, terms = self.normal.index, self.terms
        numbers = [index[name] for name in self.base]
        scales = [1.0] * len(numbers)
        for m in members:
            numbers += [index[name] for name in terms[m.form]]
            scales += [m.scale] * len(terms[m.form])
        return fitted(self.normal, numbers, np.array(scales))

    def scaled(self, h: Hypothesis) -> Hypothesis:
        """A hypothesis with forms beside the search at the scales that explain most."""
        members = list(h.members)
        for k, m in enumerate(members):
            if m.form in self.extra:
                every = [replace(m, scale=float(s)) for s in SCALES]
                fits = [self.fit([*members[:k], o, *members[k + 1 :]]).log_evidence for o in every]
                members[k] = every[int(np.argmax(fits))]
        return replace(h, members=tuple(members))

    @cached_property
    def seen_forms(self) -> dict[Form, bool]:
        """Whether each form is detectable at any plausible size."""
        _, trace = gains(self.fit(), self.sets, SCALES)
        least = SEARCH.detectable / SCALES[-1] ** 2
        return {form: bool(np.max(t) > least) for (form, _), t in zip(self.forms, trace, strict=True)}

    @cached_property
    def seen(self) -> dict[str, bool]:
        """Whether each effect is detectable in any form."""
        out: dict[str, bool] = {}
        for form, seen in self.seen_forms.items():
            out[form.effect] = seen or out.get(form.effect, False)
        return out

    @property
    def candidates(self) -> tuple[str, ...]:
        """Listed effects that are detectable."""
        return tuple(name for name, seen in self.seen.items() if seen and name != UNKNOWN)

    def prior(self, effects: Sequence[str]) -> float:
        """Log prior of a set of effects; one that is there several times acts at several joints."""
        named = set(effects) - {UNKNOWN}
        count = max(len(self.candidates), 1)
        further = np.log(SEARCH.further / count) * max(len(named) - 1, 0)
        further += np.log(SEARCH.again) * (len(effects) - len(set(effects)))
        if UNKNOWN in effects:
            return float(np.log(SEARCH.unknown) + further + (np.log(SEARCH.beside / count) if named else 0.0))
        if not named:
            return float(np.log(SEARCH.null)) + SEARCH.tolerance
        return float(np.log(SEARCH.single / count) + further)

    @cached_property
    def channels(self) -> dict[Form, frozenset[int]]:
        """Channels of the residuals in which each form acts."""
        return {form: self._channels(terms) for form, terms in self.terms.items()}

    def _channels(self, terms: Sequence[str]) -> frozenset[int]:
        every = frozenset(range(len(self.normal.chi2)))
        return frozenset().union(*(self.acting.get(term, every) for term in terms))

    def of_form(self, h: Hypothesis) -> Callable[[frozenset[int]], float]:
        """Nats that a further effect in some channels must exceed: they may belong to the form of the names.

        These are a share of what is explained by those names that act in one of the channels.
        """
        whole, nothing = self.fit(h.members).log_evidence, self.fit().log_evidence
        explained = SEARCH.form * max(h.log_evidence, 0.0)

        @cache
        def of(apart: tuple[Member, ...]) -> float:
            share = (whole - self.fit(apart).log_evidence) / max(whole - nothing, 1e-9)
            return explained * float(np.clip(share, 0.0, 1.0))

        def nats(channels: frozenset[int]) -> float:
            apart = tuple(m for m in h.members if channels.isdisjoint(self.channels[m.form]))
            return of(apart) if explained and len(apart) < len(h.members) else 0.0

        return nats

    def additions(self, h: Hypothesis) -> dict[str, tuple[Member, float]]:
        """Of each effect the best form at a new site, and its gain over a hypothesis, nats, averaged.

        The gain is what exceeds the nats `of_form`.
        """
        members, least = h.members, self.of_form(h)
        table = gains(self.fit(members), self.sets, SCALES)[0]
        table -= self.flexible[:, None] * np.maximum(table, 0.0)
        table -= np.array([least(self.channels[form]) for form, _ in self.forms])[:, None]
        table += self.form_priors[:, None] + self.scale_priors
        taken, out = {(m.form.effect, m.form.site) for m in members}, {}
        terms = {term for m in members for term in self.terms[m.form]}
        for name, chosen in self.by_effect.items():
            elsewhere = [k for k in chosen if (name, self.forms[k][0].site) not in taken]
            new = [k for k in elsewhere if terms.isdisjoint(self.forms[k][1])]
            if new and (name == UNKNOWN or self.seen[name]):
                part = table[new]
                i, k = np.unravel_index(int(np.argmax(part)), part.shape)
                member = Member(self.forms[new[i]][0], float(SCALES[k]))
                out[name] = member, float(logsumexp(part)) + self._sign(member, members)
        return out

    def _sign(self, member: Member, members: Sequence[Member]) -> float:
        """Log evidence, nats, of a physically positive parameter over that of any sign, beside others."""
        name = member.form.effect
        if name not in EFFECTS or not EFFECTS[name].positive:
            return 0.0
        wide = self.fit((*members, member))
        terms = self.terms[member.form]
        return float(sum(log_ndtr(wide.values[t] / wide.u[t]) + np.log(2.0) for t in terms))

    def cells(self, members: Sequence[Member]) -> list[tuple[Form, float]]:
        """Gain of each cell over a hypothesis, nats, averaged over scales; the largest first."""
        chosen = self.by_effect.get(UNKNOWN, np.empty(0, int))
        table, _ = gains(self.fit(members), [self.sets[k] for k in chosen], SCALES)
        gain = logsumexp(table + SCALE_PRIOR, axis=1)
        return [(self.forms[chosen[k]][0], float(gain[k])) for k in np.argsort(-gain)]

    def run(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of growing size, the most probable first."""
        null = Hypothesis((), 0.0, self.prior(()))
        every: dict[tuple[str, ...], Hypothesis] = {(): null}
        level = [null]
        for _ in range(SEARCH.largest):
            further: dict[tuple[str, ...], Hypothesis] = {}
            for h in level:
                effects = [m.form.effect for m in h.members]
                for name, (member, gain) in self.additions(h).items():
                    key = tuple(sorted([*effects, name]))
                    new = Hypothesis((*h.members, member), h.log_evidence + gain, self.prior(key))
                    if key not in further or new.log_evidence > further[key].log_evidence:
                        further[key] = new
            every |= further
            # a general function may lead until all names are found: it is in no set that is extended
            least = max(h.score for h in every.values() if UNKNOWN not in h.names) - SEARCH.below_best
            level = [h for h in further.values() if UNKNOWN not in h.names and h.score > least]
            level = sorted(level, key=lambda h: -h.score)[: SEARCH.width]
            level = [h for h in level if h.log_evidence > SEARCH.gain]
            if not level:
                break
        return tuple(sorted(every.values(), key=lambda h: -h.score))


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
    sets = [h.names or (NULL,) for h in hypotheses]
    probability = {name: float(np.sum(weight[[name in names for names in sets]])) for name in effects}
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
        kind, members = "class", _members(hypotheses, probability)
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
    """The verdict without names that fitted motions, of `search`, do not show, or withheld ones not confirm.

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
        least = SEARCH.shown * expected - 2.0 * np.hypot(np.sqrt(2.0 * expected), SEARCH.scatter)
        (kept if search.seen_forms[m.form] and gain > least else refused).append(m)
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


def _members(hypotheses: tuple[Hypothesis, ...], probability: Mapping[str, float]) -> dict[str, float]:
    """The leading effect, those that may be in its place, and a cause that is not in the list."""
    leader = hypotheses[0].names[0]
    instead = {n for h in hypotheses if leader not in h.names for n in h.names if n != UNKNOWN}
    likely = sorted(instead, key=lambda n: (-probability[n], n))
    chosen = [leader, *(n for n in likely if probability[n] >= VERDICT.fewest)]
    return {n: probability[n] for n in chosen} | {OTHER: probability[UNKNOWN]}


def _credible(hypotheses: tuple[Hypothesis, ...], weight: np.ndarray) -> tuple[str, ...]:
    """Effects of the most probable hypotheses with 90 % in total."""
    last = int(np.searchsorted(np.cumsum(weight), VERDICT.credible)) + 1
    return tuple(dict.fromkeys(name for h in hypotheses[:last] for name in h.names or (NULL,)))
