"""The score card: a terminal summary, and the tables of a documentation page."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from analysis.blind.files import write_score
from analysis.blind.rows import Row, bands, by_form, by_lambda, number, rows
from analysis.pages import between, table
from bayescal.reporting.text import FigureTable, facts

BEGIN, END = "<!-- blind: begin -->", "<!-- blind: end -->"
KINDS = {
    "null": "noise only",
    "single": "one effect",
    "pair": "two effects",
    "outside": "not in the list of known effects",
}
MET = {True: Text("yes", style="green"), False: Text("no", style="yellow"), None: Text("")}
ALTERNATIVE = {
    "blind-lambda.png": "Share of correct answers by detectability lambda",
    "blind-reliability.png": "Reliability: stated probability and observed frequency; log score",
    "blind-shrinkage.png": "Reduction of validation errors, predicted and achieved",
    "blind-confusion.png": "Confusion matrix",
}
"""Figures of a page in their order, and their alternative texts."""
SUMS = {"code": "code_sha256", "sealed truth": "truth_sha256", "answers": "answers_sha256"}


def terminal(found: Mapping[str, Any]) -> RenderableType:
    """The figures on one screen, at most 100 columns wide."""
    title = Text.assemble((f"{found['worlds']} simulated sessions", "bold"), f"  {kinds(found)}")
    bins = found["reliability"]
    strength = FigureTable("by detectability", *bands())
    for label, cells in by_lambda(found):
        strength.add_row(label, *cells)
    stated = FigureTable("probability stated", *(span(b["bin"]) for b in bins))
    for label, cells in reliability(found):
        stated.add_row(label, *cells)
    parts: list[RenderableType] = [
        title,
        "",
        _figures(found),
        "",
        strength,
        "",
        stated,
        "",
        facts((*_forms(found), *_misses(found))),
    ]
    return Group(*parts)


def _figures(found: Mapping[str, Any]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 0, 0))
    for heading in ("criterion", "result (95 %)", "required", ""):
        table.add_column(heading)
    for row in rows(found):
        table.add_row(row.label, row.found, row.wanted, MET[row.met if row.wanted else None])
    return table


def kinds(found: Mapping[str, Any]) -> str:
    """'48 noise only, 120 one effect, ...'."""
    return ", ".join(f"{found['kinds'][kind]} {words}" for kind, words in KINDS.items())


def span(ends: tuple[float, float]) -> str:
    """A bin of probabilities."""
    return f"{ends[0]:g}-{ends[1]:g}"


def reliability(found: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Rows of the reliability table, a cell per bin."""
    bins = found["reliability"]
    return [
        ("count", [str(b["count"]) for b in bins]),
        ("mean", [f"{b['said']:.2f}" for b in bins]),
        ("observed frequency", [f"{b['held']:.2f}" for b in bins]),
        ("95 % band", ["{:.2f}-{:.2f}".format(*b["band95"]) for b in bins]),
    ]


