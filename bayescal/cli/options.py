"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.errors import BayescalError

Datasets = Annotated[
    list[Path],
    typer.Argument(
        metavar="DATASET...",
        help="Dataset folder with dataset.yaml, measurements.csv and the robot. Several sessions of the same "
        "arm are evaluated together.",
    ),
]
"""Sessions of one arm."""
Out = Annotated[
    Path | None,
    typer.Option(
        help="Run folder to write [default: runs/<dataset>-<command>; several names are joined by +]."
    ),
]
"""The run folder; see `output.run_folder`."""
Model = Annotated[
    str,
    typer.Option(
        help="Effects of the calibrated model, separated by commas, each at all its sites or 'at joint 3'."
    ),
]
Without = Annotated[
    str,
    typer.Option(
        help="Parts of these effects that stay nominal, separated by commas: 'geometry at joint 4' (theta4, "
        "d4, and a4, alpha4, beta4 of the next link), 'geometry at link 4', or names of parameters: "
        "'compliance J3'. A diagnosis takes them for candidates."
    ),
]
Seed = Annotated[int, typer.Option(help="Random seed.")]
Robust = Annotated[bool, typer.Option(help="Exclude outliers.")]
PriorWidth = Annotated[float, typer.Option(help="Factor on the standard deviations of the arm's prior.")]
Remounted = Annotated[
    bool, typer.Option("--remounted", help="The tools were remounted between the sessions.")
]
AllowXacro = Annotated[
    bool, typer.Option("--allow-xacro", help="Execute a robot's xacro file: it is a program.")
]
"""The option of every command that reads a robot."""
Run = Annotated[
    Path, typer.Argument(metavar="RUN", help="Run folder of bayescal fit or gap: its arm.json and dataset.")
]
WithEffects = Annotated[
    str,
    typer.Option(
        "--with",
        help="Effects to add to the model of the run, separated by commas: the session is fitted again.",
    ),
]
WithoutEffects = Annotated[
    str,
    typer.Option(
        help="Effects of the model of the run to leave out, or parts of them ('geometry at joint 4', "
        "'compliance J3'), separated by commas: the session is fitted again."
    ),
]
"""Options of the commands that take the arm of a run."""


def known(to: str, formats: tuple[str, ...]) -> None:
    """Refuse a format that a command does not print."""
    if to not in formats:
        raise BayescalError(f"there is no format `{to}`", "--to", f"formats: {', '.join(formats)}")
