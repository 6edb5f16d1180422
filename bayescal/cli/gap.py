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
        help="Dataset folder with dataset.yaml, measurements.csv and the robot. Several sessions of the same "
        "arm are diagnosed together.",
    ),
    model: str = typer.Option(
        "geometry,compliance", help="Effects of the calibrated model, separated by commas."
    ),
    without: str = typer.Option(
        "",
        help="Parts of these effects to keep nominal and to diagnose, separated by commas: "
        "'geometry at joint 4' (theta4, d4, and a4, alpha4, beta4 of the next link), 'geometry at link 4', "
        "'compliance at joint 3'.",
    ),
    seed: int = typer.Option(0, help="Random seed."),
    out: Path | None = typer.Option(
        None, help="Run folder to write [default: runs/<dataset>-gap; several names are joined by +]."
    ),
    robust: bool = typer.Option(True, help="Exclude outliers."),
    prior_width: float = typer.Option(1.0, help="Factor on the standard deviations of the arm's prior."),
    remounted: bool = typer.Option(
        False, "--remounted", help="The tools were remounted between the sessions."
    ),
    pictures: bool = typer.Option(True, help="Write gap-where.png, -which, -levels and -residuals."),
    allow_xacro: AllowXacro = False,
) -> None:
    """Diagnose the difference between model and machine: size, location, effect, improvement."""
    from bayescal.cli.sessions import read_sessions
    from bayescal.folders import check_free

    effects, parts = (
        tuple(name.strip() for name in text.split(",") if name.strip()) for text in (model, without)
    )
    # the sessions share a noise scale, so that their residuals are comparable
    session, name = read_sessions(datasets, remounted, False, allow_xacro)
    folder = out or Path("runs") / f"{name}-gap"
    check_free(folder, "gap.json")

    from rich.console import Console, Group

    from bayescal.gap.diagnose import diagnose
    from bayescal.reporting.gap.files import write_gap
    from bayescal.reporting.gap.summary import gap_summary

    console = Console(highlight=False)
    with progress() as notify:
        result = diagnose(session, effects, seed, robust, prior_width, notify, parts)
        notify("write", 1.0)
        written = write_gap(result, folder, pictures)
    console.print(gap_summary(result))
    if session.sessions:
        from bayescal.assess.agreement import agreement
        from bayescal.estimate import calibrated
        from bayescal.model.scene import Scene
        from bayescal.reporting.fit.agreement import verdicts
        from bayescal.reporting.shared.text import facts

        together = calibrated(Scene(session), effects, prior_width, robust)
        compared = agreement(together, effects, prior_width, robust)
        console.print(Group("", facts(verdicts(compared))))
    console.print(f"[dim]written          [/dim]{folder}/{', '.join(written)}", soft_wrap=True)
