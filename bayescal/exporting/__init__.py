"""What an integrator takes away: the calibrated robot, and the fitted arm of a run at any pose."""

from __future__ import annotations

from bayescal.exporting.arm_file import read_arm, write_arm
from bayescal.exporting.fitted import FittedArm, Poses, of_estimate, of_fit, of_gap, open_run, refitted
from bayescal.exporting.robot import calibrated_robot

__all__ = [
    "FittedArm",
    "Poses",
    "calibrated_robot",
    "of_estimate",
    "of_fit",
    "of_gap",
    "open_run",
    "read_arm",
    "refitted",
    "write_arm",
]
