"""The command line: a thin layer that parses, calls and prints. Heavy imports stay inside commands.

This module imports little: a signal soon after the start then finds `main` prepared for it.
"""

import os
import sys

__all__ = ["app", "main"]


def __getattr__(name: str) -> object:
    """`app` with all commands, imported when it is first used."""
    if name != "app":
        raise AttributeError(f"module 'bayescal.cli' has no attribute '{name}'")
    from bayescal.cli.entry import commands

    return commands()


def main() -> None:
    """Entry point of the console script."""
    try:
        from bayescal.cli.entry import run
    except KeyboardInterrupt:
        sys.stderr.write("bayescal: stopped; nothing was written\n")
        os._exit(130)
    run()
