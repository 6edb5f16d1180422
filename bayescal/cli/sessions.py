"""Commands before a calibration: `init`, `schema`, `import`, `simulate`, `check`, `robots`."""

import shlex
from pathlib import Path
from typing import Any

import typer

from bayescal.cli.root import check_format, command, print_as
from bayescal.errors import BayescalError
from bayescal.public import console, functions, starting


@command(
    'bayescal init cell --robot ur5e --artefact cube,spheres --tcp "0 0 150 mm"',
    "bayescal init cell --robot arm.urdf --artefact tracker",
    calls=starting.init,
    tool="tcp",
)
def init(
    folder: Path = typer.Argument(metavar="DIR"), robot: str = typer.Option(), tcp: str = "", **options: Any
) -> None:
    """Write the set-up of a new session: a commented dataset.yaml, an empty table, and what to measure.

    Parameters
    ----------
    folder
        Folder to write; new or empty.
    robot
        Built-in name or a part of it (ur5e), robot.yaml, URDF or xacro; new: a robot.yaml to fill.
    artefact
        cube, spheres, plate, socket, bar, tracker; several separated by commas.
    tcp
        Centre of the ball or reflector on the flange, "0 0 120 mm" [default: to fill in].
    name
        Name of the session [default: name of the folder].
    allow_xacro
        As of `fit`.
    """
    written = starting.init(folder, robot, tool=tcp, **options)
    typer.echo(f"written to {folder}: {', '.join(written)}")
    typer.echo(f"next: read {folder}/README.md; fill in dataset.yaml (values marked !FILL_IN)")


@command("bayescal schema dataset", "bayescal schema robot")
def schema(name: str = typer.Argument(metavar="dataset|robot|artefact")) -> None:
    """Print the JSON schema of dataset.yaml, robot.yaml or artefact.yaml, for editors.

    Parameters
    ----------
    name
        Which file.
    """
    from bayescal.preparing.artefacts import schema_text

    typer.echo(schema_text(name), nl=False)


