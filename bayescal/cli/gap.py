"""`bayescal gap`."""

from __future__ import annotations

from pathlib import Path

import typer

from bayescal.cli import app
from bayescal.cli.options import AllowXacro
from bayescal.cli.progress import progress


@app.command()
def gap(
    datasets: list[Path] = typer.Argument(
        ...,
        metavar="DATASET...",
        help="Dataset folder: dataset.yaml, measurements.csv and the robot. Several, sessions of one arm, "
        "are diagnosed together.",
    ),
    model: str = typer.Option(
        "geometry,compliance", help="Effects that the model has already, comma separated."
    ),
    without: str = typer.Option(
        "",
        help="Parts of these effects to leave out and look for, comma separated: 'geometry at joint 4' "
        "(theta4, d4, and a4, alpha4, beta4 behind), 'geometry at link 4', 'compliance at joint 3'.",
    ),
    seed: int = typer.Option(0, help="One seed, one result."),
    out: Path | None = typer.Option(
        None, help="Run folder to write [default: runs/<dataset>-gap; of several, their names joined by +]."
    ),
    robust: bool = typer.Option(True, help="Find outliers and leave them out."),
    prior_width: float = typer.Option(1.0, help="Factor on the widths of the arm's tolerance priors."),
    remounted: bool = typer.Option(
        False, "--remounted", help="Of several sessions: the tools were taken off in between."
    ),
    pictures: bool = typer.Option(True, help="Draw gap-where.png, -which, -ladder and -residuals."),
    allow_xacro: AllowXacro = False,
) -> None:
    """Diagnose the gap between model and machine: how big, where, which effect, how far it shrinks."""
    from bayescal.cli.sessions import read_sessions
    from bayescal.folders import check_free

    effects, parts = (
        tuple(name.strip() for name in words.split(",") if name.strip()) for words in (model, without)
    )
    # places are told in one noise: the sessions share its scale
    session, name = read_sessions(datasets, remounted, False, allow_xacro)
    folder = out or Path("runs") / f"{name}-gap"
    check_free(folder, "gap.json")

    from rich.console import Console, Group

    from bayescal.assess.agreement import agreement
    from bayescal.estimate import calibrated
    from bayescal.gap.diagnose import diagnose
    from bayescal.model.scene import Scene
    from bayescal.reporting.fit.agreement import verdicts
    from bayescal.reporting.gap.files import write_gap
    from bayescal.reporting.gap.summary import gap_summary
    from bayescal.reporting.shared.text import facts

    console = Console(highlight=False)
    with progress() as told:
        result = diagnose(session, effects, seed, robust, prior_width, told, parts)
        told("write", 1.0)
        written = write_gap(result, folder, pictures)
    console.print(gap_summary(result))
    if session.sessions:
        together = calibrated(Scene(session), effects, prior_width, robust)
        compared = agreement(together, effects, prior_width, robust)
        console.print(Group("", facts(verdicts(compared))))
    console.print(f"[dim]written          [/dim]{folder}/{', '.join(written)}", soft_wrap=True)
