"""`bayescal report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.root import app, ending


@app.command(
    **ending(
        "bayescal report runs/cell-fit --pdf",
        "bayescal report runs/monday-fit runs/tuesday-fit --out both.html",
    )
)
def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Run folders of bayescal fit or gap; several are compared."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="HTML file to write [default: report.html or gap.html of the run folder; of several runs "
            "runs/<names>-report.html].",
        ),
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also print a PDF, by Chromium or Chrome.")] = False,
) -> None:
    """Write the page of a run again, or a page of several runs side by side."""
    from bayescal.public.starting import report as work

    for path in work(runs, out, pdf=pdf):
        typer.echo(f"written          {path}")
