"""Logs of controllers and instruments, in whatever units, to a dataset folder or a joint log.

Functions
---------
convert
    A log and its description to a draft in memory, with notes and failed checks.
write
    A draft to a folder, atomically.
"""

from pathlib import Path

from bayescal.dataset.read import SETTINGS
from bayescal.dataset.write import check_new
from bayescal.errors import BayescalError
from bayescal.importing.ask import Request
from bayescal.importing.convert import Draft, convert_contacts
from bayescal.importing.images import convert_images
from bayescal.importing.joint_draft import MotionDraft, convert_motions, format_of
from bayescal.storage.folders import whole

__all__ = ["Draft", "MotionDraft", "Request", "convert", "write"]


def convert(request: Request) -> Draft | MotionDraft:
    """Read images with a board, a log of motions, by its format or with `--motions`, or one of contacts."""
    if request.board:
        return convert_images(request)
    return convert_motions(request) if format_of(request) else convert_contacts(request)


def write(draft: Draft | MotionDraft, folder: Path, force: bool = False) -> None:
    """Write a draft as a folder, atomically, and check that it can be read.

    Parameters
    ----------
    draft : Draft or MotionDraft
    folder : Path
        A new or an empty one.
    force : bool
        Write also values that are probably in a wrong unit, or implausible.

    Raises
    ------
    BayescalError
        For a folder that is not empty, a failed check, and whatever the format does not allow; of contacts
        with the line of the log.
    """
    if draft.wrong and not force:
        remedy = f"correct the map, or write the {draft.noun} with --force"
        raise BayescalError(draft.wrong, draft.log, remedy)
    check_new(folder)
    with whole(folder, SETTINGS) as stage:
        draft.write(stage, judge=not force)
