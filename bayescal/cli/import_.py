"""`bayescal import`: convert a log of a controller, an instrument or RoboDK to a dataset folder."""

from __future__ import annotations

from pathlib import Path

import typer

from bayescal.cli.options import AllowXacro
from bayescal.cli.root import app, ending


@app.command(
    "import",
    **ending(
        'bayescal import log.csv --map "j*=A* deg, x=X mm, y=Y mm, z=Z mm" --robot ur5e --out cell',
        "bayescal import log.csv --plan runs/cell-plan --template cell --out cell-measured",
        tool="tcp",
    ),
)
def import_(
    log: Path = typer.Argument(
        ...,
        help="Joint readings, one row per measurement: text in columns, book.xlsx#Sheet, or --format.",
    ),
    out: Path = typer.Option(..., help="Dataset folder to write; new or empty."),
    map_: str = typer.Option(
        "",
        "--map",
        help='Contents of the columns: "j*=A* deg, x=X mm, id=Point", or a .yaml file with such entries.',
    ),
    robot: str = typer.Option("", help="Built-in name or file [default: robot of the template]."),
    format_: str = typer.Option(
        "csv",
        "--format",
        help="csv (with --map); without a map robodk, ur-rtde, probing (log of a probing program, recognised "
        "with --plan), fanuc-ls, fanuc-va, kuka-dat, abb-mod.",
    ),
    points: list[Path] = typer.Option(
        [],
        help="File with the points of the instrument, or with conditions such as a temperature; repeatable.",
    ),
    points_map: list[str] = typer.Option(
        [],
        help="Unit of the points if rows are names, x, y, z; else a map: id=#1, x=#2 mm, ...; for each file, "
        "or one for all.",
    ),
    pair: str = typer.Option(
        "row", help="How points are assigned to readings: row, id, or time:0.5 s (nearest, with a tolerance)."
    ),
    template: Path | None = typer.Option(
        None, help="dataset.yaml, or its folder, with tools, targets and noise of the session."
    ),
    plan: Path | None = typer.Option(
        None,
        help="Run folder of bayescal plan: rows of the log are its contacts, by id. A log with columns of "
        "measurements.csv (j1_deg, x_mm, ...) needs no map.",
    ),
    tool: str = typer.Option(
        "",
        "--tcp",
        help='Position of the reflector on the flange, "0 0 31 mm", and orientation of its frame if stated: '
        '"0 0 31 mm; 0 0 90 wpr deg" [default: estimated].',
    ),
    noise: str = typer.Option(
        "",
        help='Standard uncertainty of a coordinate of the instrument, and of an angle: "0.03 mm, 0.01 deg".',
    ),
    readings: str = typer.Option("encoder", help="Contents of the joint columns: encoder or command."),
    validate: str = typer.Option(
        "",
        help="Validation data, whole stops: every:5, last:20%, targets 'ball.*', stops 'b*' [default: column "
        "role, or none].",
    ),
    decimal: str = typer.Option(
        "", help="comma: numbers such as 1,234 have a decimal comma [default: found, or asked for]."
    ),
    name: str = typer.Option("", help="Name of the session [default: name of the log]."),
    force: bool = typer.Option(
        False, "--force", help="Write the dataset even if a check fails (for example a wrong unit)."
    ),
    allow_xacro: AllowXacro = False,
) -> None:
    """Convert a log to a dataset folder. Units must be stated and are checked."""
    from bayescal.importing import Request, convert, write

    request = Request(
        log=log,
        map=map_,
        format=format_,
        robot=robot,
        points=points,
        points_map=points_map or "",
        pair=pair,
        template=template,
        plan=plan,
        tool=tool,
        noise=noise,
        readings=readings,
        name=name,
        validate=validate,
        decimal=decimal,
        allow_xacro=allow_xacro,
    )
    draft = convert(request)
    write(draft, out, force)
    rows = len(draft.line)
    typer.echo(f"{rows} rows of {draft.dataset.robot.name} from {draft.log}")
    failed = [f"WRITTEN DESPITE A FAILED CHECK: {draft.wrong}"] if draft.wrong else []
    for note in (*draft.understood, *draft.notes, *failed):
        typer.echo(note)
    typer.echo(f"written to {out}")
