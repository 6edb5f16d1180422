"""The part of an effect that the baseline does not absorb: finite differences, projected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from analysis.world.arm import JOINT, SIZE, Arm
from analysis.world.scene import U_DIAMETER, U_DISTANCE, U_SIZE, U_SQUARE, pairs
from analysis.world.session import CUBE, SPHERES, TRACKER
from analysis.world.touch import World
from analysis.world.tracker import Tracked

STEP = 1e-5
PRIOR = {"a": 3e-4, "alpha": 1e-3, "d": 3e-4, "zero": 2e-3, "beta3": 1e-3}


@dataclass
class Fitted:
    """Derivatives of every row by the parameters of a baseline, at one set of readings."""

    columns: np.ndarray  # (n, m)
    normal: np.ndarray  # of the touched surface, outward (contacts, 3); nan of a tracker
    certificates: np.ndarray  # certificates (k, m), whitened
    prior: np.ndarray  # standard deviations (m,), wide where nothing is known
    used: np.ndarray  # rows to calibrate with
    certified: bool  # whether certificates always count: on spheres alone nothing else has a scale

    def left(self, shift: np.ndarray, sigma: float, certificates: bool = False) -> np.ndarray:
        """Return what no fit absorbs of a shift of rows (n,), whitened."""
        matrix, right = self.columns[self.used] / sigma, shift[self.used] / sigma
        if certificates or self.certified:
            matrix, right = (
                np.concatenate([matrix, self.certificates]),
                np.append(right, np.zeros(len(self.certificates))),
            )
        u, s, _ = np.linalg.svd(matrix / np.linalg.norm(matrix, axis=0), full_matrices=False)
        u = u[:, s > 1e-7 * s[0]]
        return right - u @ (u.T @ right)

    def absorbed(self, shift: np.ndarray, sigma: float, rows: np.ndarray) -> np.ndarray:
        """Return what a fit of these rows makes of a shift of rows, everywhere (n,)."""
        matrix = np.concatenate([self.columns[rows] / sigma, self.certificates, np.diag(1 / self.prior)])
        right = np.zeros(len(matrix))
        right[: rows.sum()] = shift[rows] / sigma
        scale = np.linalg.norm(matrix, axis=0)
        return self.columns @ (np.linalg.lstsq(matrix / scale, right, rcond=1e-12)[0] / scale)


def _equilibrium(world: World, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    seen, _ = world.seen(readings, ())
    coordinates = np.zeros((len(readings), SIZE))
    coordinates[:, JOINT] = seen.link + world.give * seen.load[:, JOINT]
    return coordinates, seen.load[:, JOINT], seen.normal, seen.turn


def fitted(world: World, readings: np.ndarray, stiffness: bool) -> Fitted:
    """Return the derivatives at given readings, of an arm without effects.

    Parameters
    ----------
    world : World
        The true arm before its scene.
    readings : numpy.ndarray
        Joint readings (n, 6).
    stiffness : bool
        Whether the baseline fits compliances too.
    """
    coordinates, load, normal, turn = _equilibrium(world, readings)
    shape = world.arm.shape

    def ball(arm: Arm, at: np.ndarray) -> np.ndarray:
        origin, turned = arm.place(at)
        return origin + turned @ arm.shape.tool

    out, prior = [], []
    for name, sd in PRIOR.items():
        value = getattr(shape, name)
        for i in range(np.size(value)):
            change = STEP * np.eye(6)[i] if np.size(value) > 1 else STEP
            ends = [ball(Arm(replace(shape, **{name: value + way * change})), coordinates) for way in (1, -1)]
            out.append(world.shown(ends[0] - ends[1], normal) / (2 * STEP))
            prior.append(sd)
    if stiffness:
        for j in range(1, 6):
            change = np.zeros_like(coordinates)
            change[:, JOINT[j]] = STEP * load[:, j]
            ends = [ball(world.arm, coordinates + way * change) for way in (1, -1)]
            out.append(world.shown(ends[0] - ends[1], normal) / (2 * STEP))
            prior.append(10 * shape.give[j])
    out += [world.shown(turn[:, :, axis], normal) for axis in range(3)]
    prior += [5e-3] * 3
    columns, spread, certificates = TARGETS[world.session.stage](world, ball(world.arm, coordinates), normal)
    width = len(out)
    return Fitted(
        np.stack([*out, *columns], axis=1),
        normal,
        np.pad(certificates, ((0, 0), (width, 0))),
        np.array(prior + spread),
        world.session.of_rows(world.session.phase == 0),
        world.session.stage == SPHERES,
    )


Targets = tuple[list[np.ndarray], list[float], np.ndarray]
"""Derivatives of rows by the unknowns of targets, their priors, and certificates by these unknowns."""


def _faces(world: World, ball: np.ndarray, normal: np.ndarray) -> Targets:
    """Return the same of tilts and offsets of four faces."""
    del normal
    sc, out = world.scene, []
    for f in range(4):
        on = world.session.target == f
        lever = (ball - sc.point[f]) * on[:, None]
        out += [lever @ sc.across[f, 0], lever @ sc.across[f, 1], -on.astype(float)]
    return out, [0.2, 0.2, 0.05] * 4, _certificates(world)


def _balls(world: World, ball: np.ndarray, normal: np.ndarray) -> Targets:
    """Return the same of centres and diameters of the balls to calibrate with."""
    del ball
    out = []
    for b in world.session.calibrating:
        on = world.session.target == b
        out += [*(-normal * on[:, None]).T, -0.5 * on]
    return out, [0.05, 0.05, 0.05, 1e-3] * len(world.session.calibrating), _ball_certificates(world)


def _instrument(world: World, ball: np.ndarray, normal: np.ndarray) -> Targets:
    """Return the same of place and orientation of a tracker, which needs no certificate."""
    assert isinstance(world, Tracked)
    lever, axes = ball - world.instrument.origin, np.eye(3)
    moves = [np.broadcast_to(-axis, lever.shape) for axis in axes] + [np.cross(lever, axis) for axis in axes]
    return [world.shown(move, normal) for move in moves], [0.05] * 3 + [0.2] * 3, np.empty((0, 6))


TARGETS: dict[str, Callable[[World, np.ndarray, np.ndarray], Targets]] = {
    CUBE: _faces, SPHERES: _balls, TRACKER: _instrument,
}  # fmt: skip
"""What the targets of a session add to the unknowns."""


def _certificates(world: World) -> np.ndarray:
    """Return the certificates' rows by tilts and offsets of faces."""
    sc, rows = world.scene, []
    size = np.zeros(12)
    size[2] = size[5] = 1 / U_SIZE
    rows.append(size)
    for k in range(2):
        row = np.zeros(12)
        for f in (0, 1):
            row[3 * f : 3 * f + 2] = sc.across[f] @ sc.across[0, k] / U_SQUARE
        rows.append(row)
    for f, g in ((0, 2), (0, 3), (2, 3)):
        row = np.zeros(12)
        row[3 * f : 3 * f + 2] = sc.across[f] @ sc.normal[g] / U_SQUARE
        row[3 * g : 3 * g + 2] = sc.across[g] @ sc.normal[f] / U_SQUARE
        rows.append(row)
    return np.array(rows)


def _ball_certificates(world: World) -> np.ndarray:
    """Return the certificates' rows by centres and diameters of the balls to calibrate with."""
    sc, rows = world.scene, []
    column = {int(b) - 4: 4 * k for k, b in enumerate(world.session.calibrating)}
    width = 4 * len(column)
    for i, j in pairs():
        if i in column and j in column:
            along = (sc.ball[j] - sc.ball[i]) / np.linalg.norm(sc.ball[j] - sc.ball[i]) / U_DISTANCE
            row = np.zeros(width)
            row[column[i] : column[i] + 3], row[column[j] : column[j] + 3] = -along, along
            rows.append(row)
    for at in column.values():
        rows.append(np.eye(width)[at + 3] / U_DIAMETER)
    return np.array(rows)
