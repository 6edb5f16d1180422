"""`bayescal simulate`: a session on a cube and spheres, with its ground truth in a separate file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bayescal.cli.options import AllowXacro
from bayescal.cli.root import app, ending


@app.command(
    **ending(
        "bayescal simulate --out practice --effects geometry,compliance,backlash --seed 7",
        "bayescal simulate --setup cell --out cell-practice",
        payload="payload-kg",
    )
)
def simulate(
    context: typer.Context,
    out: Annotated[
        Path, typer.Option("--out", help="Folder to write; an earlier simulated session is replaced.")
    ],
    robot: str = typer.Option("fanuc-lrmate200ic", help="Built-in name, robot.yaml, URDF or xacro."),
    effects: str = typer.Option(
        "geometry,compliance", help="Effects of the simulated arm, separated by commas."
    ),
    error_scale: float = typer.Option(1.0, help="Factor on all errors of the arm, at most 4."),
    contacts: int = typer.Option(500, help="Plane contacts for calibration, including repeats."),
    later: int = typer.Option(60, help="Plane contacts for validation."),
    repeats: int = typer.Option(15, help="Contacts that are measured four times."),
    spheres: int = typer.Option(3, help="Spheres of the artefact."),
    placements: int = typer.Option(4, help="Placements of the artefact."),
    sphere_contacts: int = typer.Option(11, help="Contacts on each sphere."),
    noise_um: float = typer.Option(5.0, help="Noise of a contact along the normal (standard deviation)."),
    joint_noise_deg: float = typer.Option(0.0, help="Noise of a joint reading (standard deviation)."),
    outliers: float = typer.Option(0.0, help="Fraction of gross outliers."),
    payload: float = typer.Option(
        0.0, "--payload-kg", help="Additional payload for half of the plane contacts."
    ),
    seed: int = typer.Option(0, help="Random seed."),
    arm_seed: int | None = typer.Option(
        None, help="Seed of the arm, to simulate several sessions of the same arm [default: --seed]."
    ),
    name: str = typer.Option("", help="Name of the session [default: name of the folder]."),
    setup: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Practice on a set-up of bayescal init: its robot, tools, targets and noise are simulated.",
        ),
    ] = None,
    allow_xacro: AllowXacro = False,
) -> None:
    """Simulate a session on a cube and spheres, or on a set-up; the ground truth is a separate file."""
    import math

    from bayescal.public.functions import simulate as run
    from bayescal.simulation.record import TRUTH
    from bayescal.storage.folders import claimed

    with claimed(out, TRUTH):
        if setup is not None:
            _check_given(context)
        stated: dict[str, Any] = {
            "name": name or out.resolve().name,
            "error_scale": error_scale,
            "contacts": contacts,
            "later": later,
            "repeats": repeats,
            "arm_seed": arm_seed,
        }
        artefact: dict[str, Any] = {
            "spheres": spheres,
            "placements": placements,
            "sphere_contacts": sphere_contacts,
            "noise": noise_um * 1e-6,
            "joint_noise": math.radians(joint_noise_deg),
            "outliers": outliers,
            "payload": payload,
        }
        options = stated | (artefact if setup is None else {})
        session = run(robot, effects, seed=seed, allow_xacro=allow_xacro, setup=setup, **options)
        session.save(out)
    typer.echo(str(session))
    typer.echo(f"written to {out}")


def _check_given(context: typer.Context) -> None:
    """Refuse options that a set-up states itself."""
    from bayescal.errors import BayescalError
    from bayescal.public.functions import PRACTICE

    applies = {*PRACTICE, "out", "effects", "seed", "setup", "allow_xacro"}
    for name in context.params:
        source = context.get_parameter_source(name)
        if name not in applies and source is not None and source.name == "COMMANDLINE":
            option = f"--{name.replace('_', '-')}"
            raise BayescalError("a set-up states it itself", option, "change dataset.yaml, or omit --setup")
