"""The terminal's summary of a diagnosis: how big, where, which, how far it shrinks, what to probe next."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bayescal.gap.result import Gap, Margin, Shrinkage
from bayescal.reporting.gap.phrases import headline, listed, p_value, place, probability, rival, warnings
from bayescal.reporting.shared.text import facts, model_label, plain_table, size, um

PLACES = 5
BLIND = 4
MARGINS = 3
ADVICE = 3
SIGNIFICANT = 0.01
LEAST_PROBABILITY = 0.01
STYLES = {"null": "bold green", "named": "bold", "ambiguous": "bold yellow"}

Facts = Iterable[tuple[str, str, str]]
NEVER = 1000.0
"""Times its plausible size from which on an effect would not be named at any."""


def gap_summary(gap: Gap) -> RenderableType:
    """Verdict, size, places, probabilities, shrinkage, ladder, advice, blind spots, warnings: one screen."""
    nothing = gap.verdict.kind == "null"
    title = Text.assemble(
        (gap.dataset.name, "bold"),
        f"  {gap.dataset.robot.name}  model: {', '.join(gap.baseline) or 'as drawn'}",
        f" without {', '.join(gap.without)}" if gap.without else "",
    )
    style = STYLES.get(gap.verdict.kind, "bold red")
    parts: list[RenderableType] = [
        title,
        *(Text(line, style) for line in headline(gap)),
        "",
        facts(_size(gap)),
    ]
    if gap.magnitude.measured:
        parts.append(_measured(gap))
    parts.append("")
    if nothing:
        parts.append(facts(_largest(gap)))
    elif gap.where:
        parts += [_where(gap), facts(_margins(gap))]
    parts += [facts(_which(gap)), ""]
    if gap.shrinkage and not nothing:
        parts += [_shrinkage(gap), facts(_not_claimed(gap.shrinkage))]
    if gap.ladder:
        parts += [_ladder(gap), ""]
    parts.append(facts(_next(gap)))
    if gap.blind_spots:
        parts.append(_blind(gap))
    parts.append(facts(_words(gap)))
    return Group(*parts)


def _size(gap: Gap) -> Facts:
    m = gap.magnitude
    heldout = "rows kept back to validate" if m.heldout == "validate" else m.heldout
    low, high = m.noise_interval95
    yield "held out", f"{um(m.heldout_rms)} um rms ({heldout})", ""
    each = "contact" if any(x.what == "held-out contacts" for x in m.measured) else "coordinate"
    yield "noise", f"{um(m.noise)} um a {each}, {um(low)} to {um(high)} (95 %, from {_noise_from(gap)})", ""
    low, high = m.excess_interval95
    if gap.verdict.kind == "null":
        yield "excess", f"none above noise; at most {um(high)} um (95 %)", ""
    else:
        yield "excess", f"{um(m.excess)} um, {um(low)} to {um(high)} (95 %)", "bold"


def _noise_from(gap: Gap) -> str:
    words = {"repeats": "repeated contacts", "fit": "the fit", "stated": "dataset.yaml"}
    return words.get(gap.magnitude.noise_from, gap.magnitude.noise_from)


def _measured(gap: Gap) -> Table:
    table = plain_table("rms (um)", "count", "measured", "the model expected", "95 %", "")
    for x in gap.magnitude.measured:
        low, high = x.predicted_interval95
        inside = low <= x.rms <= high
        table.add_row(
            x.what,
            str(x.count),
            um(x.rms),
            um(x.predicted_rms),
            f"{um(low)} .. {um(high)}",
            Text("inside", style="green") if inside else Text("outside", style="yellow"),
        )
    return table


def _where(gap: Gap) -> Table:
    table = plain_table("where", "um rms", "share", "p (family)", "belongs to")
    table.columns[0].no_wrap = False
    shown = gap.where[:PLACES]
    if gap.verdict.kind == "named+unexplained" and all(w.explained_by for w in shown):
        shown = (*shown[:-1], *[w for w in gap.where[PLACES - 1 :] if not w.explained_by][:1])
    excess = any(w.share > 0 for w in gap.where)  # none in the fitted rows: then there is nothing to share
    for w in shown:
        table.add_row(
            place(w),
            um(w.rms),
            f"{100 * w.share:.0f} %" if excess and np.isfinite(w.share) else "-",
            p_value(w.family_p_value),
            w.explained_by or "-",
            style="" if w.family_p_value < SIGNIFICANT else "dim",
        )
    return table


def _largest(gap: Gap) -> Facts:
    for w in gap.where[:1]:
        yield (
            "where",
            f"the largest, not significant: {place(w)}, {um(w.rms)} um (p {p_value(w.family_p_value)})",
            "dim",
        )


def _margins(gap: Gap) -> Facts:
    """The bins that stand out most, one of each margin."""
    found: list[Margin] = []
    for bins in gap.margins.values():
        found += sorted((m for m in bins if m.p_value < SIGNIFICANT), key=lambda m: -m.rms)[:1]
    worst = sorted(found, key=lambda m: -m.rms)[:MARGINS]
    if worst:
        yield "stands out", "; ".join(f"{m.label} ({um(m.rms)} um)" for m in worst), ""


def _which(gap: Gap) -> Facts:
    verdict = gap.verdict
    ranked = sorted(verdict.probability.items(), key=lambda item: -item[1])
    shown = [f"{rival(n)} {probability(p)}" for n, p in ranked if p >= LEAST_PROBABILITY]
    if shown:
        yield "probability", ", ".join(shown), ""
    if len(verdict.credible_set90) > 1 and verdict.kind != "null":
        # a set of effects that are there together is no doubt between them
        together = {n.effect for n in verdict.named} == set(verdict.credible_set90)
        words = listed(map(rival, verdict.credible_set90), "and" if together else "or")
        yield "90 % set", words, "" if together else "yellow"
    for k, note in enumerate(verdict.footnotes):
        yield "" if k else "footnote", note, "dim"


def _shrinkage(gap: Gap) -> Table:
    headings = ("count", "before", "after", "the refit expects", "floor", "removed", "95 %")
    table = plain_table("shrinks (um rms)", *headings)
    for s in gap.shrinkage:
        low, high = s.removed_interval95
        shown = s.claimed and np.isfinite(s.removed)
        table.add_row(
            s.what,
            str(s.count),
            um(s.before),
            um(s.after) if s.claimed else "not claimed",
            f"{um(s.predicted_before)} -> {um(s.predicted)}",
            um(s.floor),
            f"{100 * s.removed:.0f} %" if shown else "-",
            f"{100 * low:.0f} .. {100 * high:.0f} %" if shown and np.isfinite(low) else "-",
        )
    return table


def _not_claimed(shrinkage: tuple[Shrinkage, ...]) -> Facts:
    for s in shrinkage:
        if not s.claimed:
            why = (
                f"the refitted model expects {um(s.predicted)} um, no better than before"
                if s.predicted >= s.before
                else f"{um(s.before)} um before, {um(s.after)} um after, which shows nothing"
            )
            yield "", f"{s.what}: {why}; nothing is claimed", "yellow"


def _ladder(gap: Gap) -> Table:
    distances = any(np.isfinite(s.distance_rms) for s in gap.ladder)
    points = any(np.isfinite(s.point_rms) for s in gap.ladder)
    headings = ["held out"] + ["distances"] * distances + ["points"] * points
    table = plain_table("ladder (um rms)", *headings, "gain (nats)")
    before: tuple[str, ...] = ()
    for k, step in enumerate(gap.ladder):
        cells = [um(step.heldout_rms)]
        cells += [um(step.distance_rms)] if distances else []
        cells += [um(step.point_rms)] if points else []
        gain = (
            f"{step.delta_elpd:+.0f} +- {step.delta_elpd_se:.0f}"
            if k and np.isfinite(step.delta_elpd)
            else ""
        )
        table.add_row(rung_label(step.model, before), *cells, gain)
        before = step.model
    return table


def rung_label(model: tuple[str, ...], before: tuple[str, ...]) -> str:
    """A rung by what it adds to the one before: ``as drawn``, ``kinematic``, ``+ backlash``."""
    added = model[len(before) :]
    if len(before) > 1 and added and model[: len(before)] == before:
        return f"+ {', '.join(added)}"
    return model_label(model)


def _next(gap: Gap) -> Facts:
    for k, a in enumerate(gap.advice[:ADVICE]):
        more = f" at {len(a.poses)} poses of gap.json" if a.poses else ""
        yield (
            "" if k else "probe next",
            f"{listed(map(rival, a.separates), 'from')}: {a.what}{more} "
            f"(lambda {a.lambda_before:.0f} to {a.lambda_after:.0f})",
            "",
        )


def _blind(gap: Gap) -> Table:
    """The worst blind spots: those that would do most to a distance."""
    worst = sorted(gap.blind_spots, key=lambda b: -np.nan_to_num(b.distance_error))
    more = f" (worst of {len(worst)})" if len(worst) > BLIND else ""
    table = plain_table(f"blind spots{more}", "plausible", "named from", "puts on a distance")
    for b in worst[:BLIND]:
        does = f"{um(b.distance_error)} um" if np.isfinite(b.distance_error) else "-"
        site = f", {b.site}" if b.site else ""
        named = size(b.smallest, b.unit) if b.smallest < NEVER * b.plausible else "never"
        table.add_row(f"{b.effect}{site}", size(b.plausible, b.unit), named, does)
    return table


def _words(gap: Gap) -> Facts:
    """What cannot be judged, notes, warnings; effects that lack the same thing in one line."""
    reasons: dict[str, list[str]] = {}
    for effect, why in gap.verdict.missing.items():
        reasons.setdefault(why, []).append(effect)
    for k, (why, effects) in enumerate(reasons.items()):
        yield "" if k else "cannot be judged", f"{', '.join(effects)}: {why}", "dim"
    for k, note in enumerate(gap.verdict.notes):
        yield "" if k else "note", note, ""
    for k, warning in enumerate(warnings(gap)):
        yield "" if k else "warning", warning, "yellow"
