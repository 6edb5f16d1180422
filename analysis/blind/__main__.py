"""`python -m analysis.blind`: simulate, diagnose and score the blind check of `bayescal gap`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.entry import run as run_command
from bayescal.cli.root import ending, said
from bayescal.errors import BayescalError
from bayescal.storage.stopping import keeping

KEPT = "completed sessions are kept; the same command continues"
"""What a stopped command reports."""
app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Blind check of the diagnosis: simulate test sessions, diagnose them without ground truth, score.",
    **ending("python -m analysis.blind make --out blind --worlds 20", "python -m analysis.blind run blind"),
)

Folder = Annotated[Path, typer.Argument(help="Folder written by `python -m analysis.blind make`.")]
Workers = Annotated[int, typer.Option(min=1, help="Worker processes on this machine.")]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Use the workers of this Dask scheduler instead, tcp://HOST:PORT (bayescal[blind]).",
    ),
]
Rounds = Annotated[
    int, typer.Option(min=1, max=2, help="2: a second round of contacts that the diagnosis plans.")
]


@app.command(
    **ending(
        "python -m analysis.blind make --out blind --worlds 20",
        "python -m analysis.blind make --out blind --worlds 200 --seed 7 --workers 8",
    )
)
def make(
    out: Annotated[Path, typer.Option("--out", help="Folder to write; an interrupted run continues.")],
    worlds: Annotated[int, typer.Option(min=1, help="Number of test sessions.")] = 200,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Random seed [default: drawn at random and sealed].")
    ] = None,
    workers: Workers = 1,
    dask: Dask = None,
    generator: Annotated[
        int | None,
        typer.Option(min=1, help="Version of the simulator; seeds have a meaning within one [default: 4]."),
    ] = None,
    reserved: Annotated[
        bool, typer.Option("--reserved", help="Also draw the causes on which no constant may be chosen.")
    ] = False,
    kind: Annotated[
        str,
        typer.Option(
            help="What is simulated: contacts, motions (joint logs), images (of a camera) or changes (pairs)."
        ),
    ] = "contacts",
) -> None:
    """Simulate test sessions with unmodelled effects, and seal the ground truth.

    The simulator is independent of the model (needs bayescal[blind]). The ground truth of all sessions is in
    a single file; its SHA-256 is printed and stored in every session. An interrupted run continues.
    """
    from analysis.blind.make import make as run
    from bayescal.cli.root import progress
    from bayescal.storage.locks import alone

    with alone(out), keeping(lambda: KEPT), progress("worlds") as notify:
        sealed = run(out, worlds, seed, workers, dask, notify, generator, reserved, kind)
    typer.echo(f"{worlds} test sessions in {out}/worlds; ground truth sealed in {out}/truth.json")
    typer.echo(f"SHA-256 of the ground truth  {sealed}")


@app.command(
    **ending(
        "python -m analysis.blind run blind", "python -m analysis.blind run blind --workers 8 --rounds 2"
    )
)
def run(folder: Folder, workers: Workers = 1, dask: Dask = None, rounds: Rounds = 1) -> None:
    """Diagnose every test session with `bayescal gap` without its ground truth, and seal the answers.

    A diagnosis gets a folder that holds only the dataset. An interrupted run continues. Sealed answers are
    not changed. With two rounds, the diagnosis then plans 60 further contacts of every session that its
    answer leaves open, the simulator probes them, and the diagnosis answers again, beside 60 random ones.
    """
    from analysis.blind.folder import SEALED, of_contacts
    from analysis.blind.rounds import second_round
    from analysis.blind.run import known
    from analysis.blind.run import run as answer
    from bayescal.cli.root import progress
    from bayescal.storage.locks import alone

    if rounds > 1 and not of_contacts(folder):
        raise BayescalError(
            "only sessions of contacts have a second round", str(folder), "leave --rounds out"
        )
    with alone(folder), keeping(lambda: KEPT), progress("worlds") as notify:
        sealed = rounds > 1 and (folder / SEALED).is_file()
        found = known(folder) if sealed else answer(folder, workers, dask, notify)
        further = second_round(folder, workers, dask, notify) if rounds > 1 else {}
    crashed = f", {found.crashed} of them crashes" if found.crashed else ""
    typer.echo(f"{found.worlds} answers in {folder}/answers{crashed}, sealed in {folder}/answers.json")
    if found.again:
        typer.echo(f"{found.again} were computed again: the sessions or the sources of bayescal had changed")
    typer.echo(f"SHA-256 of the answers       {found.sha256}")
    for arm, own in further.items():
        typer.echo(f"SHA-256 after 60 {arm:<6} contacts, {own.worlds} sessions  {own.sha256}")


@app.command(
    **ending(
        "python -m analysis.blind score blind",
        "python -m analysis.blind score blind --rounds 2 --no-pictures",
    )
)
def score(
    folder: Folder,
    out: Annotated[Path | None, typer.Option(help="Score folder to write [default: FOLDER/score].")] = None,
    page: Annotated[Path | None, typer.Option(help="Markdown page whose tables are updated.")] = None,
    note: Annotated[str, typer.Option(help="Date and commit of the frozen thresholds, for the page.")] = "",
    pictures: Annotated[bool, typer.Option(help="Write the figures.")] = True,
    rounds: Rounds = 1,
) -> None:
    """Check the seals, open the ground truth, and print the score card.

    Refuses if the ground truth, a session or an answer differs from what was sealed.
    """
    from analysis.blind.card import page as renew
    from analysis.blind.card import terminal
    from analysis.blind.files import SCORE, write_score
    from analysis.blind.make import CHANGES, CONTACTS, IMAGES, MOTIONS
    from analysis.blind.score import figures, records
    from analysis.blind.unseal import opened
    from analysis.pages import between
    from bayescal.storage.folders import check_free

    target = out or folder / "score"
    check_free(target, SCORE)
    truths, answers, about = opened(folder)
    about |= {"note": note} if note else {}
    if about["kind"] != CONTACTS:
        from analysis.blind import changes, images, motions

        card = {MOTIONS: motions.CARD, IMAGES: images.CARD, CHANGES: changes.CARD}[about["kind"]]
        card.scored(truths, answers, about, target, page)
        return
    judged = records(truths, answers)
    found = figures(judged)
    written = write_score(judged, found, about, target, pictures)
    if page is not None:
        renew(page, found, about, target)

    from bayescal.public import console

    shown = console()
    shown.print(terminal(found))
    shown.print()
    if rounds > 1:
        from analysis.blind import compared

        second = compared.compared(folder, truths, answers)
        shown.print(compared.terminal(second))
        shown.print()
        if page is not None:
            between(page, (compared.BEGIN, compared.END), compared.page(second))
    for what in ("truth", "answers", "code"):
        changed = " (sources have changed since)" if what == "code" and not about["same_code"] else ""
        said(shown, what, f"{about[f'{what}_sha256']}{changed}", 9)
    names = ", ".join(written) + (f"; {page}" if page else "")
    said(shown, "written", f"{target}/{names}", 9)


if __name__ == "__main__":
    run_command(lambda: app)
