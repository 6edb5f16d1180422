"""The terminal summary of a diagnosis: size, location, effect, improvement, next measurements."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from bayescal.gap.result import VALIDATION_CONTACTS, BlindSpot, Gap, Margin, Step
from bayescal.reporting.gap import causes
from bayescal.reporting.gap.causes import cause
from bayescal.reporting.gap.contacts import as_lengths, first_contacts, length, main, per_residual
from bayescal.reporting.gap.phrases import headline, place, unexplained, unshown, warnings
from bayescal.reporting.gap.sheets import significant
from bayescal.reporting.shared.origin import filed_lines
from bayescal.reporting.shared.sheet import Column, Sheet, inside, terminal
from bayescal.reporting.shared.text import (
    NEVER,
    Facts,
    FigureTable,
    facts,
    level_label,
    listed,
    p_value,
    probability,
    reduction,
    rival,
    signed,
    size,
    um,
    under,
)

PLACES = 5
BLIND = 4
MARGINS = 3
ADVICE = 3
LEAST_PROBABILITY = 0.01
STYLES = {"null": "bold green", "named": "bold", "ambiguous": "bold yellow", "class": "bold yellow"}


def gap_summary(gap: Gap) -> RenderableType:
    """Verdict, size, locations, probabilities, model levels, next measurements, warnings: one screen."""
    nothing = gap.verdict.kind == "null"
    title = Text.assemble(
        (gap.dataset.name, "bold"),
        f"  {gap.dataset.robot.name}  model: {', '.join(gap.baseline) or 'nominal'}",
        f" without {', '.join(gap.options.omitted)}" if gap.options.without else "",
    )
    style = STYLES.get(gap.verdict.kind, "bold red")
    parts: list[RenderableType] = [
        title,
        *(Text(line, style) for line in headline(gap)),
        "",
        facts(_size(gap)),
    ]
    if gap.magnitude.measured:
        parts.append(terminal(_measured(gap)))
    parts.append("")
    if nothing:
        parts.append(facts(_largest(gap)))
    elif gap.where:
        parts += [_where(gap), facts(_margins(gap))]
    parts += [facts(_which(gap)), facts(_amplitudes(gap)), facts(_remedy(gap)), ""]
    if gap.shrinkage and not nothing:
        parts += [terminal(Sheet(SHRINKAGE, tuple(map(as_lengths, gap.shrinkage)))), facts(_not_claimed(gap))]
    if gap.levels:
        parts += [terminal(_levels(gap)), ""]
    parts.append(facts(_next(gap)))
    if any(a.contacts for a in gap.advice):
        parts.append(terminal(first_contacts(gap)))
    if gap.blind_spots:
        parts.append(terminal(_blind(gap)))
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


def _measured(gap: Gap) -> Sheet:
    columns = (
        Column("RMS (µm)", "what"),
        Column("count", "count"),
        Column("measured", lambda x: um(length(x.what, x.rms))),
        Column("expected", lambda x: um(length(x.what, x.predicted_rms))),
        Column("95 %", lambda x: " .. ".join(um(length(x.what, end)) for end in x.predicted_interval95)),
        Column("", lambda x: x.predicted_interval95[0] <= x.rms <= x.predicted_interval95[1], inside),
    )
    return Sheet(columns, gap.magnitude.measured)


def _where(gap: Gap) -> FigureTable:
    shown = gap.where[:PLACES]
    if gap.verdict.kind == "named+unexplained" and all(w.explained_by for w in shown):
        shown = (*shown[:-1], *[w for w in gap.where[PLACES - 1 :] if not w.explained_by][:1])
    excess = any(w.share > 0 for w in gap.where)  # none in the fitted measurements: no share is defined
    columns = (
        Column(f"location: RMS{per_residual(gap)} (µm)", place),
        Column("RMS", "rms", um),
        Column("share", lambda w: f"{100 * w.share:.0f} %" if excess and np.isfinite(w.share) else None),
        Column("p", "family_p_value", p_value),
        Column("explained by", lambda w: w.explained_by or None),
    )
    table = terminal(Sheet(columns, shown, style=lambda w: "" if significant(w.family_p_value) else "dim"))
    table.columns[0].no_wrap = False
    return table


def _largest(gap: Gap) -> Facts:
    each = per_residual(gap)
    for w in gap.where[:1]:
        text = f"{place(w)}, {um(w.rms)} µm{each} (p {p_value(w.family_p_value)})"
        yield "location", f"largest, not significant: {text}", "dim"


def _margins(gap: Gap) -> Facts:
    """The groups with the largest residuals, at most one of each grouping."""
    groups: list[Margin] = []
    for bins in gap.margins.values():
        groups += sorted((m for m in bins if significant(m.p_value)), key=lambda m: -m.rms)[:1]
    largest = sorted(groups, key=lambda m: -m.rms)[:MARGINS]
    if largest:
        each = per_residual(gap)
        yield "largest groups", "; ".join(f"{m.text} ({um(m.rms)} µm{each})" for m in largest), ""


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
    yield from under("footnote", verdict.footnotes, "dim")


def _amplitudes(gap: Gap) -> Facts:
    """Amplitudes of the named effects, and the model that has them."""
    yield from under("amplitude", causes.lines(gap), "bold")
    if gap.amplitudes:
        without = f" --without '{','.join(map(str, gap.still_without))}'" if gap.still_without else ""
        yield "refit", f"--model '{','.join(gap.refit)}'{without}", ""


def _remedy(gap: Gap) -> Facts:
    """What to inspect on the machine, of an unmodelled effect alone."""
    where = unexplained(gap) if gap.verdict.kind == "unknown" else None
    if where and (shown := cause(where)):
        yield "inspect", shown.remedy, ""


SHRINKAGE = (
    Column("refit: RMS (µm)", "what"),
    Column("count", "count"),
    Column("before", "before", um),
    Column("after", lambda s: um(s.after) if s.claimed else "not claimed"),
    Column("expected", lambda s: f"{um(s.predicted_before)} -> {um(s.predicted)}"),
    Column("limit", "floor", um),
    Column("removed", lambda s: reduction(s.removed, s.removed_interval95, s.claimed)[0]),
    Column("95 %", lambda s: reduction(s.removed, s.removed_interval95, s.claimed)[1]),
)


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


def _levels(gap: Gap) -> Sheet:
    before = {step.model: last.model for step, last in zip(gap.levels[1:], gap.levels, strict=False)}

    def gain(step: Step) -> str:
        if step is gap.levels[0] or not np.isfinite(step.delta_elpd):
            return ""
        spread = f" ± {step.delta_elpd_se:.0f}" if np.isfinite(step.delta_elpd_se) else ""
        return signed(step.delta_elpd) + spread

    columns = [
        Column("model: RMS (µm)", lambda step: level_label(step.model, before.get(step.model, ()))),
        Column("validation", lambda step: um(length(main(gap), step.validation_rms))),
    ]
    if any(np.isfinite(s.distance_rms) for s in gap.levels):
        columns += [Column("distances", "distance_rms", um)]
    if main(gap) == VALIDATION_CONTACTS and any(np.isfinite(s.point_rms) for s in gap.levels):
        columns += [Column("points", lambda step: um(length("points", step.point_rms)))]
    return Sheet((*columns, Column("difference of log density (nats)", gain)), gap.levels)


def _next(gap: Gap) -> Facts:
    for k, a in enumerate(gap.advice[:ADVICE]):
        plural = "s" if len(a.contacts) > 1 else ""
        more = f", {len(a.contacts)} contact{plural} in next.csv" if a.contacts else ""
        what = f"{listed(map(rival, a.separates), 'from')}: {a.what}{more}"
        detectability = f"(detectability {a.lambda_before:.0f} to {a.lambda_after:.0f})"
        yield "" if k else "measure next", f"to distinguish {what} {detectability}", ""
    for k, (columns, effects) in enumerate(_unshown(gap).items(), start=len(gap.advice)):
        yield "" if k else "measure next", f"to show {listed(effects, 'or')}: record {columns}", ""


def _unshown(gap: Gap) -> dict[str, list[str]]:
    return {} if gap.verdict.kind == "null" else unshown(gap.verdict)


def _blind(gap: Gap) -> Sheet:
    """Effects that these data may miss, the largest distance error first."""
    largest = sorted(gap.blind_spots, key=lambda b: -np.nan_to_num(b.distance_error))
    more = f" ({BLIND} of {len(largest)})" if len(largest) > BLIND else ""

    def least(b: BlindSpot) -> str:
        return size(b.smallest, b.unit) if b.smallest < NEVER * b.plausible else "not detectable"

    def error(b: BlindSpot) -> str | None:
        return f"{um(b.distance_error)} µm" if np.isfinite(b.distance_error) else None

    columns = (
        Column(f"may be missed{more}", lambda b: f"{b.effect}, {b.site.text}"),
        Column("plausible", lambda b: size(b.plausible, b.unit)),
        Column("detectable", least),
        Column("distance error", error),
    )
    return Sheet(columns, largest[:BLIND])


def _remarks(gap: Gap) -> Facts:
    """Effects that were not assessed (by reason), notes and warnings."""
    reasons: dict[str, list[str]] = {}
    shown = {name for names in _unshown(gap).values() for name in names}  # above, with what to record
    for effect, why in gap.verdict.missing.items():
        if effect in shown:
            continue
        reasons.setdefault(why, []).append(effect)
    yield from under("not assessed", (f"{', '.join(names)}: {why}" for why, names in reasons.items()), "dim")
    yield from under("note", gap.verdict.notes)
    yield from under("warning", warnings(gap), "yellow")
    yield from filed_lines(gap.dataset)
