"""Which effects: a beam search over sets of effects, against noise only and an unmodelled effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr

from bayescal.effects import EFFECTS
from bayescal.effects.location import FOLDED, Driver, Site
from bayescal.gap.linear.evidence import SCALE_PRIOR, SCALES, Bank, log_sum, project, weighed_sets
from bayescal.gap.linear.problem import Problem
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.search.candidates import Candidates, Variant
from bayescal.gap.settings import SEARCH, VERDICT

COMPLIANCE = "compliance"


@dataclass(frozen=True)
class Member:
    """An effect in a hypothesis: its best variant and scale, and the cost of averaging over the others."""

    variant: Variant
    scale: float
    averaging: float  # log of the mean evidence over variants and scales, relative to the best
    unseen: float = 0.0  # share of the evidence, of sizes that these data would not show

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.variant.effect


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of named effects, fitted with its own outliers."""

    members: tuple[Member, ...]
    state: State
    log_evidence: float
    log_prior: float

    @property
    def names(self) -> tuple[str, ...]:
        """The effects, in the order in which they entered."""
        return tuple(m.effect for m in self.members)

    @property
    def unseen(self) -> float:
        """Share of the evidence, of sizes of the last effect that these data would not show."""
        return self.members[-1].unseen if self.members else 0.0

    @property
    def series(self) -> tuple[Member, ...]:
        """Effects that share all their sites and coordinates with others: terms that fit any function."""
        return tuple(m for m in self.members if self.terms_with(m))

    def terms_with(self, member: Member) -> tuple[Member, ...]:
        """Other effects that share all sites and coordinates of one; none where they lack some of them.

        Many waves a turn are no term of a function of the angle: they depend on the angle within one wave.
        """
        shared, mine = [m for m in self.members if m is not member and _of(m) & _of(member)], _of(member)
        return tuple(shared) if mine and mine <= set().union(*map(_of, shared)) else ()

    @property
    def score(self) -> float:
        """Log of evidence times prior."""
        return self.log_evidence + self.log_prior


def _of(member: Member) -> set[tuple[Site, Driver, bool]]:
    """Sites and coordinates of an effect, and whether it has many waves there."""
    return {(site, driver.course, driver.order > FOLDED) for site, driver in member.variant.places}


@dataclass(frozen=True)
class Scored:
    """The gain of one effect that is added to a hypothesis."""

    member: Member
    gain: float  # nats, averaged
    others: tuple[Member, ...] = ()  # the best scale of each of the other leading variants, without averaging


def unseen_share(share: float, gain: float, fitted: float) -> float:
    """Share of evidence that the data would not show, of a gain, nats, in that of a fit, `fitted`."""
    return float(min(share * np.exp(min(gain - fitted, 700.0)), 1.0))


