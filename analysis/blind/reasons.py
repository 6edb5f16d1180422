"""The reason of a miss, from ground truth and answer: the first of `REASONS` that applies."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from analysis.blind.assessed import CRASHED, FLAGGED, Record, false_names, leader, missing
from bayescal.effects import confusable

WEAK = 30.0
"""Lambda below which an effect is weak: about half of such effects can be named."""


class Reason(NamedTuple):
    """A kind of miss: title, condition and detail."""

    title: str
    holds: Callable[[Record], bool]
    detail: Callable[[Record], str]


def reason(r: Record) -> tuple[str, str]:
    """The kind of miss and its detail; ("", "") where name and location are correct."""
    found = next((k for k in REASONS if k.holds(r)), None)
    return ("", "") if found is None else (found.title, found.detail(r))


def mate(r: Record) -> tuple[str, str]:
    """A false name and the missing effect that it is confusable with; ("", "") without."""
    return _mates(false_names(r), missing(r))


def _mates(said: list[str], true: list[str]) -> tuple[str, str]:
    pairs = ((a, b) for a in said for b in true if confusable(a, b))
    return next(pairs, ("", ""))


def _mate_words(r: Record) -> str:
    said, true = mate(r)
    at, acts = (places.get(name, "").partition(",")[0] for places, name in
                ((r["named_places"], said), (r["true_places"], true)))  # fmt: skip
    same = f"same {at.split()[0]}: " if at and at == acts else ""
    return f"{same}{said} for {true}"


def _hidden(r: Record) -> bool:
    return r["kind"] in ("single", "pair")


def _outside(r: Record) -> bool:
    return r["kind"] == "outside"


def _null(r: Record) -> bool:
    return r["kind"] == "null"


def _strongest(r: Record) -> float:
    return max((r["each"][name] for name in missing(r) if name in r["each"]), default=r["lambda"])


def _sizes(r: Record) -> str:
    return f"lambda {', '.join(f'{size:.0f}' for size in r['each'].values()) or 0}"


def _lost(r: Record) -> str:
    return ", ".join(f"{name}, lambda {r['each'][name]:.0f}" for name in missing(r))


def _names(r: Record) -> str:
    return " + ".join(f"{name} (P {_p(r, name)})" for name in r["named"])


def _p(r: Record, name: str) -> str:
    return f"{r['probability'].get(name, 0.0):.2f}"


def _misplaced(r: Record) -> str:
    wrong = [name for name, ok in r["named_at_right_site"].items() if not ok]
    return "; ".join(f"{n} at {r['named_places'][n]}, acts at {r['true_places'][n]}" for n in wrong)


REASONS = (
    Reason("crashed", lambda r: r["verdict"] == CRASHED, lambda r: r["error"]),
    Reason("false alarm: effect named", lambda r: _null(r) and bool(r["named"]), _names),
    Reason(
        "false alarm: flagged",
        lambda r: _null(r) and r["verdict"] in FLAGGED,
        lambda r: f"P(unknown) {_p(r, 'unknown')}",
    ),
    Reason(
        "noise only, but ambiguous",
        lambda r: _null(r) and not r["right"],
        lambda r: f"P(null) {_p(r, 'null')}",
    ),
    Reason(
        "outside: named as an effect",
        lambda r: _outside(r) and not r["right"] and bool(r["named"]),
        _names,
    ),
    Reason("outside: flagged, wrong location",
           lambda r: _outside(r) and r["right"] and not r["at_right_site"],
           lambda r: r["places"][0] if r["places"] else "no location"),
    Reason("outside: too weak", lambda r: _outside(r) and not r["right"] and r["lambda"] < WEAK,
           _sizes),
    Reason("outside: not flagged", lambda r: _outside(r) and not r["right"],
           lambda r: f"{_sizes(r)}, P(unknown) {_p(r, 'unknown')}"),
    Reason("a confusable effect was named", lambda r: _hidden(r) and bool(mate(r)[0]), _mate_words),
    Reason("additional false name", lambda r: _hidden(r) and bool(false_names(r)) and not missing(r),
           lambda r: ", ".join(false_names(r))),
    Reason("false name", lambda r: _hidden(r) and bool(false_names(r)),
           lambda r: f"{', '.join(false_names(r))} for {_lost(r)}"),
    Reason("second effect weak", lambda r: _hidden(r) and bool(r["named"]) and 0 < _second(r) < WEAK, _lost),
    Reason("second effect missed", lambda r: _hidden(r) and bool(r["named"]) and bool(missing(r)), _lost),
    Reason("correct, but also flagged as unmodelled",
           lambda r: _hidden(r) and not missing(r) and r["verdict"] in FLAGGED,
           lambda r: f"P(unknown) {_p(r, 'unknown')}"),
    Reason("correct, but ambiguous", lambda r: _hidden(r) and not missing(r) and not r["right"], _names),
    Reason("flagged as unmodelled", lambda r: _hidden(r) and r["verdict"] in FLAGGED,
           lambda r: f"{_sizes(r)}, P(unknown) {_p(r, 'unknown')}"),
    Reason("leading effect correct, probability too low",
           lambda r: _hidden(r) and leader(r) in missing(r) and r["probability"][leader(r)]
           > r["probability"].get("null", 0.0),
           lambda r: f"{leader(r)} P {_p(r, leader(r))}, {_sizes(r)}"),
    Reason("too weak", lambda r: _hidden(r) and bool(missing(r)) and _strongest(r) < WEAK, _sizes),
    Reason("not distinguished from a confusable effect",
           lambda r: _hidden(r) and bool(_mates([leader(r)], missing(r))[0]),
           lambda r: f"{leader(r)} P {_p(r, leader(r))}, {_sizes(r)}"),
    Reason("not detected", lambda r: _hidden(r) and bool(missing(r)), _sizes),
    Reason("correct name, wrong location", lambda r: not all(r["named_at_right_site"].values()), _misplaced),
)  # fmt: skip
"""Ordered from specific to general; the first that applies is reported."""


def _second(r: Record) -> float:
    """Lambda of the strongest effect that was missed in addition to a named effect, else 0."""
    return _strongest(r) if missing(r) else 0.0
