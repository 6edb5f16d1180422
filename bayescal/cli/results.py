"""Commands that use the arm of a run folder: `budget`, `export`, `verify`, `compensate`, `report`."""

from functools import partial
from math import radians
from pathlib import Path
from typing import Any

import typer

from bayescal.cli.root import carried_out, check_format, command, print_as, said, show
from bayescal.errors import BayescalError
from bayescal.exporting import CERTIFICATE, FORMATS
from bayescal.public import arms, console, starting


@command(
    "bayescal budget runs/cell-fit --distance ball1 ball2",
    'bayescal budget runs/cell-fit --point-deg "10,20,-30,40,50,60" --to json',
    point="point-deg",
)
def budget(
    run: Path = typer.Argument(metavar="RUN"),
    distance: tuple[str, str] | None = typer.Option(None, metavar="A B"),
    parameter: str = "",
    point_deg: str = typer.Option("", metavar='"J1,J2,..."'),
    tool: str = "",
    payload_kg: float = 0.0,
    to: str = "table",
) -> None:
    """State the uncertainty budget (JCGM 100) of a distance, a parameter or a point of a run folder.

    Parameters
    ----------
    run
        Run folder of bayescal fit or gap: its arm.json and dataset.
    distance
        Two targets with a centre: the distance between them.
    parameter
        A parameter of the model, such as a2.
    point_deg
        Joint readings, deg, mm of prismatic joints: the TCP there.
    tool
        Tool of the point [default: that of the last fitted row].
    payload_kg
        Additional payload at the point.
    to
        table, csv or json.
    """
    from bayescal.public.budgets import budget as work

    check_format(to, ("table", "csv", "json"))
    point = None
    if point_deg:
        remedy = "give one reading in deg (mm of prismatic joints) for each joint, with commas"
        point = _numbers(point_deg, "--point-deg", f"'{point_deg}' is no list of numbers", remedy)
    result = work(
        run, distance=distance, parameter=parameter, point=point, tool=tool or None, payload_kg=payload_kg
    )
    print_as(to, result)


def _numbers(text: str, option: str, what: str, remedy: str, count: int | None = None) -> list[float]:
    """Numbers with commas between them, of which there must be `count`."""
    try:
        out = [float(part) for part in text.split(",")]
    except ValueError:
        raise BayescalError(what, option, remedy) from None
    if count not in (None, len(out)):
        raise BayescalError(what, option, remedy)
    return out


@command(
    "bayescal export runs/cell-fit --to urdf --into arm.urdf#tool0",
    "bayescal export runs/cell-gap --to mjcf --with backlash --out arm.xml",
    calls=arms.export,
    at_time="at-time-s",
)
def export(
    run: Path = typer.Argument(metavar="RUN"),
    to: str = typer.Option(help=f"Format: {', '.join((*FORMATS, CERTIFICATE))}."),
    out: Path | None = None,
    at_time_s: float | None = None,
    certificate: str = "",
    schema: str = "",
    **options: Any,
) -> None:
    """Export the arm of a run folder of fit or gap, and state what the file cannot hold.

    Parameters
    ----------
    run
        As of `budget`.
    out
        File to write [default: the robot's name with the format's suffix].
    into
        Your own file of the arm, which is patched in a copy: names, comments, meshes and order stay.
        arm.urdf#tool0 names the link that carries the tool.
    with_
        Effects to add to the model of the run, separated by commas: the session is fitted again.
    without
        Effects of the model of the run to leave out, or parts of them ('geometry at joint 4', 'compliance
        J3'), separated by commas: the session is fitted again.
    readings
        mjcf: errors of the readings in the file (plain) or in a replay script (script).
    at_time_s
        Time since the session began at which the file holds (drift, step).
    at_row
        id of the row at which it holds [default: the last fitted row].
    certificate
        dcc: YAML file with the administrative data of the certificate.
    schema
        dcc: a copy of dcc.xsd, with SI_Format.xsd beside it, to validate by.
    force
        Export in spite of reasons against it.
    """
    from bayescal.public import budgets

    result: budgets.CertificateResult | arms.ExportResult
    if to == CERTIFICATE:
        force, readings = options.pop("force"), options.pop("readings")
        if readings != "plain" or at_time_s is not None or any(options.values()):
            what = "a certificate states the arm as it was fitted"
            raise BayescalError(what, "--to dcc", "leave out the options of other formats")
        result = budgets.certificate(run, certificate, schema=schema, force=force)
    else:
        if certificate or schema:
            what = f"{to} has no administrative data"
            raise BayescalError(what, "--certificate", "use it with --to dcc")
        result = arms.export(run, to, at_time=at_time_s, **options)
    written = result.save(out)
    terminal = console()
    terminal.print(result.report())
    said(terminal, "written", ", ".join(map(str, written)))


