"""`bayescal compare`."""

from __future__ import annotations

from pathlib import Path

import typer

from bayescal.cli import app
from bayescal.cli.options import AllowXacro
from bayescal.cli.progress import progress


@app.command()
def compare(
    dataset: Path = typer.Argument(..., help="Dataset folder: dataset.yaml, measurements.csv and the robot."),
    model: str = typer.Option(
        "geometry,compliance", help="Effects that every method fits, separated by commas."
    ),
    seed: int = typer.Option(0, help="Random seed."),
    out: Path | None = typer.Option(None, help="Run folder to write [default: runs/<dataset>-compare]."),
    allow_xacro: AllowXacro = False,
) -> None:
    """Calibrate by several published methods, and compare their errors on the same validation rows."""
    from bayescal.dataset import read_dataset
    from bayescal.folders import check_free

    effects = tuple(name.strip() for name in model.split(",") if name.strip())
    session = read_dataset(dataset, allow_xacro=allow_xacro)
    folder = out or Path("runs") / f"{dataset.resolve().name}-compare"
    check_free(folder, "compare.json")

    from rich.console import Console

    from bayescal.methods import compare as run
    from bayescal.reporting.comparison import comparison_summary, write_comparison

    console = Console(highlight=False)
    with progress("compare") as notify:
        result = run(session, effects, seed, progress=notify)
        write_comparison(result, folder)
    console.print(comparison_summary(result))
    console.print(f"[dim]written          [/dim]{folder}/compare.json", soft_wrap=True)
