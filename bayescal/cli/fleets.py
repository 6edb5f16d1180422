"""Commands for several sessions: `fleet`, `changed`, `history`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from bayescal.cli.root import command, progress, run_folder, show


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


@command(
    "bayescal changed monday friday",
    "bayescal changed before-crash after-crash after-repair --at targets.csv --remounted",
)
def changed(
    datasets: list[Path] = typer.Argument(metavar="BEFORE AFTER [MORE]..."),
    model: str = "geometry,compliance",
    at: Path | None = typer.Option(None, metavar="TARGETS"),
    out: Path | None = None,
    **options: Any,
) -> None:
    """What changed between sessions of one arm: parameters and effects, by how much, and what it does.

    Parameters
    ----------
    datasets
        Dataset folders of one arm in the order of time. Targets of the same name and description are
        compared.
    model
        Effects that all sessions have, separated by commas.
    at
        Table of targets, as `compensate` reads it: the displacement of the TCP there.
    remounted, robust, out, allow_xacro
        As of `fit`.
    """
    from bayescal.public.changes import changed as run

    with run_folder(out, datasets, "changed") as folder, progress() as notify:
        result = run(datasets, model, at=at, progress=notify, **options)
        notify("write", 0.0)
        written = result.save(folder)
    show(result.report(), folder, written)


@command("bayescal history runs/arm-7", "bayescal history runs/arm-7 --limit-mm 0.1")
def history(
    folder: Path = typer.Argument(metavar="ARM"),
    order: str = "",
    limit_mm: float | None = typer.Option(None, min=0.0),
    out: Path | None = None,
) -> None:
    """The parameters of an arm over its sessions: trends, steps, and when to calibrate again.

    Parameters
    ----------
    folder
        Folder with run folders of fit or gap of one arm.
    order
        Names of the run folders in the order of time, separated by commas [default: by the dates that the
        datasets record, or by the names of the run folders].
    limit_mm
        RMS error of distances at which the arm is to be calibrated again: when the drift reaches it.
    out
        As of `fit`.
    """
    from bayescal.public.changes import history as run

    with run_folder(out, [folder], "history") as target, progress("read") as notify:
        result = run(folder, order=order, limit_mm=limit_mm, progress=notify)
        written = result.save(target)
    show(result.report(), target, written)
