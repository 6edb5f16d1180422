"""The fitted arm of a run at any pose, its file, and what it may be used for."""

from __future__ import annotations

from bayescal.fitted.arm import FittedArm, Poses, of_estimate, of_fit, of_gap, refitted
from bayescal.fitted.file import open_run, read_arm, write_arm

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
