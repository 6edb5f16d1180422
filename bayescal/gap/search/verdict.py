"""The verdict: probabilities of all hypotheses, and the effects that are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.effects import EFFECTS, confusable
from bayescal.effects.location import ARM, Site
from bayescal.gap.linear.evidence import log_sum
from bayescal.gap.outcome.where import unabsorbed, visible
from bayescal.gap.search.beam import Hypothesis, Member, Search
from bayescal.gap.search.candidates import Variant
from bayescal.gap.search.makers import Argument, Cell
from bayescal.gap.search.unknown import CellFit, Pool, Related, relatives, unknown, with_set
from bayescal.gap.settings import SEARCH, VERDICT

SURELY_UNSEEN = 1e-9
"""Least share of a set that is not regarded as unseen (rounding)."""


@dataclass(frozen=True)
class Weighed:
    """A hypothesis, with or without an unmodelled effect, and its probability.

    The unmodelled effect is that of a generic cell beside the named ones, or a relative in place of one.
    """

    hypothesis: Hypothesis
    cell: CellFit | None  # best cell of the unmodelled effect; None without one
    log_evidence: float  # relative to noise only
    score: float
    probability: float = 0.0
    unseen: float = 0.0  # share of its evidence, of sizes of the last effect that the data would not show
    at_names: float = -np.inf  # nats of the best cell at a site of a named effect, beyond what is forgiven
    related: Related | None = None  # in place of its member

    @property
    def names(self) -> tuple[str, ...]:
        """The named effects."""
        replaced = self.related.member if self.related else None
        return tuple(m.effect for m in self.hypothesis.members if m is not replaced)

    @property
    def unmodelled(self) -> bool:
        """Whether it has an unmodelled effect."""
        return self.cell is not None or self.related is not None

    @property
    def effects(self) -> tuple[str, ...]:
        """Names, "unknown" last."""
        return self.names + (("unknown",) if self.unmodelled else ())


@dataclass(frozen=True)
class Decision:
    """The decision and its basis."""

    kind: str
    hypothesis: Hypothesis  # of the named effects
    weighed: tuple[Weighed, ...]  # the most probable first
    probability: Mapping[str, float]
    credible: tuple[str, ...]
    alone: tuple[CellFit, ...]  # every cell over noise only
    footnotes: tuple[str, ...]
    unclaimed: frozenset[str] = frozenset()  # named effects that validation data do not confirm
    withheld: frozenset[str] = frozenset()  # effects that validation data do not admit
    replaced: frozenset[str] = frozenset()  # named effects that validation data admit in another form only
    explained: float = 1.0  # share of the nats of names and an unmodelled effect that the names explain

    @property
    def members(self) -> tuple[Member, ...]:
        """The named effects."""
        return self.hypothesis.members

    @property
    def total(self) -> float:
        """Log evidence, nats, of the measurements under all hypotheses."""
        return float(log_sum(np.array([w.score for w in self.weighed])))

    def lost(self, effect: str) -> float:
        """Log evidence, nats, that the best set loses without an effect."""
        without = max((w.score for w in self.weighed if effect not in w.effects), default=-np.inf)
        return self.weighed[0].score - without


def decide(search: Search, pool: Pool, given: Sequence[Argument] = ()) -> Decision:
    """Compute the probability of every hypothesis, with and without an unmodelled effect, and decide."""
    weighed, alone = weigh(search, pool, given)
    probability = probabilities(weighed, list(search.candidates.variants))
    kind, names = verdict_of(weighed, probability)
    best = weighed[0]
    null = search.hypotheses[frozenset()].log_evidence
    explained = (best.hypothesis.log_evidence - null) / best.log_evidence if best.cell is not None else 1.0
    members = tuple(m for m in best.hypothesis.members if m.effect in names)
    if best.cell is not None and names:
        needed = (_beside(search, best, pool, m) for m in members if explained >= VERDICT.sure)
        members = tuple(m for m in needed if m is not None)
        kind = "named+unexplained" if members else "unknown"
    if kind == "named" and contradicted(weighed):
        kind = "named+unexplained"
    members, footnotes = _without_footnotes(search, members, probability)
    chosen = search.hypothesis(members, (None, best.hypothesis.state.weight))
    sets = credible_set(weighed)
    return Decision(kind, chosen, weighed, probability, sets, tuple(alone), footnotes, explained=explained)


def weigh(
    search: Search, pool: Pool, given: Sequence[Argument] = ()
) -> tuple[tuple[Weighed, ...], list[CellFit]]:
    """All hypotheses with their probabilities, the most probable first; and every cell over noise only.

    `given` are the quantities of the session that may modulate a named effect.
    """
    ranked = sorted(search.hypotheses.values(), key=lambda h: -h.score)
    null = search.hypotheses[frozenset()]
    leaders = dict.fromkeys((null, *ranked[: VERDICT.leaders]))
    out = [Weighed(h, None, h.log_evidence - null.log_evidence, h.score, 0.0, h.unseen) for h in ranked]
    alone: list[CellFit] = []
    for h in leaders:
        # a part of the baseline that was left out is a linear form of an error that may be large
        tested = [m for m in h.members if m.effect not in search.candidates.partly] if given else []
        every = relatives(h, tested, null.log_evidence, given, _without(search, h)) if tested else ()
        nats = h.log_evidence - null.log_evidence
        out += [Weighed(h, None, nats + r.gain, h.score + r.gain, related=r) for r in every]
        out += [Weighed(h, None, nats + r.gain, h.score + r.gain, related=r) for r in _alike(search, h)]
        gain, small, cells = unknown(h, pool, null.log_evidence)
        alone = cells if h is null else alone
        if not np.isfinite(gain):
            continue
        best = max((f for f in cells if f.rival), key=lambda f: f.gain + pool.log_prior[f.cell])
        beside = bool(h.members) or search.further
        prior = h.log_prior + float(np.log(VERDICT.beside)) if beside else float(np.log(SEARCH.unknown))
        evidence = h.log_evidence + gain - given_away(pool.cells[best.cell], ranked) * max(gain, 0.0)
        named = _sites(h)
        at_names = max(
            (f.gain for f in cells if f.rival and pool.cells[f.cell].site in named), default=-np.inf
        )
        out.append(Weighed(h, best, evidence - null.log_evidence, evidence + prior, 0.0, small, at_names))
    out = seen(softened(out))
    total = log_sum(np.array([w.score for w in out]))
    out = [replace(w, probability=float(np.exp(w.score - total))) for w in out]
    return tuple(sorted(out, key=lambda w: -w.score)), alone


def _without(search: Search, h: Hypothesis) -> Callable[[Member], Hypothesis]:
    """A hypothesis without one of its members."""

    def without(member: Member) -> Hypothesis:
        others = [m for m in h.members if m is not member]
        hypothesis = search.hypotheses.get(frozenset(m.effect for m in others))
        return hypothesis or search.hypothesis(others, (None, h.state.weight))

    return without


def _alike(search: Search, h: Hypothesis) -> Iterator[Related]:
    """Causes that are not known in place of members that have their form; see `Effect.shown_by`.

    Their evidence is that of the member by any other quantity than the one that would show it.
    """
    for m in h.members:
        shown = EFFECTS[m.effect].shown_by if m.effect in EFFECTS else ""
        if not shown or m.variant.sites in ((), (ARM,)):
            continue
        loss = 0.0
        if shown in _kinds(m.variant):
            others, start = [x for x in h.members if x is not m], (None, h.state.weight)
            nats = [
                search.hypothesis((*others, replace(m, variant=v)), start).state.log_evidence
                for v in search.candidates.variants[m.effect]
                if v.sites == m.variant.sites and shown not in _kinds(v)
            ]
            loss = max(h.state.log_evidence - max(nats, default=h.state.log_evidence), 0.0)
        yield Related(m, m.variant.places[0][1], float(np.log(VERDICT.same_form)) - loss, alike=True)


def _kinds(variant: Variant) -> set[str]:
    """Kinds of quantities on which a variant depends."""
    return {driver.kind for _, driver in variant.places}


def _sites(h: Hypothesis) -> set[Site]:
    """The sites of its effects."""
    return {site for m in h.members for site, _ in m.variant.places}


def given_away(cell: Cell, ranked: Sequence[Hypothesis]) -> float:
    """Discount on the nats of a cell, by the effects of the leading hypotheses at its site and driver."""
    leaders = [h for h in ranked[: VERDICT.leaders + 1] if h.score > ranked[0].score - VERDICT.rival]
    members = [m for h in leaders for m in h.members]
    named = {(site, driver.course) for m in members for site, driver in m.variant.places}
    if (cell.site, cell.driver) in named:
        return VERDICT.same_place
    return VERDICT.same_course if (cell.site, cell.driver.course) in named else VERDICT.form


def softened(weighed: Sequence[Weighed]) -> list[Weighed]:
    """Scores of sets that replace an effect of the leading set by a confusable one, softened.

    The form of an effect is known to 10 or 20 %, which is equivalent to a few nats, and confusable effects
    differ only in form. Their scores are therefore moved towards that of the leading set.
    """
    leader = max(weighed, key=lambda w: w.score)

    def soft(w: Weighed) -> Weighed:
        return replace(w, score=leader.score - VERDICT.soft * (leader.score - w.score))

    return [soft(w) if confusable_sets(leader, w) else w for w in weighed]


def seen(weighed: Sequence[Weighed]) -> list[Weighed]:
    """Scores of sets without what is too small to be seen: with it a set is the same as without the effect.

    An effect whose expected lambda is below `SEARCH.detectable` leaves the data as they are.
    """
    out = sorted(weighed, key=lambda w: -len(w.effects))
    bare = {frozenset(w.names): k for k, w in enumerate(out) if not w.unmodelled}
    score = np.array([w.score for w in out])
    for k, w in enumerate(out):
        base = bare.get(frozenset(w.names if w.unmodelled else w.names[:-1]))
        if w.unseen > 0 and base is not None:
            score[base] = np.logaddexp(score[base], score[k] + np.log(w.unseen))
            score[k] += np.log1p(-min(w.unseen, 1.0 - SURELY_UNSEEN))
    return [replace(w, score=s) for w, s in zip(out, score.tolist(), strict=True)]


def confusable_sets(a: Weighed, b: Weighed) -> bool:
    """Whether two sets differ only in one effect, which is replaced by a confusable one."""
    swapped = set(a.effects) ^ set(b.effects)
    return len(swapped) == 2 and confusable(*swapped)


def probabilities(weighed: Sequence[Weighed], effects: Sequence[str]) -> dict[str, float]:
    """Marginal probability of the noise-only model, of an unmodelled effect and of every effect."""
    out = dict.fromkeys(("null", "unknown", *effects), 0.0)
    for w in weighed:
        for name in w.effects or ("null",):
            out[name] += w.probability
    return {name: min(p, 1.0) for name, p in out.items()}


def credible_set(weighed: Sequence[Weighed]) -> tuple[str, ...]:
    """Effects of the most probable hypotheses with 90 % in total, and confusable ones nearly as probable.

    "null" stands for the noise-only model, where that is one of them.
    """
    out: dict[str, None] = {}
    mass = 0.0
    for w in weighed:
        out |= dict.fromkeys(w.effects or ("null",))
        mass += w.probability
        if mass >= VERDICT.credible:
            break
    for w in weighed:
        if confusable_sets(weighed[0], w) and weighed[0].score - w.score < VERDICT.far:
            out |= dict.fromkeys(w.effects)
    return tuple(out)


def verdict_of(weighed: Sequence[Weighed], probability: Mapping[str, float]) -> tuple[str, tuple[str, ...]]:
    """Kind of verdict and the effects to be named."""
    best = weighed[0]
    if probability["null"] >= VERDICT.null_enough or not best.effects:
        return "null", ()
    sure = tuple(n for n in best.names if probability[n] >= VERDICT.sure)
    if instead(weighed) is not None or undecided(weighed, probability):
        return "class", sure
    if best.cell is not None and not best.names:
        return ("unknown" if probability["unknown"] >= VERDICT.sure else "ambiguous"), ()
    if best.cell is not None:
        return "named+unexplained", sure
    if len(sure) == len(best.names) and not level(weighed, probability):
        if best.hypothesis.series:
            return "class", sure
        return ("named+unexplained" if further(weighed) >= VERDICT.unexplained else "named"), sure
    return "ambiguous", tuple(n for n in sure if probability[n] >= VERDICT.credible)


def instead(weighed: Sequence[Weighed]) -> Related | None:
    """What may be in place of a member of the leading set, which is no name then; None if nothing."""
    best, least = weighed[0], weighed[0].probability * (1.0 / VERDICT.alone - 1.0)
    of_best = [w for w in weighed if w.hypothesis is best.hypothesis and w.probability > least]
    alike = (w.related for w in of_best if w.related is not None and w.related.alike)
    return best.related or next(alike, None)


def level(weighed: Sequence[Weighed], probability: Mapping[str, float]) -> list[Weighed]:
    """The best hypothesis of each effect that is nearly as probable as one of the leading set."""
    least = min((probability[n] for n in weighed[0].names), default=1.0) / VERDICT.odds
    others = (n for n, p in probability.items() if n not in ("null", *weighed[0].effects) and p > least)
    return [next(w for w in weighed if name in w.names) for name in others if name != "unknown"]


def undecided(weighed: Sequence[Weighed], probability: Mapping[str, float]) -> bool:
    """Whether a lone effect leads without enough probability over what may be in its place, at its site.

    That is an unmodelled effect, or effects that are nearly as probable.
    """
    first, others = weighed[0], level(weighed, probability)
    lone = len(first.names) == 1 and not first.unmodelled and probability[first.names[0]] < VERDICT.alone
    here, *each = (_sites(w.hypothesis) for w in (first, *others))
    return lone and bool(others or probability["unknown"] >= VERDICT.fewest) and all(here & e for e in each)


def further(weighed: Sequence[Weighed]) -> float:
    """Probability that the leading set is not all: of its supersets, and of every unmodelled effect."""
    names = set(weighed[0].effects)
    return sum(w.probability for w in weighed if w.unmodelled or names < set(w.effects))


def contradicted(weighed: Sequence[Weighed]) -> bool:
    """Whether residual structure at the site of a named effect of the best set contradicts its form."""
    return any(w.at_names > VERDICT.structure for w in weighed if w.hypothesis is weighed[0].hypothesis)


def _beside(search: Search, best: Weighed, pool: Pool, member: Member) -> Member | None:
    """A named effect as it is needed beside the unmodelled effect, or None: in its own form or in another.

    Of several shifts, some may stand for what the unmodelled effect explains.
    """
    assert best.cell is not None
    others = [m for m in best.hypothesis.members if m is not member]
    without = search.hypothesis(others)
    start = best.hypothesis.state.weight
    bare = with_set(without.state, pool, best.cell.best, best.cell.scale, start)
    full = with_set(best.hypothesis.state, pool, best.cell.best, best.cell.scale, start)
    if full.log_evidence + member.averaging - bare.log_evidence > VERDICT.kept:
        return member
    other = search.additions(bare, [m.effect for m in others])[member.effect]
    return other.member if other.gain > VERDICT.kept else None


def _without_footnotes(
    search: Search, members: tuple[Member, ...], probability: Mapping[str, float]
) -> tuple[tuple[Member, ...], tuple[str, ...]]:
    """Members that are certain or explain enough of the variance, the largest first, and the others as text.

    Enough of the variance of lengths, or of orientations: a rotation of the tool may hardly move its point.
    """
    if len(members) < 2:
        return members, ()
    null = search.hypotheses[frozenset()].state
    state = search.hypothesis(members).state
    each = [state.predicted(m.variant.columns) for m in members]
    size = [float(np.mean(visible(null, moved) ** 2)) for moved in each]
    turns = [float(np.sum(unabsorbed(null, moved)[search.problem.lengths :] ** 2)) for moved in each]
    total, turned = max(sum(size), 1e-300), max(sum(turns), 1e-300)
    share = [max(s / total, t / turned) for s, t in zip(size, turns, strict=True)]
    small = {
        m.effect: f"{m.effect}: RMS {1e6 * np.sqrt(s):.1f} µm, {100 * part:.0f} % of the explained variance"
        for m, s, part in zip(members, size, share, strict=True)
        if part < VERDICT.footnote and probability[m.effect] <= VERDICT.certain
    }
    kept = tuple(members[k] for k in np.argsort(size)[::-1] if members[k].effect not in small)
    return kept, tuple(small.values())
