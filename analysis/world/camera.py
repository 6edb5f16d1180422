"""Simulated sessions of a camera and a board: the arm of the other worlds, its own lens, board and errors.

An arm with errors in every length and elastic joints carries a board before a fixed camera, or a camera
before a fixed board. Intrinsics and board differ from what is stated within the stated uncertainty. At most
one thing is hidden beyond that, on the side of the arm, the camera, the board, the mount or the clock; its
size follows from a drawn detectability. Nothing is shared with the calibration model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from analysis.world import arm
from analysis.world.arm import JOINT, LIMITS, LINK_FROM_READING, SIZE, Arm, Shape
from analysis.world.camera_files import (
    CENTRE,
    COLUMNS,
    FOCAL,
    IMAGE,
    LENS,
    ROWS,
    SQUARE,
    U_CENTRE,
    U_FLAT,
    U_FOCAL,
    U_LENS,
    U_SCALE,
    settings,
    table,
)  # fmt: skip
from analysis.world.joints import played
from analysis.world.write import SCHEMA, robot_text

GOAL = (20.0, 2000.0)
"""Detectability of what is hidden, from and to."""
PRIORS = {"a": 3e-4, "alpha": 1e-3, "d": 3e-4, "zero": 2e-3, "give": 1e-3, "place": 5e-2, "turn": 0.2}
SIDES = ("arm", "arm", "camera", "board", "mount", "clock", "null", "null")

OF_ARM = {
    "a1": ("a", 1), "a2": ("a", 2), "a3": ("a", 3), "a4": ("a", 4), "d4": ("d", 3), "alpha4": ("alpha", 4),
    "theta3": ("zero", 2), "theta4": ("zero", 3), "theta5": ("zero", 4),
}  # fmt: skip
"""Parameters of the arm by the names of modified Denavit-Hartenberg rows, and where a shape has them."""


@dataclass(frozen=True)
class Cell:
    """All that determines a pixel: the true arm, places of camera and board, lens and board."""

    shape: Shape
    on_flange: np.ndarray  # (6,) rotation vector and origin
    fixed: np.ndarray  # (6,)
    carried: bool  # the camera is on the flange
    focal: np.ndarray = field(default_factory=lambda: FOCAL.copy())
    centre: np.ndarray = field(default_factory=lambda: CENTRE.copy())
    lens: np.ndarray = field(default_factory=lambda: LENS.copy())
    stretch: np.ndarray = field(default_factory=lambda: np.ones(2))
    bend: np.ndarray = field(default_factory=lambda: np.zeros(2))


@dataclass
class Change:
    """What is hidden in every image: angles of joints (I, 6), shifts of mounts (I, 6), late clock (s)."""

    joint: np.ndarray
    flange: np.ndarray
    fixed: np.ndarray
    late: float = 0.0


def corners() -> np.ndarray:
    """Return nominal inner corners (24, 2) of the board, row by row."""
    grid = np.meshgrid(np.arange(1, COLUMNS), np.arange(1, ROWS))
    return SQUARE * np.stack([g.ravel() for g in grid], axis=1)


def _bent(cell: Cell) -> np.ndarray:
    """Return the corners (24, 3) as they are: stretched, and on a surface of two bends."""
    flat = corners()
    middle = flat.mean(axis=0)
    off = (flat - middle) * cell.stretch
    part = off / (flat.max(axis=0) - middle)
    height = cell.bend[0] * (1 - part[:, 0] ** 2) + cell.bend[1] * (1 - part[:, 1] ** 2)
    return np.column_stack([middle + off, height])


def _moved(pose: np.ndarray, more: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return turns (I, 3, 3) and origins (I, 3) of a pose (6,) that is moved in its own frame by (I, 6)."""
    turn = Rotation.from_rotvec(pose[:3])
    return (turn * Rotation.from_rotvec(more[:, :3])).as_matrix(), pose[3:] + turn.apply(more[:, 3:])


