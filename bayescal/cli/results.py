"""Commands that use the arm of a run folder: `budget`, `export`, `verify`, `compensate`, `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.progress import progress
from bayescal.cli.root import Run, WithEffects, WithoutEffects, app, ending, known, print_as, said, show
from bayescal.errors import BayescalError
from bayescal.exporting import CERTIFICATE, FORMATS


@app.command(
    **ending(
        "bayescal budget runs/cell-fit --distance ball1 ball2",
        'bayescal budget runs/cell-fit --point-deg "10,20,-30,40,50,60" --to json',
        point="point-deg",
    )
)
def budget(
    run: Run,
    distance: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="A B", help="Two targets with a centre: the distance between them."),
    ] = None,
    parameter: Annotated[str, typer.Option(help="A parameter of the model, such as a2.")] = "",
    point: Annotated[
        str, typer.Option("--point-deg", metavar='"J1,J2,..."', help="Joint readings: the TCP there.")
    ] = "",
    tool: Annotated[str, typer.Option(help="Tool of the point [default: that of the last fitted row].")] = "",
    payload_kg: Annotated[float, typer.Option(help="Additional payload at the point.")] = 0.0,
    to: Annotated[str, typer.Option(help="table, csv or json.")] = "table",
) -> None:
    """State the uncertainty budget (JCGM 100) of a distance, a parameter or a point of a run folder."""
    from bayescal.public.budgets import budget as work

    known(to, ("table", "csv", "json"))
    found = work(
        run,
        distance=distance,
        parameter=parameter,
        point=_numbers(point) if point else None,
        tool=tool or None,
        payload_kg=payload_kg,
    )
    print_as(to, found)


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        remedy = "give one reading in deg for each joint, with commas"
        raise BayescalError(f"'{text}' is no list of numbers", "--point-deg", remedy) from None


@app.command(
    **ending(
        "bayescal export runs/cell-fit --to urdf --into arm.urdf#tool0",
        "bayescal export runs/cell-gap --to mjcf --with backlash --out arm.xml",
        at_time="at-time-s",
    )
)
def export(
    run: Run,
    to: Annotated[str, typer.Option(help=f"Format: {', '.join((*FORMATS, CERTIFICATE))}.")],
    out: Annotated[
        Path | None, typer.Option(help="File to write [default: the robot's name with the format's suffix].")
    ] = None,
    into: Annotated[
        str,
        typer.Option(
            help="Your own file of the arm, which is patched in a copy: names, comments, meshes and order "
            "stay. arm.urdf#tool0 names the link that carries the tool."
        ),
    ] = "",
    with_: WithEffects = "",
    without: WithoutEffects = "",
    readings: Annotated[
        str,
        typer.Option(help="mjcf: errors of the readings in the file (plain) or in a replay script (script)."),
    ] = "plain",
    at_time: Annotated[
        float | None,
        typer.Option(
            "--at-time-s", help="Time since the session began at which the file holds (drift, step)."
        ),
    ] = None,
    at_row: Annotated[
        str, typer.Option(help="id of the row at which it holds [default: the last fitted row].")
    ] = "",
    certificate: Annotated[
        str, typer.Option(help="dcc: YAML file with the administrative data of the certificate.")
    ] = "",
    schema: Annotated[
        str, typer.Option(help="dcc: a copy of dcc.xsd, with SI_Format.xsd beside it, to validate by.")
    ] = "",
    force: Annotated[bool, typer.Option("--force", help="Export in spite of reasons against it.")] = False,
) -> None:
    """Export the arm of a run folder of fit or gap, and state what the file cannot hold."""
    from bayescal.public.arms import ExportResult
    from bayescal.public.arms import export as work
    from bayescal.public.budgets import CertificateResult
    from bayescal.public.budgets import certificate as certify
    from bayescal.public.results import console

    result: CertificateResult | ExportResult
    if to == CERTIFICATE:
        if into or with_ or without or at_time is not None or at_row or readings != "plain":
            what = "a certificate states the arm as it was fitted"
            raise BayescalError(what, "--to dcc", "leave out the options of other formats")
        result = certify(run, certificate, schema=schema, force=force)
    else:
        if certificate or schema:
            what = f"{to} has no administrative data"
            raise BayescalError(what, "--certificate", "use it with --to dcc")
        result = work(
            run, to, into=into, with_=with_, without=without, readings=readings, at_time=at_time,
            at_row=at_row or None, force=force,
        )  # fmt: skip
    written = result.save(out)
    terminal = console()
    terminal.print(result.report())
    said(terminal, "written", ", ".join(map(str, written)))


@app.command(
    **ending(
        "bayescal verify runs/cell-fit arm.xml",
        "bayescal verify runs/cell-fit arm.urdf --out runs/arm-verify",
    )
)
def verify(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder of bayescal fit or gap.")],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File written by bayescal export.")],
    out: Annotated[
        Path | None, typer.Option(help="Run folder to write [default: runs/<file>-verify].")
    ] = None,
) -> None:
    """Load an exported arm in its simulator: against the fitted arm, and against the measurements."""
    from bayescal.public.arms import verify as verified
    from bayescal.storage.folders import claimed

    folder = out or Path("runs") / f"{file.stem}-verify"
    with claimed(folder, "verify.json"), progress() as notify:
        result = verified(run, file, progress=notify)
        written = result.save(folder)
    show(result.report(), folder, written)
    if not result.passed:
        raise typer.Exit(1)


@app.command(
    **ending(
        "bayescal compensate runs/cell-fit targets.csv --out corrected.csv",
        "bayescal compensate runs/cell-fit weld.ls --out weld-corrected.ls --payload-kg 2.5",
        at_time="at-time-s",
    )
)
def compensate(
    run: Run,
    targets: Annotated[
        Path,
        typer.Argument(
            metavar="TARGETS",
            help="CSV with x_mm, y_mm, z_mm, rx_deg, ry_deg, rz_deg or j1_deg ...; or a robot program: "
            "URScript, FANUC LS, KUKA .src or .dat, ABB RAPID, RoboDK CSV.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="File to write: the same with corrected positions.")],
    format_: Annotated[
        str,
        typer.Option("--format", help="csv, urscript, fanuc, kuka, abb or robodk [default: by the name]."),
    ] = "",
    frame: Annotated[
        str | None, typer.Option(help="Frame of the poses: base, or a target of the session [default: base].")
    ] = None,
    tool: Annotated[
        str | None, typer.Option(help="Tool of the session that is brought to the targets.")
    ] = None,
    tcp: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z,RX,RY,RZ",
            help="Another tool than those of the session: mm, and fixed-axis roll, pitch, yaw in deg, in the "
            "frame of the flange. A negative X: --tcp=-1,2,...",
        ),
    ] = "",
    payload_kg: Annotated[
        float, typer.Option(min=0.0, help="Additional payload, where the table states none.")
    ] = 0.0,
    with_: WithEffects = "",
    without: WithoutEffects = "",
    at_time: Annotated[
        float | None,
        typer.Option("--at-time-s", help="Time of the session whose state of the arm holds (drift, step)."),
    ] = None,
    at_row: Annotated[
        str | None, typer.Option(help="id of the row whose state holds [default: the last fitted row].")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Compensate in spite of reasons against the arm.")
    ] = False,
) -> None:
    """Correct targets or a robot program for all fitted effects of an arm."""
    from bayescal.public.arms import check_out
    from bayescal.public.arms import compensate as run_

    check_out(out, targets)
    result = run_(
        run,
        targets,
        format=format_,
        frame=frame,
        tool=tool,
        tcp=_tcp(tcp) if tcp else None,
        payload_kg=payload_kg,
        with_=with_,
        without=without,
        at_time=at_time,
        at_row=at_row,
        force=force,
    )
    show(result.report(), out.parent, result.save(out))


def _tcp(text: str) -> list[float]:
    """x, y, z in m, and roll, pitch, yaw in rad."""
    from math import radians

    from bayescal.errors import BayescalError

    try:
        x, y, z, rx, ry, rz = (float(part) for part in text.split(","))
    except ValueError:
        what, remedy = f"`{text}` is not six numbers", "give X,Y,Z,RX,RY,RZ in mm and deg, with commas"
        raise BayescalError(what, "--tcp", remedy) from None
    return [1e-3 * x, 1e-3 * y, 1e-3 * z, radians(rx), radians(ry), radians(rz)]


@app.command(
    **ending(
        "bayescal report runs/cell-fit --pdf",
        "bayescal report runs/monday-fit runs/tuesday-fit --out both.html",
    )
)
def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Run folders of bayescal fit or gap; several are compared."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="HTML file to write [default: report.html or gap.html of the run folder; of several runs "
            "runs/<names>-report.html].",
        ),
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also print a PDF, by Chromium or Chrome.")] = False,
) -> None:
    """Write the page of a run again, or a page of several runs side by side."""
    from bayescal.public.starting import report as work

    for path in work(runs, out, pdf=pdf):
        typer.echo(f"written          {path}")
