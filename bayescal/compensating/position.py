"""Where the tool of a fitted arm is relative to a frame, with its uncertainty; the region that was probed.

A frame is the base F0, or a target of the session as it was found. The place of a target was found with the
same arm: its errors and those of the arm are correlated. A target's state moves with the arm's parameters as
the fit would have moved it, and the point is judged relative to it.

The error of a point is a vector. `u` is the root of its mean square length, and `expanded` the length that it
does not exceed with a probability of 95.45 %: that of the uncertainty budget of a point (`assess.budget`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from bayescal.arm.transforms import rigid
from bayescal.assess.budget import COVERAGE
from bayescal.assess.inputs import READINGS, Basis, Input
from bayescal.assess.measurand import POINT, Measurand
from bayescal.dataset.target_kinds import KINDS
from bayescal.effects import Parameter
from bayescal.errors import BayescalError
from bayescal.fitted.arm import FittedArm, Poses
from bayescal.fitted.unmodelled import Unmodelled
from bayescal.model import ARM
from bayescal.model.block import Block
from bayescal.programs.tools import Working, axes_of, tool_of
from bayescal.statistics import f_isf

BESIDE = 10e-3
"""m: a point this close to the hull counts as inside; the hull of points on one plane has no volume."""
BEYOND = np.radians(1.0)
"""rad: a reading this close to the range counts as inside."""
STIFF = 1e3  # weight of the sum of the weights, 1/m


@dataclass(frozen=True)
class Region:
    """The probed region, where data support an arm: TCPs (N, 3), m, and readings (N, n), rad, of a session.

    A target is inside if both hold:

    - its TCP is within the convex hull of the TCP positions of the session. Errors that the model lacks, and
      the effect of gravity, vary with the place of the arm, and were only seen there;
    - each reading is within the range of the readings of the session. Errors of encoders and gears vary with
      the angle of a joint, and an arm can reach a probed place with angles that were never seen.

    The hull of the readings is not used: with six joints it contains hardly anything but the rows themselves.
    The uncertainty of a target outside is that of the model, and says nothing about a model that is wrong
    there.
    """

    points: np.ndarray
    readings: np.ndarray

    @classmethod
    def of(cls, arm: FittedArm) -> Region:
        """The region of all rows that the fit did not reject, also those that only validate."""
        m = arm.dataset.measurements
        rows = np.flatnonzero(~np.isin(m.ids, arm.rejected))
        return cls(arm.at_rows(rows).points, m.readings[rows])

    def contains(self, points: np.ndarray, readings: np.ndarray) -> np.ndarray:
        """Which of C points (C, 3), reached with readings (C, n), are inside, (C,)."""
        low, high = self.readings.min(axis=0) - BEYOND, self.readings.max(axis=0) + BEYOND
        ranged = np.all((readings >= low) & (readings <= high), axis=1)
        return np.array([r and self.away(p) <= BESIDE for p, r in zip(points, ranged, strict=True)], bool)

    def away(self, point: np.ndarray) -> float:
        """Distance of a point (3,) from the convex hull of the session's points, m.

        The nearest point of the hull is a mean of its points with weights that are not negative and sum to
        one: a problem of least squares, whatever the dimension of the hull.
        """
        matrix = np.vstack([(self.points - point).T, np.full(len(self.points), STIFF)])
        weights, _ = nnls(matrix, np.array([0.0, 0.0, 0.0, STIFF]))
        return float(np.linalg.norm(weights @ (self.points - point) / weights.sum()))


BASE = "base"
STEP = 1e-6  # m and rad: of a target's state, for its slopes


@dataclass(frozen=True)
class Frame:
    """A frame by its nominal pose and the pose that was found, (4, 4) in F0."""

    nominal: np.ndarray
    fitted: np.ndarray

    def moved(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (C, 3, P + K) of points relative to the frame, and the covariance (C, 3, 3), m2, of its own.

        In F0.
        """
        return poses.by_all, np.zeros((len(poses.points), 3, 3))


