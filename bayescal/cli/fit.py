"""`bayescal fit`."""

from __future__ import annotations

from pathlib import Path

import typer

from bayescal.cli import app
from bayescal.cli.options import AllowXacro
from bayescal.cli.progress import progress
from bayescal.errors import BayescalError


@app.command()
def fit(
    datasets: list[Path] = typer.Argument(
        ...,
        metavar="DATASET...",
        help="Dataset folder with dataset.yaml, measurements.csv and the robot. Several sessions of the same "
        "arm are fitted together.",
    ),
    model: str = typer.Option("geometry,compliance", help="Effects to fit, separated by commas."),
    samples: int = typer.Option(
        5000, min=0, help="Effective draws of every parameter; 0: Gaussian approximation."
    ),
    seed: int = typer.Option(0, help="Random seed."),
    out: Path | None = typer.Option(
        None, help="Run folder to write [default: runs/<dataset>-fit; several names are joined by +]."
    ),
    robust: bool = typer.Option(True, help="Exclude outliers."),
    prior_width: float = typer.Option(1.0, help="Factor on the standard deviations of the arm's prior."),
    latent_joints: bool = typer.Option(
        False, "--latent-joints", help="Estimate the errors of the joint readings as unknowns."
    ),
    remounted: bool = typer.Option(
        False, "--remounted", help="The tools were remounted between the sessions."
    ),
    allow_xacro: AllowXacro = False,
    tolerance_mm: float | None = typer.Option(
        None, help="Decide whether distance errors are within this tolerance (ISO 14253-1, U with k = 2)."
    ),
    verbose: bool = typer.Option(
        False, "--verbose", "-v", help="Print all distances, all parameters, weak directions and the sampler."
    ),
) -> None:
    """Calibrate an arm: its parameters with uncertainty, and the expected distance error in its workspace."""
    from bayescal.cli.sessions import read_sessions
    from bayescal.folders import check_free

    effects = tuple(name.strip() for name in model.split(",") if name.strip())
    session, name = read_sessions(datasets, remounted, allow_xacro=allow_xacro)
    folder = out or Path("runs") / f"{name}-fit"
    check_free(folder, "fit.json")

    from rich.console import Console, Group

    from bayescal.assess.agreement import agreement
    from bayescal.calibration import fit as run
    from bayescal.reporting.fit.agreement import agreement_summary
    from bayescal.reporting.fit.files import write_fit
    from bayescal.reporting.fit.summary import fit_summary

    console = Console(highlight=False)
    tolerance = None if tolerance_mm is None else 1e-3 * tolerance_mm
    with progress() as told:
        result = run(session, effects, samples, seed, robust, prior_width, latent_joints, told, tolerance)
        compared = None
        if session.sessions:
            told("compare", 1.0)
            compared = agreement(result.final.estimate, effects, prior_width, robust)
        told("write", 1.0)
        write_fit(result, folder, compared)
    console.print(fit_summary(result, verbose))
    if compared is not None:
        console.print(Group("", agreement_summary(compared)))
    console.print(f"[dim]written          [/dim]{folder}/fit.json, posterior.nc, robot.yaml", soft_wrap=True)
    if not result.draws.converged:
        raise BayescalError(
            f"the sampler did not converge: {result.draws.complaint}", "--samples", "see fit.json"
        )
