"""`bayescal compensate`: targets or a robot program with readings that put the calibrated arm there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import Run, WithEffects, WithoutEffects
from bayescal.cli.root import app, ending


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
    from bayescal.cli.output import show
    from bayescal.public.compensating import check_out
    from bayescal.public.compensating import compensate as run_

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
