"""The page of the knock-outs: its tables, and a rule that says why something was not named."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from statistics import median
from typing import Any

from analysis.pages import table as markdown
from bayescal.gap.settings import SEARCH

MARKS = "<!-- knock-out: begin -->", "<!-- knock-out: end -->"
SEEN = 30.0
"""Lambda from which on an effect is named more often than not."""
MISSED = 1.02
"""Factor on the validation error of the complete model from which on a part has an effect there."""
MANY = 2.0
"""Factor on the error of the complete model from which on evidence is compared with what is possible."""
Record = dict[str, Any]


def right(r: Record) -> bool:
    """Whether what was taken out was named, at its site."""
    effect, _, site = r["without"].partition(" at ")
    return any(n["effect"] == effect and n["site"] in (site, "") for n in r["named"])


def main_kind(r: Record) -> Record:
    """Validation errors of contacts where there are any, else of points."""
    held = r["validation"]
    return held.get("planes") or held["points"]


def _said(r: Record, words: str) -> bool:
    effect = r["without"].partition(" at ")[0]
    return any(note.startswith(f"{effect}{words}") for note in r["footnotes"])


RULES: dict[str, Callable[[Record], bool]] = {
    "not detectable": lambda r: bool(r["missing"]) or r["lambda"] < SEEN,
    "not named: it increased validation errors": lambda r: _said(r, " explains"),
    "a footnote in addition to larger effects": lambda r: _said(r, ": "),
    "an unmodelled effect has more evidence than possible": lambda r: (
        main_kind(r)["before_um"] > MANY * main_kind(r)["whole_um"] and r["claimed_nats"] > r["possible_nats"]
    ),
    "no effect on validation errors": lambda r: main_kind(r)["before_um"] < MISSED * main_kind(r)["whole_um"],
    "other effects explain it, on validation measurements too": lambda r: (
        bool(r["named"]) and main_kind(r)["after_um"] < MISSED * main_kind(r)["whole_um"]
    ),
    "other effects are preferred": lambda r: bool(r["named"]),
    f"{SEARCH.largest} other effects, the maximum of a set, explain more": lambda r: (
        len(set(r["leading"]) - {"unknown"}) == SEARCH.largest
    ),
    "attributed to an unmodelled effect": lambda r: r["verdict"] == "unknown",
}
"""Why something was not named: the first rule that holds."""


def why(r: Record) -> str:
    """In words, why what was taken out was not named; "" where it was."""
    if right(r):
        return ""
    return next((words for words, holds in RULES.items() if holds(r)), "not decided")


def table(records: Sequence[Record]) -> str:
    """All tables, as Markdown, of the records of whole models and of what was taken out."""
    models = [r for r in records if not r["without"]]
    again = {(r["session"], r["without"]): r for r in records if r.get("beside")}
    first = [r for r in records if r["without"] and not r["beside"]]
    parts = (_summary(first, again), *_knocked(first, again), _levels(models), _left(models))
    return "\n\n".join(parts)


def _summary(first: Sequence[Record], again: dict[tuple[str, str], Record]) -> str:
    seen = [r for r in first if r["lambda"] >= SEEN and not r["missing"]]
    missed = [r for r in seen if main_kind(r)["before_um"] >= MISSED * main_kind(r)["whole_um"]]

    def count(some: Sequence[Record]) -> str:
        named = sum(map(right, some))
        more = sum(not right(r) and (r["session"], r["without"]) in again
                   and right(again[r["session"], r["without"]]) for r in some)  # fmt: skip
        return f"{named} of {len(some)} named, {more} more with the other effects in the model"

    return "\n".join(
        [
            f"- all parts: {count(first)};",
            f"- of these, detectable in the fitted measurements (lambda from {SEEN:.0f}): {count(seen)};",
            "- of these, with an effect on validation measurements "
            f"(error {100 * (MISSED - 1):.0f} % larger): {count(missed)};",
            _foreseen([r for r in first if right(r)]),
        ]
    )


def _foreseen(named: Sequence[Record]) -> str:
    """How well the refits predicted the validation errors, before and after."""
    words = []
    for when in ("before", "after"):
        ratios = [main_kind(r)[f"{when}_um"] / main_kind(r)[f"predicted_{when}_um"] for r in named]
        if ratios:
            words.append(f"{when} {median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")
    return f"- where named, validation error over the prediction of the refit: {', '.join(words) or 'none'}."


def _names(r: Record) -> str:
    named = [f"{n['effect']}{' at ' + n['site'] if n['site'] else ''}" for n in r["named"]]
    return ", ".join(named) or r["verdict"]


def _knocked(first: Sequence[Record], again: dict[tuple[str, str], Record]) -> Iterator[str]:
    heads = ("nominal part", "largest, prior s.d.", "visible, µm (lambda)", "found", "P", "named", "before",
             "after", "expected", "complete")  # fmt: skip
    for session in dict.fromkeys(r["session"] for r in first):
        own = [r for r in first if r["session"] == session]
        yield f"### {session}\n\n{markdown(heads, map(_row, own))}"
        notes = [
            f"- {r['without']}: {why(r)} (largest generic location: {r['place']})."
            + _later(again.get((session, r["without"])))
            for r in own
            if not right(r)
        ]
        if notes:
            yield "\n".join(notes)


def _row(r: Record) -> list[str]:
    held, largest = main_kind(r), r["largest"]
    return [
        r["without"],
        f"{largest['name']} {largest['prior_sds']:.1f}",
        f"{r['visible_um']:.1f} ({r['lambda']:.0f})",
        "yes" if right(r) else "no",
        f"{r['probability']:.2f}",
        _names(r),
        f"{held['before_um']:.0f}",
        f"{held['after_um']:.0f}" if r["named"] else "-",
        f"{held['predicted_before_um']:.0f} -> {held['predicted_after_um']:.0f}" if r["named"] else "-",
        f"{held['whole_um']:.0f}",
    ]


def _later(r: Record | None) -> str:
    if r is None:
        return ""
    held = main_kind(r)
    shrinks = f"{held['before_um']:.0f} -> {held['after_um']:.0f} µm, complete {held['whole_um']:.0f}"
    found = f"named, probability {r['probability']:.2f}" if right(r) else f"also not named ({why(r)})"
    return f" With {', '.join(r['beside'])} in the model: {found}; {shrinks}."


def _levels(models: Sequence[Record]) -> str:
    sizes = ("mean", "RMS", "maximum")
    out = []
    for r in models:
        for kind in ("planes", "points"):
            levels = [(step["adds"], step[kind]) for step in r["levels"] if kind in step]
            quoted = r["yardsticks"] if kind == "planes" or "planes" not in r["levels"][0] else []
            for k in range(max(len(levels), len(quoted)) if levels else 0):
                cells = [f"{r['session']}, {levels[0][1]['count']} {kind}" if k == 0 else ""]
                out.append(cells + _step(k, levels) + _quoted(k, quoted))
    rows = markdown(("session", "model", *sizes, "README: model", *sizes), out)
    return f"### All model levels, validation errors, mm\n\n{rows}"


def _step(k: int, levels: list[tuple[str, Record]]) -> list[str]:
    if k >= len(levels):
        return [""] * 4
    name, size = levels[k]
    return ["+ " * (k > 0) + name, *(f"{size[f'{what}_mm']:.3f}" for what in ("mean", "rms", "max"))]


def _quoted(k: int, quoted: list[Record]) -> list[str]:
    if k >= len(quoted):
        return [""] * 4
    return [quoted[k]["model"], *(f"{quoted[k][what]:.3f}" for what in ("mean", "rms", "max"))]


def _left(models: Sequence[Record]) -> str:
    heads = ("session", "verdict", "noise, µm", "validation, µm", "largest unexplained location", "µm RMS",
             "share", "p")  # fmt: skip
    out = []
    for r in models:
        left = r["left"]
        where = ["-"] * 4 if left is None else [
            left["place"], f"{left['rms_um']:.1f}", f"{100 * left['share']:.0f} %",
            "< 0.0001" if left["family_p_value"] < 1e-4 else f"{left['family_p_value']:.4f}",
        ]  # fmt: skip
        out.append([r["session"], r["verdict"], f"{r['noise_um']:.0f}", f"{r['validation_um']:.0f}", *where])
    notes = [f"- {r['session']}: {note}" for r in models for note in r["footnotes"]]
    return "\n\n".join(("### Remaining errors", markdown(heads, out), "\n".join(notes)))
