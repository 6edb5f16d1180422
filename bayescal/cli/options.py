"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

AllowXacro = Annotated[
    bool, typer.Option("--allow-xacro", help="Execute a robot's xacro file: it is a program.")
]
"""The option of every command that reads a robot."""
