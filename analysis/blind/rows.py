"""The criteria of a score as rows of text with their required values, for terminal and page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from analysis.blind.rates import BANDS, proportion, value
from analysis.blind.score import CERTAIN, CLEAR, SEEN, STRONG, SURE

Found = Mapping[str, Any]
NONE = "-"
SHOWN = 2
"""Maximum number of sessions that are listed in a row; the others are counted."""


class Row(NamedTuple):
    """A criterion as text and whether it is met; None without a requirement or without cases."""

    label: str
    found: str
    wanted: str = ""
    met: bool | None = None


def rows(f: Found) -> list[Row]:
    """All criteria that are a single number."""
    single, pair, clear, out = f["single"], f["pairs"]["all"], f["pairs"]["clear"], f["outside"]
    d, planes, points = f["distances"], f["planes"], f["points"]
    return [
        _at_least(f"named with P from {SURE:g}: exactly right", f["sure"]["right"], 0.96),
        _at_least(f"the same, where every lambda is from {SEEN:g}", f["sure"]["right_seen"], 0.96),
        _at_least(f"effects of P from {CERTAIN:g}: present", f["certain"]["vocabulary"], 0.98),
        _at_most("the same, cause outside: claims", _claims(f["certain"]["outside"]), 0.0),
        _at_least(f"one effect, lambda over {STRONG:g}: correct", single["strong"], 0.98),
        _at_least(f"one effect, lambda {CLEAR:g} to {STRONG:g}: correct", single["clear"], 0.90),
        _at_least(f"outside, lambda from {STRONG:g}: flagged", out["flagged"], 0.90),
        _at_least(f"first location, lambda from {STRONG:g}", f["first_place_strong"], 0.95),
        _at_most("noise only: called otherwise", f["null"]["otherwise"], 0.02),
        _at_most("noise only: an effect was named", f["null"]["named"], 0.02),
        _at_most("distances worse beyond noise", f["worse_beyond_noise"], 0.03),
        _at_least(f"first form, lambda from {CLEAR:g}: correct", f["forms"]["first"], 0.90),
        _at_least("another form likewise", f["forms"]["further"], 0.90),
        *_stages(f["stages"]),
        Row("named likewise: no false name", of(f["sure"]["names_true"])),
        _at_least("90 % set contains all effects", f["set"]["holds"], 0.87),
        _under(
            "mean size of the set", f["set"]["size"], 5.0, f"{number(f['set']['size_all'])} over all sessions"
        ),
        _at_least(f"two effects, {pair['worlds']} sessions: recall", pair["recall"], 0.93),
        _at_least("the same: precision", pair["precision"], 0.97),
        _at_least(f"both lambda over {CLEAR:g}, {clear['worlds']} sessions: recall", clear["recall"], 0.93),
        _at_least("the same: precision", clear["precision"], 0.97),
        _at_least("outside, flagged: correct site", out["right_site"], 0.95),
        Row("outside, all: named and not flagged", of(out["named_alone"])),
        Row("named: first location correct", of(f["named_place"])),
        Row("not named: first location correct", of(f["unnamed_place"])),
        _closed(f"distances, {d['count']} named sessions: excess removed", d),
        _closed(f"the same, lambda from {CLEAR:g}", f["distances_clear"]),
        _worse(f["worse"]),
        _near("distances: RMS after refit / true model", d),
        _near("planes: RMS after refit / true model", planes),
        *([_near("points: RMS after refit / true model", points)] if points["count"] else []),
        *(_predicted(what, s) for what, s in f["predicted"].items() if s["count"] or what != "points"),
        _log_score(f["log_score"]),
        Row("seconds per session, median and maximum", f"{number(f['seconds']['median'])}, {_most(f)}"),
        Row("crashes", listed([f"{w}: {e}" for w, e in f["crashed"].items()]), "none", not f["crashed"]),
    ]


def by_form(f: Found) -> list[tuple[str, str, str]]:
    """Rows of effect, form, and the share of sessions of lambda from `CLEAR` in which it was named."""
    return [(name, form, of(s)) for name, forms in f["forms"]["effects"].items() for form, s in forms.items()]


def _stages(stages: Found) -> list[Row]:
    """Sessions that are not on the cube: noise only, or with a clear effect."""
    labels = {"spheres": "spheres alone", "tracker": "tracker"}
    return [
        _at_least(f"{labels[stage]}, lambda 0 or from {CLEAR:g}: correct", s, 0.90)
        for stage, s in stages.items() if s["count"]
    ]  # fmt: skip


def _claims(s: Found) -> Found:
    """The statements that are not true, as a share of those that were made."""
    return proportion(s["count"] - s["hits"], s["count"])


def by_lambda(f: Found) -> list[tuple[str, list[str]]]:
    """Rows of shares, a cell per band of lambda."""
    single = f["single"]
    return [
        ("one effect: sessions", [str(b["count"]) for b in single["right"]]),
        ("correct", _cells(single["right"])),
        ("95 % interval", [_ends(s) for s in single["right"]]),
        ("a false name", _cells(single["wrong_name"])),
        ("90 % set contains it", _cells(single["set_holds"])),
        ("mean size of the set", [number(b["mean"]) for b in single["set_size"]]),
        ("two effects: each named", _cells(f["each_of_two"], counts=True)),
        ("outside: flagged", _cells(f["outside_flagged"], counts=True)),
        ("first location correct, all", _cells(f["first_place"], counts=True)),
    ]


def bands() -> list[str]:
    """The bands of lambda as text."""
    return [
        f"over {low:g}" if high == BANDS[-1][1] else f"{low:g} to {high:g}" if low else f"under {high:g}"
        for low, high in BANDS
    ]


def _cells(shares: Sequence[Found], counts: bool = False) -> list[str]:
    return [
        (f"{percent(value(s))} of {s['count']}" if counts else percent(value(s))) if s["count"] else NONE
        for s in shares
    ]


def _ends(s: Found) -> str:
    return "{:.0f}-{:.0f} %".format(*(100 * end for end in s["interval95"])) if s["count"] else NONE


def of(s: Found) -> str:
    """'12 of 13, 92 % (67 to 99)'."""
    if not s["count"]:
        return "no cases"
    low, high = (f"{100 * end:.0f}" for end in s["interval95"])
    return f"{s['hits']} of {s['count']}, {percent(value(s))} ({low} to {high})"


def percent(share: float | None) -> str:
    """A fraction in per cent."""
    return NONE if share is None else f"{100 * share:.0f} %"


def number(x: float | None, digits: int = 1) -> str:
    """A number, or a dash."""
    return NONE if x is None else f"{x:.{digits}f}"


def listed(words: Sequence[str]) -> str:
    """The first few of many, and how many more."""
    more = f" and {len(words) - SHOWN} more" if len(words) > SHOWN else ""
    return "; ".join(words[:SHOWN]) + more if words else "none"


def _share(label: str, s: Found, wanted: str, good: Callable[[float], bool]) -> Row:
    share = value(s)
    return Row(label, of(s), wanted, None if share is None else good(share))


def _at_least(label: str, s: Found, least: float) -> Row:
    return _share(label, s, f"at least {100 * least:.0f} %", lambda share: share >= least)


def _at_most(label: str, s: Found, most: float) -> Row:
    return _share(label, s, f"at most {100 * most:.0f} %", lambda share: share <= most)


def _under(label: str, x: float | None, most: float, more: str) -> Row:
    return Row(label, f"{number(x)} ({more})", f"under {most:g}", None if x is None else x < most)


def _closed(label: str, s: Found) -> Row:
    share, wanted = s["closed"], "at least 95 %"
    if share is None:
        return Row(label, NONE, wanted)
    lengths = f"{s['before_um']:.1f} to {s['after_um']:.1f}, true model {s['floor_um']:.1f} µm"
    return Row(label, f"{percent(share)} ({lengths})", wanted, share >= 0.95)


def _worse(worse: Found) -> Row:
    names = [f"{world}: x {new / old:.2f}" for world, (old, new) in worse.items()]
    text = f"{len(names)} ({listed(names)})" if names else "none"
    return Row("distances worse by more than 5 %", text, "none", not names)


def _near(label: str, s: Found) -> Row:
    if s["ratio"] is None:
        return Row(label, NONE, "at most 1.15")
    exact = "" if s["ratio_right"] is None else f", {s['ratio_right']:.2f} where correct"
    text = f"{s['ratio']:.2f}, median {s['ratio_median']:.2f}{exact}"
    return Row(label, text, "at most 1.15", s["ratio"] <= 1.15)


def _predicted(what: str, s: Found) -> Row:
    label = f"{what}: achieved / predicted reduction"
    if not s["count"]:
        return Row(label, NONE)
    near, going = percent(s["near"]), number(s["correlation"], 2)
    return Row(label, f"{s['median']:.2f}, {near} within 1.3 x, r {going}")


def _log_score(s: Found | None) -> Row:
    label = "log score: mean ln P(truth), nats"
    if s is None:
        return Row(label, NONE)
    text = f"{s['mean']:.2f}, base rates {s['base']:.2f}"
    return Row(label, text, "above base rates", s["mean"] > s["base"])


def _most(f: Found) -> str:
    return number(f["seconds"]["most"])
