"""The page of a run folder, `report.html` of a fit or `gap.html` of a diagnosis, and of several runs.

Several runs side by side: verdicts, distance errors, parameters with their differences, model levels. A page
as PDF, printed by a Chromium or Chrome that is installed.
"""

import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bayescal import __version__
from bayescal.errors import BayescalError
from bayescal.gap.result import VALIDATION_CONTACTS
from bayescal.predict.forecast import CENTRES
from bayescal.reporting import motion, text
from bayescal.reporting.gap import likely
from bayescal.reporting.origin import filed
from bayescal.reporting.page import GENERATOR, Facts, Run, Section, Text, blocks, fit, gap, page, read_run
from bayescal.reporting.page.common import inputs, interactive
from bayescal.reporting.sheet import Bar, Column, Sheet, sheet_of_cells
from bayescal.storage.files import write_together
from bayescal.storage.folders import LIST, put, whole
from bayescal.storage.reading import Json

BROWSERS = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)  # fmt: skip
"""Names and places of browsers that print without a window, in the order of preference."""
SECONDS = 120
MARK = b"\n%bayescal page\n"
"""Comment at the end of a PDF file that marks it as ours; readers ignore what follows the last line."""


def browser() -> str:
    """The path of a browser.

    Raises
    ------
    BayescalError
        If none is installed.
    """
    path = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if path is None:
        what = "no Chromium or Chrome is installed, which prints the page"
        remedy = "install it (Debian: apt install chromium), or print the HTML page"
        raise BayescalError(what, "--pdf", remedy)
    return path


def is_ours(path: Path) -> bool:
    """Whether a PDF file was printed by `pdf_of`."""
    return path.read_bytes()[-len(MARK) :] == MARK


