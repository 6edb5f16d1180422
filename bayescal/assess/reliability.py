"""Gross errors of single measurements that a fit would not detect, and what they would do to distances.

Reliability after Baarda (A testing procedure for use in geodetic networks, 1968). A gross error e of a
measurement, over the standard uncertainty of its k residuals, leaves the share R e of itself in them, with
R = I - H and H = J C J' its leverage: the redundancy numbers of the measurement. The rule for outliers
(`estimate.outliers`) then has the noncentrality e' R e, and detects it with probability `POWER` where that
is the one of `detectable` (internal reliability). Undetected it moves the estimate by C J' e, and a distance
of slopes d by d C J' e (external reliability). For each measurement, the e of that noncentrality is taken
that gives the largest root mean square of these over all distances: the largest eigenvalue of a k x k matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.estimate import Estimate
from bayescal.estimate.noise import by_group
from bayescal.estimate.outliers import LEAST_SPARE, detectable
from bayescal.model.block import ARM, Block
from bayescal.model.length_blocks import length_blocks
from bayescal.predict.forecast import workspace
from bayescal.predict.pairs import slopes


@dataclass(frozen=True)
class Reliability:
    """Of each fitted measurement of a length, without the rejected ones."""

    rows: np.ndarray  # (N,) of the session
    error: np.ndarray  # (N,) m: length of the gross error that is detected with probability `POWER`
    shift: np.ndarray  # (N,) m: root mean square change of distances by it, over the workspace


def reliability(found: Estimate) -> Reliability:
    """The minimum detectable gross error of each measurement, and the change of distances that it causes.

    Linear in the error; orientations are not judged. Without parameters of the arm or distances all changes
    are 0.
    """
    model, space, arm = found.model, workspace(found), found.model.slices[ARM]
    mean = np.zeros((arm.stop - arm.start,) * 2)
    if model.parameters and len(space.pairs):
        by = slopes(model, space.motion, space.values, space.pairs)
        mean = by.T @ by / len(by)
    counts = {group: sum(len(b.rows) for b in blocks) for group, blocks in by_group(model).items()}
    parts = [_of_block(found, b, mean, counts[b.group]) for b in length_blocks(model)]
    rows, error, shift = np.concatenate([np.zeros((3, 0)), *parts], axis=1)
    return Reliability(rows.astype(int), error, shift)


def _of_block(found: Estimate, block: Block, mean: np.ndarray, count: int) -> np.ndarray:
    """Rows, errors and changes (3, C) of the kept measurements of a block, of `count` in its noise group.

    `mean` (P, P) is the mean square of the slopes of distances by z of the arm, m^2.
    """
    k, keep = block.kind.rows, found.weights.row[block.name] > 0
    jacobian = found.linear.jacobian[found.linear.of_block[block.name]].reshape(k, len(keep), -1)[:, keep]
    sigma = 1.0 / found.weights.whitening(block).reshape(k, -1)[:, keep]
    moved = jacobian @ found.covariance  # (k, C, D)
    share, turn = np.linalg.eigh(np.einsum("icd,jcd->cij", moved, jacobian))
    spare = np.maximum(1.0 - share, LEAST_SPARE)
    spread = turn / np.sqrt(spare)[:, None, :]  # R^-1/2, times a rotation
    of_arm = moved[..., found.model.slices[ARM]]
    square = np.einsum("icp,pq,jcq->cij", of_arm, mean, of_arm, optimize=True)
    largest, vector = np.linalg.eigh(np.swapaxes(spread, 1, 2) @ square @ spread)
    size = np.sqrt(detectable(k, found.dof[block.group], count))
    error = size * np.einsum("cij,cj->ic", spread, vector[..., -1]) * sigma
    shift = size * np.sqrt(np.maximum(largest[:, -1], 0.0))
    return np.stack([block.rows[keep], np.linalg.norm(error, axis=0), shift])
