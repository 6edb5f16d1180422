"""The page of a diagnosis, `gap.html`: its sections, each a function of the run."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bayescal.effects import EFFECTS
from bayescal.effects.location import Site
from bayescal.reporting.page import rows
from bayescal.reporting.page.arm import draw_arm, marked_sites
from bayescal.reporting.page.fit import level_sheet
from bayescal.reporting.page.numbers import MISSING, interval, length, measured, quantity, share, uncertainty
from bayescal.reporting.page.run import Run
from bayescal.reporting.page.section import Bar, Block, Fault, Section, Sheet, Text, blocks, texts
from bayescal.reporting.shared.text import NEVER, level_label, p_value, probability, rival

VERDICTS = {
    "null": ("good", "✓", "No effect above noise"),
    "named": ("bad", "✗", "Effect found"),
    "named+unexplained": ("bad", "✗", "Effect found, and an unmodelled effect"),
    "unknown": ("bad", "✗", "Unmodelled effect"),
    "ambiguous": ("warn", "?", "Ambiguous: several explanations"),
}
"""Tone, sign and word of each verdict."""
UNMODELLED = ("unknown", "named+unexplained")
"""Verdicts that state an unmodelled effect."""
UNKNOWN = (
    "No effect of the vocabulary explains the error. Inspect the location first: bolts, cables and hoses "
    "that pull, covers that touch, the mounting. Then measure the contacts that are proposed."
)
SIGNIFICANT = 0.01
COVERAGE = 2.0
MARGINS = ("target", "joint", "region", "time", "direction")
LEAST = 0.01
"""Least probability of an effect that is listed unfolded."""
NULL, OTHER = "null", "unknown"
VALIDATION_POINTS, DISTANCES = "validation points", "sphere distances"
COORDINATES = 3
"""Of a point: records state RMS values per coordinate, pages the length of the error vector."""


def first(run: Run) -> Section:
    """Verdict, distance error with U, effects with size and location, remedies, next commands."""
    record = run.record
    tone, sign, word = VERDICTS[record["verdict"]]
    if record["verdict"] == "null" and record["words"][0].startswith("No effect found"):
        tone, sign, word = "warn", "?", "No effect found"
    sites = marked_sites(run)
    context = {
        "tone": tone,
        "sign": sign,
        "word": word,
        "lines": record["words"],
        "keys": _keys(record),
        "fault_title": "What is wrong, and what to look at",
        "faults": _faults(record),
        "arm": draw_arm(run) if sites else None,
        "arm_caption": "Marked: " + ", ".join(s.text for s in sites),
        "next": _next(run),
        "warnings": record["warnings"],
    }
    return Section("result", "", "first.html.j2", context)


def _faults(record: Mapping[str, Any]) -> list[Fault]:
    """Named effects with location, amplitude, probability and share; an unmodelled effect; or the rivals."""
    out = []
    for named in record["named"]:
        own = [a for a in record["amplitudes"] if a["effect"] == named["effect"]]
        clear = [a for a in own if a["significant"]] or own
        facts = [
            ("location", ", ".join(dict.fromkeys(_site(a["site"]) for a in clear)) or _site(named["site"])),
            ("size", "; ".join(_amplitude(a) for a in clear)),
            ("probability", probability(named["probability"])),
            ("share of the excess", _share(record, named["effect"])),
        ]
        name = named["effect"] + ("" if named["confirmed"] else " (validation data do not confirm it)")
        out.append(Fault(name, _known(facts), _remedy(named["effect"])))
    if record["verdict"] in UNMODELLED:
        where = _unexplained(record)
        p = record["probability"].get(OTHER)
        facts = [("location", _words(where) if where else "no single location")]
        facts += [("size", _size(record, where))] if where else []
        facts += [] if p is None else [("probability", probability(p))]
        facts += [("share of the excess", share(where["share"]))] if where else []
        facts += [("what happens", where.get("words", ""))] if where else []
        remedy = where.get("remedy", "") if where else ""
        out.append(Fault(rival(OTHER), _known(facts), remedy or UNKNOWN))
    if record["verdict"] == "ambiguous":
        for name in (n for n in record["credible_set90"] if n != NULL):
            remedy = UNKNOWN if name == OTHER else _remedy(name)
            facts = [("probability", probability(record["probability"].get(name) or 0.0))]
            out.append(Fault(f"possibly {rival(name)}", _known(facts), remedy))
    return out


def _unexplained(record: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The largest location that no named effect explains, where the verdict is an unmodelled effect."""
    if record["verdict"] not in UNMODELLED:
        return None
    return next((w for w in record["where"] if not w["explained_by"]), None)


def _rms(record: Mapping[str, Any]) -> str:
    """What RMS values of groups and locations are: for points they are per coordinate."""
    return "RMS" if record["lengths"]["of"] == "validation contacts" else "RMS per coordinate"


