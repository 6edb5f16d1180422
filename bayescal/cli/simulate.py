"""`bayescal simulate`: a session on a cube and spheres, with its ground truth in a separate file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import AllowXacro
from bayescal.cli.root import app


@app.command()
def simulate(
    out: Annotated[
        Path, typer.Option("--out", help="Folder to write; an earlier simulated session is replaced.")
    ],
    robot: str = typer.Option("fanuc-lrmate200ic", help="Built-in name, robot.yaml, URDF or xacro."),
    effects: str = typer.Option(
        "geometry,compliance", help="Effects of the simulated arm, separated by commas."
    ),
    error_scale: float = typer.Option(1.0, help="Factor on all errors of the arm."),
    contacts: int = typer.Option(500, help="Plane contacts for calibration, including repeats."),
    later: int = typer.Option(60, help="Plane contacts for validation."),
    repeats: int = typer.Option(15, help="Contacts that are measured four times."),
    spheres: int = typer.Option(3, help="Spheres of the artefact."),
    placements: int = typer.Option(4, help="Placements of the artefact."),
    sphere_contacts: int = typer.Option(11, help="Contacts on each sphere."),
    noise_um: float = typer.Option(5.0, help="Noise of a contact along the normal, µm (standard deviation)."),
    joint_noise_deg: float = typer.Option(0.0, help="Noise of a joint reading, deg (standard deviation)."),
    outliers: float = typer.Option(0.0, help="Fraction of gross outliers."),
    payload: float = typer.Option(
        0.0, metavar="KG", help="Additional payload for half of the plane contacts."
    ),
    seed: int = typer.Option(0, help="Random seed."),
    arm_seed: int | None = typer.Option(
        None, help="Seed of the arm, to simulate several sessions of the same arm [default: --seed]."
    ),
    name: str = typer.Option("", help="Name of the session [default: name of the folder]."),
    allow_xacro: AllowXacro = False,
) -> None:
    """Simulate a session on a cube and spheres; the ground truth is written to a separate file."""
    import math

    from bayescal.folders import claimed
    from bayescal.public.functions import simulate as run
    from bayescal.simulation.folder import TRUTH

    with claimed(out, TRUTH):
        session = run(
            robot,
            effects,
            seed=seed,
            allow_xacro=allow_xacro,
            name=name or out.resolve().name,
            error_scale=error_scale,
            contacts=contacts,
            later=later,
            repeats=repeats,
            spheres=spheres,
            placements=placements,
            sphere_contacts=sphere_contacts,
            noise=noise_um * 1e-6,
            joint_noise=math.radians(joint_noise_deg),
            outliers=outliers,
            payload=payload,
            arm_seed=arm_seed,
        )
        session.save(out)
    typer.echo(str(session))
    typer.echo(f"written to {out}")