@dataclass
class Search:
    """The problem, its candidates, and every hypothesis that was evaluated."""

    problem: Problem
    candidates: Candidates
    robust: bool = True
    further: bool = False  # an effect was named before: every effect named now is a further one
    unseen: tuple[str, ...] = ()
    hypotheses: dict[frozenset[str], Hypothesis] = field(default_factory=dict)
    anew: dict[bytes, State] = field(default_factory=dict)  # fits of no initial row weights

    def prior(self, size: int) -> float:
        """Log prior of a set with this number of effects."""
        count = max(len(self.candidates.variants), 1)
        if self.further:
            return float(size * np.log(SEARCH.further / count))
        if size == 0:
            return float(np.log(SEARCH.null))
        return float(np.log(SEARCH.single / count) + (size - 1) * np.log(SEARCH.further / count))

    def hypothesis(
        self, members: Sequence[Member], starts: Sequence[np.ndarray | None] = (None,)
    ) -> Hypothesis:
        """Fit a set of effects from several initial row weights, and return the best fit."""
        columns = np.concatenate([np.empty(0, int), *(m.variant.columns for m in members)])
        scales = np.concatenate([np.empty(0), *(np.full(len(m.variant.columns), m.scale) for m in members)])
        state = max((self._state(columns, scales, start) for start in starts), key=lambda s: s.log_evidence)
        return self._of(members, state)

    def _of(self, members: Sequence[Member], state: State) -> Hypothesis:
        """The hypothesis of a set of effects and its fit."""
        evidence = state.log_evidence + sum(m.averaging for m in members) + self.signs(state)
        return Hypothesis(tuple(members), state, evidence, self.prior(len(members)))

    def _state(self, columns: np.ndarray, scales: np.ndarray, start: np.ndarray | None) -> State:
        """The fit of `columns` with `scales`; of no initial row weights once: a search asks again."""
        if start is not None:
            return fit_state(self.problem, columns, scales, start, self.robust)
        key = columns.tobytes() + scales.tobytes()
        if key not in self.anew:
            self.anew[key] = fit_state(self.problem, columns, scales, None, self.robust)
        return self.anew[key]

    def signs(self, state: State) -> float:
        """Log evidence, nats, of physically positive parameters over that of any sign, each by itself.

        A normal prior about 0 that is restricted to positive values changes the evidence by the ratio of the
        posterior to the prior probability of a positive value.
        """
        positive = np.array([self.candidates.pool[k].positive for k in state.columns], bool)
        if not np.any(positive):
            return 0.0
        last = state.step[len(state.problem.z) :][positive]
        sd = np.sqrt(np.diag(state.covariance)[len(state.problem.z) :][positive])
        return float(np.sum(log_ndtr(last / sd) + np.log(2.0)))

    def additions(self, state: State, without: Sequence[str]) -> dict[str, Scored]:
        """The gain of each effect not in `without` that is added to a state."""
        bayes, small = weighed_sets(state, self._bank)
        out, first = {}, 0
        for name, variants in self.candidates.variants.items():
            of_effect = slice(first, first + len(variants))
            prior = np.array([v.log_prior for v in variants])[:, None] + SCALE_PRIOR
            table, first = bayes[of_effect] + prior, of_effect.stop
            if name in without:
                continue
            i, k = np.unravel_index(int(np.argmax(table)), table.shape)
            gain = float(log_sum(table))
            best = float(table[i, k] - variants[i].log_prior - SCALE_PRIOR[k])
            order = np.argsort(-np.max(table, axis=1))[: SEARCH.fitted + 1]
            others = tuple(
                Member(variants[o], float(SCALES[int(np.argmax(table[o]))]), 0.0)
                for o in order.tolist()
                if o != i
            )
            unseen = float(np.sum(np.exp(small[of_effect] + prior - gain)))
            out[name] = Scored(Member(variants[i], float(SCALES[k]), gain - best, unseen), gain, others)
        return out

    def instead(self, members: Sequence[Member], member: Member) -> tuple[Member, ...]:
        """Other forms of an effect that the measurements show beside the others, each by itself."""
        others = [m for m in members if m is not member]
        without = self.hypothesis(others).state
        scored = self.additions(without, [m.effect for m in others])[member.effect]
        score = {
            m: self.hypothesis((*others, m)).state.log_evidence + m.variant.log_prior
            for m in (scored.member, *scored.others)
            if m.variant is not member.variant
        }
        return tuple(m for m in score if score[m] - without.log_evidence > VERDICT.kept)

    @cached_property
    def _bank(self) -> Bank:
        """All variants of all candidates, in order; from `run` on they are those that are detectable."""
        sets = [v.columns for variants in self.candidates.variants.values() for v in variants]
        p = self.problem
        return Bank(p.pool, tuple(sets), p.count, p.worth, p.jacobian)

    def allowed(self, names: Sequence[str]) -> bool:
        """Whether a set contains all effects that its effects require, where these are candidates."""
        c, there = self.candidates, {*names, *self.candidates.partly}
        required = {r for n in names if n in EFFECTS for r in EFFECTS[n].requires}
        return not any(r in c.variants and r not in there for r in required)

    def extend(self, base: Hypothesis, least: float) -> list[Hypothesis]:
        """Every hypothesis with a further effect whose gain is at least this number of nats."""
        tables = [(self.additions(base.state, base.names), base.state.weight)]
        if base.state.gross:
            whole = fit_state(self.problem, base.state.columns, base.state.scales, robust=False)
            tables.append((self.additions(whole, base.names), np.ones_like(whole.weight)))
        out = []
        for name in tables[0][0]:
            if not self.allowed((*base.names, name)):
                continue
            key = frozenset((*base.names, name))
            tried = [
                (self.hypothesis((*base.members, table[name].member), (None, start)), table[name])
                for table, start in tables
                if table[name].gain >= least or (len(tables) == 1 and not base.members)
            ]
            if not tried:
                continue
            best, scored = max(tried, key=lambda t: t[0].log_evidence)
            if best.log_evidence - base.log_evidence >= SEARCH.large:
                best = self._refitted(base, best, tables[0][0][name].others)
            last = best.members[-1]
            unseen = unseen_share(last.unseen, scored.gain, best.log_evidence - base.log_evidence)
            best = replace(best, members=(*base.members, replace(last, unseen=unseen)))
            earlier = self.hypotheses.get(key)
            if earlier is None or best.log_evidence > earlier.log_evidence:
                self.hypotheses[key] = best
            out.append(self.hypotheses[key])
        return out

    def _refitted(self, base: Hypothesis, best: Hypothesis, others: Sequence[Member]) -> Hypothesis:
        """The best variant and scale of the last effect of a hypothesis, each by a fit of its own.

        The gains of `additions` hold for the noise and the row weights without the effect: for a large effect
        they misjudge how well a variant fits what is left.
        """
        fits = {replace(best.members[-1], averaging=0.0): best.state}

        def fit(members: Sequence[Member]) -> None:
            for m in members:
                if m not in fits:
                    fits[m] = self.hypothesis((*base.members, m), (best.state.weight,)).state

        def weight(m: Member) -> float:
            """Log evidence of a variant and scale, with their prior within the effect."""
            nearest = int(np.argmin(np.abs(np.log(SCALES / m.scale))))
            return fits[m].log_evidence + m.variant.log_prior + float(SCALE_PRIOR[nearest])

        fit(others)
        lead = max(fits, key=weight)
        nearest = int(np.argmin(np.abs(np.log(SCALES / lead.scale))))
        beside = [float(SCALES[k]) for k in (nearest - 1, nearest + 1) if 0 <= k < len(SCALES)]
        fit([replace(lead, scale=scale) for scale in beside])
        member = max(fits, key=weight)
        total = float(log_sum(np.array([weight(m) for m in fits])))
        chosen = replace(member, averaging=total - fits[member].log_evidence)
        return self._of((*base.members, chosen), fits[member])

    def _leave_out_unseen(self, state: State) -> None:
        """Effects that are not detectable at any plausible amplitude are not candidates."""
        whole = fit_state(self.problem, state.columns, state.scales, robust=False)
        projected = project(whole, self.problem.pool)
        weighted = projected.weighted
        squares = np.einsum("rk,rk->k", weighted, weighted)  # without a copy of all columns
        seen = squares - np.einsum("dk,dk->k", projected.across, projected.solved)
        seen *= (whole.kappa / state.kappa) ** 2  # at the noise without outliers
        most = {
            name: max(float(np.sum(seen[v.columns])) for v in variants)
            for name, variants in self.candidates.variants.items()
        }
        self.unseen = tuple(name for name, size in most.items() if size * SCALES[-1] ** 2 < SEARCH.detectable)
        kept = {n: v for n, v in self.candidates.variants.items() if n not in self.unseen}
        self.candidates = replace(self.candidates, variants=kept)

    def run(self) -> None:
        """Search sets of growing size with a beam."""
        null = self.hypothesis(())
        self._leave_out_unseen(null.state)
        self.hypotheses[frozenset()] = null
        level = self.extend(null, SEARCH.first_gain)
        for _ in range(SEARCH.largest - 1):
            beam = sorted(dict.fromkeys(level), key=lambda h: -h.score)[: SEARCH.width]
            beam = [h for h in beam if h.score > null.score - SEARCH.below_null]
            level = [new for h in beam for new in self.extend(h, SEARCH.further_gain)]
            top = max(h.score for h in self.hypotheses.values())
            level = [h for h in level if h.score > top - SEARCH.below_best]
            if not level:
                break
