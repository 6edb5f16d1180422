"""The command with all its commands: importing this module registers them."""

from __future__ import annotations

from bayescal.cli.root import app

__all__ = ["app"]
