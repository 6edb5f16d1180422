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
