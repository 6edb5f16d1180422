"""Pairs of sessions in the blind check: an answer, its score against the truth, and the criteria."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from analysis.blind.card import Card
from analysis.blind.folder import PAIR
from analysis.blind.motions import CRASHED, need
from analysis.blind.rates import proportion, value
from analysis.blind.rows import NONE, Row

BEGIN, END = "<!-- blind changes: begin -->", "<!-- blind changes: end -->"
CLEAR = 30.0
"""Lambda from which a change must be named."""
NAMES = ("zero", "compliance", "backlash", "tool", "base")
MISS = {
    "world": "pair",
    "truth": "truth",
    "lambda": "lambda",
    "verdict": "verdict",
    "named": "named",
    "nuisance": "model errors",
    "detail": "detail",
}
"""Fields of a miss, and their columns on the page."""
Record = dict[str, Any]


def answer(folder: Path) -> dict[str, Any]:
    """What changed between two sessions."""
    from bayescal.changes import changed
    from bayescal.dataset import read_dataset
    from bayescal.effects import BASELINE
    from bayescal.reporting.changed import changed_record

    return {"gap": changed_record(changed([read_dataset(folder / s) for s in PAIR], BASELINE))}


def is_item(change: Mapping[str, Any], item: Mapping[str, Any]) -> bool:
    """Whether an item of an answer is a change of the truth."""
    j = change["site"].rpartition(" ")[2]
    name = change["name"]
    if name == "zero":
        return bool(item["item"] == f"theta{j}")
    if name in ("tool", "base"):
        return bool(item["item"] == name)
    return bool(item["effect"] == name and item["site"] == change["site"])


def off(change: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[float]:
    """Errors of the differences of a change in their u; of a base none: its frame is arbitrary."""
    own = [i for i in items if is_item(change, i)]
    true = np.array(change["value"])
    factor = {"rad": 180 / np.pi, "m": 1e3, "rad/(N m)": 1e6}[change["unit"]]
    if change["name"] == "base" or len(own) != len(true):
        return []
    return [(i["difference"] - factor * t) / i["u"] for i, t in zip(own, true, strict=True)]


def record(truth: Mapping[str, Any], given: Mapping[str, Any] | None) -> Record:
    """Compare an answer with the ground truth of its pair, as `analysis.world.changes.build` returns it."""
    said, found = given or {}, (given or {}).get("gap")
    items = [i for i in found["items"] if i["stated"]] if found else []
    out = {key: truth[key] for key in ("world", "kind", "stage", "lambda", "changes")}
    out |= {
        "truth": "+".join(f"{c['name']} {c['site']}" for c in truth["changes"]) or "same",
        "nuisance": "+".join(truth["nuisance"]),
        "verdict": found["verdict"] if found else CRASHED,
        "same": found["probability"]["same"] if found else None,
        "named": list(dict.fromkeys(" or ".join(i["class"]) or i["item"] for i in items)),
        "detail": said.get("error", ""),
        "seconds": said.get("seconds"),
        "each": [],
        "off": [],
    }
    if not found:
        return out
    for c in truth["changes"]:
        own = [i for i in items if is_item(c, i)]
        alone = bool(own) and not own[0]["class"]
        out["each"].append({**c, "named": bool(own), "alone": alone})
        out["off"] += off(c, items) if alone else []
    true = [i for i in items if any(is_item(c, i) for c in truth["changes"])]
    explained = {i["item"] for i in true} | {name for i in true for name in i["class"]}
    out["extra"] = sorted({i["item"] for i in items} - explained)
    return out


def figures(records: Sequence[Record]) -> dict[str, Any]:
    """All results."""
    null = [r for r in records if r["kind"] == "null"]
    clear = [c for r in records for c in r["each"] if c["lambda"] > CLEAR]
    offs = np.abs([x for r in records for x in r["off"]])
    changed = [r for r in records if r["verdict"] == "changed" and r["kind"] != "null"]

    def part(chosen: Sequence[Mapping[str, Any]], key: str) -> dict[str, Any]:
        return proportion(sum(bool(c[key]) for c in chosen), len(chosen))

    return {
        "schema": "bayescal-blind-changes/1",
        "worlds": len(records),
        "kinds": {k: sum(r["kind"] == k for r in records) for k in dict.fromkeys(r["kind"] for r in records)},
        "false": proportion(sum(r["verdict"] == "changed" for r in null), len(null)),
        "null_ambiguous": proportion(sum(r["verdict"] == "ambiguous" for r in null), len(null)),
        "named": part(clear, "named"),
        "alone": part(clear, "alone"),
        "of": {n: part([c for c in clear if c["name"] == n], "named") for n in NAMES},
        "extra": proportion(sum(bool(r.get("extra")) for r in changed), len(changed)),
        "within": proportion(int(np.sum(offs < 2.0)), len(offs)),
        "seconds": float(np.median([r["seconds"] for r in records if r["seconds"]] or [0.0])),
        "crashed": {r["world"]: r["detail"] or "no answer" for r in records if r["verdict"] == CRASHED},
        "misses": [{k: r[k] for k in MISS} for r in records if _missed(r)],
    }


def _missed(r: Record) -> bool:
    named = all(c["named"] for c in r["each"] if c["lambda"] > CLEAR)
    return (
        r["verdict"] == CRASHED
        or not named
        or bool(r.get("extra"))
        or (r["kind"] == "null" and r["verdict"] != "same")
    )


def rows(f: Mapping[str, Any]) -> list[Row]:
    """The criteria, with what is required."""
    each = "; ".join(f"{s} {p['hits']} of {p['count']}" for s, p in f["of"].items() if p["count"])
    crashed, within = f["crashed"], value(f["within"])
    plain = need("difference within its U (k = 2)", f["within"], least=0.93)
    return [
        need("nothing changed: called changed", f["false"], most=0.02),
        need("the same: called ambiguous", f["null_ambiguous"]),
        need(f"right item named, alone or in a class, lambda from {CLEAR:g}", f["named"], least=0.9),
        need("of these alone", f["alone"]),
        Row("named by kind", each or NONE),
        need("changed: a further item named that did not change", f["extra"]),
        Row(plain.label, plain.found, "0.93 to 0.97", None if within is None else 0.93 <= within <= 0.97),
        Row("seconds per pair, median", f"{f['seconds']:.1f}"),
        Row("crashes", "; ".join(f"{w}: {e}" for w, e in crashed.items()) or "none", "none", not crashed),
    ]


CARD = Card(
    record, figures, rows, (BEGIN, END), MISS,
    lambda found: ", ".join(f"{count} {kind}" for kind, count in found["kinds"].items()), "; ",
)  # fmt: skip
