"""The probed region: where the data of a session support a fitted arm.

A target is inside if both hold:

- its TCP is within the convex hull of the TCP positions of the session. Errors that the model lacks, and
  the effect of gravity, vary with the place of the arm, and were only seen there;
- each reading is within the range of the readings of the session. Errors of encoders and gears vary with the
  angle of a joint, and an arm can reach a probed place with angles that were never seen.

The hull of the readings is not used: with six joints it contains hardly anything but the rows themselves. The
uncertainty of a target outside is that of the model, and says nothing about a model that is wrong there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from bayescal.exporting.fitted import FittedArm

BESIDE = 10e-3
"""m: a point this close to the hull counts as inside; the hull of points on one plane has no volume."""
BEYOND = np.radians(1.0)
"""rad: a reading this close to the range counts as inside."""
STIFF = 1e3  # weight of the sum of the weights, 1/m


@dataclass(frozen=True)
class Region:
    """TCP positions (N, 3), m, and readings (N, n), rad, of a session."""

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
