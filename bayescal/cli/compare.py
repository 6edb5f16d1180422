"""`bayescal compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import AllowXacro, Model, Out, Seed
from bayescal.cli.output import run_folder, show
from bayescal.cli.progress import progress
from bayescal.cli.root import app, ending


@app.command(
    **ending(
        "bayescal compare data/lrmate200ic-cube",
        "bayescal compare cell --model geometry --out runs/cell-geometry",
    )
)
def compare(
    dataset: Annotated[
        Path, typer.Argument(help="Dataset folder: dataset.yaml, measurements.csv and the robot.")
    ],
    model: Model = "geometry,compliance",
    seed: Seed = 0,
    out: Out = None,
    allow_xacro: AllowXacro = False,
) -> None:
    """Calibrate by several published methods, and compare their errors on the same validation data."""
    from bayescal.public.functions import compare as run

    with run_folder(out, [dataset], "compare") as folder, progress("compare") as notify:
        result = run(dataset, model, seed, allow_xacro=allow_xacro, progress=notify)
        written = result.save(folder)
    show(result.report(), folder, written)
