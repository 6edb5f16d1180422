"""Logs of controllers and instruments, in whatever units, to a dataset folder or a joint log.

Functions
---------
convert
    A log and its description to a draft in memory, with notes and failed checks.
write
    A draft to a folder, atomically.
"""

from __future__ import annotations

from pathlib import Path

from bayescal.importing.ask import Request
from bayescal.importing.convert import Draft, convert_contacts, write_session
from bayescal.importing.images import convert_images
from bayescal.importing.joint_draft import MotionDraft, convert_motions, format_of, write_motions

__all__ = ["Draft", "MotionDraft", "Request", "convert", "write"]


def convert(request: Request) -> Draft | MotionDraft:
    """Read images with a board, a log of motions, by its format or with `--motions`, or one of contacts."""
    if request.board:
        return convert_images(request)
    return convert_motions(request) if format_of(request) else convert_contacts(request)


def write(draft: Draft | MotionDraft, folder: Path, force: bool = False) -> None:
    """Write a draft as a new folder, atomically, and read it back; `force`: despite a failed check."""
    if isinstance(draft, MotionDraft):
        write_motions(draft, folder, force)
    else:
        write_session(draft, folder, force)
