"""`bayescal simulate`: a session on a cube and spheres, with its truth apart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli import app
from bayescal.cli.options import AllowXacro


@app.command()
def simulate(
    out: Annotated[
        Path, typer.Option("--out", help="Folder to write; an earlier simulated session is replaced.")
    ],
    robot: str = typer.Option("fanuc-lrmate200ic", help="Built-in name, robot.yaml, URDF or xacro."),
    effects: str = typer.Option("geometry,compliance", help="What is wrong with the true arm."),
    error_scale: float = typer.Option(1.0, help="Factor on every error of the arm."),
    contacts: int = typer.Option(500, help="Plane contacts to calibrate with, repeats among them."),
    later: int = typer.Option(60, help="Plane contacts to validate with, later."),
    repeats: int = typer.Option(15, help="Contacts that are made four times."),
    spheres: int = typer.Option(3, help="Spheres of the artefact."),
    placements: int = typer.Option(4, help="Places where the artefact is put."),
    sphere_contacts: int = typer.Option(11, help="Contacts on each sphere."),
    noise_um: float = typer.Option(5.0, help="Noise of a contact along the normal, 1 sigma."),
    joint_noise_deg: float = typer.Option(0.0, help="Noise of a joint reading, 1 sigma."),
    outliers: float = typer.Option(0.0, help="Fraction of contacts that are grossly wrong."),
    payload: float = typer.Option(0.0, metavar="KG", help="Mass on half of the plane contacts."),
    seed: int = typer.Option(0, help="One seed, one session."),
    arm_seed: int | None = typer.Option(
        None, help="Seed of the arm, for another session of the same one [default: that of the session]."
    ),
    name: str = typer.Option("", help="Name of the session; that of the folder where left out."),
    allow_xacro: AllowXacro = False,
) -> None:
    """Simulate a session on a cube and spheres, and write its truth apart."""
    import math

    from bayescal.folders import check_free
    from bayescal.simulation import Options
    from bayescal.simulation import simulate as run
    from bayescal.simulation.folder import TRUTH, summary, write

    check_free(out, TRUTH)
    options = Options(
        robot=robot,
        effects=tuple(part.strip() for part in effects.split(",") if part.strip()),
        name=name or out.resolve().name,
        seed=seed,
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
    simulation = run(options, allow_xacro)
    write(simulation, out)
    typer.echo(summary(simulation))
    typer.echo(f"written to {out}")