@command(
    'bayescal import log.csv --map "j*=A* deg, x=X mm, y=Y mm, z=Z mm" --robot ur5e --out cell',
    "bayescal import log.csv --plan runs/cell-plan --template cell --out cell-measured",
    name="import",
    tool="tcp",
)
def import_(
    log: Path = typer.Argument(),
    out: Path = typer.Option(),
    format_: str = "csv",
    points: list[Path] = typer.Option([]),
    points_map: list[str] = typer.Option([]),
    pair: str = "row",
    template: Path | None = None,
    plan: Path | None = None,
    readings: str = "encoder",
    table: str = "csv",
    calibration: Path | None = None,
    force: bool = False,
    **options: Any,
) -> None:
    """Convert a log to a dataset folder. Units must be stated and are checked.

    Parameters
    ----------
    log
        Joint readings, one row per measurement: text in columns, book.xlsx#Sheet, or --format. Joint logs
        also: a ROS bag (.mcap, .db3, .bag), a LeRobot or SAGE folder, a folder of such files.
    out
        Dataset folder to write; new or empty.
    map_
        Contents of the columns: "j*=A* deg, x=X mm, id=Point", or a .yaml file with such entries.
    robot
        Built-in name or file [default: robot of the template].
    format_
        csv (with --map); without a map robodk, ur-rtde, probing (log of a probing program, recognised with
        --plan), fanuc-ls, fanuc-va, kuka-dat, abb-mod. Joint logs: csv, ur-rtde, rosbag, lerobot, sage; the
        last three are recognised.
    points
        File with the points of the instrument, or with conditions such as a temperature; repeatable.
    points_map
        Unit of the points if rows are names, x, y, z; else a map: id=#1, x=#2 mm, ...; for each file, or one
        for all.
    pair
        How points are assigned to readings: row, id, or time:0.5 s (nearest, with a tolerance).
    template
        dataset.yaml, or its folder, with tools, targets and noise of the session.
    plan
        Run folder of bayescal plan: rows of the log are its contacts, by id. A log with columns of
        measurements.csv (j1_deg, x_mm, ...) needs no map.
    tcp
        Position of the reflector on the flange, "0 0 31 mm", and orientation of its frame if stated:
        "0 0 31 mm; 0 0 90 wpr deg" [default: estimated].
    noise
        Standard uncertainty of a coordinate of the instrument, and of an angle: "0.03 mm, 0.01 deg".
    readings
        Contents of the joint columns: encoder or command.
    validate
        Validation data, whole stops: every:5, last:20%, targets 'ball.*', stops 'b*' [default: column role,
        or none]. Joint log: every:5, last:20%, motions '7,8', kind 'pick*' [default: the last kind, or 20 %].
    decimal
        comma: numbers such as 1,234 have a decimal comma [default: found, or asked for].
    name
        Name of the session [default: name of the log].
    motions
        Joint log: how it is divided into motions: files (each file, bag or episode), pause:2 s, or column
        (map `motion`) [default: column, else files].
    joints
        Joint log: names of the joints in the log, in the order of the robot [default: found by name]. Images:
        table with image, j1_deg, j2_deg, ...
    board
        Images (LOG is their folder): the board, charuco:7x5:30mm:22mm, checkerboard:9x6:25mm or
        apriltag:36h11:40mm. Needs OpenCV (bayescal[camera]).
    torque
        Joint log: motor, sensor or current, with constants "current: 11.4 11.4 9.9 ..." (N m/A at the joints)
        [default: as the format states].
    topic
        Joint log: topic of a bag with the rows, if several have joint positions.
    table
        Joint log: csv (motion.csv.gz) or parquet.
    calibration
        LeRobot's calibration of the servos (JSON): readings in steps, deg or normalised become angles by it.
    force
        Write the dataset even if a check fails (for example a wrong unit).
    allow_xacro
        As of `fit`.
    """
    given = dict(locals())
    from bayescal.importing import Request, convert, write

    given |= given.pop("options")
    del given["out"], given["force"]  # the others are fields of the request
    given |= {"tool": given.pop("tcp"), "points_map": points_map or ""}
    draft = convert(Request(**{name.rstrip("_"): value for name, value in given.items()}))
    write(draft, out, force)
    typer.echo(draft.headline)
    failed = [f"WRITTEN DESPITE A FAILED CHECK: {draft.wrong}"] if draft.wrong else []
    for note in (*draft.understood, *draft.notes, *failed):
        typer.echo(note)
    typer.echo(f"written to {out}; next: bayescal check {shlex.quote(str(out))}")


@command(
    "bayescal simulate --out practice --effects geometry,compliance,backlash --seed 7",
    "bayescal simulate --setup cell --out cell-practice",
    payload="payload-kg",
)
def simulate(
    context: typer.Context,
    out: Path = typer.Option(),
    robot: str = "fanuc-lrmate200ic",
    effects: str = "geometry,compliance",
    error_scale: float = 1.0,
    contacts: int = 500,
    later: int = 60,
    repeats: int = 15,
    spheres: int = 3,
    placements: int = 4,
    sphere_contacts: int = 11,
    noise_um: float = 5.0,
    joint_noise_deg: float = 0.0,
    outliers: float = 0.0,
    payload_kg: float = 0.0,
    seed: int = 0,
    arm_seed: int | None = None,
    name: str = "",
    setup: Path | None = typer.Option(None, metavar="DIR"),
    allow_xacro: bool = False,
) -> None:
    """Simulate a session on a cube and spheres, or on a set-up; the ground truth is a separate file.

    Parameters
    ----------
    out
        Folder to write; an earlier simulated session is replaced.
    robot
        Built-in name, robot.yaml, URDF or xacro.
    effects
        Effects of the simulated arm, separated by commas.
    error_scale
        Factor on all errors of the arm, at most 4.
    contacts
        Plane contacts for calibration, including repeats.
    later
        Plane contacts for validation.
    repeats
        Contacts that are measured four times.
    spheres
        Spheres of the artefact.
    placements
        Placements of the artefact.
    sphere_contacts
        Contacts on each sphere.
    noise_um
        Noise of a contact along the normal (standard deviation).
    joint_noise_deg
        Noise of a joint reading (standard deviation).
    outliers
        Fraction of gross outliers.
    payload_kg
        Additional payload for half of the plane contacts.
    seed
        As of `fit`.
    arm_seed
        Seed of the arm, to simulate several sessions of the same arm [default: --seed].
    name
        Name of the session [default: name of the folder].
    setup
        Practice on a set-up of bayescal init: its robot, tools, targets and noise are simulated.
    allow_xacro
        As of `fit`.
    """
    given = dict(locals())
    import math

    from bayescal.simulation.record import TRUTH
    from bayescal.storage.folders import claimed

    with claimed(out, TRUTH):
        options = {key: given[key] for key in functions.PRACTICE} | {"name": name or out.resolve().name}
        if setup is not None:
            _check_given(context)
        else:
            of_artefact = ("spheres", "placements", "sphere_contacts", "outliers")
            options |= {key: given[key] for key in of_artefact}
            options |= {"noise": noise_um * 1e-6, "joint_noise": math.radians(joint_noise_deg)}
            options["payload"] = payload_kg
        session = functions.simulate(
            robot, effects, seed=seed, allow_xacro=allow_xacro, setup=setup, **options
        )
        session.save(out)
    typer.echo(str(session))
    typer.echo(f"written to {out}")


