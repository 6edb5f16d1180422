"""Inverse calibration: joints as they would have to be for the arm to be where it was, against readings.

A row says where the tool is: a point for an instrument or a socket, an orientation beside it for a pose, one
direction for a surface. The joint change that would bring the drawn arm there is that of least length,
dq = J' (J J')^-1 r with J the row's gradients by the readings: the first step of inverse kinematics. Its
squares are summed, so a millimetre counts more where the joints must turn further for it. Targets are
unknown, certificates hold.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.methods.linear import NO_LENGTH
from bayescal.methods.method import Method, Solution, where_it_stands
from bayescal.methods.solving import Rows, System, levenberg
from bayescal.model import Block, Model, build
from bayescal.model.scene import Scene

SINGULAR = 0.03
"""Least share of the largest singular value of a row's J that a direction counts with near singular poses."""


def joint_change(block: Block, coupling: np.ndarray) -> np.ndarray:
    """Factors (C, rows, rows), rad/m, that turn a row's residuals into ones as long as its joint change."""
    still = np.zeros(block.motion.size), np.zeros(block.size)
    gradients = block.by_readings(*still, coupling)
    own = gradients.reshape(block.kind.rows, len(block.rows), -1).swapaxes(0, 1)
    left, size, _ = np.linalg.svd(own, full_matrices=False)
    reach = np.maximum(size, SINGULAR * size[:, :1])
    return left / reach[:, None, :] @ left.swapaxes(1, 2)


def in_joints(model: Model) -> Callable[[Block, np.ndarray, np.ndarray], Rows]:
    """Rows in joint space, over the stated noise of a block at its median reach."""
    coupling = model.scene.dataset.robot.link_from_reading
    factors = {block.name: joint_change(block, coupling) for block in model.blocks}

    def rows(block: Block, values: np.ndarray, z: np.ndarray) -> Rows:
        factor = factors[block.name]
        usual = np.median(np.trace(factor, axis1=1, axis2=2)) / block.kind.rows
        factor = factor / (usual * block.sigma[:, None, None])

        def turned(columns: np.ndarray) -> np.ndarray:
            own = columns.reshape(block.kind.rows, len(block.rows), -1)
            return np.einsum("cij,jck->ick", factor, own).reshape(columns.shape)

        r, by_arm, by_target = block.linearise(values, z)
        return turned(r), turned(by_arm), turned(by_target)

    return rows


def missing(model: Model) -> str:
    """What a session lacks for joint residuals."""
    return "" if model.knows_length else NO_LENGTH


@where_it_stands
def solve(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """Fit the arm to its joint readings."""
    model = build(scene, effects)
    return levenberg(System(model, in_joints(model)))


INVERSE = Method(
    "inverse",
    "joint residuals at known poses",
    "least squares of the joint corrections that reproduce the measured poses, along the measured directions",
    missing,
    solve,
)
