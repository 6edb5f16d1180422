"""The score of a blind check: a record of every session, and the results of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from scipy.stats import binom

from analysis.blind.assessed import CRASHED, OTHERS, Record, false_names, record
from analysis.blind.forms import by_form
from analysis.blind.rates import BANDS, by_lambda, ends, mean, proportion, share
from analysis.blind.reasons import reason
from analysis.blind.shrunk import MEASURES, made_worse, predicted, shrunk, worse_beyond_noise
from analysis.blind.skill import log_score
from bayescal.errors import BayescalError

SCHEMA = "bayescal-blind-score/1"
KINDS = ("null", "single", "pair", "outside")
BINS = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
"""Edges of the bins of stated probabilities; smaller ones are not assessed."""
SURE, CERTAIN = 0.9, 0.98
SEEN, CLEAR, STRONG = 10.0, 30.0, 100.0
"""Lambda from which on an effect can be seen, must be named, and an effect not in the list is flagged."""


def records(truths: Mapping[str, dict], answers: Mapping[str, dict]) -> list[Record]:
    """Compare every answer with the ground truth of its session.

    Parameters
    ----------
    truths : Mapping of str to dict
        By session, as `analysis.world.build.build` returns them.
    answers : Mapping of str to dict
        By session: ``{"world", "seconds", "gap"}``, the gap as in gap.json, or ``{"world", "error"}``. A
        session without an answer counts as a crash.

    Raises
    ------
    BayescalError
        If an answer has no session, or lacks keys of gap.json.
    """
    strangers = sorted(set(answers) - set(truths))
    if strangers:
        raise BayescalError("an answer has no ground truth", f"session {strangers[0]}")
    out = []
    for name, truth in sorted(truths.items()):
        try:
            r = record(truth, answers.get(name))
        except KeyError as key:
            raise BayescalError(
                f"{key} is missing in the ground truth or the answer",
                f"session {name}",
                "run `python -m analysis.blind run` again",
            ) from None
        title, detail = reason(r)
        out.append(r | {"reason": title, "detail": detail})
    return out


def figures(records: Sequence[Record]) -> dict[str, Any]:
    """All results of a number of sessions.

    Returns
    -------
    dict
        Shares as ``{"count", "hits", "interval95"}`` (Wilson), lengths in µm, bands of lambda as lists.
    """
    of = {kind: [r for r in records if r["kind"] == kind] for kind in KINDS}
    hidden = of["single"] + of["pair"]
    sure = [r for r in records if r["verdict"] == "named" and _least(r) >= SURE]
    strong = [r for r in of["outside"] if r["lambda"] >= STRONG]
    clear = [r for r in of["pair"] if min(r["each"].values()) > CLEAR]
    places = [ok for r in records for ok in r["named_at_right_site"].values()]
    seconds = [r["seconds"] for r in records if r["seconds"] is not None]
    return {
        "schema": SCHEMA,
        "worlds": len(records),
        "kinds": {kind: len(own) for kind, own in of.items()},
        "crashed": {r["world"]: r["error"] for r in records if r["verdict"] == CRASHED},
        "seconds": {"median": _median(seconds), "most": max(seconds, default=None)},
        "null": {
            "named": share(of["null"], lambda r: bool(r["named"])),
            "right": share(of["null"], _right),
            "otherwise": share(of["null"], lambda r: not r["right"]),
        },
        "single": single(of["single"]),
        "each_of_two": by_lambda(
            (size, name in r["named"]) for r in of["pair"] for name, size in r["each"].items()
        ),
        "outside_flagged": by_lambda((r["lambda"], r["right"]) for r in of["outside"]),
        "first_place": by_lambda(
            (max(r["each"].values()), r["first_place_right"]) for r in records if r["each"]
        ),
        "sure": {
            "right": share(sure, _right),
            "right_seen": share([r for r in sure if min(r["each"].values(), default=inf) >= SEEN], _right),
            "names_true": share(sure, lambda r: not false_names(r)),
        },
        "certain": {
            "vocabulary": certain([r for r in records if r["kind"] != "outside"]),
            "outside": certain(of["outside"]),
        },
        "first_place_strong": share(
            [r for r in records if max(r["each"].values(), default=0.0) >= STRONG],
            lambda r: r["first_place_right"],
        ),
        "forms": by_form(hidden, CLEAR),
        "stages": {
            stage: share([r for r in records if r["stage"] == stage and _clear(r)], _right)
            for stage in ("spheres", "tracker")
        },
        "set": coverage(hidden) | {"size_all": mean(len(r["set"]) for r in records)},
        "set_clear": coverage([r for r in hidden if min(r["each"].values()) > CLEAR]),
        "pairs": {"all": pairs(of["pair"]), "clear": pairs(clear)},
        "outside": {
            "flagged": share(strong, _right),
            "right_site": share([r for r in strong if r["right"]], lambda r: r["at_right_site"]),
            "flagged_all": share(of["outside"], _right),
            "named_alone": share(of["outside"], lambda r: bool(r["named"]) and not r["right"]),
        },
        "named_place": proportion(sum(places), len(places)),
        "unnamed_place": share(
            [r for r in records if r["each"] and not r["named"]], lambda r: r["first_place_right"]
        ),
        "distances": shrunk(hidden, "distance_um"),
        "distances_clear": shrunk([r for r in hidden if r["lambda"] >= CLEAR], "distance_um"),
        "planes": shrunk(hidden, "plane_um"),
        "points": shrunk(hidden, "point_um"),
        "worse": {
            r["world"]: [r["distance_um"][k] for k in ("before", "after")] for r in records if made_worse(r)
        },
        "worse_beyond_noise": share([r for r in records if r["distance_um"]], worse_beyond_noise),
        "predicted": {what: predicted(records, what) for what in MEASURES},
        "reliability": reliability(records),
        "log_score": log_score(records) if records else None,
        "reasons": dict(Counter(r["reason"] for r in records if r["reason"]).most_common()),
        "misses": [miss(r) for r in records if r["reason"]],
    }


def single(records: Sequence[Record]) -> dict[str, Any]:
    """Single effects: by lambda, and over the two bands with a requirement."""
    return {
        "right": by_lambda((r["lambda"], r["right"]) for r in records),
        "wrong_name": by_lambda((r["lambda"], bool(false_names(r))) for r in records),
        "set_holds": by_lambda((r["lambda"], _holds(r)) for r in records),
        "set_size": [
            {"lambda": ends(band), "mean": mean(len(r["set"]) for r in records if _in(r["lambda"], band))}
            for band in BANDS
        ],
        "clear": share([r for r in records if _in(r["lambda"], (CLEAR, STRONG))], _right),
        "strong": share([r for r in records if r["lambda"] >= STRONG], _right),
    }


def coverage(records: Sequence[Record]) -> dict[str, Any]:
    """Coverage of the 90 % set, and its mean size."""
    return {"holds": share(records, _holds), "size": mean(len(r["set"]) for r in records)}


def pairs(records: Sequence[Record]) -> dict[str, Any]:
    """Recall and precision of the named effects."""
    found = sum(len(set(r["named"]) & set(r["effects"])) for r in records)
    return {
        "worlds": len(records),
        "recall": proportion(found, sum(len(r["effects"]) for r in records)),
        "precision": proportion(found, sum(len(r["named"]) for r in records)),
        "both": share(records, _right),
    }


def certain(records: Sequence[Record]) -> dict[str, Any]:
    """Effects with a probability of at least `CERTAIN`, and how many of them are present."""
    sure = [(r, name) for r in records for name, p in r["probability"].items()
            if p >= CERTAIN and name not in OTHERS]  # fmt: skip
    return proportion(sum(name in r["effects"] for r, name in sure), len(sure))


def reliability(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Stated probabilities of effects, noise only and unmodelled, with observed frequencies by bin.

    The band is binomial, for correct and independent stated probabilities.
    """
    statements = [(p, _holds_true(r, name)) for r in records for name, p in r["probability"].items()]
    out = []
    for low, high in pairwise(BINS):
        own = [s for s in statements if low <= s[0] < high or s[0] == high == BINS[-1]]
        if not own:
            continue
        said, held = np.mean(own, axis=0)
        band = np.asarray(binom.ppf([0.025, 0.975], len(own), min(said, 1.0))) / len(own)
        out.append(
            {
                "bin": [low, high],
                "count": len(own),
                "said": float(said),
                "held": float(held),
                "band95": band.tolist(),
            }
        )
    return out


