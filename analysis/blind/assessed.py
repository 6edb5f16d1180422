"""The answer to one session compared with its ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

FLAGGED = ("unknown", "named+unexplained", "class")
"""Verdicts that flag an unmodelled effect."""
CRASHED = "crashed"
COMPLIANCE = "compliance"
FIRST = "first"
"""The form of an effect for which the ground truth states none."""
OTHERS = ("null", "unknown")
"""Names with a stated probability that are not effects."""

Record = dict[str, Any]


def record(truth: Mapping[str, Any], answer: Mapping[str, Any] | None) -> Record:
    """The answer to one session and its ground truth; lengths in µm.

    Parameters
    ----------
    truth : Mapping
        As `analysis.world.build.build` returns it.
    answer : Mapping or None
        ``world``, ``seconds`` and ``gap`` (the contents of gap.json), or ``error`` for a crash; None is one.
    """
    out: Record = {
        "world": truth["world"],
        "kind": truth["kind"],
        "effects": list(truth["effects"]),
        "outside": truth.get("outside"),
        "lambda": float(truth["lambda"]["value"]),
        "each": {name: float(size) for name, size in truth["lambda"]["each"].items()},
        "true_places": _acts(truth["where"]),
        "stage": truth.get("session", {}).get("stage", "cube"),
        "forms": dict.fromkeys(truth["effects"], FIRST) | truth.get("form", {}),
    }
    gap = (answer or {"error": "no answer"}).get("gap")
    out |= _silence(answer) if gap is None or answer is None else _said(gap, truth, answer)
    return out | {"right": right(out)}


def _acts(where: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Where every effect acts, as text: the first location of each, and the number of others."""
    places: dict[str, list[str]] = {}
    for w in where:
        places.setdefault(w["effect"], []).append(_words(w))
    return {
        name: own[0] + (f", and {len(own) - 1} more" if len(own) > 1 else "") for name, own in places.items()
    }


def _silence(answer: Mapping[str, Any] | None) -> Record:
    """A session without a diagnosis counts as incorrect in every respect."""
    return {
        "verdict": CRASHED,
        "error": str((answer or {}).get("error", "no answer")),
        "named": [],
        "probability": {},
        "sets": [],
        "set": [],
        "places": [],
        "named_places": {},
        "named_at_right_site": {},
        "at_right_site": False,
        "first_place_right": False,
        "distance_um": None,
        "plane_um": None,
        "point_um": None,
        "seconds": None,
    }


def _said(gap: Mapping[str, Any], truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Record:
    named = list(dict.fromkeys(n["effect"] for n in gap["named"]))
    left = [p for p in gap["where"] if not p["explained_by"]]
    of_name = {name: next((p for p in gap["where"] if p["explained_by"] == name), None) for name in named}
    first = [p for p in of_name.values() if p] if named else left[:1]
    return {
        "verdict": gap["verdict"],
        "error": None,
        "named": named,
        "probability": {name: float(p) for name, p in gap["probability"].items()},
        "sets": _sets(gap, named),
        "set": list(gap["credible_set90"]),
        "places": [_words(p) for p in left[:2]],
        "named_places": {name: _words(p) for name, p in of_name.items() if p},
        "named_at_right_site": {
            name: meets(p, own)
            for name, p in of_name.items()
            if p and (own := [w for w in truth["where"] if w["effect"] == name])
        },
        "at_right_site": bool(left) and meets(left[0], truth["where"]),
        "first_place_right": bool(first) and meets(first[0], truth["where"]),
        "distance_um": _distances(gap, float(truth["distance_rms_um"]["fit_without_effect"])),
        "plane_um": _planes(gap, float(truth["noise_um"])),
        "point_um": _points(gap, truth),
        "seconds": float(answer["seconds"]),
    }


def _sets(gap: Mapping[str, Any], named: Sequence[str]) -> list[tuple[list[str], float]]:
    """Sets of effects with their stated probabilities.

    If a diagnosis added compliance to the model, all of its sets contain compliance, and their probabilities
    are multiplied by that of compliance.
    """
    sets = [(list(h["effects"]), float(h["probability"])) for h in gap["hypotheses"]]
    promoted = COMPLIANCE in named and COMPLIANCE not in gap["baseline"]
    if promoted and not any(COMPLIANCE in names for names, _ in sets):
        sure = float(gap["probability"][COMPLIANCE])
        return [([COMPLIANCE, *names], sure * p) for names, p in sets]
    return sets


def _words(place: Mapping[str, Any]) -> str:
    return f"{place['site']}, {place['driver']}"


def meets(place: Mapping[str, Any], where: Iterable[Mapping[str, Any]]) -> bool:
    """Whether a location is among those of the ground truth; time may also be given by a driver."""
    for w in where:
        words = [w["site"], *w.get("also", [])]
        if any(word == place["site"] or word in place["site"] for word in words):
            return True
        if w["site"] == "time" and any(word in place["driver"] for word in words):
            return True
    return False


def _distances(gap: Mapping[str, Any], floor: float) -> dict[str, float | None] | None:
    """Sphere distances before and after the refit, measured and predicted; as measured without one."""
    found = _measure(gap, "distances", floor)
    if found is not None:
        return found
    measured = (m["rms_um"] for m in gap["gap"]["measured"] if m["what"] == "sphere distances")
    rms = next(measured, None)
    if rms is None:
        return None
    return {"before": rms, "after": rms, "floor": floor, "predicted_before": None, "predicted_after": None,
            "count": None}  # fmt: skip


def _planes(gap: Mapping[str, Any], noise: float) -> dict[str, float | None] | None:
    """Validation planes likewise; the error of the true model uses the true noise."""
    found = _measure(gap, "planes", 0.0)
    if found is None:
        return None
    by_parameters = max(gap["shrinkage"]["planes"]["floor_um"] ** 2 - gap["gap"]["noise_um"] ** 2, 0.0)
    return found | {"floor": float(np.sqrt(noise**2 + by_parameters))}


def _points(gap: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, float | None] | None:
    """A coordinate of validation points likewise; where a tracker read them."""
    true = truth.get("point_rms_um")
    return _measure(gap, "points", float(true["fit_without_effect"])) if true else None


def _measure(gap: Mapping[str, Any], what: str, floor: float) -> dict[str, float | None] | None:
    s = gap["shrinkage"].get(what)
    if s is None:
        return None
    return {
        "before": s["before_rms_um"],
        "after": s["after_rms_um"],
        "floor": floor,
        "predicted_before": s.get("predicted_before_rms_um"),
        "predicted_after": s.get("predicted_rms_um"),
        "count": s.get("count"),
    }


def right(r: Record) -> bool:
    """Whether a verdict names exactly the effects of the ground truth."""
    if r["kind"] == "outside":
        return r["verdict"] in FLAGGED
    if r["kind"] == "null":
        return r["verdict"] == "null"
    return r["verdict"] == "named" and set(r["named"]) == set(r["effects"])


def missing(r: Record) -> list[str]:
    """Effects that are present and were not named."""
    return [name for name in r["effects"] if name not in r["named"]]


def false_names(r: Record) -> list[str]:
    """Named effects that are not present."""
    return [name for name in r["named"] if name not in r["effects"]]


def leader(r: Record) -> str:
    """The effect of the largest stated probability, "" where none is stated."""
    effects = {name: p for name, p in r["probability"].items() if name not in OTHERS}
    return max(effects, key=lambda name: effects[name], default="")
