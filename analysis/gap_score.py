"""Diagnoses held against the truth: a record a world, figures of many, and the table that shows them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import binom

from bayescal.gap.result import Gap

SCHEMA = "bayescal-gap-study/1"
UM = 1e6
BANDS = ((0, 10), (10, 20), (20, 30), (30, 50), (50, 100), (100, np.inf))
"""Of lambda: contacts times (visible rms over noise) squared."""
BINS = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
"""Edges of stated probabilities."""
SURE = 0.9
CLEAR, STRONG = 30.0, 100.0  # lambda from which a pair, an effect outside the vocabulary, must be seen
WORSE = 1.05
"""Times the distances' rms from which on they count as made worse: refitting costs some noise."""
FLAGGED = ("unknown", "named+unexplained")

Record = dict[str, Any]


def record(gap: Gap, truth: Mapping[str, Any], seconds: float) -> Record:
    """What a diagnosis said of one world, beside what is true of it; lengths in um."""
    verdict = gap.verdict
    distances = next((s for s in gap.shrinkage if s.what == "distances"), None)
    planes = next((s for s in gap.shrinkage if s.what == "planes"), None)
    measured = next((UM * m.rms for m in gap.magnitude.measured if m.what == "sphere distances"), None)
    said = truth["distance_rms_um"]
    left = [p for p in gap.where if not p.explained_by]
    return {
        "world": truth["world"],
        "kind": truth["kind"],
        "effects": list(truth["effects"]),
        "outside": truth.get("outside"),
        "lambda": float(truth["lambda"]["value"]),
        "each": dict(truth["lambda"]["each"]),
        "true_places": [f"{w['site']}, {w['driver']}" for w in truth["where"]],
        "verdict": verdict.kind,
        "named": [n.effect for n in verdict.named],
        "probability": {k: float(p) for k, p in verdict.probability.items()},
        "set": list(verdict.credible_set90),
        "places": [f"{p.site}, {p.driver}" for p in left[:2]],
        "at_right_site": bool(left) and _meets(left[0].site, left[0].driver, truth["where"]),
        "named_at_right_site": named_places(gap, truth["where"]),
        "distance_um": {
            "before": measured if distances is None else UM * distances.before,
            "after": measured if distances is None else UM * distances.after,
            "floor": float(said["fit_without_effect"]),
        },
        "plane_um": None if planes is None else _planes(gap, planes, float(truth["noise_um"])),
        "seconds": seconds,
    }


def _planes(gap: Gap, planes: Any, noise: float) -> dict[str, float]:
    """Held-out planes before and after; their floor with the true noise in place of the estimated one."""
    by_parameters = max(planes.floor**2 - gap.magnitude.noise**2, 0.0)
    floor = float(np.hypot(noise, UM * np.sqrt(by_parameters)))
    return {"before": UM * planes.before, "after": UM * planes.after, "floor": floor}


def named_places(gap: Gap, where: Sequence[Mapping[str, Any]]) -> dict[str, bool]:
    """Whether the first place of every effect that was rightly named is where it acts."""
    out = {}
    for name in (n.effect for n in gap.verdict.named):
        true = [w for w in where if w["effect"] == name]
        first = next((p for p in gap.where if p.explained_by == name), None)
        if true and first is not None:
            out[name] = _meets(first.site, first.driver, true)
    return out


def _meets(site: str, driver: str, where: Iterable[Mapping[str, Any]]) -> bool:
    """Whether a place is one that the truth names in its own words; time may be told by a driver."""
    for w in where:
        words = [w["site"], *w.get("also", [])]
        if any(word == site or word in site for word in words):
            return True
        if w["site"] == "time" and any(word in driver for word in words):
            return True
    return False


def right(r: Record) -> bool:
    """Whether a verdict is what the truth asks for, no name more and none less."""
    if r["kind"] == "outside":
        return r["verdict"] in FLAGGED
    if r["kind"] == "null":
        return r["verdict"] == "null"
    return r["verdict"] == "named" and set(r["named"]) == set(r["effects"])


