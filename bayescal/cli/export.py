"""`bayescal export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import Run, WithEffects, WithoutEffects
from bayescal.cli.output import said
from bayescal.cli.root import app, ending
from bayescal.errors import BayescalError


@app.command(
    **ending(
        "bayescal export runs/cell-fit --to urdf --into arm.urdf#tool0",
        "bayescal export runs/cell-gap --to mjcf --with backlash --out arm.xml",
        at_time="at-time-s",
    )
)
def export(
    run: Run,
    to: Annotated[
        str, typer.Option(help="Format: robot.yaml, urdf, sdf, ur-yaml, dh-csv, joint-zeros, mjcf, dcc.")
    ],
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
    from bayescal.public.budgets import CertificateResult
    from bayescal.public.budgets import certificate as certify
    from bayescal.public.exports import ExportResult
    from bayescal.public.exports import export as work
    from bayescal.public.results import console

    result: CertificateResult | ExportResult
    if to == "dcc":
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
