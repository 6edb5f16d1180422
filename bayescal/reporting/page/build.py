"""The page of a run folder: `report.html` of a fit, `gap.html` of a diagnosis."""

from __future__ import annotations

from pathlib import Path

from bayescal import __version__
from bayescal.reporting.page import fit, gap
from bayescal.reporting.page.render import page
from bayescal.reporting.page.rows import interactive
from bayescal.reporting.page.run import Run, read_run

SECTIONS = {"fit": fit.SECTIONS, "gap": gap.SECTIONS}
PAGES = {"fit": "report.html", "gap": "gap.html"}
"""File name of the page of each kind of run."""
TITLES = {"fit": "calibration", "gap": "diagnosis"}


def run_page(run: Run) -> str:
    """The page of a run, as text."""
    some = [make(run) for make in SECTIONS[run.kind]]
    model = run.record["model"] if run.kind == "fit" else run.record["baseline"]
    subtitle = f"{TITLES[run.kind]} of {run.robot or 'the arm'}; model: {', '.join(model) or 'nominal'}"
    return page(run.name, subtitle, [s for s in some if s is not None], foot(run), interactive(run))


def foot(run: Run) -> tuple[str, ...]:
    """Origin of a page."""
    sha = str(run.record["dataset"]["sha256"] or "")[:12]
    made = run.record["software"]["bayescal"]
    return (
        f"bayescal {__version__}; run by {made}; dataset {sha or 'in memory'}; seed {run.record['seed']}",
    )


def write_page(stage: Path, folder: Path) -> str:
    """Write the page of a run folder that is being written to `stage`; its name is returned."""
    run = read_run(stage, str(folder))
    name = PAGES[run.kind]
    (stage / name).write_text(run_page(run), encoding="utf-8")
    return name
