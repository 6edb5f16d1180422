"""The terminal summary of a diagnosis: size, location, effect, improvement, next measurements."""

import re
from dataclasses import replace
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from bayescal.assess.agreement import Agreement
from bayescal.effects.common import ELSEWHERE
from bayescal.gap.result import VALIDATION_CONTACTS, Gap, Margin
from bayescal.reporting import gap as sheets
from bayescal.reporting import text
from bayescal.reporting.fit import verdicts
from bayescal.reporting.gap import causes
from bayescal.reporting.origin import filed_lines, images_lines, scaled
from bayescal.reporting.sheet import Column, Sheet, below, headed, inside, screen, terminal
from bayescal.storage.reading import Json

PLACES = 5
BLIND = 4
MARGINS = 3
ADVICE = 3

NOISE_FROM = {"repeats": "repeated measurements", "images": "corners within images"}
NOISE_FROM |= {"fit": "the fit", "stated": "dataset.yaml"}
STYLES = {"null": "bold green", "named": "bold", "ambiguous": "bold yellow", "class": "bold yellow"}


def gap_summary(gap: Gap, record: Json, compared: Agreement | None = None) -> RenderableType:
    """Verdict, size, locations, probabilities, model levels, next measurements, warnings: one screen.

    All is from the record of the diagnosis, but the texts of groups and amplitudes, which it does not have.
    `compared` is what several sessions say each by itself.
    """
    nothing = record["verdict"] == "null"
    without = f" without {', '.join(record['without'])}" if record["without"] else ""
    model = f"model: {', '.join(record['baseline']) or 'nominal'}{without}"
    title = headed(record["dataset"]["name"], record["arm"]["robot"], model)
    style = STYLES.get(record["verdict"], "bold red")
    parts: list[Any] = [title, *(Text(line, style) for line in record["words"]), ""]
    parts += [[*_size(record), *images_lines(record)], _measured(record), ""]
    if nothing:
        parts.append(_largest(record))
    elif record["where"]:
        headings = (f"location: {sheets.rms_of(record)} (µm)", "RMS", "share", "p", "explained by")
        parts += [terminal(_where(record), *headings), _margins(gap, record)]
    parts += [_which(record), _amplitudes(gap, record), _remedy(record), ""]
    if gap.shrinkage and not nothing:
        parts += [terminal(_improvements(record), *IMPROVEMENTS), _not_claimed(record)]
    if record["ladder"]:
        levels = _levels(record)
        parts += [terminal(levels, "model: RMS (µm)", *levels.headings), ""]
    parts.append(_next(record))
    if advised := [c for advice in record["next"] for c in advice["contacts"]]:
        parts.append(sheets.first_contacts(advised, sheets.measured_as(record, advised)))
    if record["blind_spots"]:
        blind = sheets.blind_sheet(record)
        more = f" ({BLIND} of {len(blind.items)})" if len(blind.items) > BLIND else ""
        blind = replace(blind, items=blind.items[:BLIND])
        parts.append(terminal(blind, f"may be missed{more}", "plausible", "detectable", "distance error"))
    return screen(*parts, _remarks(record), *below(verdicts(compared) if compared else None))


def _size(record: Json) -> text.Facts:
    size, of = record["gap"], record["lengths"]
    each = "contact" if of["of"] == VALIDATION_CONTACTS else "point (length)"
    factor, ends = sheets.per_vector(of["of"], of["components"]), size["excess_um"]["interval95"]
    yield "validation", f"{text.length(of['validation_rms_um'])} µm RMS per {each} ({size['heldout']})", ""
    source = NOISE_FROM.get(size["noise_from"], size["noise_from"])
    interval = text.interval(size["noise_interval95_um"], factor)
    yield "noise", f"{text.length(of['noise_um'])} µm per {each}, {interval} (95 %, from {source})", ""
    excess = f"{text.length(of['excess_um'])} µm"
    if None in ends:
        yield "excess", f"{excess}; no interval: the validation measurements have one pose", "bold"
    elif sheets.exceeds(record):
        yield "excess", f"{excess}, {text.interval(ends, factor)} (95 %)", "bold"
    else:
        most = f"at most {text.length(factor * ends[1])} µm (95 %)"
        yield "excess", f"not significant by the RMS alone; {most}", ""


