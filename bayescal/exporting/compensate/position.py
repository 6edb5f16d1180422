"""Where the tool of a fitted arm is, with the uncertainty that a compensation and a position both state.

The error of a point is a vector. `u` is the root of its mean square length, and `expanded` the length that it
does not exceed with a probability of 95.45 %: that of the uncertainty budget of a point (`assess.budget`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.assess.budget import COVERAGE
from bayescal.distributions import f_isf
from bayescal.errors import BayescalError
from bayescal.exporting.compensate.frames import BASE, Frame, frame_of
from bayescal.exporting.compensate.region import Region
from bayescal.exporting.compensate.tools import Working, axes_of, tool_of
from bayescal.exporting.fitted import FittedArm, Poses
from bayescal.exporting.lost_motion import lost_motion

FEWEST_DOF = 1.0
"""Degrees of freedom that any variance has at least."""


@dataclass(frozen=True)
class Uncertain:
    """Covariance (C, 3, 3), m2, of points relative to a frame, and the length U (C,), m, of their errors."""

    covariance: np.ndarray
    expanded: np.ndarray

    @property
    def u(self) -> np.ndarray:
        """Standard uncertainty (C,), m, of the points: length of the vector."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))


@dataclass(frozen=True)
class Positions:
    """C positions of the tool of a fitted arm, relative to a frame; SI."""

    frame: str
    readings: np.ndarray  # (C, n) rad
    poses: np.ndarray  # (C, 4, 4) of the tool's frame, in the frame
    uncertain: Uncertain  # covariance along the axes of the frame
    inside: np.ndarray  # (C,) bool: within the region that the session has probed


def uncertainty(
    working: Working,
    frame: Frame,
    at: Callable[[np.ndarray, np.ndarray, np.ndarray], Poses],
    velocity: np.ndarray,
    poses: Poses,
) -> Uncertain:
    """Uncertainty of the points of an arm relative to a frame, along the axes of F0.

    Parameters
    ----------
    working : Working
    frame : Frame
    at, velocity, poses
        As of `lost_motion`, with the working tool.
    """
    by, own = frame.moved(poses)
    off = lost_motion(working.arm, at, poses.readings, velocity, poses)
    covariance = poses.spread_by(by) + own + np.einsum("cji,cjk->cik", off, off) + working.covariance(poses)
    dof = poses.dof_by(by, np.trace(covariance, axis1=1, axis2=2))
    return Uncertain(covariance, expanded(covariance, dof))


def expanded(covariance: np.ndarray, dof: np.ndarray) -> np.ndarray:
    """Lengths (C,), m, that errors of covariance (C, 3, 3) with `dof` (C,) do not exceed (95.45 %).

    Over u^2 the length squared is taken for F with (sum s_i^2)^2 / sum s_i^4 and `dof` degrees of freedom,
    s_i the principal uncertainties; as in `assess.budget`.
    """
    total = np.trace(covariance, axis1=1, axis2=2)
    square = np.trace(covariance @ covariance, axis1=1, axis2=2)
    h = np.divide(total**2, square, out=np.ones(len(total)), where=square > 0)
    k = [f_isf(1.0 - COVERAGE, *each) for each in zip(h, np.maximum(dof, FEWEST_DOF), strict=True)]
    return np.sqrt(np.array(k, float) * total)


def positions(
    arm: FittedArm,
    readings: np.ndarray,
    *,
    frame: str = BASE,
    tool: str | None = None,
    tcp: np.ndarray | None = None,
    payload_kg: np.ndarray | float = 0.0,
    velocity: np.ndarray | None = None,
    time: float | None = None,
    row: str | None = None,
) -> Positions:
    """Where a fitted arm puts its tool.

    Parameters
    ----------
    arm : FittedArm
    readings : np.ndarray, shape (n,) or (C, n)
        rad, as the controller shows them.
    frame : str
        `base` (F0), or a target that was fitted.
    tool, tcp : optional
        Of the working tool; see `tools.tool_of`.
    payload_kg : float or np.ndarray, shape (C,)
        kg, beyond the tool.
    velocity : np.ndarray, shape (n,) or (C, n), optional
        Its signs are those of the motion of each joint before the pose; 0 where it is not known.
    time, row : optional
        State of the arm; see `FittedArm.at`.

    Raises
    ------
    BayescalError
        For readings of another arm, or a frame, tool or row that does not exist.
    """
    readings = np.atleast_2d(np.asarray(readings, float))
    n = arm.dataset.robot.n
    if readings.ndim != 2 or readings.shape[1] != n or not np.all(np.isfinite(readings)):
        what = f"readings of shape {readings.shape}, or one that is no finite number, for {n} joints"
        raise BayescalError(what, "readings", f"give (n,) or (C, {n}) in rad")
    try:
        way = np.broadcast_to(0.0 if velocity is None else np.asarray(velocity, float), readings.shape)
        payload = np.broadcast_to(np.asarray(payload_kg, float), len(readings))
    except ValueError:
        what = "the velocity or the payload has another shape than the readings"
        raise BayescalError(what, "readings", "give one value for each, or one for all") from None
    working = tool_of(arm, tool, tcp)
    arm = working.arm
    stand = frame_of(arm, frame)

    def at(q: np.ndarray, which: np.ndarray, more: np.ndarray | float = 0.0) -> Poses:
        return arm.at(q, tool=working.tool.name, payload_kg=payload[which], direction=way[which] + more,
                      time=time, row=row)  # fmt: skip

    every = np.arange(len(readings))
    poses = at(readings, every)
    found = uncertainty(working, stand, at, way, poses)
    inside = Region.of(arm).contains(
        working.probed(
            poses,
            lambda name: arm.at(readings, tool=name, payload_kg=payload, direction=way, time=time, row=row),
        ),
        readings,
    )
    here = poses.flange.copy()
    here[:, :3, :3] = here[:, :3, :3] @ axes_of(working.tool)
    here[:, :3, 3] = poses.points
    turn = stand.found[:3, :3]
    own = Uncertain(turn.T @ found.covariance @ turn, found.expanded)
    return Positions(frame, readings, np.linalg.inv(stand.found) @ here, own, inside)
