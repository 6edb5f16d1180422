"""Targets of a compensation, and what becomes of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Target:
    """A position that a table or a program states.

    Parameters
    ----------
    where : str
        For messages: the line, and the name of the position if it has one.
    pose : np.ndarray, shape (4, 4), optional
        Of the tool's frame in the frame of the targets, m.
    readings : np.ndarray, shape (n,), optional
        rad. Without a pose: nominal readings, which stand for the pose that the nominal model gives them.
        With a pose: readings to which the solution is the nearest.
    straight : bool
        The tool moves to it along a straight line, not by joint angles.
    velocity : np.ndarray, shape (n,), optional
        rad/s, of the readings on arrival; by default it follows from the target before.
    payload : float
        kg, beyond the tool.
    tool : str, optional
        Its name; default: that of the compensation.
    admits : callable, optional
        Whether readings (n,), rad, have the configuration that the program states.
    strict : bool
        A target without a solution that `admits` has none; otherwise the nearest is taken.
    """

    where: str
    pose: np.ndarray | None = None
    readings: np.ndarray | None = None
    straight: bool = False
    velocity: np.ndarray | None = None
    payload: float = 0.0
    tool: str | None = None
    admits: Callable[[np.ndarray], bool] | None = None
    strict: bool = True


@dataclass(frozen=True)
class Corrected:
    """What a compensation gives for a target; only `reason` where it has no solution."""

    reason: str = ""
    readings: np.ndarray | None = None  # (n,) rad, that put the tool there
    pose: np.ndarray | None = None  # (4, 4) in the frame of the targets: where the nominal model has these
    nominal: np.ndarray | None = None  # (n,) rad, of the nominal model
    solutions: int = 0  # of the nominal model, up to whole turns; 0 where the readings were given
    u: float = np.nan  # m: standard uncertainty of the TCP, length of the vector
    error: float = np.nan  # m: of the TCP at the nominal readings
    inside: bool = False  # the region that the session has probed
    expanded: float = np.nan  # m: length that the error of the TCP does not exceed (95.45 %)