def figures(records: Sequence[Record]) -> dict[str, Any]:
    """All figures of a number of worlds; those on which a diagnosis crashed are only counted."""
    crashed = [f"{r['world']}: {r['crash']}" for r in records if "crash" in r]
    records = [r for r in records if "crash" not in r]
    of = {kind: [r for r in records if r["kind"] == kind] for kind in ("null", "single", "pair", "outside")}
    hidden = of["single"] + of["pair"]
    sure = [r for r in records if r["verdict"] == "named" and _least(r) > SURE]
    strong = [r for r in of["outside"] if r["lambda"] >= STRONG]
    flagged = [r for r in strong if right(r)]
    clear = [r for r in of["pair"] if min(r["each"].values()) > CLEAR]
    places = [ok for r in records for ok in r["named_at_right_site"].values()]
    return {
        "schema": SCHEMA,
        "worlds": len(records),
        "crashed": crashed,
        "seconds": {"median": _median(records, "seconds"), "most": max(r["seconds"] for r in records)},
        "null": {"named": share(of["null"], lambda r: bool(r["named"])), "right": share(of["null"], right)},
        "single": [band(of["single"], low, high) for low, high in BANDS],
        "sure": {"right": share(sure, right), "names_true": share(sure, _true_names)},
        "set": {
            "holds": share(hidden, _holds),
            "size": _mean(len(r["set"]) for r in hidden),
            "size_all": _mean(len(r["set"]) for r in records),
        },
        "pairs": {"all": pairs(of["pair"]), "clear": pairs(clear)},
        "outside": {
            "flagged": share(strong, right),
            "right_site": share(flagged, lambda r: r["at_right_site"]),
            "named_wrongly": share(of["outside"], lambda r: bool(r["named"])),
        },
        "named_place": {"count": len(places), "hits": sum(places)},
        "distances": shrunk(hidden, "distance_um"),
        "distances_clear": shrunk([r for r in hidden if r["lambda"] >= CLEAR], "distance_um"),
        "planes": shrunk([r for r in hidden if r["plane_um"]], "plane_um"),
        "worse": {
            r["world"]: [r["distance_um"][k] for k in ("before", "after")] for r in records if made_worse(r)
        },
        "reliability": reliability(records),
        "misses": [miss(r) for r in records if not right(r)],
    }


def share(records: Sequence[Record], hit: Callable[[Record], bool]) -> dict[str, int]:
    """How many of how many."""
    return {"count": len(records), "hits": sum(map(hit, records))}


def band(records: Sequence[Record], low: float, high: float) -> dict[str, Any]:
    """Single effects of a band of lambda."""
    own = [r for r in records if low <= r["lambda"] < high]
    return {
        "lambda": [low, None if np.isinf(high) else high],
        "right": share(own, right),
        "wrong_name": share(own, lambda r: not _true_names(r)),
        "set_holds": share(own, _holds),
        "set_size": _mean(len(r["set"]) for r in own),
    }


def pairs(records: Sequence[Record]) -> dict[str, Any]:
    """Names found of those that are true, and true of those that were found."""
    found = sum(len(set(r["named"]) & set(r["effects"])) for r in records)
    return {
        "worlds": len(records),
        "recall": {"count": sum(len(r["effects"]) for r in records), "hits": found},
        "precision": {"count": sum(len(r["named"]) for r in records), "hits": found},
        "both": share(records, right),
    }


def shrunk(records: Sequence[Record], key: str) -> dict[str, Any]:
    """What a refit takes off held-out errors, in worlds where something hidden was named.

    `closed` is of the pooled excess variance over the floor; `ratio` the pooled rms after the refit over the
    floor's, with its largest in a world whose names are right.
    """
    own = [r for r in records if r["named"] and r[key] and r[key]["after"] is not None]
    if not own:
        return {"count": 0, "closed": None, "ratio": None, "before_um": None, "after_um": None}
    old, new, floor = (np.array([r[key][k] for r in own]) ** 2 for k in ("before", "after", "floor"))
    excess = float(np.sum(old - floor))
    exact = np.array([right(r) for r in own])
    return {
        "count": len(own),
        "closed": float(np.sum(old - new)) / excess if excess > 0 else None,
        "ratio": float(np.sqrt(np.sum(new) / np.sum(floor))),
        "ratio_right": float(np.sqrt(np.sum(new[exact]) / np.sum(floor[exact]))) if np.any(exact) else None,
        "ratio_median": float(np.median(np.sqrt(new / floor))),
        "before_um": float(np.sqrt(np.mean(old))),
        "after_um": float(np.sqrt(np.mean(new))),
        "floor_um": float(np.sqrt(np.mean(floor))),
    }


