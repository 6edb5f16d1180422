"""`bayescal verify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.output import show
from bayescal.cli.progress import progress
from bayescal.cli.root import app, ending


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
    from bayescal.public.compensating import verify as verified
    from bayescal.storage.folders import claimed

    folder = out or Path("runs") / f"{file.stem}-verify"
    with claimed(folder, "verify.json"), progress() as notify:
        result = verified(run, file, progress=notify)
        written = result.save(folder)
    show(result.report(), folder, written)
    if not result.passed:
        raise typer.Exit(1)
