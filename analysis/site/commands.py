"""The page of the command line, from the commands themselves: what `--help` prints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer

from bayescal.cli import app


def group() -> Any:
    """The `bayescal` command."""
    return typer.main.get_command(app)


def commands(command: Any, path: str, parent: Any = None) -> Iterator[tuple[str, Any, Any]]:
    """Every command below a group: its words, the command, and its context."""
    context = command.context_class(command, info_name=path.rpartition(" ")[2], parent=parent)
    members = getattr(command, "commands", None)
    if members is None:
        yield path, command, context
        return
    for name in sorted(members):
        yield from commands(members[name], f"{path} {name}", context)


def _row(record: tuple[str, str]) -> str:
    name, text = (" ".join(part.split()).replace("|", "\\|") for part in record)
    return f"| `{name}` | {text.replace('<', '&lt;').replace('*', chr(92) + '*')} |"


PAGE = """# Commands

What `bayescal COMMAND --help` prints. A command that cannot do what it was asked prints one line that states
what is wrong, where, and the remedy, and has the exit code 1.

"""
SECTION = """## {path}

{help}

    {path} {usage}

| argument or option | |
| --- | --- |
{table}

{examples}

"""


def section(path: str, command: Any, context: Any) -> str:
    """The section of a command: summary, call, arguments and options."""
    records = [p.get_help_record(context) for p in command.get_params(context)]
    table = "\n".join(_row(record) for record in records if record)
    usage = " ".join(command.collect_usage_pieces(context))
    lines = [line for line in command.epilog.splitlines() if line.startswith("bayescal ")]
    examples = "\n".join(f"    {line}" for line in lines)
    return SECTION.format(path=path, help=command.help, usage=usage, table=table, examples=examples)


def page() -> str:
    """The page of all commands."""
    return PAGE + "".join(section(*found) for found in commands(group(), "bayescal"))
