"""The page of a diagnosis, `gap.html`: its sections, each a function of the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from bayescal.reporting.page import rows
from bayescal.reporting.page.fit import level_sheet
from bayescal.reporting.page.gap_first import (
    NULL,
    OTHER,
    VALIDATION_POINTS,
    first,
    rms_of,
    share_of,
    site_of,
    size_of,
    sizes_of,
    unexplained,
    words_of,
)
from bayescal.reporting.page.section import (
    MISSING,
    Bar,
    Block,
    Run,
    Section,
    Sheet,
    Text,
    blocks,
    length,
    quantity,
    share,
    texts,
)
from bayescal.reporting.shared.text import NEVER, level_label, p_value, probability, reduction, rival, signed

SIGNIFICANT = 0.01
MARGINS = ("target", "joint", "region", "time", "direction")
LEAST = 0.01
"""Least probability of an effect that is listed unfolded."""


def effects(run: Run) -> Section | None:
    """All effects by probability, with amplitude, share, location, and what is detectable."""
    record = run.record
    least = _detectable(record)
    ranked = sorted(record["probability"].items(), key=lambda item: -(item[1] or 0.0))
    entries: list[tuple[Any, ...]] = []
    for name, p in ranked:
        own = [a for a in record["amplitudes"] if a["effect"] == name]
        clear = [a for a in own if a["significant"]] or own
        location = ", ".join(dict.fromkeys(site_of(a["site"]) for a in clear))
        size, part = sizes_of(clear), share_of(record, name)
        if name == OTHER and (place := unexplained(record)):
            location, part = words_of(place), share(place["share"])
            size = size_of(record, place)
        entries.append(
            (
                rival(name),
                Bar(p or 0.0, MISSING if p is None else probability(p), name in record["credible_set90"]),
                size or MISSING,
                location or MISSING,
                part,
                least.get(name, MISSING),
            )
        )
    shown = sum((p or 0.0) >= LEAST for _, p in ranked)
    table = Sheet(
        "effect",
        ("probability", "size (u)", "location", "share of the excess", "detectable from"),
        tuple(entries),
        "Coloured: the 90 % set. Effects may be present together. 'noise only': the model as it is explains "
        "the data; 'unmodelled effect': none of the known effects does",
        words=(2, 3),
        shown=max(shown, 5),
    )
    missing = Sheet(
        "not assessed",
        ("why",),
        tuple(record["missing"].items()),
        "Effects that these data cannot show",
        words=(1,),
    )
    sets = Sheet(
        "set of effects",
        ("probability", "log evidence (nats)"),
        tuple(
            (
                " + ".join(map(rival, h["effects"])) or rival(NULL),
                Bar(h["probability"], probability(h["probability"])),
                MISSING if h["log_evidence"] is None else signed(h["log_evidence"], 1),
            )
            for h in record["hypotheses"]
        ),
        "Sets of effects, the most probable first; log evidence relative to noise only; 1 nat is a factor "
        "of e = 2.7 in probability",
        shown=6,
    )
    notes = texts([*record["footnotes"], *record["notes"]], "quiet")
    return blocks("effects", "Effects", table, *notes, sets, missing)


def _detectable(record: Mapping[str, Any]) -> dict[str, str]:
    """Smallest detectable amplitude of each effect that may be missed, with the location where it is."""
    out: dict[str, str] = {}
    for b in record["blind_spots"]:
        least, usual = b["smallest_nameable"]["value"], b["plausible"]["value"]
        never = least is None or (usual is not None and least >= NEVER * usual)
        size = "not detectable" if never else quantity(least, b["smallest_nameable"]["unit"])
        out.setdefault(b["effect"], f"{size}, {site_of(b['site'])}")
    return out


def where(run: Run) -> Section | None:
    """Locations of the error, the largest first."""
    record = run.record
    largest = max((w["rms_um"] or 0.0 for w in record["where"]), default=0.0) or 1.0
    excess = record["verdict"] != NULL  # no share of nothing is stated
    entries = tuple(
        (
            words_of(w),
            Bar(
                (w["rms_um"] or 0.0) / largest,
                length(w["rms_um"]),
                w["family_p_value"] is not None and w["family_p_value"] < SIGNIFICANT,
            ),
            share(w["share"]) if excess else MISSING,
            MISSING if w["family_p_value"] is None else p_value(w["family_p_value"]),
            w["explained_by"] or MISSING,
        )
        for w in record["where"]
    )
    table = Sheet(
        "location and dependence",
        (f"{rms_of(record)} (µm)", "share of the excess", "p", "explained by"),
        entries,
        "Residuals explained by a location; coloured: significant (p below 0.01, corrected for their number)",
        words=(4,),
        shown=8,
    )
    return blocks("where", "Location of the error", table)


def margins(run: Run) -> tuple[Sheet, ...]:
    """Residuals by target, joint, region, time and direction."""
    out, of = [], ", before the refit" if run.record["named"] else ""
    for key in MARGINS:
        groups = run.record["where_marginal"][key]
        largest = max((g["rms_um"] or 0.0 for g in groups), default=0.0) or 1.0
        out.append(
            Sheet(
                key,
                ("rows", f"{rms_of(run.record)} (µm)", "mean (µm)", "p"),
                tuple(
                    (
                        g["label"],
                        str(g["count"]),
                        Bar(
                            (g["rms_um"] or 0.0) / largest,
                            length(g["rms_um"]),
                            (g["p_value"] or 1.0) < SIGNIFICANT,
                        ),
                        length(g["mean_um"]),
                        MISSING if g["p_value"] is None else p_value(g["p_value"]),
                    )
                    for g in groups
                ),
                f"Residuals by {key}{of}" + (": the largest groups of each joint" if key == "joint" else ""),
                shown=8,
            )
        )
    return tuple(out)


def levels(run: Run) -> Section | None:
    """Validation errors by model level, and what the named effects improve."""
    record = run.record
    points = record["lengths"]["of"] == VALIDATION_POINTS
    columns = (
        ("contacts RMS", "heldout_rms_um"),
        ("distances RMS", "distance_rms_um"),
        ("points RMS (length)", "point_length_rms_um"),
    )
    steps = [dict(step) for step in record["ladder"]]
    for step in steps:
        gain, se = step["delta_elpd"], step["delta_elpd_se"]
        spread = "" if se is None else f" ± {se:.0f}"
        step["gain"] = f"{signed(gain)}{spread}" if gain else MISSING
    names = tuple(
        level_label(tuple(step["model"]), tuple(steps[k - 1]["model"]) if k else ())
        for k, step in enumerate(steps)
    )
    sheet = level_sheet(steps, columns[1:] if points else columns, names)
    sheet = Sheet(
        sheet.title,
        (*sheet.headings, "difference of log density (nats)"),
        tuple((*row, step["gain"]) for row, step in zip(sheet.rows, steps, strict=True)),
        sheet.caption,
    )
    improved = Sheet(
        "refit with the named effects",
        ("number", "before (µm)", "after (µm)", "expected (µm)", "limit (µm)", "removed", "95 %"),
        tuple(
            _improved(what, s, record["lengths"]["shrinkage"].get(what)) for what, s in _reductions(record)
        ),
        "RMS of validation errors; limit: expected RMS for a correct model; removed: share of the excess",
    )
    return blocks("levels", "Model levels and improvement", sheet, improved)


def _reductions(record: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    return [(what, s) for what, s in record["shrinkage"].items() if s]


def _improved(what: str, s: Mapping[str, Any], of: Mapping[str, Any] | None) -> tuple[str, ...]:
    as_length = of or s
    ratio = as_length["before_rms_um"] / s["before_rms_um"] if s["before_rms_um"] else 1.0
    return (
        what,
        str(s["count"]),
        length(as_length["before_rms_um"]),
        length(as_length["after_rms_um"]) if s["claimed"] else "not claimed",
        length(ratio * s["predicted_rms_um"]),
        length(as_length["floor_um"]),
        *reduction(s["removed"], s["removed_interval95"], s["claimed"]),
    )


def blind(run: Run) -> Section | None:
    """Effects that these data may miss."""
    spots = sorted(run.record["blind_spots"], key=lambda b: -(b["distance_error_um"] or 0.0))
    largest = max((b["distance_error_um"] or 0.0 for b in spots), default=0.0) or 1.0
    entries = []
    for b in spots:
        least, usual = b["smallest_nameable"], b["plausible"]
        never = least["value"] is None or (usual["value"] and least["value"] >= NEVER * usual["value"])
        error = b["distance_error_um"]
        entries.append(
            (
                f"{b['effect']}, {site_of(b['site'])}",
                quantity(usual["value"], usual["unit"]),
                "not detectable" if never else quantity(least["value"], least["unit"]),
                MISSING if error is None else Bar(error / largest, f"{length(error)} µm"),
            )
        )
    table = Sheet(
        "may be missed",
        ("plausible", "detectable from", "distance error if undetected"),
        tuple(entries),
        "Blind spots: effects whose plausible amplitude these contacts would not show",
        shown=8,
    )
    return blocks("blind", "Blind spots", table)


def advice(run: Run) -> Section | None:
    """What to measure next."""
    entries = tuple(
        (
            " and ".join(map(rival, a["separates"])),
            a["what"],
            str(len(a["contacts"])) if a["contacts"] else MISSING,
            f"{a['lambda_before']:.0f} to {a['lambda_after']:.0f}",
        )
        for a in run.record["next"]
    )
    table = Sheet(
        "separates",
        ("measure", "contacts in next.csv", "detectability"),
        entries,
        "Further measurements; detectability: noncentrality before and after",
        words=(1,),
    )
    parts: list[Block] = [table]
    if not entries:
        parts.append(Text("No further contacts are proposed."))
    return blocks("next", "What to measure next", *parts)


SECTIONS: tuple[Callable[[Run], Section | None], ...] = (
    first,
    effects,
    where,
    rows.scene,
    lambda run: rows.residuals(run, *margins(run)),
    levels,
    rows.budget,
    blind,
    advice,
    rows.inputs,
)
"""Sections of gap.html, in their order."""
