"""`bayescal fit`."""

from __future__ import annotations

from typing import Annotated

import typer

from bayescal.cli.options import (
    AllowXacro,
    Datasets,
    Model,
    Out,
    PriorWidth,
    Remounted,
    Robust,
    Seed,
    Without,
)
from bayescal.cli.output import run_folder, show
from bayescal.cli.progress import progress
from bayescal.cli.root import app, ending
from bayescal.errors import BayescalError


@app.command(
    **ending(
        "bayescal fit cell",
        "bayescal fit monday tuesday --model geometry,compliance,backlash --tolerance-mm 0.1",
    )
)
def fit(
    datasets: Datasets,
    model: Model = "geometry,compliance",
    samples: Annotated[
        int, typer.Option(min=0, help="Effective draws of every parameter; 0: Gaussian approximation.")
    ] = 5000,
    without: Without = "",
    seed: Seed = 0,
    out: Out = None,
    robust: Robust = True,
    prior_width: PriorWidth = 1.0,
    latent_joints: Annotated[
        bool, typer.Option("--latent-joints", help="Estimate the errors of the joint readings as unknowns.")
    ] = False,
    remounted: Remounted = False,
    allow_xacro: AllowXacro = False,
    tolerance_mm: Annotated[
        float | None,
        typer.Option(
            help="Decide whether distance errors are within this tolerance (ISO 14253-1 with U = k u)."
        ),
    ] = None,
    pictures: Annotated[
        bool, typer.Option(help="Write fit-levels.png, -distances, -residuals, -parameters and -posterior.")
    ] = True,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose", "-v", help="Print all distances, all parameters, weak directions and the sampler."
        ),
    ] = False,
) -> None:
    """Calibrate an arm: its parameters with uncertainty, and the expected distance error in its workspace."""
    from bayescal.public.functions import fit as run
    from bayescal.public.results import drawing_beside
    from bayescal.storage.locks import CHECKPOINT, checkpoint_of, remove

    with (
        run_folder(out, datasets, "fit") as folder,
        drawing_beside(pictures),
        progress() as notify,
    ):
        result = run(
            datasets,
            model,
            samples,
            seed,
            robust=robust,
            prior_width=prior_width,
            latent_joints=latent_joints,
            remounted=remounted,
            tolerance_mm=tolerance_mm,
            without=without,
            allow_xacro=allow_xacro,
            progress=notify,
            checkpoint=checkpoint_of(folder),
            say=notify.say,
        )
        notify("write", 0.0)
        written = result.save(folder, pictures)
        if samples:
            remove(checkpoint_of(folder), CHECKPOINT)
    show(result.report(verbose), folder, written)
    if not result.data.draws.converged:
        what = f"the sampler did not converge: {result.data.draws.complaint}"
        raise BayescalError(what, "--samples", "see fit.json")
