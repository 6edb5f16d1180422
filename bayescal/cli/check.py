"""`bayescal check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import AllowXacro
from bayescal.cli.root import app


@app.command()
def check(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Dataset folder.")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    allow_xacro: AllowXacro = False,
) -> None:
    """Check a dataset without fitting it: what is understood, what is missing, what looks wrong."""
    from bayescal.public.checking import check as run

    result = run(dataset, allow_xacro=allow_xacro)
    if json:
        from bayescal.files import json_text

        typer.echo(json_text(result.record), nl=False)
        return
    from bayescal.public.results import console

    console().print(result.report())
