"""The score of a blind check of joint logs: each answer beside its ground truth, and the criteria."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf, sqrt
from typing import Any

import numpy as np

from analysis.blind.card import KINDS, Card
from analysis.blind.files import HEADINGS
from analysis.blind.rates import proportion, value
from analysis.blind.rows import NONE, Row, of

BEGIN, END = "<!-- blind motions: begin -->", "<!-- blind motions: end -->"
SURE, STRONG = 0.9, 100.0
"""Probability from which a name must be right, and lambda from which an effect must be found."""
BANDS = ((0.0, 30.0, 0.3), (30.0, 100.0, 0.7), (100.0, inf, 0.92))
"""Bands of lambda, and the required share of single effects that are named exactly."""
CRASHED, FLAGGED = "crash", ("unknown", "named+unexplained")
"""Verdict of a log without an answer; verdicts that state an unmodelled cause."""
MISS = {
    "world": "log",
    "truth": "truth",
    "acts_at": "at",
    "lambda": "lambda",
    "verdict": "verdict",
    "named": "named",
    "leaders": "probability",
    "left_at": "first location",
    "detail": "detail",
}
"""Fields of a miss, and their columns on the page."""
LARGEST_CLASS = 4
"""Effects of a class that counts as partly right."""
Record = dict[str, Any]


def probability(stated: Mapping[str, float | None], names: Sequence[str]) -> float:
    """The stated probability of names together, else the smallest of theirs."""
    for key, p in stated.items():
        if set(key.split("+")) == set(names):
            return p or 0.0
    return min((stated.get(name) or 0.0 for name in names), default=0.0)


def record(truth: Mapping[str, Any], answer: Mapping[str, Any] | None) -> Record:
    """Compare an answer with the ground truth of its log.

    Parameters
    ----------
    truth : Mapping
        As `analysis.world.motion.build.make` returns it.
    answer : Mapping, optional
        ``{"gap": ...}`` as in gap.json, or ``{"error": ...}``; none is a crash.

    Returns
    -------
    dict
        ``excess`` is the mean square of the torque error over that of the true model, before and after,
        and of the simulator's fit of the baseline.
    """
    gap: Mapping[str, Any] = (answer or {}).get("gap") or {"verdict": CRASHED}
    kind, verdict, named = truth["kind"], gap["verdict"], list(gap.get("effects") or [])
    members = set((gap.get("class") or {}).get("members") or {})
    true = ["null"] if kind == "null" else list(truth["effects"])
    flagged = verdict in FLAGGED or (verdict == "class" and "other" in members)
    exact = {"null": verdict == "null", "outside": flagged}.get(
        kind, verdict == "named" and set(named) == set(true)
    )
    some = bool(named) and verdict.startswith("named") and set(named) <= set(true)
    some |= verdict == "class" and len(members) <= LARGEST_CLASS and bool(members & set(true))
    first = [w["site"] for w in (gap.get("where") or [])[:1]]
    rms, own = gap.get("torque_rms_Nm") or {}, truth["torque_rms_Nm"]

    def over(values: Sequence[float]) -> float:
        return float(np.mean((np.array(values) / own["oracle"]) ** 2))

    return {
        "world": truth["world"], "kind": kind, "truth": truth["outside"] or "+".join(true),
        "lambda": truth["lambda"]["value"], "verdict": verdict, "named": named, "exact": exact,
        "partly": exact or (kind in ("single", "pair") and some),
        "probability": probability(gap.get("probability") or {}, named) if named else None,
        "set_holds": set(true) <= set("+".join(gap.get("credible_set90", [])).split("+")),
        "site": first[0] if first else None,
        "site_right": first[0] in {w["site"] for w in truth["where"]} if first else False,
        "acts_at": ", ".join(w["site"] for w in truth["where"]),
        "excess": {k: over(v) for k, v in ({"baseline": own["baseline"]} | rms).items()},
        "error": (answer or {}).get("error"),
        "seconds": (answer or {}).get("seconds"),
    }  # fmt: skip


def figures(records: Sequence[Record]) -> dict[str, Any]:
    """All results of a number of logs: shares as in `rates.share`, and the torque errors."""
    of_kind = {kind: [r for r in records if r["kind"] == kind] for kind in KINDS}

    def part(chosen: Sequence[Record], hit: Callable[[Record], bool]) -> dict[str, Any]:
        return proportion(sum(bool(hit(r)) for r in chosen), len(chosen))

    def banded(kind: str, key: str) -> list[dict[str, Any]]:
        return [
            part([r for r in of_kind[kind] if low <= r["lambda"] < high], lambda r: r[key])
            for low, high, _ in BANDS
        ]

    sure = [r for r in records if r["verdict"] == "named" and (r["probability"] or 0.0) >= SURE]
    hidden, strong = of_kind["single"] + of_kind["pair"], [r for r in records if r["lambda"] >= STRONG]
    outside = of_kind["outside"]
    return {
        "schema": "bayescal-blind-motions/1",
        "worlds": len(records),
        "kinds": {kind: len(own) for kind, own in of_kind.items()},
        "null_named": part(of_kind["null"], lambda r: r["verdict"].startswith("named")),
        "null_otherwise": part(of_kind["null"], lambda r: not r["exact"]),
        "sure": part(sure, lambda r: r["exact"]),
        "exact": {kind: banded(kind, "exact") for kind in ("single", "pair", "outside")},
        "partly": {kind: banded(kind, "partly") for kind in ("single", "pair")},
        "pairs": part(of_kind["pair"], lambda r: r["exact"]),
        "pairs_partly": part(of_kind["pair"], lambda r: r["partly"]),
        "flagged": part([r for r in outside if r["lambda"] >= STRONG], lambda r: r["exact"]),
        "named_alone": part(outside, lambda r: r["verdict"] == "named"),
        "site": part(strong, lambda r: r["site_right"]),
        "set_holds": part(records, lambda r: r["set_holds"]),
        "closed": {kind: _closed(of_kind[kind]) for kind in ("single", "pair")} | {"all": _closed(hidden)},
        "floor": {what: _over(of_kind["null"], what) for what in ("before", "after", "baseline")},
        "seconds": float(np.median([r["seconds"] for r in records if r["seconds"]] or [0.0])),
        "crashed": {r["world"]: r["error"] or "no answer" for r in records if r["verdict"] == CRASHED},
        "misses": [_miss(r) for r in records if not r["exact"]],
    }  # fmt: skip


def _over(records: Sequence[Record], what: str) -> float | None:
    """RMS of the torque over that of the true model; None without cases."""
    every = [r["excess"][what] for r in records if what in r["excess"]]
    return sqrt(float(np.mean(every))) if every else None


def _closed(records: Sequence[Record]) -> float | None:
    """Share of the excess mean square over the true model that an answer removes; None without excess."""
    before, after = _over(records, "before"), _over(records, "after")
    if before is None or after is None or before <= 1:
        return None
    return 1 - max(0.0, after**2 - 1) / (before**2 - 1)


def _miss(r: Record) -> dict[str, Any]:
    own = {key: r[key] for key in ("world", "kind", "truth", "acts_at", "verdict")}
    return own | {
        "lambda": round(r["lambda"], 1),
        "named": "+".join(r["named"]),
        "left_at": r["site"] or "",
        "leaders": "" if r["probability"] is None else f"P {r['probability']:.2f}",
        "detail": r["error"] or "",
    }


def need(label: str, share: Mapping[str, Any], least: float | None = None, most: float | None = None) -> Row:
    """A share that must be at least, or at most, a number."""
    found = value(share)
    wanted = f">= {least:g}" if least is not None else f"<= {most:g}" if most is not None else ""
    if not wanted:
        return Row(label, of(share))
    if found is None:
        return Row(label, NONE, wanted)
    return Row(label, of(share), wanted, found >= least if least is not None else found <= (most or 0.0))


def rows(f: Mapping[str, Any]) -> list[Row]:
    """The criteria, with what is required."""
    bands = ["lambda < 30", "30 to 100", ">= 100"]
    single = zip(bands, f["exact"]["single"], BANDS, strict=True)
    closed, floor, crashed = f["closed"]["all"], f["floor"]["after"], f["crashed"]
    text = lambda x: NONE if x is None else f"{x:.3f}"  # noqa: E731
    optimum = f"{text(floor)} (known noise {text(f['floor']['baseline'])})"
    each = ", ".join(f"{kind} {text(f['closed'][kind])}" for kind in ("single", "pair"))
    return [
        need("noise only: an effect was named", f["null_named"], most=0.03),
        need("noise only: called otherwise", f["null_otherwise"], most=0.08),
        need(f"named with P from {SURE:g}: exactly right", f["sure"], least=0.95),
        *(need(f"one effect, {label}: exact", s, least=wanted) for label, s, (_, _, wanted) in single),
        need("two effects: exact", f["pairs"], least=0.7),
        need("two effects: exact or partly", f["pairs_partly"], least=0.95),
        need(f"outside, lambda from {STRONG:g}: flagged", f["flagged"], least=0.8),
        need("outside: named alone", f["named_alone"], most=0.05),
        need(f"location, lambda from {STRONG:g}: right", f["site"], least=0.9),
        Row("torque gap closed", f"{text(closed)} ({each})", ">= 0.9", closed and closed >= 0.9),
        Row("noise only: torque RMS over the true model", optimum, "<= 1.02", floor and floor <= 1.02),
        Row("90 % set contains the truth", of(f["set_holds"])),
        Row("seconds per log, median", f"{f['seconds']:.1f}"),
        Row("crashes", "; ".join(f"{w}: {e}" for w, e in crashed.items()) or "none", "none", not crashed),
    ]


CARD = Card(record, figures, rows, (BEGIN, END), MISS, written=HEADINGS)
