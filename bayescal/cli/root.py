"""The command without its commands: each of their modules registers them with `app`."""

from __future__ import annotations

import typer

from bayescal import __version__

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
