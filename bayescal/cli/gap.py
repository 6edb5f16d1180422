"""`bayescal gap`."""

from __future__ import annotations

from pathlib import Path

import typer

from bayescal.cli import app
from bayescal.cli.progress import progress


@app.command()
def gap(
    dataset: Path = typer.Argument(..., help="Dataset folder: dataset.yaml, measurements.csv and the robot."),
    model: str = typer.Option(
        "geometry,compliance", help="Effects that the model has already, comma separated."
    ),
    without: str = typer.Option(
        "",
        help="Parts of these effects to leave out and look for, comma separated: 'geometry at joint 4' "
        "(theta4, d4, and a4, alpha4, beta4 behind), 'geometry at link 4', 'compliance at joint 3'.",
    ),
    seed: int = typer.Option(0, help="One seed, one result."),
    out: Path | None = typer.Option(None, help="Run folder to write [default: runs/<dataset>-gap]."),
    robust: bool = typer.Option(True, help="Find outliers and leave them out."),
    prior_width: float = typer.Option(1.0, help="Factor on the widths of the arm's tolerance priors."),
    pictures: bool = typer.Option(True, help="Draw gap-where.png, -which, -ladder and -residuals."),
) -> None:
    """Diagnose the gap between model and machine: how big, where, which effect, how far it shrinks."""
    from bayescal.dataset import read_dataset
    from bayescal.folders import check_free

    effects, parts = (
        tuple(name.strip() for name in words.split(",") if name.strip()) for words in (model, without)
    )
    session = read_dataset(dataset)
    folder = out or Path("runs") / f"{dataset.resolve().name}-gap"
    check_free(folder, "gap.json")

    from rich.console import Console

    from bayescal.gap.diagnose import diagnose
    from bayescal.report.gap_files import write_gap
    from bayescal.report.gap_summary import gap_summary

    console = Console(highlight=False)
    with progress() as told:
        result = diagnose(session, effects, seed, robust, prior_width, told, parts)
        told("write", 1.0)
        written = write_gap(result, folder, pictures)
    console.print(gap_summary(result))
    console.print(f"[dim]written          [/dim]{folder}/{', '.join(written)}", soft_wrap=True)
