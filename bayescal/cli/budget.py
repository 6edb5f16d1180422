"""`bayescal budget`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from bayescal.cli.options import Run, known
from bayescal.cli.root import app, ending
from bayescal.errors import BayescalError

FORMATS = ("table", "csv", "json")


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

    known(to, FORMATS)
    found = work(
        run,
        distance=distance,
        parameter=parameter,
        point=_numbers(point) if point else None,
        tool=tool or None,
        payload_kg=payload_kg,
    )
    if to == "csv":
        sys.stdout.write(found.csv)
    elif to == "json":
        from bayescal.storage.files import json_text

        sys.stdout.write(json_text(found.record))
    else:
        from bayescal.public.results import console

        console().print(found.report())


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        what = f"'{text}' is no list of numbers"
        raise BayescalError(
            what, "--point-deg", "give one reading in deg for each joint, with commas"
        ) from None
