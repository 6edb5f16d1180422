"""The fitted arm of a run at any pose, its file, and what it may be used for."""

from __future__ import annotations

from bayescal.exporting.arm_file import read_arm, write_arm
from bayescal.exporting.fitted import FittedArm, Poses, of_estimate, of_fit, of_gap, open_run, refitted

__all__ = [
    "FittedArm",
    "Poses",
    "of_estimate",
    "of_fit",
    "of_gap",
    "open_run",
    "read_arm",
    "refitted",
    "write_arm",
]
