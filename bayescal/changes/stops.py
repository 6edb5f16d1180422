"""The covariance of residuals, with what the measurements of one stop of the arm share.

An unsteady joint, or air on the way to the instrument, displaces all reflectors that are read at one stop. In
a session with several measurements at one stop the last link has a displacement and a rotation of its own at
every stop, each with a variance of the session: residuals have the covariance M = K + H T H', with the
independent noise K.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from bayescal.arm.motion import Term
from bayescal.arm.transforms import AXES
from bayescal.dataset import Measurements
from bayescal.effects import Parameter
from bayescal.effects.location import link
from bayescal.estimate.families import ANGLE, EFFECT, LENGTH, poses

KIND = np.array([axis[0] == "r" for axis in AXES], int)
"""Of each axis: 0 of a displacement, 1 of a rotation."""
UNITS = (("m", LENGTH), ("rad", ANGLE))
"""Unit and unit amplitude of each kind."""


def displacements(joints: int) -> list[Parameter]:
    """Displacements and rotations of the last link, in the order of `AXES`."""
    return [
        Parameter("", unit, (Term(joints, axis),), sd, site=link(joints), effect=EFFECT)
        for axis, kind in zip(AXES, KIND, strict=True)
        for unit, sd in [UNITS[kind]]
    ]


@dataclass(frozen=True)
class Stops:
    """Stops of the sessions in which some stop has several measurements; stop 0 stands for none.

    `columns` (R, 6) are of R whitened residuals by `displacements`, zero where there is no stop; `stop` (R,)
    is the stop of each residual, `session` (P,) the session of each stop.
    """

    columns: np.ndarray
    stop: np.ndarray
    session: np.ndarray

    @classmethod
    def of(cls, m: Measurements, rows: np.ndarray, session: np.ndarray, columns: np.ndarray) -> Stops:
        """The stops of residuals with a row and a session (R,) each, and columns (R, 6)."""
        stop, sessions = np.zeros(len(rows), int), [0]
        for s in np.unique(session):
            measured, inverse = np.unique(rows[session == s], return_inverse=True)
            pose = poses(m, measured)
            if np.max(np.bincount(pose)) > 1:
                stop[session == s] = len(sessions) + pose[inverse]
                sessions += [int(s)] * (int(np.max(pose)) + 1)
        return cls(np.where(stop[:, None] > 0, columns, 0.0), stop, np.array(sessions))

    @cached_property
    def matrix(self) -> csr_array:
        """H (R, 6 P)."""
        index = 6 * self.stop[:, None] + np.arange(6)
        start = 6 * np.arange(len(self.stop) + 1)
        shape = (len(self.stop), 6 * len(self.session))
        return csr_array((self.columns.ravel(), index.ravel(), start), shape=shape)

    def shared(self, sessions: int) -> np.ndarray:
        """Whether the measurements of each of S sessions may share errors of a stop, (S, 2)."""
        return np.repeat(np.isin(np.arange(sessions), self.session[1:])[:, None], 2, axis=1)


@dataclass(frozen=True)
class Covariance:
    """M of residuals.

    Parameters
    ----------
    stops : Stops
    kappa : np.ndarray, shape (R,)
        Standard deviations of the independent noise.
    size : np.ndarray, shape (S, 2)
        Variances of the displacement and of the rotation at a stop of each session.
    """

    stops: Stops
    kappa: np.ndarray
    size: np.ndarray

    @cached_property
    def _information(self) -> np.ndarray:
        """Blocks (P, 6, 6) of H' K^-1 H."""
        by = self.stops.columns / self.kappa[:, None]
        out = np.zeros((len(self.stops.session), 6, 6))
        np.add.at(out, self.stops.stop, by[:, :, None] * by[:, None, :])
        return out

    @cached_property
    def _inner(self) -> np.ndarray:
        """Blocks (P, 6, 6) of (T^-1 + H' K^-1 H)^-1."""
        return np.linalg.inv(self._information + np.eye(6) / self.size[self.stops.session][:, None, KIND])

    def weighted(self, x: np.ndarray) -> np.ndarray:
        """M^-1 x for columns (R, k)."""
        h, noise = self.stops.matrix, self.kappa[:, None] ** 2
        projected = (h.T @ (x / noise)).reshape(len(self._inner), 6, -1)
        out: np.ndarray = (x - h @ (self._inner @ projected).reshape(h.shape[1], -1)) / noise
        return out

    @cached_property
    def diagonal(self) -> np.ndarray:
        """Diagonal (R,) of M^-1."""
        by, noise = self.stops.columns, self.kappa**2
        return (1.0 - np.einsum("ri,rij,rj->r", by, self._inner[self.stops.stop], by) / noise) / noise

    def sizes(
        self, weighted_residual: np.ndarray, x: np.ndarray, covariance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Squares (S, 2) of the most probable errors of stops, and how many of these are known.

        Parameters
        ----------
        weighted_residual : np.ndarray, shape (R,)
            M^-1 r of the residuals r that the unknowns leave.
        x : np.ndarray, shape (R, k)
            M^-1 X of the columns of the unknowns, of which `covariance` (k, k) is the covariance.
        """
        h, size = self.stops.matrix, self.size[self.stops.session][:, KIND]
        errors = size * (h.T @ weighted_residual).reshape(size.shape)
        by = h.T @ x
        absorbed = np.sum((by @ covariance) * by, axis=1).reshape(size.shape)
        information = np.einsum(
            "pii->pi", self._information - self._information @ self._inner @ self._information
        )
        square, determined = (np.zeros(self.size.shape) for _ in range(2))
        index = self.stops.session[1:, None], KIND
        np.add.at(square, index, errors[1:] ** 2)
        np.add.at(determined, index, (size * (information - absorbed))[1:])
        return square, determined

    @property
    def share(self) -> np.ndarray:
        """RMS error that the residuals of a stop of each session (S,) share, over their independent noise."""
        shared = self.stops.columns**2 * self.size[self.stops.session[self.stops.stop]][:, KIND]
        used = self.stops.stop > 0
        session, count = self.stops.session[self.stops.stop[used]], len(self.size)
        over = np.bincount(session, np.sum(shared, axis=1)[used], count)
        return np.sqrt(over / np.maximum(np.bincount(session, self.kappa[used] ** 2, count), 1e-300))