def pdf_of(page: str) -> bytes:
    """A page (HTML text) as a PDF file, marked; the browser has a temporary profile and no network.

    Raises
    ------
    BayescalError
        If there is no browser, or it does not print.
    """
    program = browser()
    with TemporaryDirectory(prefix="bayescal-page-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        source, made = folder / "page.html", folder / "page.pdf"
        source.write_text(page, encoding="utf-8")
        command = [
            program, "--headless", "--disable-gpu", "--no-first-run", "--disable-extensions",
            "--disable-background-networking", "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder}/profile", "--no-pdf-header-footer", f"--print-to-pdf={made}",
            source.as_uri(),
        ]  # fmt: skip
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # Chromium refuses its sandbox to root
        try:
            done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            what = f"{program} does not print: {error}"
            raise BayescalError(what, "--pdf", "print the HTML page") from None
        if not made.is_file() or not made.read_bytes().startswith(b"%PDF"):
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
            what = f"{program} does not print: {last[0]}"
            raise BayescalError(what, "--pdf", "print the HTML page in a browser")
        return made.read_bytes() + MARK


KINDS = {
    "fit": ("report.html", "calibration", fit.SECTIONS),
    "gap": ("gap.html", "diagnosis", gap.SECTIONS),
    "motion": ("gap.html", "diagnosis of the joint log", motion.SECTIONS),
    "motion fit": ("report.html", "calibration from the joint log", motion.FIT_SECTIONS),
}
"""Of each kind of run: the file name of its page, what it is, and its sections."""


def run_page(run: Run, scripts: bool = True) -> str:
    """The page of a run, as text; without `scripts` it has static figures alone."""
    _, title, sections = KINDS[run.kind]
    model = run.record["model"] if run.file == "fit.json" else run.record["baseline"]
    subtitle = f"{title} of {run.robot or 'the arm'}; model: {', '.join(model) or 'nominal'}"
    data = interactive(run) if scripts else None
    some = [make(run) for make in sections]
    return page(run.name, subtitle, some, foot(run), data, filed(run.record))


def runs_page(runs: Sequence[Run]) -> str:
    """The page of several runs side by side, as text."""
    some = [make(runs) for make in COMPARED]
    subtitle = ", ".join(dict.fromkeys(run.name for run in runs))
    return page(f"Comparison of {len(runs)} runs", subtitle, some)


def foot(run: Run) -> tuple[str, ...]:
    """Origin of a page."""
    sha, made = run.record["dataset"]["sha256"], run.record["software"]["bayescal"]
    dataset = sha[:12] if sha else "in memory"
    return (f"bayescal {__version__}; run by {made}; dataset {dataset}; seed {run.record['seed']}",)


def write_page(stage: Path, folder: Path) -> str:
    """Write the page of a run folder that is being written to `stage`; its name is returned."""
    run = read_run(stage, str(folder))
    name = KINDS[run.kind][0]
    (stage / name).write_text(run_page(run), encoding="utf-8")
    return name


def write_report(folders: Sequence[Path], out: Path | None, pdf: bool) -> tuple[Path, ...]:
    """Write the page of a run folder or of several, and a PDF of it; their paths are returned.

    Without `out`, the page of a single run replaces the one in its folder, atomically with all other files.

    Raises
    ------
    BayescalError
        For a folder that is no run, a joint log among several, a file that is not a page of bayescal, or a
        missing browser.
    """
    runs = [read_run(folder) for folder in folders]
    if len(runs) > 1 and (logs := [run.folder for run in runs if run.kind.startswith("motion")]):
        what = "a page of several runs is of sessions, and this is the run of a joint log"
        raise BayescalError(what, logs[0], "write the page of each log by itself")
    if pdf:
        browser()
    if out is None and len(runs) > 1:
        names = "+".join(folder.resolve().name for folder in folders)
        out = Path("runs") / f"{names}-report.html"
    if out is None:
        return _in_place(folders[0], runs[0], pdf)
    _check_replaceable(out, pdf)
    files = _files(runs, out, pdf)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_together(files)
    return tuple(files)


def _files(runs: Sequence[Run], out: Path, pdf: bool) -> dict[Path, bytes]:
    """The page of a run, or of several, and where asked the PDF of it, by their paths.

    Records with entries that are missing or of another kind, which a list of files did not show, are refused.
    """
    try:
        text = run_page(runs[0]) if len(runs) == 1 else runs_page(runs)
        plain = run_page(runs[0], scripts=False) if pdf and len(runs) == 1 else text
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        where = ", ".join(run.folder for run in runs)
        raise BayescalError(f"incomplete record: {error!r}", where, "repeat the command") from error
    return {out: text.encode()} | ({out.with_suffix(".pdf"): pdf_of(plain)} if pdf else {})


def _in_place(folder: Path, run: Run, pdf: bool) -> tuple[Path, ...]:
    """Write the page into the run folder: a copy of the folder with it replaces the folder."""
    with whole(folder, run.file) as stage:
        shutil.copytree(folder, stage, symlinks=True, dirs_exist_ok=True, ignore=shutil.ignore_patterns(LIST))
        files = _files([run], stage / KINDS[run.kind][0], pdf)
        return tuple(folder / name for name in put(stage, {path.name: files[path] for path in files}))


def _check_replaceable(path: Path, pdf: bool) -> None:
    """Refuse a folder, a file that is not a page of bayescal, and of a printed page a PDF of other origin."""
    if path.is_dir():
        raise BayescalError("a folder has this name", str(path), "give the name of a file as --out")
    if path.suffix.lower() not in (".html", ".htm"):
        raise BayescalError("the page is HTML", str(path), "give --out a name that ends in .html")
    printed = path.with_suffix(".pdf")
    foreign = [path] if path.exists() and not _is_page(path) else []
    foreign += [printed] if pdf and printed.exists() and not (printed.is_file() and is_ours(printed)) else []
    if foreign:
        what = "a file that is no page of bayescal has this name"
        raise BayescalError(what, str(foreign[0]), "give another --out, or move the file")


def _is_page(path: Path) -> bool:
    return path.is_file() and GENERATOR in path.read_text(encoding="utf-8", errors="replace")[:4000]


FAR = 2.0
"""Differences above this multiple of their u are marked (k = 2)."""


ERRORS = {
    "contacts": ("heldout_planes_rms_um", "heldout_rms_um"),
    "distances": ("distance_rms_um",),
    "points": ("points_rms_um", "point_length_rms_um"),
}
"""Errors of model levels, and their keys in the records of fits and diagnoses."""

VERDICTS = ("dataset", "command", "verdict")
Runs = Sequence[Run]


def labelled(runs: Runs, kind: str = "") -> list[tuple[str, Run]]:
    """The runs (of a kind) with their names: their folders, with numbers where two have the same."""
    return [(f"{k}: {run.folder}", run) for k, run in enumerate(runs, start=1) if kind in ("", run.kind)]


def verdicts(runs: Runs) -> Section | None:
    """What each run says, in words."""

    def verdict(run: Run) -> str:
        return run.record["verdict"]["words"] if run.kind == "fit" else "; ".join(run.record["words"])

    items = [(label, run.name, run.kind, verdict(run)) for label, run in labelled(runs)]
    columns = (Column("run", 0), *(Column(h, k, words=True) for k, h in enumerate(VERDICTS, start=1)))
    hashes = [h for run in runs if (h := run.record["dataset"]["sha256"])]  # none of a session in memory
    same = len(set(hashes)) < len(hashes)
    note = Text(
        "Runs of the same dataset are not independent: their differences come from the model alone, and the "
        "u of a difference below is too large.",
        "warning",
    )
    return blocks("verdicts", "Verdicts", Sheet(columns, items), note if same else None)


def distances(runs: Runs) -> Section | None:
    """Distance errors, expected and measured; U of a fit alone, whose budget states it."""
    items = []
    for label, run in labelled(runs):
        if run.kind == "fit":
            e, checked = run.record["predicted_distance"], run.record["validation"]["distances"]
            largest = max((abs(d["calibrated_error_um"]) for d in checked), default=None)
            items.append({**e, "run": label, "largest": largest})
        else:
            e = {m["what"]: m for m in run.record["gap"]["measured"]}.get("sphere distances") or {}
            between = {"over": CENTRES} if e else {}
            items.append({**e, "run": label, **between, "measured_rms_um": e.get("rms_um")})
    columns = (
        Column("run", "run"),
        Column("between", lambda e: e.get("over"), words=True),
        Column("expected RMS (µm)", lambda e: e.get("predicted_rms_um"), text.uncertainty),
        Column("U = k u (µm)", lambda e: e.get("expanded_U_um"), text.uncertainty),
        Column("measured RMS (µm)", "measured_rms_um", text.length),
        Column("maximum (µm)", lambda e: e.get("largest"), text.length),
        Column("distances", lambda e: e.get("count")),
    )
    return blocks("distances", "Distance errors", Sheet(columns, items))


def effects(runs: Runs) -> Section | None:
    """Probability of every effect, and amplitudes, of diagnoses."""
    some = labelled(runs, "gap")
    largest: dict[str, float] = {}
    for _, run in some:
        for name, p in run.record["probability"].items():
            largest[name] = max(largest.get(name, 0.0), p or 0.0)
    order = sorted((n for n in largest if largest[n] >= text.LEAST), key=lambda n: -largest[n])
    probabilities = [Column(label, run.record["probability"].get, likely) for label, run in some]
    table = Sheet((Column("effect", text.rival), *probabilities), order, "Probability of the effects")
    keys = dict.fromkeys(_key(a) for _, run in some for a in run.record["amplitudes"])
    amplitudes = [Column(label, _amplitudes(run).get) for label, run in some]
    name = Column("amplitude", lambda key: f"{key[0]} of {key[1]}: {key[2]}")
    sizes = Sheet((name, *amplitudes), list(keys), "Amplitudes of the named effects, with u")
    return blocks("effects", "Effects", table, sizes)


_key = itemgetter("effect", "site", "what", "unit")


def _amplitudes(run: Run) -> dict[tuple[str, ...], str]:
    """Amplitudes as text; of several with the same key the first."""
    each = reversed(run.record["amplitudes"])
    return {_key(a): text.measured(a["value"], a["u"], a["unit"]) for a in each}


def parameters(runs: Runs) -> Section | None:
    """Parameters of the arm, and their difference from the first calibration with its u."""
    some = labelled(runs, "fit")
    if len(some) < 2:
        return None
    if len({run.robot for _, run in some}) > 1:
        return blocks("parameters", "Parameters", Text("The runs are of different robots: not compared."))
    tables = [{p["name"]: p for p in run.record["parameters"] if p["effect"] != "target"} for _, run in some]
    names = list(dict.fromkeys(name for table in tables for name in table))
    rows = tuple(_compared(name, [table.get(name) for table in tables]) for name in names)
    headings = [label for label, _ in some]
    for label in headings[1:]:
        headings = [*headings, f"difference of {label.partition(':')[0]} from 1 (u)", "difference / u"]
    note = (
        "Differences with their standard uncertainty u, the root of the sum of both squared u (independent "
        f"sessions); dark: above {FAR:g} u"
    )
    return blocks("parameters", "Parameters", sheet_of_cells(("parameter", *headings), rows, note))


def _compared(name: str, each: Sequence[Json | None]) -> tuple[Any, ...]:
    """Estimates of a parameter, and the difference of each from the first."""
    first = each[0]
    cells: list[Any] = [
        text.MISSING if p is None else text.measured(p["estimate"], p["sd"], "") for p in each
    ]
    for other in each[1:]:
        if first is None or other is None or other["unit"] != first["unit"]:
            cells += [text.MISSING, text.MISSING]
            continue
        difference, u = other["estimate"] - first["estimate"], float(np.hypot(other["sd"], first["sd"]))
        ratio = abs(difference) / u if u > 0 else 0.0
        cells += [text.measured(difference, u, ""), Bar(min(ratio / 5.0, 1.0), f"{ratio:.1f}", ratio > FAR)]
    return (text.with_unit(name, next(p["unit"] for p in each if p is not None)), *cells)


def levels(runs: Runs) -> Section | None:
    """Validation errors of each model level in every run."""
    order = list(dict.fromkeys(tuple(step["model"]) for run in runs for step in run.record["ladder"]))
    errors = []
    for what in ERRORS:
        of_runs = [
            {tuple(step["model"]): _error(run, step, what) for step in reversed(run.record["ladder"])}
            for run in runs
        ]
        if any(error is not None for of_run in of_runs for error in of_run.values()):
            errors += [Column(f"{what}, {k}", e.get, text.length) for k, e in enumerate(of_runs, start=1)]
    caption = "RMS of validation measurements, µm; of points the length of the error vector"
    sheet = Sheet((Column("model", text.model_label), *errors), order, caption)
    return blocks("levels", "Model levels", sheet)


def _error(run: Run, step: Json, what: str) -> float | None:
    """RMS error, µm, of a model level; None where the run has no such rows."""
    if what == "contacts" and run.kind == "gap" and run.record["lengths"]["of"] != VALIDATION_CONTACTS:
        return None  # what the record states there is per coordinate
    return next((step[key] for key in ERRORS[what] if step.get(key) is not None), None)


def origins(runs: Runs) -> Section | None:
    """Inputs and versions of every run."""
    parts: list[Text | Facts] = []
    for label, run in labelled(runs):
        section = inputs(run)
        if section is not None:
            parts += [Text(label), *section.context["blocks"]]
    return blocks("inputs", "Inputs and versions", *parts)


COMPARED: tuple[Callable[[Runs], Section | None], ...] = (
    verdicts, distances, effects, parameters, levels, origins,
)  # fmt: skip
"""Sections of the page of several runs, in their order."""
