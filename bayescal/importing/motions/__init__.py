"""Logs of joint motions of other programs, to a folder of schema ``bayescal-motion/1``.

Functions
---------
convert_motions
    A log and its description to a `MotionDraft`: settings, columns, notes, and failed checks.
write_motions
    A draft to a folder, atomically.
format_of
    The format of a log of motions; "" of a log of contacts.
"""

from bayescal.importing.motions.draft import MotionDraft, convert_motions, format_of, write_motions

__all__ = ["MotionDraft", "convert_motions", "format_of", "write_motions"]
