"""`bayescal blind`: make, run and score the blind check of `bayescal gap`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli import app

STOPPED = 130
"""Exit code of a command that Ctrl-C ended."""
commands = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Check the diagnosis blind: make sealed worlds, diagnose them with their truth unread, and score.",
)
app.add_typer(commands, name="blind")

Folder = Annotated[Path, typer.Argument(help="Blind folder, of `bayescal blind make`.")]
Workers = Annotated[int, typer.Option(min=1, help="Worker processes on this machine.")]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Use the workers of this Dask scheduler instead, tcp://HOST:PORT (bayescal[dask]).",
    ),
]


@contextmanager
def _going_on() -> Iterator[None]:
    """Say, where Ctrl-C ends a command, that nothing is lost."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("stopped; what is done is kept, and the same command goes on from there", err=True)
        raise typer.Exit(STOPPED) from None


@commands.command()
def make(
    out: Annotated[Path, typer.Option("--out", help="Blind folder to make, or to go on with.")],
    worlds: Annotated[int, typer.Option(min=1, help="How many.")] = 200,
    seed: Annotated[
        int | None, typer.Option(min=0, help="One seed, one set of worlds [default: one that nobody knows].")
    ] = None,
    workers: Workers = 1,
    dask: Dask = None,
) -> None:
    """Make worlds in which something is wrong, and seal what it is.

    A world is a session of an independent simulator (needs bayescal[world]). The truth of all is one file;
    its SHA-256 is printed and kept in every world. What was interrupted goes on where it stopped.
    """
    from bayescal.blind.make import make as run
    from bayescal.cli.progress import progress

    with _going_on(), progress("worlds") as told:
        sealed = run(out, worlds, seed, workers, dask, told)
    typer.echo(f"{worlds} worlds in {out}/worlds, their truth sealed in {out}/truth.json")
    typer.echo(f"SHA-256 of the truth    {sealed}")


@commands.command()
def run(folder: Folder, workers: Workers = 1, dask: Dask = None) -> None:
    """Diagnose every world with `bayescal gap`, its truth unread, and seal the answers.

    A diagnosis gets a folder with the dataset alone. What was interrupted goes on where it stopped; once
    sealed, answers stay as they are.
    """
    from bayescal.blind.run import run as answer
    from bayescal.cli.progress import progress

    with _going_on(), progress("worlds") as told:
        found = answer(folder, workers, dask, told)
    crashed = f", {found.crashed} of them crashes" if found.crashed else ""
    typer.echo(f"{found.worlds} answers in {folder}/answers{crashed}, sealed in {folder}/answers.json")
    if found.again:
        typer.echo(f"{found.again} were given again: their worlds or the sources of bayescal had changed")
    typer.echo(f"SHA-256 of the answers  {found.sha256}")


@commands.command()
def score(
    folder: Folder,
    out: Annotated[Path | None, typer.Option(help="Score folder to write [default: FOLDER/score].")] = None,
    page: Annotated[
        Path | None, typer.Option(help="Markdown page whose tables to renew between its marks.")
    ] = None,
    note: Annotated[
        str, typer.Option(help="When and at which commit thresholds were frozen, for the page.")
    ] = "",
    pictures: Annotated[bool, typer.Option(help="Draw the pictures.")] = True,
) -> None:
    """Check both seals, open the truth, and print the score card.

    Refuses where the truth, a world or an answer is not what was sealed.
    """
    from bayescal.blind.card import page as renew
    from bayescal.blind.card import terminal
    from bayescal.blind.files import SCORE, write_score
    from bayescal.blind.score import figures, records
    from bayescal.blind.unseal import opened
    from bayescal.folders import check_free

    target = out or folder / "score"
    check_free(target, SCORE)
    truths, answers, about = opened(folder)
    about |= {"note": note} if note else {}
    judged = records(truths, answers)
    found = figures(judged)
    written = write_score(judged, found, about, target, pictures)
    if page is not None:
        renew(page, found, about, target)

    from rich.console import Console

    console = Console(highlight=False)
    console.print(terminal(found))
    console.print()
    for what in ("truth", "answers", "code"):
        changed = " (sources have changed since)" if what == "code" and not about["same_code"] else ""
        console.print(f"[dim]{what:<9}[/dim]{about[f'{what}_sha256']}{changed}", soft_wrap=True)
    names = ", ".join(written) + (f"; {page}" if page else "")
    console.print(f"[dim]written  [/dim]{target}/{names}", soft_wrap=True)