def _check_given(context: typer.Context) -> None:
    """Refuse options that a set-up states itself."""
    applies = {*functions.PRACTICE, "out", "effects", "seed", "setup", "allow_xacro"}
    for name in context.params:
        source = context.get_parameter_source(name)
        if name not in applies and source is not None and source.name == "COMMANDLINE":
            option = f"--{name.replace('_', '-')}"
            raise BayescalError("a set-up states it itself", option, "change dataset.yaml, or omit --setup")


@command("bayescal check cell", "bayescal check cell --to json")
def check(
    dataset: Path = typer.Argument(metavar="DATASET"),
    to: str = "table",
    json: bool = typer.Option(False, "--json", hidden=True),
    calibration: list[Path] = typer.Option([]),
    allow_xacro: bool = False,
) -> None:
    """Check a dataset or a joint log without fitting it: what is understood, missing, and what looks wrong.

    Ends with exit code 1 if `fit` would refuse it.

    Parameters
    ----------
    dataset
        Dataset folder, or that of a joint log.
    to
        table or json.
    calibration
        Joint log: LeRobot's calibration of its servos (JSON), and others to compare with it; repeatable.
    allow_xacro
        As of `fit`.
    """
    check_format(to, ("table", "json"))
    result = starting.check(dataset, calibration=calibration, allow_xacro=allow_xacro)
    print_as("json" if json else to, result)
    if any(f.kind == "refused" for f in result.data.findings):
        raise typer.Exit(1)


@command("bayescal robots", "bayescal robots ur10 --to json")
def robots(part: str = typer.Argument("", metavar="[PART]"), to: str = "table") -> None:
    """List the built-in robots: joints, reach, masses and the sources of their numbers.

    Parameters
    ----------
    part
        Only names with this part.
    to
        table, csv or json.
    """
    from bayescal.robots import table

    check_format(to, ("table", "csv", "json"))
    listed = table(part)
    if to == "csv":
        typer.echo(listed.to_csv(lineterminator="\n"), nl=False)
        return
    if to == "json":
        from bayescal.storage.files import json_text

        typer.echo(json_text({"robots": listed.reset_index().to_dict("records")}), nl=False)
        return
    from rich.padding import Padding

    terminal, wide = console(), max(map(len, listed.index), default=0)
    for name, row in listed.iterrows():
        masses = "with masses" if row.masses else "without masses"
        terminal.print(f"{name:{wide}}  {row.joints} joints  reach {row.reach_mm:4.0f} mm  {masses}")
        terminal.print(Padding(row.sources, (0, 0, 1, 2)), style="dim")
    terminal.print(f"{len(listed)} built-in robots; any other as robot.yaml or URDF (--robot FILE)")
