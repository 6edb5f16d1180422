"""Pages of results: one self-contained HTML file for a run, several runs or a plan.

A page is a list of sections, and a section is a function of a run's records. A further section is one
function and one line in `fit.SECTIONS` or `gap.SECTIONS`. Everything is in the file, with a policy that
permits nothing from outside. Of Plotly only the JavaScript file of the package is read, compressed, with the
hash that the policy permits: `plotly.graph_objects` is slow to import and not needed.
"""

import base64
import gzip
import hashlib
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

from markupsafe import Markup, escape

from bayescal import __version__
from bayescal.errors import BayescalError
from bayescal.reporting.sheet import Sheet
from bayescal.storage.folders import check_unchanged
from bayescal.storage.reading import MOTION, TOGETHER, Json, read_record, run_record
from bayescal.storage.writing import templates_beside


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
class FirstScreen:
    """What is seen first: verdict (`tone`, `sign`, `word`, `lines`), key figures, faults, next commands.

    Of `lines` the first `most` are not folded; `keys` are a name, a value and a detail each, `next`
    words and a command.
    """

    word: str
    tone: str = ""
    sign: str = ""
    lines: Sequence[str] = ()
    most: int = 1
    keys: Sequence[tuple[str, str, str]] = ()
    fault_title: str = ""
    faults: Sequence[Fault] = ()
    arm: Markup | None = None
    arm_caption: str = ""
    next: Sequence[tuple[str, str]] = ()
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()

    def section(self) -> Section:
        """The section that has no heading."""
        return Section("result", "", "first.html.j2", vars(self))


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
    some = not_empty(parts)
    return Section(key, title, "blocks.html.j2", {"blocks": some}) if some else None


def not_empty(parts: Sequence[Block | None]) -> list[Block]:
    """Blocks without those that are missing and tables without rows."""
    return [p for p in parts if p is not None and not (isinstance(p, Sheet) and not p.items)]


def picture(text: str, content: bytes) -> tuple[str, str]:
    """The text alternative of a PNG, and its content as a data URL."""
    return text, f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"


def texts(lines: Sequence[str], style: str = "") -> tuple[Text, ...]:
    """A paragraph of each line."""
    return tuple(Text(line, style) for line in lines)


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
        "fit", "gap"; of joint logs "motion fit", and "motion" for their diagnosis.
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
    def file(self) -> str:
        """The record that identifies the run folder."""
        return "fit.json" if self.kind.endswith("fit") else "gap.json"

    @property
    def name(self) -> str:
        """The name of the dataset."""
        return str(self.record["dataset"]["name"])

    @property
    def drawable(self) -> bool:
        """Whether the record has rows and an arm."""
        return bool(self.record.get("arm") and self.record.get("rows", {}).get("id"))

    @property
    def datasets(self) -> str:
        """The folders of the dataset and of its sessions, for commands."""
        folder, sessions = shlex.quote(self.folder), self.record["dataset"].get("sessions", ())
        return " ".join(f"{folder}/dataset/{k}" for k in range(1, len(sessions) + 1)) or f"{folder}/dataset"

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
        return str(self.record.get("robot") or self.record.get("arm", {}).get("robot", ""))


def read_run(folder: Path, shown: str = "") -> Run:
    """Read a run folder of `fit` or `gap`; `shown` is the folder in commands, by default as given.

    Raises
    ------
    BayescalError
        If the folder has no such record, one of another version, or one that was changed after the run.
    """
    kind, record = run_record(folder, "fit", "gap")
    budget = None
    if (folder / BUDGET).is_file():
        budget = read_record(folder / BUDGET, BUDGET_SCHEMA, "repeat the command with this version")
    figures = {file: content for file in FIGURES if (content := _png(folder / file))}
    check_unchanged(folder, (f"{kind}.json", *([BUDGET] if budget else [])))
    if record.get("unit") == TOGETHER:
        what, each = "a session and a log were fitted together", f"give {folder}/contacts or {folder}/log"
        raise BayescalError(what, str(folder), f"each has its page: {each}")
    if record.get("unit") in MOTION:
        kind = "motion" if kind == "gap" else "motion fit"
    return Run(kind, record, shown or str(folder), budget, figures)


def _png(path: Path) -> bytes:
    """Content of a figure; b"" for what is none: a link could bring any file of the user into the page."""
    if path.is_symlink() or not path.is_file():
        return b""
    content = path.read_bytes()
    return content if content.startswith(b"\x89PNG") else b""


STILL = "Figures that move with the pointer need plotly: pip install 'bayescal[interactive]'."
"""The last line of a page that has still figures alone."""


@lru_cache(maxsize=1)
def plotly() -> tuple[str, str] | None:
    """Source of plotly.js as base64 of gzip, and its CSP hash ``'sha256-...'``; None without plotly.

    The page inflates it (DecompressionStream) and runs it as an inline script with this hash: the policy
    permits no other code.
    """
    try:
        source = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    except ModuleNotFoundError:
        return None
    packed = gzip.compress(source, compresslevel=4, mtime=0)  # 9: a twentieth less, twice the time
    return base64.b64encode(packed).decode("ascii"), csp_hash(source)


def csp_hash(source: bytes) -> str:
    """Hash of an inline script, as a content security policy states it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(source).digest()).decode('ascii')}'"


GENERATOR = '<meta name="generator" content="bayescal">'
"""In the head of every page: a file with it may be replaced."""


def coded(text: Any) -> Markup:
    """A text, escaped, with what is between backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))


ASSETS = Path(__file__).parent / "templates"
TEMPLATES = templates_beside(__file__, {"coded": coded}, autoescape=True, keep_trailing_newline=False)
"""Templates of pages; values are escaped, also those of JSON: no text in it can end a script element."""
TEMPLATES.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}


def asset(name: str) -> str:
    """The text of a file beside the templates."""
    return (ASSETS / name).read_text(encoding="utf-8")


def page(
    title: str, subtitle: str, sections: Sequence[Section | None],
    foot: Sequence[str] = (f"bayescal {__version__}",), data: Mapping[str, Any] | None = None,
    headers: Sequence[tuple[str, Mapping[str, str]]] = (),
) -> str:  # fmt: skip
    """A page as text.

    Parameters
    ----------
    title, subtitle : str
    sections : sequence of Section
        In the order of the page, without those that are None; the first one is seen first.
    foot : sequence of str
        Lines at the end; default: the version.
    data : mapping, optional
        What interactive figures draw, as JSON; without it, or without plotly, the page has no scripts.
    headers : sequence of (str, mapping), optional
        What a filed report states below its title: a heading or "", names and values.
    """
    packed, allowed, script = "", "'none'", ""
    library = None if data is None else plotly()
    if library is None:
        data, foot = None, foot if data is None else (*foot, STILL)
    else:
        packed, permitted = library
        script = asset("page.js")
        allowed = f"{permitted} {csp_hash(script.encode())}"
    shown = [section for section in sections if section is not None]
    bodies = [(s, Markup(TEMPLATES.get_template(s.template).render(s.context))) for s in shown]
    return TEMPLATES.get_template("base.html.j2").render(
        generator=Markup(GENERATOR), title=title, subtitle=subtitle, headers=headers, bodies=bodies,
        foot=foot, style=Markup(asset("page.css")),
        policy=f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {allowed}; "
        "base-uri 'none'; form-action 'none'",
        data=data, script=Markup(script), packed=packed,
    )  # fmt: skip
