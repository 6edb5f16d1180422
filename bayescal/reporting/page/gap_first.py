"""The first screen of gap.html: verdict, distance error, effects with their sizes, next commands."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from bayescal.effects import EFFECTS
from bayescal.effects.location import Site
from bayescal.reporting.page.arm import draw_arm, marked_sites
from bayescal.reporting.page.section import MISSING, Fault, Run, Section, interval, length, measured, share
from bayescal.reporting.shared.origin import possible
from bayescal.reporting.shared.text import probability, rival

VERDICTS = {
    "null": ("good", "✓", "No effect above noise"),
    "named": ("bad", "✗", "Effect found"),
    "named+unexplained": ("bad", "✗", "Effect found, and a further one"),
    "unknown": ("bad", "✗", "Unmodelled effect"),
    "ambiguous": ("warn", "?", "Ambiguous: several explanations"),
}
"""Tone, sign and word of each verdict."""
UNMODELLED = ("unknown", "named+unexplained")
"""Verdicts that state an unmodelled effect."""
UNKNOWN = (
    "No known effect explains the error. Inspect the location first: bolts, cables and hoses "
    "that pull, covers that touch, the mounting. Then measure the contacts that are proposed."
)
LINES = 3
"""Lines of the verdict that are seen at once; the effects of all follow with their sizes."""
NULL, OTHER = "null", "unknown"
VALIDATION_POINTS, DISTANCES = "validation points", "sphere distances"
COORDINATES = 3
"""Of a point: records state RMS values per coordinate, pages the length of the error vector."""


def first(run: Run) -> Section:
    """Verdict, distance error before and after, effects with size and location, remedies, next commands."""
    record = run.record
    tone, sign, word = VERDICTS[record["verdict"]]
    if record["verdict"] == "null" and record["words"][0].startswith("No effect found"):
        tone, sign, word = "warn", "?", "No effect found"
    sites = marked_sites(run)
    context = {
        "tone": tone,
        "sign": sign,
        "word": word,
        "lines": _lines(word, record["words"]),
        "most": LINES,
        "keys": _keys(record),
        "fault_title": "What is wrong, and what to look at",
        "faults": _faults(record),
        "arm": draw_arm(run) if sites else None,
        "arm_caption": "Marked: " + ", ".join(s.text for s in sites),
        "next": _next(run),
        "warnings": record["warnings"],
        "notes": (),
    }
    return Section("result", "", "first.html.j2", context)


def _lines(word: str, words: Sequence[str]) -> list[str]:
    """The verdict without what its word says already: ``Effect found: joint 3 has ...`` after the first."""
    said = word.partition(",")[0].partition(":")[0]
    rest = words[0].removeprefix(f"{said}: ").removeprefix(f"{said} ")
    return [rest[:1].upper() + rest[1:], *words[1:]]


def _faults(record: Mapping[str, Any]) -> list[Fault]:
    """Named effects with location, amplitude, probability and share; an unmodelled effect; or the rivals."""
    out, may_be = [], _further(record)
    for named in record["named"]:
        own = [a for a in record["amplitudes"] if a["effect"] == named["effect"]]
        clear = [a for a in own if a["significant"]] or own
        facts = [
            (
                "location",
                ", ".join(dict.fromkeys(site_of(a["site"]) for a in clear)) or site_of(named["site"]),
            ),
            ("size", sizes_of(clear)),
            ("probability", probability(named["probability"])),
            ("share of the excess", share_of(record, named["effect"])),
        ]
        name = named["effect"] + ("" if named["confirmed"] else " (validation data do not confirm it)")
        out.append(Fault(name, _known(facts), _remedy(named["effect"])))
    if record["verdict"] in UNMODELLED and not may_be:
        where = unexplained(record)
        p = record["probability"].get(OTHER)
        facts = [("location", words_of(where) if where else "no single location")]
        facts += [("size", size_of(record, where))] if where else []
        facts += [] if p is None else [("probability", probability(p))]
        facts += [("share of the excess", share(where["share"]))] if where else []
        facts += [("what happens", where.get("words", ""))] if where else []
        remedy = where.get("remedy", "") if where else ""
        out.append(Fault(rival(OTHER), _known(facts), remedy or UNKNOWN))
    if record["verdict"] == "ambiguous":
        may_be = tuple(n for n in record["credible_set90"] if n != NULL)
    for name in may_be:
        remedy = UNKNOWN if name == OTHER else _remedy(name)
        facts = [("probability", probability(record["probability"].get(name) or 0.0))]
        out.append(Fault(f"possibly {rival(name)}", _known(facts), remedy))
    return out


def _further(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Known effects of which one is probable beside the named ones."""
    if record["verdict"] != "named+unexplained":
        return ()
    return possible(record["probability"], record["credible_set90"], record["effects"])


