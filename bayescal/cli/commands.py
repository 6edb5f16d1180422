"""The command with all its commands: importing this module registers them."""

from __future__ import annotations

from bayescal.cli import (  # noqa: F401  (they register their commands)
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
    robots,
    simulate,
    verify,
)
from bayescal.cli.root import app

__all__ = ["app"]
