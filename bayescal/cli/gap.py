"""`bayescal gap`."""

from __future__ import annotations

import shlex
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


@app.command(
    **ending(
        "bayescal gap cell", "bayescal gap cell --without 'compliance at joint 3' --out runs/cell-stiff-wrist"
    )
)
def gap(
    datasets: Datasets,
    model: Model = "geometry,compliance",
    without: Without = "",
    seed: Seed = 0,
    out: Out = None,
    robust: Robust = True,
    prior_width: PriorWidth = 1.0,
    remounted: Remounted = False,
    pictures: Annotated[
        bool, typer.Option(help="Write gap-where.png, -which, -levels and -residuals.")
    ] = True,
    allow_xacro: AllowXacro = False,
) -> None:
    """Diagnose the difference between model and machine: size, location, effect, improvement."""
    from bayescal.public.functions import diagnose
    from bayescal.public.results import drawing_beside

    with (
        run_folder(out, datasets, "gap") as folder,
        drawing_beside(pictures),
        progress() as notify,
    ):
        result = diagnose(
            datasets,
            model,
            seed,
            without=without,
            robust=robust,
            prior_width=prior_width,
            remounted=remounted,
            allow_xacro=allow_xacro,
            progress=notify,
        )
        notify("write", 0.0)
        written = result.save(folder, pictures)
    show(result.report(), folder, written)
    if result.undecided and len(datasets) == 1:
        words = [
            "bayescal",
            "plan",
            str(datasets[0]),
            "--after",
            str(folder),
            "--for",
            "gap",
            "--contacts",
            "60",
        ]
        typer.echo(f"to discriminate  {shlex.join(words)}")