def unexplained(record: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The largest location that no named effect explains, where the verdict is an unmodelled effect."""
    if record["verdict"] not in UNMODELLED:
        return None
    return next((w for w in record["where"] if not w["explained_by"]), None)


def rms_of(record: Mapping[str, Any]) -> str:
    """What RMS values of groups and locations are: for points they are per coordinate."""
    return "RMS" if record["lengths"]["of"] == "validation contacts" else "RMS per coordinate"


def size_of(record: Mapping[str, Any], place: Mapping[str, Any]) -> str:
    """Size of the error at a location."""
    return f"{length(place['rms_um'])} µm {rms_of(record)}"


def _known(facts: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    return tuple((name, value) for name, value in facts if value not in ("", MISSING))


def _remedy(effect: str) -> str:
    """What to inspect; "" for an effect of the user that is not registered here."""
    return EFFECTS[effect].remedy if effect in EFFECTS else ""


def amplitude_of(a: Mapping[str, Any]) -> str:
    """An amplitude with u and unit."""
    text = f"{a['what']} {measured(a['value'], a['u'], a['unit'])}"
    return text if a["significant"] else f"{text}, not significant alone"


def sizes_of(some: Sequence[Mapping[str, Any]]) -> str:
    """Amplitudes of an effect; with their locations, where there are several."""
    several = len({a["site"] for a in some}) > 1
    return "; ".join((f"{site_of(a['site'])}: " if several else "") + amplitude_of(a) for a in some)


def site_of(site: str) -> str:
    """One or several sites of a record in words."""
    return " and ".join(Site.read(part).text for part in site.split(" and "))


def words_of(place: Mapping[str, Any]) -> str:
    """A location in words; records of earlier versions have site and driver alone."""
    return str(place.get("text") or f"{place['site']}, {place['driver']}")


def share_of(record: Mapping[str, Any], effect: str) -> str:
    """Share of the excess variance at the largest location that an effect explains, named among several."""
    own = [w for w in record["where"] if w["explained_by"] and effect in w["explained_by"].split(", ")]
    if not own or own[0]["share"] is None:
        return MISSING
    several = len({w["site"] for w in own}) > 1
    return share(own[0]["share"]) + (f" at {site_of(own[0]['site'])}" if several else "")


def _keys(record: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    out = []
    measured_now = {m["what"]: m for m in record["gap"]["measured"]}
    better = record["shrinkage"].get("distances")
    now = measured_now.get(DISTANCES)
    if better and record["named"]:
        before, after = length(better["before_rms_um"]), length(better["after_rms_um"])
        value = f"{before} → {after} µm RMS" if better["claimed"] else f"{before} µm RMS"
        detail = (
            f"{better['count']} certified distances, before and after the refit with the named effects, "
            f"which expects {length(better['predicted_rms_um'])} µm"
        )
        detail += "" if better["claimed"] else "; no improvement is claimed"
        out.append(("Distance error", value, detail))
    elif now:
        detail = f"{now['count']} certified distances; the model expects {length(now['predicted_rms_um'])} µm"
        out.append(("Distance error", f"{length(now['rms_um'])} µm RMS", detail))
    else:
        out.append(("Distance error", "not measured", "no certified distances in the validation data"))
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
        words = "Repair the machine as described above and measure again; or keep the effects in the model:"
        out.append((words, f"bayescal fit {dataset} --model {model}{without}"))
    if unexplained(record):
        out.append(("Inspect the location that is marked, correct it, and measure again.", ""))
    open_ = record["verdict"] in ("ambiguous", *UNMODELLED) or record.get("undecided")
    if open_ and not sessions:
        command = f"bayescal plan {dataset} --after {folder} --for gap --contacts 60"
        out.append(("Measure the contacts that decide between the explanations.", command))
    if record["verdict"] == "null":
        out.insert(0, ("Calibrate with the model as it is.", f"bayescal fit {dataset}"))
    return out or [("Inspect the location that is marked, and measure again.", "")]