def _size(record: Mapping[str, Any], place: Mapping[str, Any]) -> str:
    """Size of the error at a location."""
    return f"{length(place['rms_um'])} µm {_rms(record)}"


def _known(facts: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    return tuple((name, value) for name, value in facts if value not in ("", MISSING))


def _remedy(effect: str) -> str:
    """What to inspect; "" for an effect of the user that is not registered here."""
    return EFFECTS[effect].remedy if effect in EFFECTS else ""


def _amplitude(a: Mapping[str, Any]) -> str:
    text = f"{a['what']} {measured(a['value'], a['u'], a['unit'])}"
    return text if a["significant"] else f"{text}, not significant alone"


def _site(site: str) -> str:
    return " and ".join(Site.read(part).text for part in site.split(" and "))


def _words(place: Mapping[str, Any]) -> str:
    """A location in words; records of earlier versions have site and driver alone."""
    return str(place.get("text") or f"{place['site']}, {place['driver']}")


def _share(record: Mapping[str, Any], effect: str) -> str:
    """Share of the excess variance at the largest location that an effect explains."""
    own = [w for w in record["where"] if w["explained_by"] and effect in w["explained_by"].split(", ")]
    return share(own[0]["share"]) if own and own[0]["share"] is not None else MISSING


def _keys(record: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    out = []
    measured_now = {m["what"]: m for m in record["gap"]["measured"]}
    better = record["shrinkage"].get("distances")
    now = measured_now.get(DISTANCES)
    if better and record["verdict"] == "named":
        value = f"U = {uncertainty(COVERAGE * better['predicted_rms_um'])} µm (k = 2)"
        after = f", {length(better['after_rms_um'])} µm after" if better["claimed"] else ""
        detail = (
            f"with the named effects in the model; measured RMS {length(better['before_rms_um'])} µm before"
            f"{after}, {better['count']} distances"
        )
        out.append(("Distance error", value, detail))
    elif now:
        trusted = record["verdict"] == "null" and now["rms_um"] <= now["predicted_interval95_um"][1]
        rms, expected = length(now["rms_um"]), length(now["predicted_rms_um"])
        expanded = uncertainty(COVERAGE * now["predicted_rms_um"])
        value = f"U = {expanded} µm (k = 2)" if trusted else f"{rms} µm RMS"
        detail = f"measured {rms} µm RMS over {now['count']} distances, expected {expected} µm"
        if not trusted:
            detail += f"; U = {expanded} µm (k = 2) holds only without the effect"
        out.append(("Distance error", value, detail))
    else:
        out.append(("Distance error", "not measured", "no certified distances in the validation rows"))
    of = record["lengths"]
    kind = "point (length)" if of["of"] == VALIDATION_POINTS else "contact"
    low, high = record["gap"]["excess_um"]["interval95"]
    scale = COORDINATES**0.5 if of["of"] == VALIDATION_POINTS else 1.0
    excess = f"{length(of['excess_um'])} µm" if low or record["verdict"] != "null" else "none"
    out.append(
        (
            "Excess above noise",
            excess,
            f"95 %: {interval([low, high], scale)} µm per {kind}; validation RMS "
            f"{length(of['validation_rms_um'])} µm, noise {length(of['noise_um'])} µm",
        )
    )
    null = record["probability"].get(NULL)
    if null is not None:
        out.append(("Probability of noise only", probability(null), f"from {record['gap']['heldout']}"))
    return out


def _next(run: Run) -> list[tuple[str, str]]:
    record, folder = run.record, shlex.quote(run.folder)
    sessions = record["dataset"].get("sessions") or ()
    dataset = " ".join(f"{folder}/dataset/{k}" for k in range(1, len(sessions) + 1)) or f"{folder}/dataset"
    out = []
    if record["named"]:
        model = shlex.quote(record["refit"]["model"])
        less = record["refit"]["without"]
        without = f" --without {shlex.quote(','.join(less))}" if less else ""
        words = "Correct the machine as above and measure again; or keep the effects in the model:"
        out.append((words, f"bayescal fit {dataset} --model {model}{without}"))
    if _unexplained(record):
        out.append(("Inspect the location that is marked, correct it, and measure again.", ""))
    open_ = record["verdict"] in ("ambiguous", *UNMODELLED) or record.get("undecided")
    if open_ and not sessions:
        command = f"bayescal plan {dataset} --after {folder} --for gap --contacts 60"
        out.append(("Measure the contacts that decide between the explanations.", command))
    if record["verdict"] == "null":
        out.insert(0, ("Calibrate with the model as it is.", f"bayescal fit {dataset}"))
    return out or [("Inspect the location that is marked, and measure again.", "")]


def effects(run: Run) -> Section | None:
    """All effects by probability, with amplitude, share, location, and what is detectable."""
    record = run.record
    least = _detectable(record)
    ranked = sorted(record["probability"].items(), key=lambda item: -(item[1] or 0.0))
    entries: list[tuple[Any, ...]] = []
    for name, p in ranked:
        own = [a for a in record["amplitudes"] if a["effect"] == name]
        clear = [a for a in own if a["significant"]] or own
        location = ", ".join(dict.fromkeys(_site(a["site"]) for a in clear))
        size, part = "; ".join(_amplitude(a) for a in clear), _share(record, name)
        if name == OTHER and (place := _unexplained(record)):
            location, part = _words(place), share(place["share"])
            size = _size(record, place)
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
        "Dark bars: the 90 % set. Effects may be present together. 'noise only': the model as it is explains "
        "the data; 'unmodelled effect': none of the vocabulary does",
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
                MISSING if h["log_evidence"] is None else f"{h['log_evidence']:+.1f}",
            )
            for h in record["hypotheses"]
        ),
        "Sets of effects, the most probable first; log evidence relative to noise only",
        shown=6,
    )
    notes = texts([*record["footnotes"], *record["notes"]], "quiet")
    return blocks("effects", "Effects", table, *notes, sets, missing)


