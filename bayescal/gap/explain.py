"""Effects named and confirmed: baseline, compliance where it was missing, refit, validation errors.

The verdict of a diagnosis in its final form, from the decisions of its searches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.effects import EFFECTS
from bayescal.estimate import Estimate
from bayescal.gap.examine import Examined, examine
from bayescal.gap.outcome.notes import alike, cautions, play_or_late
from bayescal.gap.result import Hypothetical, Named, Verdict
from bayescal.gap.search.beam import COMPLIANCE, Member
from bayescal.gap.search.gate import confirmed, contradiction
from bayescal.gap.search.refit import model_name, refit
from bayescal.gap.search.verdict import Decision
from bayescal.gap.settings import GATE, VERDICT
from bayescal.model.options import USUAL, FitOptions
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import BLOCKED, VALIDATED, validation_errors
from bayescal.predict.errors import ValidationErrors

UNSEEN = "not detectable with these contacts at any plausible amplitude"


def concluded(e: Examined, without: Decision | None) -> Verdict:
    """The verdict; `without` is the decision for the model without compliance, if that was missing."""
    d = e.decision
    probability = dict(d.probability)
    named = [_named(m, d, e) for m in d.members]
    kind, credible = d.kind, d.credible
    if without is not None:
        sure = without.probability[COMPLIANCE]
        probability |= {COMPLIANCE: sure, "null": without.probability["null"]}
        compliance = Named(COMPLIANCE, COMPLIANCE, (), "", stated(sure), without.lost(COMPLIANCE))
        named = [compliance, *named]
        # without any further effect, no effect is confounded with it; noise only is then compliance alone
        credible = () if kind == "null" else tuple(n for n in credible if n != "null")
        credible = (COMPLIANCE, *credible)
        kind = {"null": "named", "unknown": "named+unexplained"}.get(kind, kind)
    probability = {name: min(p, _most(name, kind, d)) for name, p in probability.items()}
    named = [replace(n, probability=min(n.probability, probability[n.effect])) for n in named]
    kind = settled(kind, bool(named), probability)
    return Verdict(
        kind,
        tuple(named),
        {name: stated(p) for name, p in probability.items()},
        credible,
        tuple(
            Hypothetical(w.effects, stated(w.probability), w.log_evidence)
            for w in d.weighed[: VERDICT.listed]
        ),
        d.footnotes,
        e.candidates.missing | dict.fromkeys(e.search.unseen, UNSEEN),
        (
            *play_or_late(d.alone, e.pool, d.credible),
            *alike(e.fitted.model.scene, d.members),
            *cautions(e.fitted.model.scene.dataset),
        ),
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
    if name in d.withheld:
        return VERDICT.not_admitted
    return VERDICT.beside_unmodelled if kind in ("named+unexplained", "unknown") else 1.0


def _named(member, d: Decision, e: Examined) -> Named:
    v = member.variant
    setting = EFFECTS[v.effect].words(v.setting)
    return Named(
        v.effect, model_name(member, e.candidates), v.sites, setting, stated(d.probability[v.effect]),
        d.lost(v.effect), v.effect not in d.unclaimed,
    )  # fmt: skip


def stated(probability: float) -> float:
    """A probability within the limits that blind checks support."""
    return float(np.clip(probability, 1.0 - VERDICT.stated, VERDICT.stated))


Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Explained:
    """A baseline, the named effects, and the validation residuals of both models."""

    first: Examined
    last: Examined  # the same, or with compliance in the model where that was `promoted`
    promoted: bool
    before: ValidationErrors  # of the baseline
    final: Estimate  # with the named effects
    after: ValidationErrors

    @property
    def verdict(self) -> Verdict:
        """Which effect."""
        return concluded(self.last, self.first.decision if self.promoted else None)


def explain(
    scene: Scene,
    effects: tuple[str, ...],
    options: FitOptions = USUAL,
    progress: Progress = lambda stage, fraction: None,
) -> Explained:
    """Name effects that a baseline lacks, if validation measurements confirm them; see `diagnose`."""
    progress("estimate", 0.0)
    first = examine(scene, effects, options)
    progress("search", 0.3)
    last, promoted = first, COMPLIANCE not in effects and _promoted(first)
    if promoted:
        last = examine(scene, (*effects, COMPLIANCE), options, further=True)
    progress("refit", 0.6)
    before = validation_errors(first.fitted)
    alone = before if last is first and before.how == VALIDATED else _judging(last.fitted)

    known: dict[tuple[int, ...], tuple[Estimate, ValidationErrors]] = {(): (last.fitted, alone)}

    def fitted(members: Sequence[Member]) -> tuple[Estimate, ValidationErrors]:
        key = tuple(map(id, members))
        if key not in known:
            final = refit(last.fitted, last.candidates, members, options)
            known[key] = final, _judging(final)
        return known[key]

    confirmed_last, final, after = _confirmed(last, alone, fitted)
    if after.how != VALIDATED:
        after = before if final is first.fitted else validation_errors(final)
    return Explained(first, confirmed_last, promoted, before, final, after)


def _judging(estimate: Estimate) -> ValidationErrors:
    """Validation errors that judge names: without validation measurements, of rows left out in blocks."""
    return validation_errors(estimate, without=BLOCKED)


def _confirmed(
    e: Examined,
    before: ValidationErrors,
    fitted: Callable[[Sequence[Member]], tuple[Estimate, ValidationErrors]],
) -> tuple[Examined, Estimate, ValidationErrors]:
    """The refit with the named effects that the validation data admit, and the decision with its reasons."""
    d = e.decision
    # beside an unmodelled effect, what a name explains may be part of that effect
    complete = d.kind == "named"
    found = confirmed(
        d.members, fitted, before, lambda m: complete and d.probability[m.effect] > VERDICT.certain
    )
    notes = [f"{a.member.effect} {a.words}; it is not named" for a in found.withheld]
    notes += [f"{a.member.effect} {a.words}; no reduction of errors is claimed" for a in found.unclaimed]
    kind = d.kind
    if found.withheld:
        kind = "ambiguous" if kind == "named" else kind if found.members else "unknown"
    if kind == "named" and (p := contradiction(before, found.errors)) < GATE.contradicted:
        kind = "named+unexplained"
        notes.append(
            f"the validation data contradict the refit: by it, so large errors have p {max(p, 1e-99):.0e}"
        )
    d = replace(
        d,
        kind=kind,
        hypothesis=e.search.hypothesis(found.members) if found.withheld else d.hypothesis,
        footnotes=(*d.footnotes, *notes),
        unclaimed=frozenset(a.member.effect for a in found.unclaimed),
        withheld=frozenset(a.member.effect for a in found.withheld),
    )
    return replace(e, decision=d), found.fitted, found.errors


def _promoted(first: Examined) -> bool:
    """Whether compliance is added to a model without it: many effects act through compliance."""
    if COMPLIANCE not in first.candidates.variants:
        return False
    sets = first.search.hypotheses
    own = sets.get(frozenset((COMPLIANCE,)))
    best = max(sets.values(), key=lambda h: h.score)
    gained = own is not None and own.score - sets[frozenset()].score > VERDICT.promoted
    sure = first.decision.probability.get(COMPLIANCE, 0.0) >= VERDICT.sure
    return gained and sure and COMPLIANCE in best.names