@dataclass(frozen=True)
class TargetFrame(Frame):
    """The frame of a target: its rows, its state, and the arm for which it was found.

    The `errors` (K) are those beyond the parameters of the arm, in the last columns of the block.
    """

    arm: FittedArm
    block: Block
    state: np.ndarray
    errors: tuple[Parameter, ...]

    def moved(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """As of any frame; the target follows the errors that the arm had where it was measured."""
        b, x, values = self.block, self.state, self.arm.values
        z = x[b.free] / b.sd
        _, by_arm, by_state = b.linearise(np.append(values, np.zeros(len(self.errors))), z)
        by_arm = by_arm * np.append(np.ones(len(values)), [p.sd for p in self.errors])
        sigma = np.tile(self.arm.beyond.noise_of(b), b.kind.rows)[:, None]
        a, c = by_state / sigma, by_arm / sigma
        information = a.T @ a + np.eye(b.size)
        follows = -np.linalg.solve(information, a.T @ c)  # (size, P + K)
        local = np.column_stack([poses.points, np.ones(len(poses.points))]) @ np.linalg.inv(self.fitted).T
        moved = np.empty((len(local), 3, b.size))
        for k, coordinate in enumerate(b.free):
            step = STEP * np.eye(len(x))[coordinate]
            ends = [local @ pose_of(b.kind.describe(x + s * step)).T for s in (1, -1)]
            moved[:, :, k] = (ends[0] - ends[1])[:, :3] / (2 * STEP) * b.sd[k]
        of_target = moved @ np.linalg.inv(information) @ np.swapaxes(moved, 1, 2)
        return poses.by_all - moved @ follows, of_target


def pose_of(described: dict[str, np.ndarray | float]) -> np.ndarray:
    """Pose (4, 4) of a target that is described: its frame, or its centre with the axes of F0."""
    if "frame" in described:
        return np.asarray(described["frame"])
    return rigid(None, np.asarray(described["centre"]))


def frame_of(arm: FittedArm, name: str) -> Frame:
    """The frame with a name: `base`, or a target that was fitted.

    Raises
    ------
    BayescalError
        For a target that does not exist, was not fitted, or has neither a frame nor a centre.
    """
    if name == BASE:
        return Frame(np.eye(4), np.eye(4))
    dataset, where = arm.dataset, f"--frame {name}"
    names = [t.name for t in dataset.targets]
    if name not in names:
        raise BayescalError("there is no such target", where, f"known: {', '.join([BASE, *names])}")
    if name not in arm.states:
        form = {t.name: KINDS[t.kind].form for t in dataset.targets}
        framed = ", ".join([BASE, *(n for n in arm.states if form[n] == "point")])
        raise BayescalError("the fit did not locate this target", where, f"give one of: {framed}")
    index, m = names.index(name), dataset.measurements
    rows = np.flatnonzero((m.target == index) & (m.role == "calibrate") & ~np.isin(m.ids, arm.rejected))
    errors = arm.beyond.errors(arm.model, arm.values)
    block = replace(arm.model, parameters=(*arm.model.parameters, *errors)).block(index, rows)
    state = arm.states[name]
    described = block.kind.describe(state)
    if not {"frame", "centre"} & set(described):
        kind = dataset.targets[index].kind
        raise BayescalError(f"a {kind} has no frame", where, "give an instrument, a sphere or a fixed point")
    nominal = pose_of(block.kind.describe(np.zeros(len(state))))
    return TargetFrame(nominal, pose_of(described), arm, block, state, errors)


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


def uncertainty(working: Working, frame: Frame, poses: Poses, velocity: np.ndarray) -> Uncertain:
    """Uncertainty of the points of an arm relative to a frame, along the axes of F0.

    Parameters
    ----------
    working : Working
    frame : Frame
    poses, velocity
        Of the working tool; as of `lost_motion`.
    """
    by, of_frame = frame.moved(poses)
    off = lost_motion(poses, velocity)
    play = np.einsum("cji,cjk->cik", off, off)
    covariance = poses.spread_by(by) + of_frame + play + working.covariance(poses)
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

    poses = arm.at(readings, tool=working.tool.name, payload_kg=payload, direction=way, time=time, row=row)
    in_base = uncertainty(working, stand, poses, way)
    inside = Region.of(arm).contains(working.probed(poses), readings)
    here = poses.tool_frames(axes_of(working.tool))
    turn = stand.fitted[:3, :3]
    in_frame = Uncertain(turn.T @ in_base.covariance @ turn, in_base.expanded)
    return Positions(frame, readings, np.linalg.inv(stand.fitted) @ here, in_frame, inside)


def lost_motion(poses: Poses, velocity: np.ndarray) -> np.ndarray:
    """Displacements (C, n, 3), m, of TCP positions by the lost motion of each joint of unknown direction.

    The joint rests on either side of its lost motion: one standard deviation from the middle.

    Parameters
    ----------
    poses : Poses
        In the middle of the lost motion.
    velocity : np.ndarray, shape (C, n)
        Signs of the motion before the pose, 0 where it is not known.
    """
    out = np.zeros((*velocity.shape, 3))
    if not any(p.driver.kind in ("direction", "flank") for p in poses.arm.model.parameters):
        return out
    for j, axis in enumerate(np.eye(velocity.shape[1])):
        rows = np.flatnonzero(velocity[:, j] == 0)
        if len(rows):
            out[rows, j] = poses.again(rows, velocity=velocity[rows] + axis).points - poses.points[rows]
    return out


def point(
    arm: FittedArm, basis: Basis, readings: np.ndarray, *, tool: str | None = None, payload_kg: float = 0.0
) -> Measurand:
    """Position of the TCP that the calibrated arm reaches, in F0: its error vector.

    Parameters
    ----------
    arm : FittedArm
    basis : Basis
        Of the same fit.
    readings : np.ndarray, shape (n,)
        rad, as the controller shows them.
    tool : str, optional
        Name; default: that of the last fitted row.
    payload_kg : float
        kg, beyond the tool.

    Raises
    ------
    BayescalError
        If the number of readings is wrong, there is no such tool, or the arm has no equilibrium.
    """
    n = arm.dataset.robot.n
    if readings.shape != (n,) or not np.all(np.isfinite(readings)):
        what = f"{readings.size} readings, or one that is no finite number, for {n} joints"
        raise BayescalError(what, "--point-deg", "give one reading in deg for each joint, with commas")
    with_errors = replace(arm, unmodelled=Unmodelled.of(basis))  # with the signs of its unknowns
    poses, unknowns = with_errors.at(readings, tool=tool, payload_kg=payload_kg), basis.stated.wide.model
    units = np.append(arm.model.sd, np.ones(len(poses.errors)))  # of the unknowns: errors have unit variance
    by_z = np.zeros((3, unknowns.size))
    by_z[:, : unknowns.slices[ARM].stop] = poses.by_all[0] * units
    independent = []
    if basis.excess:
        independent.append((basis.unexplained(), basis.excess * np.eye(3)))
    for j, off in enumerate(lost_motion(poses, np.zeros((1, n)))[0]):
        if np.any(off):
            name = f"direction of motion of joint {j + 1} is not known"
            side = Input(READINGS, name, "B", "1", 0.0, 1.0, distribution="two values")
            independent.append((side, off[:, None]))
    shown = ", ".join(f"{q:.6g}" for q in arm.dataset.robot.shown(readings))
    named = f"TCP at ({shown}) {arm.dataset.robot.unit_words}"
    return Measurand(POINT, named, "m", None, by_z, tuple(independent), position=poses.points[0])