def _detectable(record: Mapping[str, Any]) -> dict[str, str]:
    """Smallest detectable amplitude of each effect that may be missed, at the location listed first."""
    out: dict[str, str] = {}
    for b in record["blind_spots"]:
        least, usual = b["smallest_nameable"]["value"], b["plausible"]["value"]
        never = least is None or (usual is not None and least >= NEVER * usual)
        out.setdefault(
            b["effect"], "not detectable" if never else quantity(least, b["smallest_nameable"]["unit"])
        )
    return out


def where(run: Run) -> Section | None:
    """Locations of the error, the largest first."""
    record = run.record
    largest = max((w["rms_um"] or 0.0 for w in record["where"]), default=0.0) or 1.0
    entries = tuple(
        (
            _words(w),
            Bar(
                (w["rms_um"] or 0.0) / largest,
                length(w["rms_um"]),
                w["family_p_value"] is not None and w["family_p_value"] < SIGNIFICANT,
            ),
            share(w["share"]),
            MISSING if w["family_p_value"] is None else p_value(w["family_p_value"]),
            w["explained_by"] or MISSING,
        )
        for w in record["where"]
    )
    table = Sheet(
        "location and dependence",
        (f"{_rms(record)} (µm)", "share of the excess", "p", "explained by"),
        entries,
        "Residuals that a location explains. Dark: significant (p below 0.01, corrected for the number of "
        "locations)",
        words=(4,),
        shown=8,
    )
    return blocks("where", "Location of the error", table)


def margins(run: Run) -> tuple[Sheet, ...]:
    """Residuals by target, joint, region, time and direction."""
    out = []
    for key in MARGINS:
        groups = run.record["where_marginal"][key]
        largest = max((g["rms_um"] or 0.0 for g in groups), default=0.0) or 1.0
        out.append(
            Sheet(
                key,
                ("rows", f"{_rms(run.record)} (µm)", "mean (µm)", "p"),
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
                f"Residuals by {key}, before the refit",
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
    ladder = [dict(step) for step in record["ladder"]]
    for step in ladder:
        gain, se = step["delta_elpd"], step["delta_elpd_se"]
        step["gain"] = MISSING if gain is None or not gain else f"{gain:+.0f} ± {se:.0f}"
    names = tuple(
        level_label(tuple(step["model"]), tuple(ladder[k - 1]["model"]) if k else ())
        for k, step in enumerate(ladder)
    )
    sheet = level_sheet(ladder, columns[1:] if points else columns, names)
    sheet = Sheet(
        sheet.title,
        (*sheet.headings, "difference of log density (nats)"),
        tuple((*row, step["gain"]) for row, step in zip(sheet.rows, ladder, strict=True)),
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
    removed = s["removed_interval95"] or (None, None)
    claimed = s["claimed"] and s["removed"] is not None
    return (
        what,
        str(s["count"]),
        length(as_length["before_rms_um"]),
        length(as_length["after_rms_um"]) if s["claimed"] else "not claimed",
        length(ratio * s["predicted_rms_um"]),
        length(as_length["floor_um"]),
        share(s["removed"]) if claimed else MISSING,
        f"{share(removed[0])} to {share(removed[1])}" if claimed and None not in removed else MISSING,
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
                f"{b['effect']}, {_site(b['site'])}",
                quantity(usual["value"], usual["unit"]),
                "not detectable" if never else quantity(least["value"], least["unit"]),
                MISSING if error is None else Bar(error / largest, f"{length(error)} µm"),
            )
        )
    table = Sheet(
        "may be missed",
        ("plausible", "detectable from", "distance error until then"),
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
