"""The command without its commands: each of their modules registers them with `app`."""

from __future__ import annotations

from typing import Any

import typer

from bayescal import __version__


def ending(*examples: str, **renamed: str) -> dict[str, Any]:
    """What every command states of itself: examples at the end of its help, and earlier names of options.

    Parameters
    ----------
    *examples : str
        Complete command lines; a test parses them.
    **renamed : str
        Present name of an option by its earlier one, which is understood and not shown.
    """
    out: dict[str, Any] = {"epilog": "\n".join(("Examples:", "", "\b", *examples))}
    if renamed:
        out["context_settings"] = {
            "token_normalize_func": lambda name: renamed.get(name.replace("-", "_"), name)
        }
    return out


app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Calibrate a robot arm from probed contacts, with uncertainties, and diagnose unmodelled effects.",
    **ending("bayescal fit data/lrmate200ic-cube --samples 0", "bayescal gap data/lrmate200ic-cube"),
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