def made_worse(r: Record) -> bool:
    """Whether sphere distances rose, beyond what a parameter more costs in noise."""
    d = r["distance_um"]
    return bool(r["named"]) and d["before"] is not None and d["after"] > WORSE * d["before"]


def reliability(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Stated probabilities of effects, of nothing and of something else, by bins, beside how often they held.

    The band is binomial: where the share would lie were the stated probabilities right and independent.
    """
    said, held = [], []
    for r in records:
        for name, p in r["probability"].items():
            true = r["kind"] == "null" if name == "null" else name in r["effects"]
            said.append(p)
            held.append(true or (name == "unknown" and r["kind"] == "outside"))
    p, true = np.array(said), np.array(held, bool)
    out = []
    for low, high in pairwise(BINS):
        own = (p >= low) & ((p < high) | (high == BINS[-1]))
        count = int(np.sum(own))
        if count:
            mean = float(np.mean(p[own]))
            ends = (binom.ppf([0.025, 0.975], count, mean) / count).tolist()
            out.append(
                {
                    "bin": [low, high],
                    "count": count,
                    "said": mean,
                    "held": float(np.mean(true[own])),
                    "band95": ends,
                }
            )
    return out


def miss(r: Record) -> str:
    """One line on a verdict that is not what the truth asks for."""
    truth = r["outside"] or " + ".join(r["effects"]) or "nothing"
    each = ", ".join(f"{v:.0f}" for v in r["each"].values())
    ranked = sorted(r["probability"].items(), key=lambda item: -item[1])[:3]
    leaders = ", ".join(f"{name} {p:.2f}" for name, p in ranked)
    named = " + ".join(r["named"]) or "no name"
    place = f"; left at {r['places'][0]}" if r["places"] and r["kind"] == "outside" else ""
    at = f" at {r['true_places'][0]}" if r["true_places"] else ""
    return f"{r['world']}: {truth}{at} (lambda {each or 0}): {r['verdict']}, {named} ({leaders}){place}"


def table(found: Mapping[str, Any]) -> str:
    """The figures as Markdown."""
    f = found
    lines = _head(
        "one effect, by lambda", "worlds", "right", "a wrong name", "90 % set holds it", "its mean size"
    )
    for b in f["single"]:
        low, high = b["lambda"]
        words = f"over {low:g}" if high is None else f"under {high:g}" if not low else f"{low:g} to {high:g}"
        rates = [rate(b[k]) for k in ("right", "wrong_name", "set_holds")]
        lines.append(_row(words, b["right"]["count"], *rates, number(b["set_size"], 1)))
    pair, clear, out, d = f["pairs"]["all"], f["pairs"]["clear"], f["outside"], f["distances"]
    sizes = f"{number(f['set']['size'], 1)} ({number(f['set']['size_all'], 1)} over all worlds)"
    each = ", ".join(f"{world}: {old:.1f} -> {new:.1f} um" for world, (old, new) in f["worse"].items())
    worse = f"{len(f['worse'])} worlds" + (f" ({each})" if each else "")
    both = f"two effects, each lambda over {CLEAR:g}, {clear['worlds']} worlds: recall"
    rows = [
        ("null worlds that carry a name", of(f["null"]["named"]), "at most 2 %"),
        (f"named with probability above {SURE:g}: right", of(f["sure"]["right"]), "96 %"),
        ("the same: every name true", of(f["sure"]["names_true"]), ""),
        ("90 % set holds all that is true, one and two effects", of(f["set"]["holds"]), "87 %"),
        ("its mean size", sizes, "under 5"),
        (f"two effects at once, {pair['worlds']} worlds: recall", of(pair["recall"]), "93 %"),
        ("the same: precision", of(pair["precision"]), "97 %"),
        (both, of(clear["recall"]), "93 %"),
        ("the same: precision", of(clear["precision"]), "97 %"),
        (f"outside the vocabulary, lambda from {STRONG:g}: flagged", of(out["flagged"]), "90 %"),
        ("of these, at the right site", of(out["right_site"]), "95 %"),
        ("a named effect lies where it acts", of(f["named_place"]), ""),
        (f"sphere distances, {d['count']} worlds with a name: gap closed", percent(d["closed"]), "95 %"),
        (f"the same, lambda from {CLEAR:g}", percent(f["distances_clear"]["closed"]), "95 %"),
        ("sphere distances made worse by over 5 %", worse, "none"),
        ("sphere distances after the refit over those of an arm without the effect", ratio(d), "1.15"),
        ("held-out planes after the refit over their floor", ratio(f["planes"]), "1.15"),
        ("seconds a world, median and most", f"{f['seconds']['median']:.1f}, {f['seconds']['most']:.1f}", ""),
    ]  # fmt: skip
    lines += ["", *_head(f"{f['worlds']} worlds", "found", "wanted")]
    lines += [_row(*row) for row in rows]
    lines += ["", *_head("stated probability", "how many", "mean", "held", "95 % band")]
    for b in f["reliability"]:
        low, high = b["band95"]
        lines.append(
            f"| {b['bin'][0]:g} to {b['bin'][1]:g} | {b['count']} | {b['said']:.2f} | {b['held']:.2f} | "
            f"{low:.2f} to {high:.2f} |"
        )
    if f["crashed"]:
        lines += ["", f"Crashed: {'; '.join(f['crashed'])}."]
    lines += ["", f"Verdicts that are not what the truth asks for ({len(f['misses'])}):", ""]
    lines += [f"- {line}" for line in f["misses"]]
    return "\n".join(lines)


def own_table(found: Mapping[str, Any]) -> str:
    """False names in sessions with nothing hidden, as Markdown."""
    lines = _head("sessions of our own, nothing hidden", "sessions", "a false name", "flagged", "wanted")
    for case, c in found.items():
        names = "; ".join(f"{seed}: {' + '.join(names)}" for seed, names in c["names"].items())
        told = f"{c['named']} ({100 * c['named'] / c['count']:.0f} %){f': {names}' if names else ''}"
        lines.append(f"| {case} | {c['count']} | {told} | {c['unknown']} | at most 5 % |")
    return "\n".join(lines)


def own_figures(records: Sequence[Record]) -> dict[str, Any]:
    """False names by case, of sessions in which nothing is hidden."""
    out: dict[str, Any] = {}
    for r in records:
        c = out.setdefault(r["case"], {"count": 0, "named": 0, "unknown": 0, "names": {}})
        c["count"] += 1
        c["named"] += bool(r["named"])
        c["unknown"] += r["verdict"] in FLAGGED
        if r["named"]:
            c["names"][str(r["seed"])] = r["named"]
    return out


def of(hit: Mapping[str, int]) -> str:
    """'12 of 13 (92 %)'."""
    return f"{hit['hits']} of {hit['count']}" + (f" ({rate(hit)})" if hit["count"] else "")


def rate(hit: Mapping[str, int]) -> str:
    """A share in per cent."""
    return f"{100 * hit['hits'] / hit['count']:.0f} %" if hit["count"] else "-"


def percent(value: float | None) -> str:
    """A fraction in per cent."""
    return "-" if value is None else f"{100 * value:.0f} %"


def number(value: float | None, digits: int) -> str:
    """A number, or a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def ratio(s: Mapping[str, Any]) -> str:
    """Ratio to a floor and the lengths behind it."""
    if not s["count"]:
        return "-"
    right_ = "" if s["ratio_right"] is None else f", {s['ratio_right']:.2f} where the names are right"
    lengths = f"{s['before_um']:.1f} -> {s['after_um']:.1f}, floor {s['floor_um']:.1f} um"
    return f"{s['ratio']:.2f}{right_} ({lengths})"


def _row(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _head(*cells: str) -> list[str]:
    return [_row(*cells), _row(*["---"] * len(cells))]


def _least(r: Record) -> float:
    return min((r["probability"][name] for name in r["named"]), default=0.0)


def _true_names(r: Record) -> bool:
    return set(r["named"]) <= set(r["effects"])


def _holds(r: Record) -> bool:
    return set(r["effects"]) <= set(r["set"])


def _mean(values: Iterable[float]) -> float | None:
    every = list(values)
    return float(np.mean(every)) if every else None


def _median(records: Sequence[Record], key: str) -> float:
    return float(np.median([r[key] for r in records]))
