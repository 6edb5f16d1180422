"""`bayescal robots`."""

from __future__ import annotations

from typing import Annotated

import typer

from bayescal.cli.options import known
from bayescal.cli.root import app, ending

FORMATS = ("table", "csv", "json")


@app.command(**ending("bayescal robots", "bayescal robots ur10 --to json"))
def robots(
    part: Annotated[str, typer.Argument(metavar="[PART]", help="Only names with this part.")] = "",
    to: Annotated[str, typer.Option(help="table, csv or json.")] = "table",
) -> None:
    """List the built-in robots: joints, reach, masses and the sources of their numbers."""
    from bayescal.robots.listing import table

    known(to, FORMATS)
    found = table(part)
    if to == "csv":
        typer.echo(found.to_csv(lineterminator="\n"), nl=False)
        return
    if to == "json":
        from bayescal.files import json_text

        typer.echo(json_text({"robots": found.reset_index().to_dict("records")}), nl=False)
        return
    from rich.console import Console
    from rich.table import Table

    shown = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 1, 0))
    for heading in ("robot", "joints", "reach (mm)", "masses"):
        shown.add_column(heading, no_wrap=True, justify="left" if heading == "robot" else "right")
    shown.add_column("sources")
    for name, row in found.iterrows():
        masses = "yes" if row.masses else "no"
        shown.add_row(str(name), str(row.joints), f"{row.reach_mm:.0f}", masses, row.sources)
    console = Console(highlight=False, markup=False)
    console.print(shown)
    console.print(
        f"{len(found)} built-in robots; any other as robot.yaml or URDF (--robot FILE)", style="dim"
    )
