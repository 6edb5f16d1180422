"""Frames of targets: the base F0, or a target of the session as it was found.

The place of a target was found with the same arm: its errors and those of the arm are correlated. A target's
state moves with the arm's parameters as the fit would have moved it, and the point is judged relative to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.arm.transforms import rigid
from bayescal.errors import BayescalError
from bayescal.exporting.fitted import FittedArm, Poses, padded, unit_errors
from bayescal.model.block import Block

BASE = "base"
STEP = 1e-6  # m and rad: of a target's state, for its slopes


@dataclass(frozen=True)
class Frame:
    """A frame by its nominal pose and the pose that was found, (4, 4) in F0.

    That of a target has the target's rows, its state, and the values of the arm for which it was found.
    """

    nominal: np.ndarray
    found: np.ndarray
    block: Block | None = None
    state: np.ndarray | None = None
    values: np.ndarray | None = None  # (P + K,)
    units: np.ndarray | None = None  # (P + K,) of the errors in the columns of the block
    excess: float = 0.0  # m, of every measurement of the target

    def moved(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (C, 3, P + K) of points relative to the frame, and the covariance (C, 3, 3), m2, of its own.

        In F0. The target follows the errors that the arm had where it was measured.
        """
        if self.block is None:
            return poses.by_all, np.zeros((len(poses.points), 3, 3))
        by_arm, own = self._carried(poses.points)
        return poses.by_all - by_arm, own

    def _carried(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (C, 3, P + K) of points fixed to the target by the arm, and their own covariance."""
        assert self.block is not None
        assert self.state is not None
        assert self.values is not None
        assert self.units is not None
        b, x = self.block, self.state
        z = x[b.free] / b.sd
        _, by_arm, by_own = b.linearise(self.values, z)
        sigma = np.tile(np.hypot(b.sigma, self.excess), b.kind.rows)[:, None]
        a, c = by_own / sigma, by_arm * self.units / sigma
        information = a.T @ a + np.eye(b.size)
        follows = -np.linalg.solve(information, a.T @ c)  # (size, P + K)
        local = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(self.found).T
        moved = np.empty((len(points), 3, b.size))
        for k, at in enumerate(b.free):
            step = STEP * np.eye(len(x))[at]
            ends = [local @ pose_of(b.kind.describe(x + s * step)).T for s in (1, -1)]
            moved[:, :, k] = (ends[0] - ends[1])[:, :3] / (2 * STEP) * b.sd[k]
        return moved @ follows, moved @ np.linalg.inv(information) @ np.swapaxes(moved, 1, 2)


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
        fitted = ", ".join([BASE, *arm.states])
        raise BayescalError("the fit did not locate this target", where, f"give one of: {fitted}")
    index, m = names.index(name), dataset.measurements
    rows = np.flatnonzero((m.target == index) & (m.role == "calibrate") & ~np.isin(m.ids, arm.rejected))
    wide = arm.beyond.widened(arm.model, arm.values)
    block = wide.block(index, rows)
    state = arm.states[name]
    described = block.kind.describe(state)
    if not {"frame", "centre"} & set(described):
        kind = dataset.targets[index].kind
        raise BayescalError(f"a {kind} has no frame", where, "give an instrument, a sphere or a fixed point")
    nominal = pose_of(block.kind.describe(np.zeros(len(state))))
    return Frame(
        nominal, pose_of(described), block, state, padded(arm.values, wide),
        unit_errors(wide, len(arm.values)), arm.beyond.excess,
    )  # fmt: skip
