"""The terminal summary of a diagnosis: size, location, effect, improvement, next measurements."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bayescal.gap.result import VALIDATION_CONTACTS, Gap, Margin
from bayescal.reporting.gap import causes
from bayescal.reporting.gap.causes import cause
from bayescal.reporting.gap.contacts import as_lengths, first_contacts, length, main, per_residual
from bayescal.reporting.gap.phrases import headline, place, unexplained, warnings
from bayescal.reporting.shared.origin import filed_lines
from bayescal.reporting.shared.text import (
    NEVER,
    facts,
    level_label,
    listed,
    p_value,
    plain_table,
    probability,
    reduction,
    rival,
    signed,
    size,
    um,
)

PLACES = 5
BLIND = 4
MARGINS = 3
ADVICE = 3
SIGNIFICANT = 0.01
LEAST_PROBABILITY = 0.01
STYLES = {"null": "bold green", "named": "bold", "ambiguous": "bold yellow"}

Facts = Iterable[tuple[str, str, str]]


def gap_summary(gap: Gap) -> RenderableType:
    """Verdict, size, locations, probabilities, model levels, next measurements, warnings: one screen."""
    nothing = gap.verdict.kind == "null"
    title = Text.assemble(
        (gap.dataset.name, "bold"),
        f"  {gap.dataset.robot.name}  model: {', '.join(gap.baseline) or 'nominal'}",
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
    parts += [facts(_which(gap)), facts(_amplitudes(gap)), facts(_remedy(gap)), ""]
    if gap.shrinkage and not nothing:
        parts += [_shrinkage(gap), facts(_not_claimed(gap))]
    if gap.levels:
        parts += [_levels(gap), ""]
    parts.append(facts(_next(gap)))
    if any(a.contacts for a in gap.advice):
        parts.append(first_contacts(gap))
    if gap.blind_spots:
        parts.append(_blind(gap))
    parts.append(facts(_remarks(gap)))
    return Group(*parts)


def _size(gap: Gap) -> Facts:
    m = gap.magnitude
    what = main(gap)
    each = "contact" if what == VALIDATION_CONTACTS else "point (length)"

    def size(value: float) -> str:
        return um(length(what, value))

    low, high = map(size, m.noise_interval95)
    yield "validation", f"{size(m.validation_rms)} µm RMS per {each} ({m.validation})", ""
    yield "noise", f"{size(m.noise)} µm per {each}, {low} to {high} (95 %, from {_noise_from(gap)})", ""
    low, high = map(size, m.excess_interval95)
    if not np.all(np.isfinite(m.excess_interval95)):
        yield "excess", f"{size(m.excess)} µm; no interval: the validation measurements have one pose", "bold"
    elif m.excess_interval95[0] == 0 and gap.verdict.kind == "null":
        yield "excess", f"none above noise; at most {high} µm (95 %)", ""
    else:
        yield "excess", f"{size(m.excess)} µm, {low} to {high} (95 %)", "bold"


def _noise_from(gap: Gap) -> str:
    words = {"repeats": "repeated contacts", "fit": "the fit", "stated": "dataset.yaml"}
    return words.get(gap.magnitude.noise_from, gap.magnitude.noise_from)


def _measured(gap: Gap) -> Table:
    table = plain_table("RMS (µm)", "count", "measured", "expected", "95 %", "")
    for x in gap.magnitude.measured:
        low, high = x.predicted_interval95
        inside = low <= x.rms <= high
        table.add_row(
            x.what,
            str(x.count),
            um(length(x.what, x.rms)),
            um(length(x.what, x.predicted_rms)),
            f"{um(length(x.what, low))} .. {um(length(x.what, high))}",
            Text("within", style="green") if inside else Text("outside", style="yellow"),
        )
    return table


def _where(gap: Gap) -> Table:
    table = plain_table(f"location: RMS{per_residual(gap)} (µm)", "RMS", "share", "p", "explained by")
    table.columns[0].no_wrap = False
    shown = gap.where[:PLACES]
    if gap.verdict.kind == "named+unexplained" and all(w.explained_by for w in shown):
        shown = (*shown[:-1], *[w for w in gap.where[PLACES - 1 :] if not w.explained_by][:1])
    excess = any(w.share > 0 for w in gap.where)  # none in the fitted measurements: no share is defined
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
    each = per_residual(gap)
    for w in gap.where[:1]:
        yield (
            "location",
            f"largest, not significant: {place(w)}, {um(w.rms)} µm{each} (p {p_value(w.family_p_value)})",
            "dim",
        )


def _margins(gap: Gap) -> Facts:
    """The groups with the largest residuals, at most one of each grouping."""
    groups: list[Margin] = []
    for bins in gap.margins.values():
        groups += sorted((m for m in bins if m.p_value < SIGNIFICANT), key=lambda m: -m.rms)[:1]
    largest = sorted(groups, key=lambda m: -m.rms)[:MARGINS]
    if largest:
        yield (
            "largest groups",
            "; ".join(f"{m.text} ({um(m.rms)} µm{per_residual(gap)})" for m in largest),
            "",
        )


def _which(gap: Gap) -> Facts:
    verdict = gap.verdict
    ranked = sorted(verdict.probability.items(), key=lambda item: -item[1])
    shown = [f"{rival(n)} {probability(p)}" for n, p in ranked if p >= LEAST_PROBABILITY]
    if shown:
        yield "probability", ", ".join(shown), ""
    if len(verdict.credible_set90) > 1 and verdict.kind != "null":
        # effects that are all present are not alternatives
        together = {n.effect for n in verdict.named} == set(verdict.credible_set90)
        text = listed(map(rival, verdict.credible_set90), "and" if together else "or")
        yield "90 % set", text, "" if together else "yellow"
    for k, note in enumerate(verdict.footnotes):
        yield "" if k else "footnote", note, "dim"


def _amplitudes(gap: Gap) -> Facts:
    """Amplitudes of the named effects, and the model that has them."""
    for k, text in enumerate(causes.lines(gap)):
        yield "" if k else "amplitude", text, "bold"
    if gap.amplitudes:
        without = f" --without '{','.join(gap.still_without)}'" if gap.still_without else ""
        yield "refit", f"--model '{','.join(gap.refit)}'{without}", ""


def _remedy(gap: Gap) -> Facts:
    """What to inspect on the machine, of an unmodelled effect alone."""
    at = unexplained(gap) if gap.verdict.kind == "unknown" else None
    found = cause(at) if at else None
    if found:
        yield "inspect", found.remedy, ""


def _shrinkage(gap: Gap) -> Table:
    headings = ("count", "before", "after", "expected", "limit", "removed", "95 %")
    table = plain_table("refit: RMS (µm)", *headings)
    for s in map(as_lengths, gap.shrinkage):
        table.add_row(
            s.what,
            str(s.count),
            um(s.before),
            um(s.after) if s.claimed else "not claimed",
            f"{um(s.predicted_before)} -> {um(s.predicted)}",
            um(s.floor),
            *reduction(s.removed, s.removed_interval95, s.claimed),
        )
    return table


def _not_claimed(gap: Gap) -> Facts:
    doubted = [n.effect for n in gap.verdict.named if not n.confirmed]
    if doubted:
        yield "", f"the validation data do not confirm {listed(doubted)}: no improvement is claimed", "yellow"
    for s in map(as_lengths, gap.shrinkage):
        if not s.claimed and not doubted:
            why = (
                f"the refitted model expects {um(s.predicted)} µm, not less than before"
                if s.predicted >= s.before
                else f"{um(s.before)} µm before, {um(s.after)} µm after: not significant"
            )
            yield "", f"{s.what}: {why}; no improvement is claimed", "yellow"


def _levels(gap: Gap) -> Table:
    distances = any(np.isfinite(s.distance_rms) for s in gap.levels)
    points = main(gap) == VALIDATION_CONTACTS and any(np.isfinite(s.point_rms) for s in gap.levels)
    headings = ["validation"] + ["distances"] * distances + ["points"] * points
    table = plain_table("model: RMS (µm)", *headings, "difference of log density (nats)")
    before: tuple[str, ...] = ()
    for k, step in enumerate(gap.levels):
        cells = [um(length(main(gap), step.validation_rms))]
        cells += [um(step.distance_rms)] if distances else []
        cells += [um(length("points", step.point_rms))] if points else []
        gain = signed(step.delta_elpd) if k and np.isfinite(step.delta_elpd) else ""
        gain += f" ± {step.delta_elpd_se:.0f}" if gain and np.isfinite(step.delta_elpd_se) else ""
        table.add_row(level_label(step.model, before), *cells, gain)
        before = step.model
    return table


def _next(gap: Gap) -> Facts:
    for k, a in enumerate(gap.advice[:ADVICE]):
        plural = "s" if len(a.contacts) > 1 else ""
        more = f", {len(a.contacts)} contact{plural} in next.csv" if a.contacts else ""
        yield (
            "" if k else "measure next",
            f"to distinguish {listed(map(rival, a.separates), 'from')}: {a.what}{more} "
            f"(detectability {a.lambda_before:.0f} to {a.lambda_after:.0f})",
            "",
        )


def _blind(gap: Gap) -> Table:
    """Effects that these data may miss, the largest distance error first."""
    largest = sorted(gap.blind_spots, key=lambda b: -np.nan_to_num(b.distance_error))
    more = f" ({BLIND} of {len(largest)})" if len(largest) > BLIND else ""
    table = plain_table(f"may be missed{more}", "plausible", "detectable", "distance error")
    for b in largest[:BLIND]:
        does = f"{um(b.distance_error)} µm" if np.isfinite(b.distance_error) else "-"
        least = size(b.smallest, b.unit) if b.smallest < NEVER * b.plausible else "not detectable"
        table.add_row(f"{b.effect}, {b.site.text}", size(b.plausible, b.unit), least, does)
    return table


def _remarks(gap: Gap) -> Facts:
    """Effects that were not assessed (by reason), notes and warnings."""
    reasons: dict[str, list[str]] = {}
    for effect, why in gap.verdict.missing.items():
        reasons.setdefault(why, []).append(effect)
    for k, (why, effects) in enumerate(reasons.items()):
        yield "" if k else "not assessed", f"{', '.join(effects)}: {why}", "dim"
    for k, note in enumerate(gap.verdict.notes):
        yield "" if k else "note", note, ""
    for k, warning in enumerate(warnings(gap)):
        yield "" if k else "warning", warning, "yellow"
    yield from filed_lines(gap.dataset)