def _measured(record: Json) -> Sheet:
    def error(x: Json, value: float) -> str:
        return text.length(sheets.per_vector(x["what"], record["lengths"]["components"]) * value)

    def within(x: Json) -> bool:
        low, high = x["predicted_interval95_um"]
        return bool(low <= x["rms_um"] <= high)

    columns = (
        Column("RMS (µm)", "what"),
        Column("count", "count"),
        Column("measured", lambda x: error(x, x["rms_um"])),
        Column("expected", lambda x: error(x, x["predicted_rms_um"])),
        Column("95 %", lambda x: " .. ".join(error(x, end) for end in x["predicted_interval95_um"])),
        Column("", within, inside),
    )
    return Sheet(columns, record["gap"]["measured"])


def _where(record: Json) -> Sheet:
    """The largest locations; a further effect has one that no named effect explains."""
    every = sheets.places_of(record)
    shown = every[:PLACES]
    if record["verdict"] == "named+unexplained" and all(w["explained_by"] for w in shown):
        shown = [*shown[:-1], *[w for w in every[PLACES - 1 :] if not w["explained_by"]][:1]]
    return replace(sheets.where_sheet(record), items=shown, style=lambda w: "" if sheets.marked(w) else "dim")


def _largest(record: Json) -> text.Facts:
    for w in record["where"][:1]:
        error = f"{text.length(w['rms_um'])} µm{text.per_residual(record)}"
        words = f"{w['text']}, {error} (p {text.p_value(w['family_p_value'])})"
        small = "no effect is established" if sheets.marked(w) else "not significant"
        yield "location", f"largest, {small}: {words}", "dim"


def _margins(gap: Gap, record: Json) -> text.Facts:
    """The groups with the largest residuals, at most one of each grouping."""
    groups: list[Margin] = []
    for bins in gap.margins.values():
        groups += sorted((m for m in bins if text.significant(m.p_value)), key=lambda m: -m.rms)[:1]
    largest = sorted(groups, key=lambda m: -m.rms)[:MARGINS]
    if largest:
        each = text.per_residual(record)
        yield "largest groups", "; ".join(f"{m.text} ({text.um(m.rms)} µm{each})" for m in largest), ""


def _which(record: Json) -> text.Facts:
    ranked = sorted(record["probability"].items(), key=lambda item: -item[1])
    shown = [f"{text.rival(n)} {text.probability(p)}" for n, p in ranked if p >= text.LEAST]
    if shown:
        yield "probability", ", ".join(shown), ""
    credible = record["credible_set90"]
    if len(credible) > 1 and record["verdict"] != "null":
        # effects that are all present are not alternatives
        together = {n["effect"] for n in record["named"]} == set(credible)
        words = text.listed(map(text.rival, credible), "and" if together else "or")
        yield "90 % set", words, "" if together else "yellow"
    yield from text.under("footnote", record["footnotes"], "dim")


WIDTH = re.compile(r" (x[\d.]+)")
"""A factor on the prior widths of an effect, in the form of ``--model``."""


def _amplitudes(gap: Gap, record: Json) -> text.Facts:
    """Amplitudes of the named effects, and the model that has them."""
    yield from text.under("amplitude", causes.lines(gap), "bold")
    if record["amplitudes"] and any(n["confirmed"] for n in record["named"]):
        refit = record["refit"]
        without = f" --without '{','.join(refit['without'])}'" if refit["without"] else ""
        yield "refit", f"--model '{refit['model']}'{without}", ""
        if widths := dict.fromkeys(WIDTH.findall(refit["model"])):
            yield "", f"{text.listed(widths)}: prior widths, over the usual ones", "dim"


