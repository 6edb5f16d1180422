"""The command with all its commands: importing this module registers them."""

from __future__ import annotations

# they register their commands; what others describe "as of `fit`" stands in the first
from bayescal.cli import evaluation, results, sessions  # noqa: F401
from bayescal.cli.root import app

__all__ = ["app"]

ORDER = (
    *("budget", "changed", "check", "compare", "compensate", "export", "fit", "fleet", "gap", "history"),
    *("import_", "init", "schema", "plan", "report", "robots", "simulate", "verify", "watch"),
)
"""Of the commands in the help, by function."""
app.registered_commands.sort(key=lambda command: ORDER.index(command.callback.__name__))  # type: ignore[union-attr]
