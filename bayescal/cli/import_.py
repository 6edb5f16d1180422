"""`bayescal import`: a log of a controller, an instrument or RoboDK to a dataset folder."""

from __future__ import annotations

from pathlib import Path

import typer

from bayescal.cli import app
from bayescal.cli.options import AllowXacro


@app.command("import")
def import_(
    log: Path = typer.Argument(..., help="Joint readings, one row a measurement: CSV, or text in columns."),
    out: Path = typer.Option(..., help="Dataset folder to write; new or empty."),
    map_: str = typer.Option(
        "", "--map", help='What its columns hold: "j*=A* deg, x=X mm, id=Point", or a .yaml of such entries.'
    ),
    robot: str = typer.Option("", help="Built-in name, or a file; the template's where left out."),
    format_: str = typer.Option(
        "csv", "--format", help="csv, or robodk: a calibration table, no map needed."
    ),
    points: Path | None = typer.Option(None, help="An instrument's points in a file of their own."),
    points_map: str = typer.Option(
        "", help="Their unit, where rows are names, then x y z; or a map: id=#1, x=#2 mm, ..."
    ),
    pair: str = typer.Option("row", help="How points and readings go together: row, or id."),
    template: Path | None = typer.Option(
        None, help="dataset.yaml, or its folder, with the tools, targets and noise of this session."
    ),
    tool: str = typer.Option("", help='Reflector on the flange, "0 0 31 mm"; found where left out.'),
    noise: str = typer.Option("", help='Standard uncertainty of a coordinate of the instrument: "0.03 mm".'),
    readings: str = typer.Option("encoder", help="encoder or command: what the joint columns hold."),
    name: str = typer.Option("", help="Name of the session; that of the log where left out."),
    force: bool = typer.Option(False, "--force", help="Write also what cannot be, such as a wrong unit."),
    allow_xacro: AllowXacro = False,
) -> None:
    """Turn a log into a dataset folder; units are asked for, and wrong ones found out."""
    from bayescal.importing import Request, convert, write

    request = Request(
        log=log,
        map=map_,
        format=format_,
        robot=robot,
        points=points,
        points_map=points_map,
        pair=pair,
        template=template,
        tool=tool,
        noise=noise,
        readings=readings,
        name=name,
        allow_xacro=allow_xacro,
    )
    draft = convert(request)
    write(draft, out, force)
    rows = len(draft.dataset.measurements.ids)
    typer.echo(f"{rows} rows of {draft.dataset.robot.name} from {draft.log}")
    for note in (*draft.notes, *([f"WRITTEN AS IT IS: {draft.wrong}"] if draft.wrong else [])):
        typer.echo(note)
    typer.echo(f"written to {out}")
