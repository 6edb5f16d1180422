"""A laser tracker beside the arm: it reads x, y, z of a reflector on the flange while the arm is at rest.

The reflector turns to the instrument by itself, nothing is touched, and the last motion before a reading is
that of the approach. What needs a surface, a trigger or a moving arm has therefore no effect here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from analysis.world.touch import Act, World


@dataclass(frozen=True)
class Instrument:
    """Where the tracker stands (m) and how it is turned, in the frame of the base: true and as stated."""

    origin: np.ndarray
    turn: np.ndarray
    stated_origin: np.ndarray
    stated_turn: np.ndarray

    def read(self, point: np.ndarray) -> np.ndarray:
        """Return points (n, 3) of the base's frame as the instrument reads them."""
        return (point - self.origin) @ self.turn

    def of_moves(self, move: np.ndarray) -> np.ndarray:
        """Return displacements (n, 3) of the base's frame in the instrument's axes."""
        return move @ self.turn


@dataclass
class Tracked(World):
    """The true arm before a tracker: every pose has three rows, x, y and z."""

    instrument: Instrument

    def normals(self, ball: np.ndarray) -> np.ndarray:
        """Return nan (n, 3): nothing is touched."""
        return np.full_like(ball, np.nan)

    def clearance(self, ball: np.ndarray) -> np.ndarray:
        """Return what the instrument reads of a reflector without noise, x, y, z of every pose (3 n,)."""
        return self.instrument.read(ball).ravel()

    def shown(self, move: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Return what rows (3 n,) show of displacements of the reflector (n, 3)."""
        del normal
        return self.instrument.of_moves(move).ravel()

    def gap(self, readings: np.ndarray, acts: Sequence[tuple[Act, float]] = ()) -> np.ndarray:
        """Return what the instrument reads (3 n,) without noise, at given joint readings."""
        return self.clearance(self.seen(readings, acts)[0].ball)

    def touch(
        self, acts: Sequence[tuple[Act, float]], noise: np.ndarray, *, straight: bool = False
    ) -> tuple[np.ndarray, float]:
        """Return the readings of the poses: no surface changes them."""
        del acts, noise, straight
        return self.session.start, 0.0

    def points(self, acts: Sequence[tuple[Act, float]], noise: np.ndarray) -> np.ndarray:
        """Return what the instrument reads (n, 3); the noise (3 n,) has the sign that it has in contacts.

        A contact lies `noise` off the surface, which a model of the arm finds as a residual of its own sign;
        a model of the arm lies `noise` off a reading.
        """
        return (self.gap(self.session.start, acts) - noise).reshape(-1, 3)


def draw(rng: np.random.Generator) -> Instrument:
    """Return a tracker 1.8 to 3.5 m before the arm, turned at random, levelled to about half a degree."""
    bearing, far, high = rng.uniform(-1.0, 1.0), rng.uniform(1.8, 3.5), rng.uniform(0.2, 1.4)
    origin = np.array([far * np.cos(bearing), far * np.sin(bearing), high])
    level = Rotation.from_rotvec(0.01 * rng.standard_normal(3))
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)) * level
    wrong = Rotation.from_rotvec(3e-3 * rng.standard_normal(3))
    stated = origin + 5e-3 * rng.standard_normal(3)
    return Instrument(origin, turn.as_matrix(), stated, (wrong * turn).as_matrix())
