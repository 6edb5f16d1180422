"""`bayescal fit`."""

from __future__ import annotations

from pathlib import Path

import typer

from bayescal.cli import app
from bayescal.cli.progress import progress
from bayescal.errors import BayescalError


@app.command()
def fit(
    dataset: Path = typer.Argument(..., help="Dataset folder: dataset.yaml, measurements.csv and the robot."),
    model: str = typer.Option("geometry,compliance", help="Effects to fit, comma separated."),
    samples: int = typer.Option(
        5000, min=0, help="Effective draws of every parameter; 0: Gaussian approximation."
    ),
    seed: int = typer.Option(0, help="One seed, one result."),
    out: Path | None = typer.Option(None, help="Run folder to write [default: runs/<dataset>-fit]."),
    robust: bool = typer.Option(True, help="Find outliers and leave them out."),
    prior_width: float = typer.Option(1.0, help="Factor on the widths of the arm's tolerance priors."),
    latent_joints: bool = typer.Option(
        False, "--latent-joints", help="Keep the joint readings as unknowns of the graph."
    ),
) -> None:
    """Calibrate an arm: its parameters, how sure they are, and what error to expect elsewhere."""
    from bayescal.dataset import read_dataset
    from bayescal.folders import check_free

    effects = tuple(name.strip() for name in model.split(",") if name.strip())
    session = read_dataset(dataset)
    folder = out or Path("runs") / f"{dataset.resolve().name}-fit"
    check_free(folder, "fit.json")

    from rich.console import Console

    from bayescal.fit import fit as run
    from bayescal.report.files import write_fit
    from bayescal.report.summary import fit_summary

    console = Console(highlight=False)
    with progress() as told:
        result = run(session, effects, samples, seed, robust, prior_width, latent_joints, told)
        told("write", 1.0)
        write_fit(result, folder)
    console.print(fit_summary(result))
    console.print(f"[dim]written          [/dim]{folder}/fit.json, posterior.nc, robot.yaml")
    if not result.draws.converged:
        raise BayescalError(
            f"the sampler did not converge: {result.draws.complaint}", "--samples", "see fit.json"
        )
