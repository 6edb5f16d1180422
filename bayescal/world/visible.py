"""The part of an effect that the baseline does not absorb: finite differences, projected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.world.arm import JOINT, SIZE, Arm
from bayescal.world.scene import U_DIAMETER, U_DISTANCE, U_SIZE, U_SQUARE, pairs
from bayescal.world.session import SPHERES
from bayescal.world.touch import World

STEP = 1e-5
PRIOR = {"a": 3e-4, "alpha": 1e-3, "d": 3e-4, "zero": 2e-3, "beta3": 1e-3}


@dataclass
class Fitted:
    """Derivatives of every gap by the parameters of a baseline, at one set of readings."""

    columns: np.ndarray  # (n, m)
    normal: np.ndarray
    certificates: np.ndarray  # certificates (k, m), whitened
    prior: np.ndarray  # standard deviations (m,), wide where nothing is known
    used: np.ndarray  # rows to calibrate with
    certified: bool  # whether certificates always count: on spheres alone nothing else has a scale

    def left(self, shift: np.ndarray, sigma: float, certificates: bool = False) -> np.ndarray:
        """Return what no fit absorbs of a shift of gaps (n,), whitened."""
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
        """Return what a fit of these rows makes of a shift of gaps, everywhere (n,)."""
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
            out.append(np.sum(normal * (ends[0] - ends[1]), axis=1) / (2 * STEP))
            prior.append(sd)
    if stiffness:
        for j in range(1, 6):
            change = np.zeros_like(coordinates)
            change[:, JOINT[j]] = STEP * load[:, j]
            ends = [ball(world.arm, coordinates + way * change) for way in (1, -1)]
            out.append(np.sum(normal * (ends[0] - ends[1]), axis=1) / (2 * STEP))
            prior.append(10 * shape.give[j])
    tool = np.einsum("nij,ni->nj", turn, normal)
    out += list(tool.T)
    prior += [5e-3] * 3
    arm_count = len(out)
    sc, target = world.scene, world.session.target
    spheres = world.session.stage == SPHERES
    for b in world.session.calibrating if spheres else ():
        on = target == b
        out += [*(-normal * on[:, None]).T, -0.5 * on]
        prior += [0.05] * 3 + [1e-3]
    for f in () if spheres else range(4):
        on = target == f
        lever = (ball(world.arm, coordinates) - sc.point[f]) * on[:, None]
        out += [lever @ sc.across[f, 0], lever @ sc.across[f, 1], -on.astype(float)]
        prior += [0.2, 0.2, 0.05]
    return Fitted(
        np.stack(out, axis=1),
        normal,
        _ball_certificates(world, arm_count) if spheres else _certificates(world, arm_count),
        np.array(prior),
        world.session.phase == 0,
        spheres,
    )


def _certificates(world: World, before: int) -> np.ndarray:
    """Return the certificates' rows by tilts and offsets of faces; unknowns of the arm stand before them."""
    sc, rows = world.scene, []
    size = np.zeros(before + 12)
    size[before + 2] = size[before + 5] = 1 / U_SIZE
    rows.append(size)
    for k in range(2):
        row = np.zeros(before + 12)
        for f in (0, 1):
            row[before + 3 * f : before + 3 * f + 2] = sc.across[f] @ sc.across[0, k] / U_SQUARE
        rows.append(row)
    for f, g in ((0, 2), (0, 3), (2, 3)):
        row = np.zeros(before + 12)
        row[before + 3 * f : before + 3 * f + 2] = sc.across[f] @ sc.normal[g] / U_SQUARE
        row[before + 3 * g : before + 3 * g + 2] = sc.across[g] @ sc.normal[f] / U_SQUARE
        rows.append(row)
    return np.array(rows)


def _ball_certificates(world: World, before: int) -> np.ndarray:
    """Return the certificates' rows by centres and diameters of the balls to calibrate with."""
    sc, rows = world.scene, []
    column = {int(b) - 4: before + 4 * k for k, b in enumerate(world.session.calibrating)}
    width = before + 4 * len(column)
    for i, j in pairs():
        if i in column and j in column:
            along = (sc.ball[j] - sc.ball[i]) / np.linalg.norm(sc.ball[j] - sc.ball[i]) / U_DISTANCE
            row = np.zeros(width)
            row[column[i] : column[i] + 3], row[column[j] : column[j] + 3] = -along, along
            rows.append(row)
    for at in column.values():
        rows.append(np.eye(width)[at + 3] / U_DIAMETER)
    return np.array(rows)


def validating(world: World) -> list[tuple[int, int]]:
    """Return the pairs of balls whose distance validates."""
    measured = set(world.session.measured_balls)
    return [pair for pair in pairs() if measured.issuperset(pair)]


def distances(
    world: World, model: Fitted, shift: np.ndarray, sigma: float, rows: np.ndarray | None
) -> np.ndarray:
    """Return errors (m) of the validating distances that a shift of gaps leaves after a fit, if any."""
    rest = shift - model.absorbed(shift, sigma, rows) if rows is not None else shift
    target, move = world.session.target, np.empty((12, 3))
    for b in world.session.measured_balls:
        on = target == b + 4
        move[b] = np.linalg.lstsq(model.normal[on], rest[on], rcond=None)[0]
    out = []
    for i, j in validating(world):
        along = world.scene.ball[j] - world.scene.ball[i]
        out.append((move[j] - move[i]) @ along / np.linalg.norm(along))
    return np.array(out)
