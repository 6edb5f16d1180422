"""What a page consists of: sections, and the blocks of a section.

Numbers of a record as text: µm from the keys in µm, "-" where there is none.

What a page is made of: the records of a run folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from markupsafe import Markup

from bayescal.effects.vocabulary import unit_label
from bayescal.errors import BayescalError
from bayescal.reporting.shared.text import um, um2, with_u
from bayescal.storage.folders import check_unchanged
from bayescal.storage.reading import read_record


@dataclass(frozen=True)
class Section:
    """A part of a page: its anchor, its heading, its template, and the names that the template uses."""

    key: str
    title: str
    template: str
    context: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Fault:
    """What is wrong, on the first screen: its name, facts with their headings, and what to inspect."""

    name: str
    facts: tuple[tuple[str, str], ...] = ()
    remedy: str = ""


@dataclass(frozen=True)
class Bar:
    """A cell with a bar: the filled fraction (0 to 1), the text behind it, and whether it is marked."""

    fraction: float
    text: str
    marked: bool = False
    kind: ClassVar[str] = "bar"


@dataclass(frozen=True)
class Sheet:
    """A table: the heading of its first column, the headings of the others, its rows, and its caption.

    A cell is text, a `Bar` or markup. `words` are the columns (from 0) of text, which are set to the left;
    the first column always is. Rows beyond `shown` are folded.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    caption: str = ""
    words: tuple[int, ...] = ()
    shown: int | None = None
    kind: ClassVar[str] = "sheet"


@dataclass(frozen=True)
class Text:
    """A paragraph; `style` is "", "quiet", "warning" or "command"."""

    text: str
    style: str = ""
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Facts:
    """Names and their values."""

    rows: tuple[tuple[str, str], ...]
    kind: ClassVar[str] = "facts"


@dataclass(frozen=True)
class Figures:
    """Drawings beside each other, where there is room: title and SVG of each."""

    drawings: tuple[tuple[str, Markup], ...]
    kind: ClassVar[str] = "figures"


Block = Sheet | Text | Facts | Figures


def blocks(key: str, title: str, *parts: Block | None) -> Section | None:
    """A section of blocks, or None where it has none; tables without rows are left out."""
    some = [p for p in parts if p is not None and not (isinstance(p, Sheet) and not p.rows)]
    return Section(key, title, "blocks.html.j2", {"blocks": some}) if some else None


def texts(lines: Sequence[str], style: str = "") -> tuple[Text, ...]:
    """A paragraph of each line."""
    return tuple(Text(line, style) for line in lines)


MISSING = "-"


def length(value: float | None) -> str:
    """A length in µm, three significant digits, without its unit."""
    return MISSING if value is None else um(1e-6 * value)


def uncertainty(value: float | None) -> str:
    """An uncertainty in µm, two significant digits, without its unit."""
    return MISSING if value is None else um2(1e-6 * value)


def interval(ends: list[float | None] | None, of: float = 1.0) -> str:
    """An interval in µm: ``4.3 to 6.6``."""
    if not ends or None in ends:
        return MISSING
    low, high = (of * end for end in ends if end is not None)
    return f"{length(low)} to {length(high)}"


def quantity(value: float | None, unit: str) -> str:
    """A value with its unit, two significant digits."""
    if value is None:
        return MISSING
    figures = f"{value:.2g}" if abs(value) < 99.5 else f"{float(f'{value:.2g}'):.0f}"
    return f"{figures} {unit_label(unit)}".rstrip()


def measured(value: float, u: float, unit: str) -> str:
    """A value with its standard uncertainty and unit: ``0.0244(10) deg``."""
    return f"{with_u(value, u)} {unit_label(unit)}".rstrip()


def share(value: float | None) -> str:
    """A fraction in per cent."""
    return MISSING if value is None else f"{100 * value:.0f} %"


Json = Mapping[str, Any]
SCHEMAS = {"fit.json": "bayescal-fit/1", "gap.json": "bayescal-gap/1"}
"""Record that identifies a run -> its schema."""
BUDGET, BUDGET_SCHEMA = "budget.json", "bayescal-budget/1"
FIGURES = {
    "fit-distances.png": "Errors of validation data, nominal and calibrated, with 95 % prediction intervals",
    "fit-posterior.png": "Posterior and prior of the least known parameters; draws of correlated pairs",
}
"""Figures of a run folder that show what its page does not draw itself, and their text alternatives."""


@dataclass(frozen=True)
class Run:
    """The records of a run folder.

    Parameters
    ----------
    kind : str
        "fit" or "gap".
    record : mapping
        The content of fit.json or gap.json.
    folder : str
        The name of the run folder, for commands.
    budget : mapping or None
        The content of budget.json.
    figures : mapping
        Content of PNG files, by file name; those of `FIGURES`.
    """

    kind: str
    record: Json
    folder: str
    budget: Json | None = None
    figures: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name of the dataset."""
        return str(self.record["dataset"]["name"])

    @property
    def refitted(self) -> bool:
        """Whether named effects were added to the model of a diagnosis."""
        return self.kind == "gap" and bool(self.record["named"])

    @property
    def rows(self) -> Json:
        """Rows with the residuals that the page shows: those that a diagnosis explains, before its refit."""
        rows: dict[str, Any] = dict(self.record["rows"])
        rows["residual_after_um"] = rows["residual_um"]
        rows["residual_um"] = rows.pop("residual_before_um", rows["residual_um"])
        rows["rejected"] = rows.pop("rejected_before", rows["rejected"])
        return rows

    @property
    def robot(self) -> str:
        """The name of the robot; "" in records without it."""
        return str(self.record.get("arm", {}).get("robot", ""))


def read_run(folder: Path, name: str = "") -> Run:
    """Read a run folder of `fit` or `gap`; `name` is the folder in commands, by default as given.

    Raises
    ------
    BayescalError
        If the folder has no such record, one of another version, or one that was changed after the run.
    """
    there = [record for record in SCHEMAS if (folder / record).is_file()]
    if not there:
        what = f"there is no {' or '.join(SCHEMAS)}"
        raise BayescalError(what, str(folder), "give a run folder of bayescal fit or gap")
    budget = _record(folder / BUDGET, BUDGET_SCHEMA) if (folder / BUDGET).is_file() else None
    figures = {file: content for file in FIGURES if (content := _png(folder / file))}
    record = _record(folder / there[0], SCHEMAS[there[0]])
    check_unchanged(folder, (there[0], *([BUDGET] if budget else [])))
    return Run(there[0].removesuffix(".json"), record, name or str(folder), budget, figures)


def _png(path: Path) -> bytes:
    """Content of a figure; b"" for what is none: a link could bring any file of the user into the page."""
    if path.is_symlink() or not path.is_file():
        return b""
    content = path.read_bytes()
    return content if content.startswith(b"\x89PNG") else b""


def _record(path: Path, schema: str) -> Json:
    return read_record(path, schema, "repeat the command with this version")