def pixels(
    cell: Cell, readings: np.ndarray, velocity: np.ndarray, change: Change | None = None
) -> np.ndarray:
    """Return pixels (I, 24, 2) without noise."""
    n = len(readings)
    change = change or Change(np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6)))
    body, coordinates = Arm(cell.shape), np.zeros((n, SIZE))
    link = (readings - change.late * velocity) @ LINK_FROM_READING.T + change.joint
    coordinates[:, JOINT] = link
    for _ in range(2):
        coordinates[:, JOINT] = link + cell.shape.give * body.weigh(coordinates)[:, JOINT]
    origin, turn = body.place(coordinates)
    own, at = _moved(cell.on_flange, change.flange)
    held_turn, held = turn @ own, origin + np.einsum("nij,nj->ni", turn, at)
    still_turn, still = _moved(cell.fixed, change.fixed)
    eye, eye_at, plate, plate_at = (
        (held_turn, held, still_turn, still) if cell.carried else (still_turn, still, held_turn, held)
    )
    world = np.einsum("nij,kj->nki", plate, _bent(cell)) + plate_at[:, None]
    view = np.einsum("nji,nkj->nki", eye, world - eye_at[:, None])
    a, b = view[..., 0] / view[..., 2], view[..., 1] / view[..., 2]
    k1, k2, p1, p2, k3 = cell.lens
    rho = a**2 + b**2
    swell = 1 + rho * k1 + rho**2 * k2 + rho**3 * k3
    a, b = (
        a * swell + 2 * p1 * a * b + p2 * (rho + 2 * a**2),
        b * swell + p1 * (rho + 2 * b**2) + 2 * p2 * a * b,
    )
    out = np.stack([a, b], axis=-1) * cell.focal + cell.centre
    out[view[..., 2] < 0.05] = np.nan
    return out


def _draw_poses(rng: np.random.Generator, cell: Cell, count: int) -> np.ndarray:
    """Draw readings (count, 6) at which the whole board is seen, from at most 50 degrees aside."""
    found: list[np.ndarray] = []
    while len(found) < count:
        link = rng.uniform(0.95 * LIMITS[:, 0], 0.95 * LIMITS[:, 1], (3000, 6))
        link[:, 5] = rng.uniform(-np.pi, np.pi, len(link))
        readings = (link * np.sign(np.diag(LINK_FROM_READING))) @ np.linalg.inv(LINK_FROM_READING).T
        seen = pixels(replace(cell, shape=replace(cell.shape, give=np.zeros(6))), readings, 0 * readings)
        good = np.all((seen > 8) & (seen < IMAGE - 8), axis=(1, 2))
        edge = (
            np.linalg.norm(seen[:, 5] - seen[:, 0], axis=1),
            np.linalg.norm(seen[:, 18] - seen[:, 0], axis=1),
        )
        good &= (np.maximum(*edge) > 90) & (np.maximum(edge[0] * 0.6, edge[1]) < 420)
        # seen from the front, and not too flat
        first, second = seen[:, 5] - seen[:, 0], seen[:, 18] - seen[:, 0]
        area = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / np.maximum(edge[0], 1) ** 2
        good &= area > 0.35
        found += list(readings[good])
    return np.array(found[:count])


Maker = Callable[[np.random.Generator, np.ndarray, np.ndarray], tuple[str, dict, Callable]]


def _of_joint(name: str) -> Maker:
    """An error of a joint, with the words for it."""

    def make(rng: np.random.Generator, q: np.ndarray, velocity: np.ndarray) -> tuple[str, dict, Callable]:
        j, phase, sharp = int(rng.integers(0, 6)), rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 1.2)
        link = q @ LINK_FROM_READING.T
        way = velocity @ LINK_FROM_READING.T
        if name == "eccentricity":
            shape = np.sin(link[:, j] + phase)
        elif name == "second-harmonic":
            shape = np.tanh(sharp * np.sin(2 * link[:, j] + phase)) / np.tanh(sharp)
        elif name == "encoder-scale":
            shape = q[:, j] - q[:, j].mean()
        else:
            x = link[:, j]
            path = np.stack([x - 0.05 * np.sign(way[:, j]), x], axis=1).ravel()
            shape = played(path, 1e-3, 0.0)[1::2] / 1e-3 - x / 1e-3
        moves = np.eye(6)[j]
        if name == "encoder-scale":
            moves = LINK_FROM_READING[:, j]

        def act(cell: Cell, size: float) -> tuple[Cell, Change]:
            zero = np.zeros((len(q), 6))
            return cell, Change(1e-4 * size * shape[:, None] * moves, zero, zero)

        return name, {"site": f"joint {j + 1}"}, act

    return make


def _of_cell(name: str, key: str, unit: Callable[[np.random.Generator], np.ndarray]) -> Maker:
    """An error of the camera or the board."""

    def make(rng: np.random.Generator, q: np.ndarray, velocity: np.ndarray) -> tuple[str, dict, Callable]:
        step = unit(rng)

        def act(cell: Cell, size: float) -> tuple[Cell, Change]:
            zero = np.zeros((len(q), 6))
            return replace(cell, **{key: getattr(cell, key) + size * step}), Change(zero, zero, zero)

        return name, {}, act

    return make


