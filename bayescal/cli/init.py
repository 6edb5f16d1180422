"""`bayescal init` and `bayescal schema`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import AllowXacro
from bayescal.cli.root import app, ending


@app.command(
    **ending(
        'bayescal init cell --robot ur5e --artefact cube,spheres --tcp "0 0 150 mm"',
        "bayescal init cell --robot arm.urdf --artefact tracker",
        tool="tcp",
    )
)
def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write; new or empty.")],
    robot: Annotated[
        str,
        typer.Option(
            help="Built-in name or a part of it (ur5e), robot.yaml, URDF or xacro; new: a robot.yaml to fill."
        ),
    ],
    artefact: Annotated[
        str, typer.Option(help="cube, spheres, plate, socket, bar, tracker; several separated by commas.")
    ] = "cube",
    tool: Annotated[
        str,
        typer.Option(
            "--tcp", help='Centre of the ball or reflector on the flange, "0 0 120 mm" [default: to fill in].'
        ),
    ] = "",
    name: Annotated[str, typer.Option(help="Name of the session [default: name of the folder].")] = "",
    allow_xacro: AllowXacro = False,
) -> None:
    """Write the set-up of a new session: a commented dataset.yaml, an empty table, and what to measure."""
    from bayescal.public.starting import init as run

    written = run(folder, robot, artefact, tool=tool, name=name, allow_xacro=allow_xacro)
    typer.echo(f"written to {folder}: {', '.join(written)}")
    typer.echo(f"next: read {folder}/README.md; fill in dataset.yaml (values marked !FILL_IN)")


@app.command(**ending("bayescal schema dataset", "bayescal schema robot"))
def schema(
    name: Annotated[str, typer.Argument(metavar="dataset|robot|artefact", help="Which file.")],
) -> None:
    """Print the JSON schema of dataset.yaml, robot.yaml or artefact.yaml, for editors."""
    from bayescal.preparing.artefacts import schema_text

    typer.echo(schema_text(name), nl=False)
