"""The distances that validate: between balls of the plate, or between points that a tracker reads."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from analysis.world.scene import pairs
from analysis.world.session import TRACKER
from analysis.world.touch import World
from analysis.world.visible import Fitted


def of_balls(world: World) -> list[tuple[int, int]]:
    """Return the pairs of balls whose distance validates."""
    measured = set(world.session.measured_balls)
    return [pair for pair in pairs() if measured.issuperset(pair)]


def certificate_errors(world: World) -> np.ndarray | float:
    """Return true less certified lengths (m) of the validating distances; a tracker needs no certificate."""
    if world.session.stage == TRACKER:
        return 0.0
    sc = world.scene
    certified = dict(zip(pairs(), sc.certified, strict=True))
    return np.array([np.linalg.norm(sc.ball[i] - sc.ball[j]) - certified[i, j] for i, j in of_balls(world)])


def distances(world: World, model: Fitted, rest: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Return errors (m) of the validating distances.

    Parameters
    ----------
    world : World
        The true arm before its scene.
    model : Fitted
        Derivatives by the parameters of a baseline.
    rest : numpy.ndarray
        What is left of a shift in every row (m).
    still : numpy.ndarray
        What every row shows of the arm without effects (m).
    """
    if world.session.stage == TRACKER:
        late = ~model.used
        return _between_points(still[late].reshape(-1, 3), rest[late].reshape(-1, 3))
    return _between_balls(world, model, rest)


def _between_balls(world: World, model: Fitted, rest: np.ndarray) -> np.ndarray:
    target, move = world.session.target, np.empty((12, 3))
    for b in world.session.measured_balls:
        on = target == b + 4
        move[b] = np.linalg.lstsq(model.normal[on], rest[on], rcond=None)[0]
    out = []
    for i, j in of_balls(world):
        along = world.scene.ball[j] - world.scene.ball[i]
        out.append((move[j] - move[i]) @ along / np.linalg.norm(along))
    return np.array(out)


def _between_points(point: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Return errors of all distances between points (n, 3) of the validation poses that move (n, 3)."""
    i, j = np.array(list(combinations(range(len(point)), 2))).T
    along = point[j] - point[i]
    return np.sum((move[j] - move[i]) * along, axis=1) / np.linalg.norm(along, axis=1)
