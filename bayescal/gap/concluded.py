"""The verdict in its final form: from the decisions of a search and the tests by validation data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from bayescal.effects import EFFECTS
from bayescal.effects.location import ARM
from bayescal.errors import attempted
from bayescal.estimate import Estimate
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.widths import sentences
from bayescal.gap.examine import Examined, smooth_cell
from bayescal.gap.outcome.events import named_events
from bayescal.gap.outcome.statements import Change, cautions, play_or_late
from bayescal.gap.outcome.where import beside
from bayescal.gap.result import OTHER, CauseClass, Event, Hypothetical, Named, Verdict
from bayescal.gap.search.beam import COMPLIANCE, Member
from bayescal.gap.search.refit import model_name
from bayescal.gap.search.verdict import Decision, Weighed, instead
from bayescal.gap.settings import VERDICT

UNSEEN = "not detectable with these contacts at any plausible amplitude"


def concluded(e: Examined, without: Decision | None) -> Verdict:
    """The verdict; `without` is the decision for the model without compliance, if that was missing."""
    d = e.decision
    probability = dict(d.probability)
    events = attempted("rows of sudden changes", partial(events_of, e), {}, [])  # `explain` says it
    failed: list[str] = []
    named = [replace(_named(m, d, e, failed), events=events.get(m.effect, ())) for m in d.members]
    kind, credible = d.kind, d.credible
    if without is not None:
        sure = without.probability[COMPLIANCE]
        probability |= {COMPLIANCE: sure, "null": without.probability["null"]}
        compliance = Named(COMPLIANCE, COMPLIANCE, (), "", supported(sure), without.lost(COMPLIANCE))
        named = [compliance, *named]
        # without any further effect, no effect is confounded with it; noise only is then compliance alone
        credible = () if kind == "null" else tuple(n for n in credible if n != "null")
        credible = (COMPLIANCE, *credible)
        kind = {"null": "named", "unknown": "named+unexplained", "class": "named+unexplained"}.get(kind, kind)
    # what a name may not have is an unmodelled effect's
    limited = {name: min(p, _most(name, kind, d)) for name, p in probability.items()}
    lost = sum(probability.values()) - sum(limited.values())
    probability = limited | {"unknown": min(limited["unknown"] + lost, 1.0)}
    named = [replace(n, probability=min(n.probability, probability[n.effect])) for n in named]
    kind = settled(kind, bool(named), probability)
    scene = e.fitted.model.scene
    return Verdict(
        kind,
        tuple(named),
        {name: supported(p) for name, p in probability.items()},
        credible,
        hypotheticals(d.weighed)[: VERDICT.listed],
        d.footnotes,
        e.candidates.missing | dict.fromkeys(e.search.unseen, UNSEEN),
        (*sentences(e.widths), *play_or_late(d.alone, e.pool, d.credible), *cautions(scene.dataset), *failed),
        _causes(d, probability) if kind == "class" else None,
    )


def refused(e: Examined, change: Change) -> Examined:
    """The diagnosis where all names together increase the validation errors.

    Beside an unmodelled effect none of them is named: what they describe is a part of that effect. Else the
    names stay, and no reduction of errors is claimed.
    """
    d = e.decision
    names = frozenset(m.effect for m in d.members)
    if d.kind == "named":
        return replace(e, decision=replace(d, unclaimed=names))
    kind = d.kind if d.kind in ("class", "ambiguous") else "unknown"
    together = " with the other names" if len(names) > 1 else ""
    why = f"explains the calibration rows, but{together} validation errors increase, {change.sizes}"
    others = (note for note in d.footnotes if note.partition(" ")[0].partition("@")[0] not in names)
    d = replace(
        d,
        kind=kind,
        hypothesis=e.search.hypothesis(()),
        footnotes=(*others, *(f"{name} {why}; it is not named" for name in sorted(names))),
        unclaimed=frozenset(),
        withheld=d.withheld | names,
        replaced=d.replaced - names,
    )
    return replace(e, decision=d)


def hypotheticals(weighed: Sequence[Weighed]) -> tuple[Hypothetical, ...]:
    """Sets of effects, the most probable first, each once, with the log evidence of its most probable form.

    An unmodelled effect beside a set, and one in place of an effect of another set, may be of the same set.
    Less probable ones than blind checks support are left out.
    """
    best: dict[frozenset[str], Weighed] = {}
    probability: dict[frozenset[str], float] = {}
    for w in weighed:
        effects = frozenset(w.effects)
        best.setdefault(effects, w)
        probability[effects] = probability.get(effects, 0.0) + w.probability
    ranked = sorted(best, key=lambda effects: -probability[effects])
    shown = [n for n in ranked if probability[n] >= 1.0 - VERDICT.stated] or ranked[:1]
    return tuple(
        Hypothetical(best[n].effects, supported(probability[n]), best[n].log_evidence) for n in shown
    )


def events_of(e: Examined) -> Mapping[str, tuple[Event, ...]]:
    """Rows of the sudden changes that are named, by effect."""
    d = e.decision
    return named_events(d.hypothesis, e.pool, e.candidates.pool, e.circumstances, smooth_cell(e))


def _causes(d: Decision, probability: Mapping[str, float]) -> CauseClass:
    """The leading effect, those that may be in its place, and an unmodelled one."""
    best, related = d.weighed[0], instead(d.weighed)
    series = () if related else best.hypothesis.series
    leader = related.member if related else (*series, *best.hypothesis.members)[0]
    rivals = {leader.effect} | {n for w in d.weighed if leader.effect not in w.effects for n in w.names}
    rivals -= {m.effect for m in best.hypothesis.members if m is not leader}
    rivals |= {m.effect for m in series}
    likely = sorted(rivals, key=lambda n: (-probability[n], n))
    members = {n: probability[n] for n in likely if n == leader.effect or probability[n] >= VERDICT.fewest}
    sites = tuple(dict.fromkeys(site for site, _ in leader.variant.places))
    drivers = dict.fromkeys(driver.course for _, driver in leader.variant.places)
    if len(drivers) > VERDICT.advised:  # one of every joint
        drivers = dict.fromkeys(replace(driver, joint=0) for driver in drivers)
    further = () if related is None else (related.driver,)
    return CauseClass(
        (ARM,) if ARM in sites else sites,
        (*drivers, *(driver for driver in further if driver not in drivers)),
        {n: supported(p) for n, p in (members | {OTHER: probability["unknown"]}).items()},
    )


def settled(kind: str, named: bool, probability: Mapping[str, float]) -> str:
    """The verdict that probabilities support: `unknown` is as likely as not, without it `ambiguous`.

    A verdict `named` or `named+unexplained` without a name is none.
    """
    kind = "unknown" if kind in ("named", "named+unexplained") and not named else kind
    return "ambiguous" if kind == "unknown" and probability["unknown"] < VERDICT.sure else kind


def _most(name: str, kind: str, d: Decision) -> float:
    """Largest probability that is stated of an effect."""
    if name in ("null", "unknown"):
        return 1.0
    beside = kind in ("named+unexplained", "class", "unknown")
    if name in d.withheld or (beside and name in d.unclaimed):
        return VERDICT.not_admitted
    if not beside:
        return VERDICT.beside_unmodelled if name in d.replaced else 1.0
    explained = d.explained if name in d.weighed[0].names else 1.0
    return float(np.clip(explained, 0.0, VERDICT.beside_unmodelled))


def _named(member: Member, d: Decision, e: Examined, failed: list[str]) -> Named:
    v = member.variant
    setting = EFFECTS[v.effect].words(v.setting)
    alike = partial(beside, member, d.hypothesis, e.candidates.pool, e.circumstances, e.slopes)
    where = attempted(f"sites at which {v.effect} would look the same", alike, (), failed)
    terms = d.hypothesis.terms_with(member)
    return Named(
        v.effect, model_name(member, e.candidates), v.sites, setting, supported(d.probability[v.effect]),
        d.lost(v.effect), v.effect not in d.unclaimed, (), where, tuple(m.effect for m in terms),
    )  # fmt: skip


def supported(probability: float) -> float:
    """A probability within the limits that blind checks support."""
    return float(np.clip(probability, 1.0 - VERDICT.stated, VERDICT.stated))


def doubted(refitted: Estimate, baseline: Estimate, verdict: Verdict) -> Estimate:
    """A refit whose stated uncertainty keeps what its names may not explain of the baseline's discrepancy.

    The names were chosen by the residuals that show the discrepancy: they leave less of it there than
    elsewhere. Beside an unmodelled effect all of it is kept, and else the share of the probability that a
    name is wrong.
    """
    share = 1.0 - min((n.probability for n in verdict.named), default=0.0)
    share = share if verdict.kind == "named" else 1.0
    return replace(refitted, least={f: share * v for f, v in stated(baseline).variances.items() if v > 0})
