"""The command for many sessions: `fleet`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from bayescal.cli.progress import progress
from bayescal.cli.root import command, show


@command(
    "bayescal fleet arms/* --workers 4 --out runs/line-3",
    "bayescal fleet arms/* --arm '^(r[0-9]+)-' --dask tcp://head:8786",
)
def fleet(
    sessions: list[Path] = typer.Argument(metavar="SESSIONS..."),
    arm: str = "",
    workers: int | None = None,
    dask: str | None = None,
    out: Path = Path("runs/fleet"),
    **options: Any,
) -> None:
    """Fit and diagnose many sessions, compare their arms, and learn the prior of a further arm.

    Parameters
    ----------
    sessions
        Dataset folders, or folders of them. A session that fails does not stop the others.
    arm
        Which sessions are of one arm: a regular expression for the names of the folders (its first group, or
        all), or a CSV file with the columns session and arm [default: serial number of the arm, or else the
        name of the dataset].
    workers
        Processes on this machine [default: one for each processor].
    dask
        Use the workers of this Dask scheduler instead, tcp://HOST:PORT (bayescal[dask]); they must see the
        same folders.
    model, without, seed
        As of `fit`.
    out
        Folder of the fleet. The same command computes what is missing in it, and what has another dataset or
        other options.
    robust, prior_width, allow_xacro
        As of `fit`.
    """
    from bayescal.public.fleet import fleet as run

    with progress("fit") as notify:
        result = run(
            sessions, out, arm=arm, workers=workers, dask=dask, progress=notify, say=notify.say, **options
        )
    show(result.report(), out, result.written)
