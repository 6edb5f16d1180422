"""The page of a run folder, `report.html` of a fit or `gap.html` of a diagnosis, and of several runs.

A page as PDF, printed by a Chromium or Chrome that is installed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from bayescal import __version__
from bayescal.errors import BayescalError
from bayescal.reporting.page import compare, fit, gap, motion
from bayescal.reporting.page.common import interactive
from bayescal.reporting.page.section import GENERATOR, Run, page, read_run
from bayescal.reporting.shared.origin import filed
from bayescal.storage.files import write_together
from bayescal.storage.folders import LIST, whole
from bayescal.storage.locks import scratch

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)
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
    with scratch("bayescal-page") as folder:
        source, made = folder / "page.html", folder / "page.pdf"
        source.write_text(page, encoding="utf-8")
        command = [
            program,
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--disable-extensions",
            "--disable-background-networking",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder}/profile",
            "--no-pdf-header-footer",
            f"--print-to-pdf={made}",
            source.as_uri(),
        ]
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


SECTIONS = {
    "fit": fit.SECTIONS,
    "gap": gap.SECTIONS,
    "motion": motion.SECTIONS,
    "motion fit": motion.FIT_SECTIONS,
}
PAGES = {"fit": "report.html", "gap": "gap.html", "motion": "gap.html", "motion fit": "report.html"}
"""File name of the page of each kind of run."""
TITLES = {
    "fit": "calibration",
    "gap": "diagnosis",
    "motion": "diagnosis of the joint log",
    "motion fit": "calibration from the joint log",
}


def run_page(run: Run, scripts: bool = True) -> str:
    """The page of a run, as text; without `scripts` it has static figures alone."""
    some = [make(run) for make in SECTIONS[run.kind]]
    model = run.record["model"] if run.file == "fit.json" else run.record["baseline"]
    subtitle = f"{TITLES[run.kind]} of {run.robot or 'the arm'}; model: {', '.join(model) or 'nominal'}"
    data = interactive(run) if scripts else None
    return page(run.name, subtitle, some, foot(run), data, filed(run.record))


def runs_page(runs: Sequence[Run]) -> str:
    """The page of several runs side by side, as text."""
    some = [make(runs) for make in compare.SECTIONS]
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
    name = PAGES[run.kind]
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
        files = _files([run], stage / PAGES[run.kind], pdf)
        for path, content in files.items():
            path.write_bytes(content)
    return tuple(folder / path.name for path in files)


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
