"""What an integrator takes away: the calibrated robot."""

from __future__ import annotations

from bayescal.exporting.robot import calibrated_robot

__all__ = ["calibrated_robot"]