def _slip(rng: np.random.Generator, q: np.ndarray, velocity: np.ndarray) -> tuple[str, dict, Callable]:
    """A mount slips at an image: of what is on the flange, or of what is fixed."""
    row, held = int(len(q) * rng.uniform(0.25, 0.75)), bool(rng.random() < 0.6)
    way = rng.standard_normal(6) * [1e-3, 1e-3, 1e-3, 3e-4, 3e-4, 3e-4]

    def act(cell: Cell, size: float) -> tuple[Cell, Change]:
        moved = size * (np.arange(len(q)) >= row)[:, None] * way
        zero = np.zeros((len(q), 6))
        return cell, Change(zero, moved if held else zero, zero if held else moved)

    return "step", {"image": row, "on_flange": held}, act


def _late(rng: np.random.Generator, q: np.ndarray, velocity: np.ndarray) -> tuple[str, dict, Callable]:
    sign = rng.choice([-1.0, 1.0])

    def act(cell: Cell, size: float) -> tuple[Cell, Change]:
        zero = np.zeros((len(q), 6))
        return cell, Change(zero, zero, zero, 1e-3 * size * sign)

    return "latency", {}, act


def _either(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


MAKERS: dict[str, tuple[Maker, ...]] = {
    "arm": tuple(map(_of_joint, ("eccentricity", "second-harmonic", "encoder-scale", "backlash"))),
    "camera": (
        _of_cell("focal-length", "focal", lambda rng: _either(rng) * np.ones(2)),
        _of_cell("image-centre", "centre", lambda rng: rng.standard_normal(2)),
        _of_cell("lens-distortion", "lens", lambda rng: _either(rng) * np.array([0.01, -0.005, 0, 0, 0])),
    ),
    "board": (
        _of_cell(
            "board-scale", "stretch", lambda rng: 1e-3 * _either(rng) * np.array([1, rng.uniform(0, 1)])
        ),
        _of_cell("board-bow", "bend", lambda rng: 2e-4 * _either(rng) * rng.permutation([1.0, 0.2])),
    ),
    "mount": (_slip,),
    "clock": (_late,),
}


def _unknowns(cell: Cell) -> list[tuple[Callable[[float], Cell], float]]:
    """Return all that a calibration fits, as functions of one number each, and the priors of these."""
    out: list[tuple[Callable[[float], Cell], float]] = []

    def add(key: str, k: int, prior: float, of_shape: bool = False) -> None:
        def at(x: float) -> Cell:
            owner = cell.shape if of_shape else cell
            values = np.array(getattr(owner, key), float)
            values[k] += x
            changed = replace(owner, **{key: values})
            return replace(cell, shape=changed) if of_shape else changed

        out.append((at, prior))

    for key in ("a", "alpha", "d", "zero", "give"):
        for k in range(6):
            add(key, k, PRIORS[key], of_shape=True)
    for key in ("on_flange", "fixed"):
        for k in range(6):
            add(key, k, PRIORS["turn" if k < 3 else "place"])
    for k in range(2):
        add("focal", k, U_FOCAL)
        add("centre", k, U_CENTRE)
        add("stretch", k, U_SCALE)
        add("bend", k, U_FLAT)
    for k in range(5):
        add("lens", k, float(U_LENS[k]))
    return out


def detectability(cell: Cell, q: np.ndarray, velocity: np.ndarray, shift: np.ndarray, sigma: float) -> float:
    """Return the noncentrality of a shift (I, 24, 2), px, that a calibration leaves of it."""
    still, columns = pixels(cell, q, velocity), []
    for at, prior in _unknowns(cell):
        step = 1e-4 * prior
        columns.append(((pixels(at(step), q, velocity) - still) / 1e-4 / sigma).ravel())
    by, white = np.stack(columns, axis=1), shift.ravel() / sigma
    taken = np.linalg.solve(by.T @ by + np.eye(by.shape[1]), by.T @ white)
    return float(white @ white - (by.T @ white) @ taken)


def build(
    seed: int, number: int, side: str = "", goal: float = 0.0, count: int = 0
) -> tuple[dict[str, str], dict]:
    """Return the files of a session by name, and its truth.

    Parameters
    ----------
    seed, number : int
        Of the set of sessions, and which of them.
    side : str
        Where something is hidden; drawn of `SIDES` without one.
    goal : float
        Its detectability; drawn between the values of `GOAL` without one.
    count : int
        Images; drawn without one.
    """
    rng = np.random.default_rng([seed, 7, number])
    side = side or str(rng.choice(SIDES))
    carried = bool(rng.random() < 0.5)
    shape = arm.draw(rng)
    down = Rotation.from_euler("xyz", [np.pi, 0, rng.uniform(-np.pi, np.pi)])
    if carried:
        fixed = down * Rotation.from_rotvec(0.05 * rng.standard_normal(3))
        place = np.array([rng.uniform(0.35, 0.5), rng.uniform(-0.15, 0.15), rng.uniform(0.0, 0.05)])
    else:
        fixed = Rotation.from_euler("xyz", [-100, 5, -90], degrees=True)
        fixed = fixed * Rotation.from_rotvec(0.1 * rng.standard_normal(3))
        place = np.array([-0.15, 0.1, 0.5]) + 0.05 * rng.standard_normal(3)
    on = Rotation.from_rotvec(rng.uniform(-0.1, 0.1, 3)) * Rotation.from_euler(
        "z", rng.uniform(-np.pi, np.pi)
    )
    cell = Cell(
        shape,
        np.concatenate([on.as_rotvec(), rng.uniform([-0.06, -0.06, 0.03], [0.06, 0.06, 0.09])]),
        np.concatenate([fixed.as_rotvec(), place]),
        carried,
    )
    drawn = int(rng.integers(40, 81))
    images = count or drawn
    q = _draw_poses(rng, cell, images)
    moving = side == "clock" or bool(rng.random() < 0.4)
    velocity = rng.uniform(-0.4, 0.4, q.shape)
    true = replace(
        cell,
        focal=FOCAL + U_FOCAL * rng.standard_normal(2),
        centre=CENTRE + U_CENTRE * rng.standard_normal(2),
        lens=LENS + U_LENS * rng.standard_normal(5),
        stretch=1 + U_SCALE * rng.standard_normal(2),
        bend=U_FLAT * rng.standard_normal(2),
    )
    sigma = float(np.exp(rng.uniform(np.log(0.1), np.log(0.5))))
    stated = sigma * rng.uniform(0.75, 4 / 3)
    truth: dict = {"schema": SCHEMA, "seed": seed, "world": f"{number:03d}", "side": side, "effects": []}
    hidden, change, effect, detail, size = true, None, "", {}, 0.0
    if side != "null":
        maker = MAKERS[side][int(rng.integers(len(MAKERS[side])))]
        effect, detail, act = maker(rng, q, velocity)
        goal = goal or float(np.exp(rng.uniform(*np.log(GOAL))))
        still, size = pixels(true, q, velocity), 1.0
        for _ in range(3):
            hidden, change = act(true, size)
            found = detectability(true, q, velocity, pixels(hidden, q, velocity, change) - still, sigma)
            size *= np.sqrt(goal / max(found, 1e-12))
        hidden, change = act(true, size)
        truth["effects"] = [effect]
    clean = pixels(hidden, q, velocity, change)
    level = np.full(images, sigma)
    blurred = rng.random(images) < 0.03
    noise = np.where(blurred, 6 * sigma, level)[:, None, None] * rng.standard_normal(clean.shape)
    wild = rng.random(clean.shape[:2]) < 0.004
    noise[wild] += rng.standard_normal((int(wild.sum()), 2)) * 5
    kept = rng.random(clean.shape[:2]) < np.where(rng.random(images) < 0.2, 0.6, 1.0)[:, None]
    # the elastic arm may put a corner beyond the edge, where none is found
    kept &= np.all((clean + noise > 0) & (clean + noise < IMAGE), axis=2)
    on_flange, fixed_at = _as_identified(true)
    truth |= {
        "lambda": goal if side != "null" else 0.0, "size": size, "detail": detail, "carried": carried,
        "noise_px": sigma, "images": images, "on_flange": on_flange.tolist(), "moving": moving,
        "fixed": fixed_at.tolist(), "focal_px": hidden.focal.tolist(),
        "arm": {name: float(getattr(shape, of)[k]) for name, (of, k) in OF_ARM.items()},
    }  # fmt: skip
    name = f"camera-{number:03d}"
    texts = {
        "dataset.yaml": settings(name, carried, stated),
        "robot.yaml": robot_text(),
        "measurements.csv": table(
            q, velocity if moving or effect == "backlash" else None, clean + noise, kept
        ),
    }
    return texts, truth


def _as_identified(cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (6,) on the flange and in the base of an arm whose first and last row are nominal.

    No data distinguish the last row of an arm from the tool, or the first from the base.
    """
    s, nominal = cell.shape, arm.nominal()

    def placed(pose: np.ndarray) -> tuple[Rotation, np.ndarray]:
        return Rotation.from_rotvec(pose[:3]), pose[3:]

    turn, at = placed(cell.on_flange)
    last = Rotation.from_euler("z", s.zero[5] - nominal.zero[5])
    held = np.concatenate(
        [(last * turn).as_rotvec(), last.apply(at) + np.array([0, 0, s.d[5] - nominal.d[5]])]
    )
    turn, at = placed(cell.fixed)
    tilt = Rotation.from_euler("x", s.alpha[0])
    first = tilt * Rotation.from_euler("z", s.zero[0])
    off = tilt.apply([s.a[0], 0, s.d[0]])
    return held, np.concatenate([(first.inv() * turn).as_rotvec(), first.inv().apply(at - off)])