@command(
    "bayescal verify runs/cell-fit arm.xml", "bayescal verify runs/cell-fit arm.urdf --out runs/arm-verify"
)
def verify(
    run: Path = typer.Argument(metavar="RUN"),
    file: Path = typer.Argument(metavar="FILE"),
    out: Path | None = None,
) -> None:
    """Load an exported arm in its simulator: against the fitted arm, and against the measurements.

    Parameters
    ----------
    run
        Run folder of bayescal fit or gap.
    file
        File written by bayescal export.
    out
        Run folder to write [default: runs/<file>-verify].
    """
    work = partial(arms.verify, run, file)
    result, _ = carried_out(work, out, [file.with_suffix("")], "verify")
    if not result.passed:
        raise typer.Exit(1)


@command(
    "bayescal compensate runs/cell-fit targets.csv --out corrected.csv",
    "bayescal compensate runs/cell-fit weld.ls --out weld-corrected.ls --payload-kg 2.5",
    calls=arms.compensate,
    at_time="at-time-s",
)
def compensate(
    run: Path = typer.Argument(metavar="RUN"),
    targets: Path = typer.Argument(metavar="TARGETS"),
    out: Path = typer.Option(),
    format_: str = "",
    tcp: str = typer.Option("", metavar="X,Y,Z,RX,RY,RZ"),
    payload_kg: float = typer.Option(0.0, min=0.0),
    at_time_s: float | None = None,
    **options: Any,
) -> None:
    """Correct targets or a robot program for all fitted effects of an arm.

    Parameters
    ----------
    run
        As of `export`.
    targets
        CSV with x_mm, y_mm, z_mm, rx_deg, ry_deg, rz_deg or j1_deg ...; or a robot program: URScript, FANUC
        LS, KUKA .src or .dat, ABB RAPID, RoboDK CSV.
    out
        File to write: the same with corrected positions.
    format_
        csv, urscript, fanuc, kuka, abb or robodk [default: by the name].
    frame
        Frame of the poses: base, or a target of the session [default: base].
    tool
        Tool of the session that is brought to the targets.
    tcp
        Another tool than those of the session: mm, and fixed-axis roll, pitch, yaw in deg, in the frame of
        the flange. A negative X: --tcp=-1,2,...
    payload_kg
        Additional payload, where the table states none.
    with_, without
        As of `export`.
    at_time_s
        Time of the session whose state of the arm holds (drift, step).
    at_row
        id of the row whose state holds [default: the last fitted row].
    force
        Compensate in spite of reasons against the arm.
    """
    arms.check_out(out, targets)
    frame_of_tool = None  # x, y, z in m, and roll, pitch, yaw in rad
    if tcp:
        remedy = "give X,Y,Z,RX,RY,RZ in mm and deg, with commas"
        numbers = _numbers(tcp, "--tcp", f"`{tcp}` is not six numbers", remedy, 6)
        frame_of_tool = [*(1e-3 * mm for mm in numbers[:3]), *map(radians, numbers[3:])]
    options |= {"format": format_, "tcp": frame_of_tool, "payload_kg": payload_kg, "at_time": at_time_s}
    result = arms.compensate(run, targets, **options)
    show(result.report(), out.parent, result.save(out))
    lacking = [target for target in result.data.corrected if target.readings is None]
    if lacking and len(lacking) == len(result.data.corrected):
        raise BayescalError("no target has a solution", str(out), "its column `reason` states why")


@command(
    "bayescal report runs/cell-fit --pdf", "bayescal report runs/monday-fit runs/tuesday-fit --out both.html"
)
def report(
    runs: list[Path] = typer.Argument(metavar="RUN..."),
    out: Path | None = typer.Option(None, metavar="FILE"),
    pdf: bool = False,
) -> None:
    """Write the page of a run again, or a page of several runs side by side.

    Parameters
    ----------
    runs
        Run folders of bayescal fit or gap; several are compared.
    out
        HTML file to write [default: report.html or gap.html of the run folder; of several runs
        runs/<names>-report.html].
    pdf
        Also print a PDF, by Chromium or Chrome.
    """
    for path in starting.report(runs, out, pdf=pdf):
        typer.echo(f"written          {path}")
