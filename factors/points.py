"""Certified coordinates of an artefact's points: its form, wherever it stands.

Points p of one placement are the certified points c, turned and shifted by an unknown pose. After the best
fit of c to p (Kabsch, Acta Cryst. A 32 (1976) 922) the rest e = R'(p - t) - c, in the frame of the artefact,
is free of the pose in the directions N that no rigid motion moves: N e has the covariance N S N', where S is
that of the coordinates. With a flat prior of the pose nothing else of the coordinates can be seen. Points on
one line leave a rotation about it undetermined: there the form is the lengths between neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from factors.certificate import Certificate, Residual
from factors.kind import Kind, direction, feature

CORRELATION = 0.9
"""Of the errors of one artefact at two placements: clamps and temperature change the rest (assumed)."""
STRAIGHT = 0.02
"""Width over length up to which points count as on one line."""
EXACT = 1e-4
"""Of the root mean square uncertainty, assumed of every relation: the covariance then has an inverse."""

Form = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Values (..., m) of points (..., k, 3), 0 where they are as certified, and their slopes (..., m, k, 3)."""


@dataclass(frozen=True)
class Shape:
    """What certified coordinates state of placed points, whitened.

    Attributes
    ----------
    forms : tuple of (indices of targets, Form)
        One for each placement.
    whiten : np.ndarray, shape (m, m)
        Of the stacked values of all placements.
    by_coordinate : np.ndarray, shape (m, 3 K)
        Slopes of the stated values by the certified coordinates, 1/m.
    """

    forms: tuple[tuple[np.ndarray, Form], ...]
    whiten: np.ndarray
    by_coordinate: np.ndarray


def shape(
    coordinates: np.ndarray, covariance: np.ndarray, placements: Sequence[Sequence[tuple[int, int]]]
) -> Shape:
    """The relations between targets that certified coordinates state.

    Parameters
    ----------
    coordinates : np.ndarray, shape (K, 3)
        m, in any frame.
    covariance : np.ndarray, shape (3 K, 3 K)
        m2; positive semi-definite.
    placements : sequence
        Of each placement its targets: (index of the target, index of its point), two or more.
    """
    forms, slopes = [], []
    for placement in placements:
        points = [point for _, point in placement]
        form, by_points = form_of(coordinates[points])
        by = np.zeros((len(by_points), len(coordinates), 3))
        by[:, points] = by_points
        forms.append((np.array([target for target, _ in placement]), form))
        slopes.append(by.reshape(len(by), -1))
    by = np.concatenate(slopes)
    of = np.repeat(np.arange(len(slopes)), [len(s) for s in slopes])
    alike = np.where(of[:, None] == of, 1.0, CORRELATION)
    exact = EXACT**2 * np.trace(covariance) / len(covariance)
    whiten = np.linalg.inv(np.linalg.cholesky(alike * (by @ covariance @ by.T) + exact * np.eye(len(by))))
    return Shape(tuple(forms), whiten, whiten @ by)


def form_of(certified: np.ndarray) -> tuple[Form, np.ndarray]:
    """The form of points (k, 3), m, and the slopes (m, k, 3) of its values by their coordinates."""
    arms = certified - certified.mean(axis=0)
    across, size, _ = np.linalg.svd(arms, full_matrices=False)
    if len(certified) == 2 or size[1] < STRAIGHT * size[0]:
        return _in_line(certified, np.argsort(across[:, 0]))
    count = len(certified)
    turns = np.cross(np.eye(3)[:, None], arms)  # (3, k, 3)
    motions = np.concatenate([np.tile(np.eye(3), count), turns.reshape(3, -1)])
    free = np.linalg.qr(motions.T, mode="complete")[0][:, 6:].T.reshape(-1, count, 3)

    def values(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = p - p.mean(axis=-2, keepdims=True)
        u, _, v = np.linalg.svd(arms.T @ out)
        u[..., -1] *= np.linalg.det(u @ v)[..., None]  # a rotation, no reflection
        turn = np.swapaxes(u @ v, -1, -2)  # out = turn @ arm
        seen = out @ turn
        deviations = np.einsum("mki,...ki->...m", free, seen - arms)
        # the rotation follows the points: sum of arm x seen is 0
        spread = np.einsum("...ki,kj->...ij", seen, arms)
        inertia = np.sum(arms * seen, axis=(-1, -2))[..., None, None] * np.eye(3) - spread
        lever = np.sum(np.cross(seen[..., None, :, :], free), axis=-2)  # (..., m, 3)
        by_turn = lever @ np.linalg.inv(inertia)
        by = free - np.cross(by_turn[..., :, None, :], arms)
        return deviations, by @ np.swapaxes(turn, -1, -2)[..., None, :, :]

    return values, free


def _in_line(certified: np.ndarray, order: np.ndarray) -> tuple[Form, np.ndarray]:
    """Lengths between neighbours of points on a line."""
    lengths = np.linalg.norm(np.diff(certified[order], axis=0), axis=1)
    steps = np.zeros((len(lengths), len(certified)))
    steps[np.arange(len(lengths)), order[1:]] = 1.0
    steps[np.arange(len(lengths)), order[:-1]] = -1.0

    def values(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        way, length = direction(steps @ p)
        return length[..., 0] - lengths, steps[:, :, None] * way[..., None, :]

    return values, values(certified)[1]


def certified_points(of: Shape, targets: Sequence[Kind]) -> Certificate:
    """Targets, points of an artefact, as its certified coordinates state them to stand to each other."""

    def residual(*x: np.ndarray) -> Residual:
        places = [feature(t, state) for t, state in zip(targets, x, strict=True)]
        values, slopes = [], [np.zeros(0)] * len(targets)
        first = 0
        for members, form in of.forms:
            value, by = form(np.stack([places[k].place for k in members], axis=-2))
            values.append(value)
            white = of.whiten[:, first : first + value.shape[-1]]
            first += value.shape[-1]
            for i, k in enumerate(members):
                slopes[k] = white @ by[..., i, :] @ np.swapaxes(places[k].by_place, -1, -2)
        return np.concatenate(values, axis=-1) @ of.whiten.T, tuple(slopes)

    return residual