def _remedy(record: Json) -> text.Facts:
    """What to inspect on the machine, of an unmodelled effect alone and of a sudden change beside others."""
    where = sheets.unexplained(record)
    if where and "remedy" in where and (record["verdict"] == "unknown" or "event" in where):
        yield "inspect", where["remedy"], ""


IMPROVEMENTS = ("refit: RMS (µm)", "count", "before", "after", "expected", "limit", "removed", "95 %")


def _improvements(record: Json) -> Sheet:
    """What the named effects improve, with the errors that the refit expects before and after."""
    sheet = sheets.improvements(record)
    keys = ("predicted_before_rms_um", "predicted_rms_um")
    expected = Column("expected", lambda s: " -> ".join(text.length(s[key]) for key in keys))
    return replace(sheet, columns=(*sheet.columns[:4], expected, *sheet.columns[5:]))


def _not_claimed(record: Json) -> text.Facts:
    doubted = [n["effect"] for n in record["named"] if not n["confirmed"]]
    if doubted:
        words = f"the validation data do not confirm {text.listed(doubted)}: no improvement is claimed"
        yield "", words, "yellow"
    for s in () if doubted else sheets.improved(record):
        if not s["claimed"]:
            before, after = s["before_rms_um"], s["after_rms_um"]
            why = (
                f"the refitted model expects {text.length(s['predicted_rms_um'])} µm, not less than before"
                if s["predicted_rms_um"] >= before
                else f"{text.length(before)} µm before, {text.length(after)} µm after: not significant"
            )
            shown = [f"{n['effect']}: {n['established']}" for n in record["named"] if n.get("established")]
            claim = f"established by {text.listed(shown)}" if shown else "no improvement is claimed"
            yield "", f"{s['what']}: {why}; {claim}", "yellow"


def _levels(record: Json) -> Sheet:
    of = record["lengths"]["of"]
    shown = [("validation", "validation_um"), ("distances", "distance_rms_um")]
    shown += [("points", "point_length_rms_um")] if of == VALIDATION_CONTACTS else []
    factor = sheets.per_vector(of, record["lengths"]["components"])
    levels = [step | {"validation_um": scaled(step["heldout_rms_um"], factor)} for step in record["ladder"]]
    return sheets.levels_sheet({**record, "ladder": levels}, shown, "")


def _next(record: Json) -> text.Facts:
    for k, a in enumerate(record["next"][:ADVICE]):
        count = len(a["contacts"])
        noun = sheets.measured_as(record, a["contacts"])
        more = f", {count} {noun}{'s' if count > 1 else ''} in next.csv" if count else ""
        what = f"{text.listed(sheets.pair_of(record, a['separates']), 'from')}: {a['what']}{more}"
        detectability = f"(detectability {a['lambda_before']:.0f} to {a['lambda_after']:.0f})"
        yield "" if k else "measure next", f"to distinguish {what} {detectability}", ""
    for k, (columns, effects) in enumerate(sheets.unshown(record).items(), start=len(record["next"])):
        yield "" if k else "measure next", f"to show {text.listed(effects, 'or')}: record {columns}", ""


def _remarks(record: Json) -> text.Facts:
    """Effects that were not assessed (by reason), notes and warnings."""
    # said above, with what to record
    shown = {name for names in sheets.unshown(record).values() for name in names}
    missing = text.not_assessed(record).items()
    reasons = text.by_reason({n: why for n, why in missing if n not in shown and why not in ELSEWHERE})
    lines = (f"{', '.join(names)}: {why}" for why, names in reasons.items())
    yield from text.under("not assessed", lines, "dim")
    yield from text.under("note", record["notes"])
    yield from text.under("warning", record["warnings"], "yellow")
    yield from filed_lines(record)
