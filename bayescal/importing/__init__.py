"""Logs of controllers and instruments, in whatever units, to a dataset folder.

Functions
---------
convert
    A log and its description to a `Draft`: a `Dataset` in memory, notes, and failed checks.
write
    A draft to a folder, atomically.
"""

from __future__ import annotations

from bayescal.importing.ask import Request
from bayescal.importing.convert import Draft, convert, write

__all__ = ["Draft", "Request", "convert", "write"]
