"""Positions of the cube and the spheres within reach of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, product

import numpy as np

from bayescal.arm.transforms import rotation, rpy_matrix
from bayescal.collision import Clearance, Solid, on_table, sphere
from bayescal.collision.scene import STEM
from bayescal.errors import BayescalError
from bayescal.simulation.probing import Contacts, Spheres, from_above, on_face, on_spheres
from bayescal.simulation.reach import Arm
from bayescal.simulation.scenery import DIAMETER, FACES, LONGEST, SIZE, Cube, layout

FORWARD, UP = 0.507, 0.169  # relative to the reach: centre of the cube in front of the base
TRIALS = 200
BATCH = 8  # placements of the artefact that are tried at a time: their searches run together
NEAREST, FARTHEST = 0.25, 0.75  # of the reach: from the base to a sphere
LOWEST, HIGHEST = -0.05, 0.6  # of the reach: height of a sphere, and of the artefact's middle
ABOVE = 1
SECTORS = ((15.0, 65.0), (-40.0, 40.0), (-65.0, -15.0))
"""deg, seen from the base: on one side of the cube, above it, on the other side; spheres alternate."""
SAMPLES = 30  # contacts that are tested at a position of the cube
ENOUGH = 0.4  # share of them that must be reached
LEAST = 0.1


def depth(arm: Arm) -> float:
    """How far below the origin of the base the table is, m: the lowest sphere stands on its stem there."""
    return STEM - LOWEST * arm.reach


def among(arm: Arm, clearance: Clearance, cube: Cube, spheres: Sequence[Solid] = ()) -> Clearance:
    """The arm among the cube (the first solid), spheres (those behind it) and the table."""
    base = arm.chain.base
    height = float(base[:3, 2] @ base[:3, 3]) - depth(arm)
    return clearance.among(on_table([cube.solid, *spheres], base[:3, 2], height))


def place_cube(arm: Arm, clearance: Clearance, radius: float) -> tuple[Cube, tuple[str, ...]]:
    """A cube within reach, aligned with the base, and its four faces that are reached best.

    Two of them are opposite; their certified distance gives the scale. The position depends only on the arm.

    Raises
    ------
    BayescalError
        If no such position is found.
    """
    base, reach, rng = arm.chain.base, arm.reach, np.random.default_rng(0)
    best: tuple[float, Cube, tuple[str, ...]] | None = None
    for up, forward, azimuth in product((1.0, 2.0), (1.0, 0.8, 1.2), (0, 90, -90, 180)):
        out = rotation(2, np.radians(azimuth)) @ [forward * FORWARD * reach, 0.0, up * UP * reach]
        cube = Cube(np.round(base[:3, :3] @ out + base[:3, 3], 2), base[:3, :3])
        here = among(arm, clearance, cube)
        share = {face: on_face(arm, here, cube, face, radius, SAMPLES, rng)[0] for face in FACES}
        score, faces = _four(share)
        if best is None or score > best[0] + 0.05:
            best = score, cube, faces
        if best[0] >= ENOUGH:
            break
    if best is None or best[0] < LEAST:
        what = f"four faces of a {SIZE * 1e3:.1f} mm cube are out of its reach of {reach * 1e3:.0f} mm"
        raise BayescalError(what, arm.robot.name, "give another robot, or check its limits")
    return best[1], best[2]


def _four(share: dict[str, float]) -> tuple[float, tuple[str, ...]]:
    """Both faces across one axis, the better one across the other axis, and the top face."""
    options = []
    for pair, other in (("y", "x"), ("x", "y")):
        single = max((f"-{other}", f"+{other}"), key=lambda face: share[face])
        faces = (f"+{pair}", f"-{pair}", single, "+z")
        options.append((min(share[face] for face in faces), faces))
    return max(options, key=lambda option: option[0])


def place_spheres(
    arm: Arm,
    clearance: Clearance,
    cube: Cube,
    spheres: int,
    radius: float,
    count: int,
    turn: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, list[Contacts]]:
    """The `turn`-th placement of the artefact: sphere centres (spheres, 3), m, and contacts on each sphere.

    Raises
    ------
    BayescalError
        If there is none where the whole upper half of every sphere can be touched.
    """
    up = cube.axes[:, 2]
    for trial in range(0, TRIALS, BATCH):
        sector = None if trial > TRIALS / 3 else turn % len(SECTORS)
        options = _options(arm, cube, spheres, sector, rng)
        solids = [
            [sphere(f"ball {k + 1}", c, DIAMETER, up, str(p + 1)) for k, c in enumerate(centres)]
            for p, centres in enumerate(options)
        ]
        every = 1 + np.arange(len(options) * spheres)
        all_ = Spheres(every, np.reshape(options, (-1, 3)), up, DIAMETER / 2 + radius)
        own, homes = from_above(
            arm, among(arm, clearance, cube, list(chain.from_iterable(solids))), all_, rng
        )
        for p, centres in enumerate(options):
            mine = own // spheres == p
            if len(np.unique(own[mine])) < spheres:
                continue
            here, alone = among(arm, clearance, cube, solids[p]), all_[np.arange(spheres) + p * spheres]
            alone = replace(alone, solids=every[:spheres])
            found = on_spheres(arm, here, alone, (own[mine] - p * spheres, homes[mine]), count, rng)
            if found is not None:
                return centres, found
    what = f"no position is found where {spheres} spheres can be touched from all sides"
    raise BayescalError(what, arm.robot.name, "ask for fewer --spheres or --sphere-contacts")


def _options(
    arm: Arm, cube: Cube, spheres: int, sector: int | None, rng: np.random.Generator
) -> list[np.ndarray]:
    """Up to `BATCH` placements of the artefact: sphere centres (spheres, 3), m, each within reach."""
    plate = layout(spheres, min(LONGEST, 0.42 * arm.reach))
    out: list[np.ndarray] = []
    for _ in range(BATCH):
        middles = _middles(arm, cube, sector, rng)
        tilts = rpy_matrix(rng.uniform([-0.6, -1.1, -np.pi], [0.6, 1.1, np.pi], (len(middles), 3)))
        placed = np.round(middles[:, None] + plate @ np.swapaxes(cube.axes @ tilts, 1, 2), 6)
        out += [centres for centres in placed if _fits(arm, cube, centres)]
        if len(out) >= BATCH:
            break
    return out[:BATCH]


def _fits(arm: Arm, cube: Cube, centres: np.ndarray) -> bool:
    """Whether spheres (K, 3), m, and the bar between them are within reach, off the base and off the cube."""
    flat, height = arm.beside(centres)
    away = np.linalg.norm(flat, axis=1)
    within = bool(np.hypot(away, height).max() < FARTHEST * arm.reach)
    outside = bool(away.min() > NEAREST * arm.reach and height.min() > LOWEST * arm.reach)
    bar = centres[0] + np.linspace(0, 1, 9)[:, None, None] * (centres - centres[0])
    return within and outside and not bool(np.any(cube.inside(bar, 0.06)))


def _middles(arm: Arm, cube: Cube, sector: int | None, rng: np.random.Generator) -> np.ndarray:
    """Reachable positions (M, 3) of the ball, m, in a sector or in all."""
    middles = arm.ball(arm.frames(arm.anywhere(512, rng)))
    flat, height = arm.beside(middles)
    forward, level = arm.beside(cube.centre)
    fit = (height > 0) & (height < HIGHEST * arm.reach)
    aside = np.degrees(np.arctan2(flat[:, 1], flat[:, 0]) - np.arctan2(forward[1], forward[0]))
    aside = (aside + 180) % 360 - 180
    bounds = SECTORS if sector is None else SECTORS[sector : sector + 1]
    fit &= np.any([(aside > low) & (aside < high) for low, high in bounds], axis=0)
    if sector == ABOVE:
        fit &= height > level + 0.5 * SIZE
    return middles[fit][:20]
