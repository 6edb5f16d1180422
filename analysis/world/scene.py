"""What stands before the arm: a cube of four probed faces, and three balls on a plate at four places.

A session with a tracker has neither: its only target is the instrument.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

FACES = ("cube.+y", "cube.-y", "cube.-x", "cube.+z")
NAMES = (*FACES, *(f"ball.{b}@{p}" for p in (1, 2, 3, 4) for b in "ABC"), "tracker")
"""Of the targets, by their numbers in a session: faces, then balls, then the instrument."""
BALLS, INSTRUMENT = slice(4, 16), 16
SIDE, BALL = 0.2286, 0.0508
MIDDLE = np.array([0.45, 0.0, 0.15])
NORMALS = np.array([[0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, 0, 1]], dtype=float)
U_SIZE, U_SQUARE, U_DISTANCE, U_DIAMETER = 3e-6, 1.2e-5, 1e-6, 1e-6


@dataclass
class Scene:
    """Where things stand (m): faces as n.x = offset, balls by centre, drawn and true."""

    normal: np.ndarray
    point: np.ndarray
    across: np.ndarray  # (4, 2, 3): two directions on every face
    ball: np.ndarray  # (12, 3)
    ball_drawn: np.ndarray  # (12, 3)
    radius: np.ndarray  # (12,)
    certified: np.ndarray  # (12,): A-B, A-C and B-C at every place


def pairs() -> list[tuple[int, int]]:
    """Return the pairs of balls whose distance is certified."""
    return [(3 * p + i, 3 * p + j) for p in range(4) for i, j in ((0, 1), (0, 2), (1, 2))]


def _plates(rng: np.random.Generator) -> np.ndarray:
    """Draw three balls in a plate, and the plate at four places."""
    angle = rng.uniform(0, 2 * np.pi) + np.array([0, 2, 4]) * np.pi / 3 + rng.uniform(-0.25, 0.25, 3)
    radius = rng.uniform(0.075, 0.1, 3)
    plate = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(3)], axis=-1)
    balls = []
    towards = rng.permutation(np.radians([-48, -20, 15, 45])) + np.radians(rng.uniform(-7, 7, 4))
    for azimuth in towards:
        far, high = rng.uniform(0.36, 0.47), rng.uniform(0.1, 0.26)
        centre = np.array([far * np.cos(azimuth), far * np.sin(azimuth), high])
        turn = Rotation.from_rotvec(rng.uniform(-0.2, 0.2, 3) + np.array([0, 0, rng.uniform(0, 2 * np.pi)]))
        balls.append(turn.apply(plate) + centre)
    return np.concatenate(balls)


def draw(rng: np.random.Generator) -> Scene:
    """Return a cube slightly out of place and true to its certificate, and the balls."""
    turn = Rotation.from_rotvec(0.009 * rng.standard_normal(3))
    move = 2e-3 * rng.standard_normal(3)
    tilt = U_SQUARE / np.sqrt(2) * rng.standard_normal((4, 3))
    normal = turn.apply(NORMALS + np.cross(tilt, NORMALS))
    size = SIDE / 2 + U_SIZE / np.sqrt(2) * rng.standard_normal(4)
    point = turn.apply(NORMALS * size[:, None]) + MIDDLE + move
    first = turn.apply(np.array([[1, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], dtype=float))
    across = np.stack([first, np.cross(normal, first)], axis=1)
    ball = _plates(rng)
    drawn = ball + 2e-3 * rng.standard_normal(ball.shape)
    true = np.array([np.linalg.norm(ball[i] - ball[j]) for i, j in pairs()])
    one = true[:3] + U_DISTANCE * rng.standard_normal(3)
    radius = np.tile(BALL / 2 + 0.5e-6 * rng.standard_normal(3), 4)
    return Scene(normal, point, across, ball, drawn, radius, np.tile(one, 4))
