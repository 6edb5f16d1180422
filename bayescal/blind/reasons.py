"""Why an answer missed, in a few words decided from truth and answer: the first of `REASONS` that holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from bayescal.blind.judge import CRASHED, FLAGGED, Record, false_names, leader, missing
from bayescal.effects import confusable

WEAK = 30.0
"""Lambda below which an effect is called weak: about half of these can be named at all."""


class Reason(NamedTuple):
    """A kind of miss."""

    title: str
    holds: Callable[[Record], bool]
    detail: Callable[[Record], str]


def reason(r: Record) -> tuple[str, str]:
    """The kind of miss and its detail; ("", "") where name and place are right."""
    found = next((k for k in REASONS if k.holds(r)), None)
    return ("", "") if found is None else (found.title, found.detail(r))


def mate(r: Record) -> tuple[str, str]:
    """A false name and the missing effect whose mate it is; ("", "") without."""
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
    Reason("false alarm: a name for nothing", lambda r: _null(r) and bool(r["named"]), _names),
    Reason(
        "false alarm: flagged without cause",
        lambda r: _null(r) and r["verdict"] in FLAGGED,
        lambda r: f"P(unknown) {_p(r, 'unknown')}",
    ),
    Reason(
        "nothing there, but not called nothing",
        lambda r: _null(r) and not r["right"],
        lambda r: f"P(null) {_p(r, 'null')}",
    ),
    Reason(
        "outside: named as something else",
        lambda r: _outside(r) and not r["right"] and bool(r["named"]),
        _names,
    ),
    Reason("outside: right flag, wrong place",
           lambda r: _outside(r) and r["right"] and not r["at_right_site"],
           lambda r: r["places"][0] if r["places"] else "no place"),
    Reason("outside: too weak to see", lambda r: _outside(r) and not r["right"] and r["lambda"] < WEAK,
           _sizes),
    Reason("outside: not flagged", lambda r: _outside(r) and not r["right"],
           lambda r: f"{_sizes(r)}, P(unknown) {_p(r, 'unknown')}"),
    Reason("its mate was named", lambda r: _hidden(r) and bool(mate(r)[0]), _mate_words),
    Reason("one name too many", lambda r: _hidden(r) and bool(false_names(r)) and not missing(r),
           lambda r: ", ".join(false_names(r))),
    Reason("wrong name", lambda r: _hidden(r) and bool(false_names(r)),
           lambda r: f"{', '.join(false_names(r))} for {_lost(r)}"),
    Reason("second effect weak", lambda r: _hidden(r) and bool(r["named"]) and 0 < _second(r) < WEAK, _lost),
    Reason("second effect missed", lambda r: _hidden(r) and bool(r["named"]) and bool(missing(r)), _lost),
    Reason("right, but something unexplained was added",
           lambda r: _hidden(r) and not missing(r) and r["verdict"] in FLAGGED,
           lambda r: f"P(unknown) {_p(r, 'unknown')}"),
    Reason("right, but called ambiguous", lambda r: _hidden(r) and not missing(r) and not r["right"], _names),
    Reason("flagged as unknown", lambda r: _hidden(r) and r["verdict"] in FLAGGED,
           lambda r: f"{_sizes(r)}, P(unknown) {_p(r, 'unknown')}"),
    Reason("right, but not sure enough",
           lambda r: _hidden(r) and leader(r) in missing(r) and r["probability"][leader(r)]
           > r["probability"].get("null", 0.0),
           lambda r: f"{leader(r)} P {_p(r, leader(r))}, {_sizes(r)}"),
    Reason("too weak to see", lambda r: _hidden(r) and bool(missing(r)) and _strongest(r) < WEAK, _sizes),
    Reason("not told from its mate", lambda r: _hidden(r) and bool(_mates([leader(r)], missing(r))[0]),
           lambda r: f"{leader(r)} P {_p(r, leader(r))}, {_sizes(r)}"),
    Reason("not seen", lambda r: _hidden(r) and bool(missing(r)), _sizes),
    Reason("right name, wrong place", lambda r: not all(r["named_at_right_site"].values()), _misplaced),
)  # fmt: skip
"""From the particular to the general; the first that holds is told."""


def _second(r: Record) -> float:
    """Lambda of the strongest effect that was left out beside a name, 0 where none was."""
    return _strongest(r) if missing(r) else 0.0