def _holds_true(r: Record, name: str) -> bool:
    """Whether a named alternative is true; all effects not in the list of known effects are 'unknown'."""
    return r["kind"] == "null" if name == OTHERS[0] else name in r["effects"]


def miss(r: Record) -> dict[str, Any]:
    """An entry of the list of misses: ground truth, answer and reason."""
    ranked = sorted(r["probability"].items(), key=lambda item: -item[1])[:3]
    true = r["outside"] or " + ".join(r["effects"]) or "noise only"
    return {
        "world": r["world"],
        "kind": r["kind"],
        "truth": true,
        "acts_at": "; ".join(r["true_places"].values()),
        "lambda": ", ".join(f"{size:.0f}" for size in r["each"].values()),
        "verdict": r["verdict"],
        "named": " + ".join(r["named"]),
        "leaders": ", ".join(f"{name} {p:.2f}" for name, p in ranked),
        "left_at": r["places"][0] if r["places"] else "",
        "reason": r["reason"],
        "detail": r["detail"],
    }


def _right(r: Record) -> bool:
    return bool(r["right"])


def _clear(r: Record) -> bool:
    return not r["each"] or min(r["each"].values()) >= CLEAR


def _least(r: Record) -> float:
    return min((r["probability"][name] for name in r["named"]), default=0.0)


def _holds(r: Record) -> bool:
    return set(r["effects"]) <= set(r["set"])


def _in(size: float, band: tuple[float, float]) -> bool:
    return band[0] <= size < band[1]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
