"""Commands before a calibration: `init`, `schema`, `import`, `simulate`, `check`, `robots`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bayescal.cli.root import AllowXacro, app, ending, known, print_as


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
        ..., help="Joint readings, one row per measurement: text in columns, book.xlsx#Sheet, or --format."
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


@app.command(**ending("bayescal check cell", "bayescal check cell --to json"))
def check(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Dataset folder.")],
    to: Annotated[str, typer.Option(help="table or json.")] = "table",
    json: Annotated[bool, typer.Option("--json", hidden=True)] = False,
    allow_xacro: AllowXacro = False,
) -> None:
    """Check a dataset without fitting it: what is understood, what is missing, what looks wrong."""
    from bayescal.public.starting import check as run

    known(to, ("table", "json"))
    print_as("json" if json else to, run(dataset, allow_xacro=allow_xacro))


@app.command(**ending("bayescal robots", "bayescal robots ur10 --to json"))
def robots(
    part: Annotated[str, typer.Argument(metavar="[PART]", help="Only names with this part.")] = "",
    to: Annotated[str, typer.Option(help="table, csv or json.")] = "table",
) -> None:
    """List the built-in robots: joints, reach, masses and the sources of their numbers."""
    from bayescal.robots import table

    known(to, ("table", "csv", "json"))
    found = table(part)
    if to == "csv":
        typer.echo(found.to_csv(lineterminator="\n"), nl=False)
        return
    if to == "json":
        from bayescal.storage.files import json_text

        typer.echo(json_text({"robots": found.reset_index().to_dict("records")}), nl=False)
        return
    from rich.console import Console
    from rich.padding import Padding

    console = Console(highlight=False, markup=False)
    wide = max(map(len, found.index), default=0)
    for name, row in found.iterrows():
        masses = "with masses" if row.masses else "without masses"
        console.print(f"{name:{wide}}  {row.joints} joints  reach {row.reach_mm:4.0f} mm  {masses}")
        console.print(Padding(row.sources, (0, 0, 1, 2)), style="dim")
    console.print(f"{len(found)} built-in robots; any other as robot.yaml or URDF (--robot FILE)")