def _forms(found: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    every = found["forms"]["effects"].items()
    missed = [
        f"{name} ({form}) {s['count'] - s['hits']} of {s['count']}"
        for name, forms in every for form, s in forms.items() if s["hits"] < s["count"]
    ]  # fmt: skip
    yield "forms not named, lambda from 30", "; ".join(missed) or "none", ""


def _misses(found: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    reasons = "; ".join(f"{title} {count}" for title, count in found["reasons"].items())
    yield f"misses ({len(found['misses'])})", reasons or "none", ""


def page(path: Path, found: Mapping[str, Any], about: Mapping[str, Any], folder: Path) -> None:
    """Replace the tables between the marks of a Markdown page, and its figures.

    Parameters
    ----------
    path : Path
        The page; the figures are written to ``pictures/`` in its folder.
    found : Mapping
        As `score.figures` returns it.
    about : Mapping
        ``truth_sha256``, ``answers_sha256``, ``software``, ``code_sha256``, ``worlds``, ``seed`` and, where
        given, ``note``: when and at which commit thresholds were frozen.
    folder : Path
        The score folder that holds the pictures.

    Raises
    ------
    BayescalError
        Where the page cannot be read or has no marks.
    """
    shown = [name for name in ALTERNATIVE if (folder / name).is_file()]
    between(path, (BEGIN, END), tables(found, about, shown))
    for name in shown:
        (path.parent / "pictures").mkdir(exist_ok=True)
        shutil.copyfile(folder / name, path.parent / "pictures" / name)


def tables(found: Mapping[str, Any], about: Mapping[str, Any], pictures: Iterable[str] = ()) -> str:
    """The figures as Markdown."""
    bins = found["reliability"]
    strength = [(label, *cells) for label, cells in by_lambda(found)]
    stated = [(label, *cells) for label, cells in reliability(found)]
    judged = [(r.label, r.found, r.wanted, str(MET[r.met if r.wanted else None])) for r in rows(found)]
    score = [(KINDS[kind], s["count"], number(s["mean"], 2), number(s["base"], 2))
             for kind, s in (found["log_score"] or {"kinds": {}})["kinds"].items()]  # fmt: skip
    blocks = [
        origin(found, about),
        table(["criterion", "result (Wilson 95 %)", "required", "met"], judged),
        table(["by detectability lambda", *bands()], strength),
        table(["probability stated", *(span(b["bin"]) for b in bins)], stated),
        table(["effect, lambda from 30", "form", "named (Wilson 95 %)"], by_form(found)),
        table(["log score (nats)", "sessions", "answers", "base rates"], score),
        "\n\n".join(f"![{ALTERNATIVE[name]}](pictures/{name})" for name in pictures),
        _worse(found),
        f"**{len(found['misses'])} misses by reason**",
        *(_of_reason(found, title) for title in found["reasons"]),
    ]
    return "\n\n".join(block for block in blocks if block)


HEADS = ("criterion", "found (95 %)", "wanted", "met")
IS_MET = {True: "yes", False: "no", None: ""}


def _judged(criteria: Iterable[Row]) -> list[tuple[str, ...]]:
    return [(r.label, r.found, r.wanted, IS_MET[r.met if r.wanted else None]) for r in criteria]


def show(criteria: Iterable[Row]) -> None:
    """Print criteria, each with what was found and what is wanted."""
    from bayescal.public import console

    shown = Table(box=None, pad_edge=False)
    for head in HEADS:
        shown.add_column(head, no_wrap=head == HEADS[0])
    for line in _judged(criteria):
        shown.add_row(*line)
    console().print(shown)


def page_of(
    path: Path, marks: tuple[str, str], found: Mapping[str, Any], about: Mapping[str, Any],
    criteria: Iterable[Row], misses: tuple[Sequence[str], Sequence[Sequence[str]]], words: str = "",
) -> None:  # fmt: skip
    """Write origin, criteria and misses (headings and rows) between the marks of a page."""
    parts = (origin(found, about, words), table(HEADS, _judged(criteria)), table(*misses))
    between(path, marks, "\n\n".join(p for p in parts if p))


@dataclass(frozen=True)
class Card:
    """How sessions of a kind are scored and shown.

    Attributes
    ----------
    record : callable
        What is scored of a session, of its truth and its answer, if it has one.
    figures, rows : callable
        Figures of all records, and the criteria of these.
    marks : tuple of str
        Between which the tables are on a page.
    misses : mapping
        Fields of a miss, and their headings on the page.
    words : callable
        How many sessions of which kind there are, of the figures.
    and_ : str
        Between several names in a cell.
    written : tuple of str
        Fields of a miss in the table that is written; default: those of the page.
    """

    record: Callable[[Mapping[str, Any], Mapping[str, Any] | None], dict[str, Any]]
    figures: Callable[[Sequence[dict[str, Any]]], dict[str, Any]]
    rows: Callable[[Mapping[str, Any]], list[Row]]
    marks: tuple[str, str]
    misses: Mapping[str, str]
    words: Callable[[Mapping[str, Any]], str] = kinds
    and_: str = "+"
    written: tuple[str, ...] = ()

    def scored(
        self, truths: Mapping[str, Any], answers: Mapping[str, Any], about: Mapping[str, Any], target: Path,
        page: Path | None,
    ) -> None:  # fmt: skip
        """Print the score, write it to a folder, and the tables to a page with the marks.

        Parameters
        ----------
        truths, answers, about
            As `unseal.opened` returns them.
        target : Path
            The score folder.
        page : Path, optional
            A Markdown page with the marks.
        """
        records = [self.record(truth, answers.get(name)) for name, truth in sorted(truths.items())]
        found = self.figures(records)
        names = write_score(
            records, found, about, target, pictures=False, headings=self.written or tuple(self.misses)
        )
        show(self.rows(found))
        if page is not None:
            misses = [[self._text(m[key]) for key in self.misses] for m in found["misses"]]
            heads = tuple(self.misses.values())
            page_of(page, self.marks, found, about, self.rows(found), (heads, misses), self.words(found))
        print(f"written  {target}/{', '.join(names)}{f'; {page}' if page else ''}")

    def _text(self, x: Any) -> str:
        if isinstance(x, float):
            return f"{x:.3g}"
        return self.and_.join(x) if isinstance(x, list) else str(x if x is not None else "")


def origin(found: Mapping[str, Any], about: Mapping[str, Any], words: str = "") -> str:
    """Origin of the results, in lines that can be checked; `words` are how many of which kind there are."""
    frozen = about.get("note") or "date of freezing the thresholds not recorded"
    software = ", ".join(f"{name} {version}" for name, version in about.get("software", {}).items())
    sums = ", ".join(f"{what} {_short(about, key)}" for what, key in SUMS.items())
    lines = [
        f"{found['worlds']} simulated sessions of {_drawn(about)}: {words or kinds(found)}.",
        f"Frozen: {frozen}. SHA-256: {sums}. Software: {software or 'not recorded'}.",
    ]
    return "\n".join(lines)


def _drawn(about: Mapping[str, Any]) -> str:
    """Seed of the sessions, generator if it is not the first, and whether reserved causes were drawn."""
    version = about.get("generator", 1)
    words = [f"seed {about.get('seed', 'not recorded')}"]
    words += [f"generator {version}"] if version > 1 else []
    return ", ".join(words + (["reserved causes included"] if about.get("reserved") else []))


def _short(about: Mapping[str, Any], key: str) -> str:
    return f"`{str(about.get(key) or 'not recorded')[:16]}`"


def _worse(found: Mapping[str, Any]) -> str:
    each = (f"{world} ({old:.1f} to {new:.1f} µm)" for world, (old, new) in found["worse"].items())
    return f"Sphere distance errors increased by more than 5 %: {', '.join(each) or 'none'}."


def _of_reason(found: Mapping[str, Any], title: str) -> str:
    own = [m for m in found["misses"] if m["reason"] == title]
    lines = [f"{title} ({len(own)}):", ""]
    for m in own:
        at = f" at {m['acts_at']}" if m["acts_at"] else ""
        said = m["named"] or "no effect named"
        line = f"- {m['world']}: {m['truth']}{at} (lambda {m['lambda'] or 0}): {m['verdict']}, {said}"
        detail = f"; {m['detail']}" if m["detail"] not in line else ""
        lines.append(f"{line} ({m['leaders']}){detail}")
    return "\n".join(lines)
