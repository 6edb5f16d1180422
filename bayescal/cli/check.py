"""`bayescal check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import AllowXacro, known
from bayescal.cli.root import app, ending

FORMATS = ("table", "json")


@app.command(**ending("bayescal check cell", "bayescal check cell --to json"))
def check(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Dataset folder.")],
    to: Annotated[str, typer.Option(help="table or json.")] = "table",
    json: Annotated[bool, typer.Option("--json", hidden=True)] = False,
    allow_xacro: AllowXacro = False,
) -> None:
    """Check a dataset without fitting it: what is understood, what is missing, what looks wrong."""
    from bayescal.public.starting import check as run

    known(to, FORMATS)
    result = run(dataset, allow_xacro=allow_xacro)
    if json or to == "json":
        from bayescal.storage.files import json_text

        typer.echo(json_text(result.record), nl=False)
        return
    from bayescal.public.results import console

    console().print(result.report())
