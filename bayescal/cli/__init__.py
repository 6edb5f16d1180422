"""The command line: a thin layer that parses, calls and prints. Heavy imports stay inside commands."""

from __future__ import annotations

import os
import sys

import typer

from bayescal import __version__
from bayescal.errors import BayescalError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Calibrate a robot arm from probed contacts, with uncertainties, and diagnose unmodelled effects.",
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bayescal {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Calibrate a robot arm from probed contacts, with uncertainties, and diagnose unmodelled effects."""


def main() -> None:
    """Entry point of the console script: a `BayescalError` becomes one line and exit code 1."""
    # the matrices are small: several BLAS threads would slow the computation down
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from bayescal.cli import (  # noqa: F401  (they register their commands)
        blind,
        budget,
        check,
        compare,
        compensate,
        export,
        fit,
        gap,
        import_,
        init,
        plan,
        report,
        simulate,
        verify,
    )

    try:
        app()
    except BayescalError as error:
        sys.stderr.write(f"bayescal: {error}\n")
        sys.exit(1)
