"""The verdict of a diagnosis in its final form, from the decisions of its searches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bayescal.effects import EFFECTS
from bayescal.gap.examine import Examined
from bayescal.gap.outcome.notes import alike, cautions, play_or_late
from bayescal.gap.result import Hypothetical, Named, Verdict
from bayescal.gap.search.beam import COMPLIANCE
from bayescal.gap.search.refit import model_name
from bayescal.gap.search.verdict import Decision
from bayescal.gap.settings import VERDICT

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
