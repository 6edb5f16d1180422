"""The plan of a session: targets, order, times and payloads.

Positions of the cube and the spheres within reach of an arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, product

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rotation, rpy_matrix
from bayescal.dataset import Dataset, Measurements
from bayescal.errors import BayescalError
from bayescal.probing.approach import (
    DIAMETER,
    FACES,
    LONGEST,
    SIZE,
    Contacts,
    Cube,
    Spheres,
    from_above,
    join,
    layout,
    on_face,
    on_spheres,
)
from bayescal.probing.clearance import Clearance
from bayescal.probing.reach import Arm
from bayescal.probing.scene import STEM, Solid, on_table, sphere
from bayescal.simulation.options import GROUP, RADIUS, TOOL, Options, Scenery, dataset_of, stream

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


SET_UP, LUNCH = 120.0, 1800.0  # s: before the spheres of a placement, before the later contacts
PACE = 6.0, 14.0  # s per contact
COLD, WARMER, WARMING = 22.0, 4.0, 3000.0  # degC, K, s


@dataclass(frozen=True)
class Visit:
    """Consecutive contacts: indices of their targets (M,), their repeat groups."""

    role: str
    contacts: Contacts
    target: np.ndarray
    repeat: np.ndarray
    pause: float = 0.0  # s, before the first


def plan(options: Options, robot: Robot) -> tuple[Dataset, Scenery]:
    """The planned session: readings at which the nominal arm touches the nominal targets.

    Raises
    ------
    BayescalError
        If too little of the cube or the spheres can be reached.
    """
    arm = Arm(robot, TOOL.centre)
    cube, faces = cube_of(arm)
    visits = [_calibrating(arm, options.contacts, options.repeats, options.seed)]
    centres = np.empty((options.placements if options.spheres else 0, options.spheres, 3))
    for p in range(len(centres)):
        centres[p], balls = placement(arm, options.spheres, options.sphere_contacts, options.seed, p)
        for k, ball in enumerate(balls):
            target = np.full(len(ball), len(faces) + p * options.spheres + k)
            visits.append(_visit("validate", ball, target, 0.0 if k else SET_UP))
    visits.append(_later(arm, options.later, options.seed))
    scenery = Scenery(cube, faces, centres)
    return dataset_of(options, robot, scenery, _measurements(options, visits, len(faces))), scenery


@lru_cache(maxsize=64)
def clearance_of(arm: Arm) -> Clearance:
    """The check of collisions of the arm on its table."""
    return Clearance.of(arm.robot, TOOL, stand=depth(arm))


@lru_cache(maxsize=64)
def cube_of(arm: Arm) -> tuple[Cube, tuple[str, ...]]:
    """The cube and its faces: they depend on the arm alone."""
    return place_cube(arm, clearance_of(arm), RADIUS)


@lru_cache(maxsize=64)
def placement(arm: Arm, spheres: int, count: int, seed: int, turn: int) -> tuple[np.ndarray, list[Contacts]]:
    """Placement `turn` of the spheres; effects, noise and contacts on the cube do not change it."""
    rng = stream(seed, "spheres", str(turn))
    return place_spheres(arm, clearance_of(arm), cube_of(arm)[0], spheres, RADIUS, count, turn, rng)


def _visit(role: str, contacts: Contacts, target: np.ndarray, pause: float) -> Visit:
    return Visit(role, contacts, target, np.full(len(contacts), ""), pause)


@lru_cache(maxsize=64)
def _calibrating(arm: Arm, contacts: int, repeats: int, seed: int) -> Visit:
    """Contacts on all faces in random order, of which `repeats` are made `GROUP` times in a row."""
    rng = stream(seed, "faces")
    different = contacts - (GROUP - 1) * repeats
    target, found = _shuffled(arm, different, rng)
    times = np.ones(different, int)
    times[rng.choice(different, repeats, replace=False)] = GROUP
    names = np.array([f"r{k:02d}" if k else "" for k in np.where(times > 1, np.cumsum(times > 1), 0)])
    rows = np.repeat(np.arange(different), times)
    return Visit("calibrate", found[rows], target[rows], names[rows])


@lru_cache(maxsize=64)
def _later(arm: Arm, count: int, seed: int) -> Visit:
    """The later contacts on the faces, for validation."""
    target, found = _shuffled(arm, count, stream(seed, "later"))
    return _visit("validate", found, target, LUNCH)


def _shuffled(arm: Arm, count: int, rng: np.random.Generator) -> tuple[np.ndarray, Contacts]:
    """Equally many contacts on all faces, in random order, with the index of the face of each."""
    cube, faces = cube_of(arm)
    clearance = among(arm, clearance_of(arm), cube)
    target = np.sort(rng.permutation(count) % len(faces))
    parts = []
    for k, face in enumerate(faces):
        wanted, have = int(np.sum(target == k)), 0
        for _ in range(20):
            _, found = on_face(arm, clearance, cube, face, RADIUS, 2 * (wanted - have) + 8, rng)
            found = found[: wanted - have]
            parts.append(found)
            have += len(found)
            if have == wanted:
                break
        else:
            raise BayescalError(
                f"too few contacts on face {face} of the cube are within reach and clear of collisions",
                arm.robot.name,
                "check its limits",
            )
    order = rng.permutation(count)
    return target[order], join(parts)[order]


def _measurements(options: Options, visits: list[Visit], faces: int) -> Measurements:
    """The table of all visits; targets before `faces` are planes."""
    contacts = join([v.contacts for v in visits])
    target, repeat = (np.concatenate([getattr(v, name) for v in visits]) for name in ("target", "repeat"))
    clock = stream(options.seed, "clock")
    steps = clock.uniform(*PACE, len(target))
    begins = np.cumsum([0] + [len(v.target) for v in visits[:-1]])
    for at, visit in zip(begins, visits, strict=True):
        steps[at : at + 1] += visit.pause
    time = np.cumsum(steps)
    warm = COLD + WARMER * (1 - np.exp(-time / WARMING)) + clock.normal(0, 0.03, len(time))
    return Measurements(
        ids=tuple(f"c{i:04d}" for i in range(len(target))),
        role=np.concatenate([np.full(len(v.target), v.role) for v in visits]),
        target=target,
        tool=np.zeros(len(target), int),
        readings=contacts.readings,
        line=np.arange(len(target)) + 2,
        velocity=contacts.velocity,
        time=np.round(time, 2),
        temperature=np.round(warm, 2),
        payload=_payload(options, repeat, target < faces),
        repeat=repeat,
    )


def _payload(options: Options, repeat: np.ndarray, on_plane: np.ndarray) -> np.ndarray | None:
    """Payloads (N,), kg, for half of the plane contacts, equal within a repeat group; None without."""
    if not options.payload:
        return None
    rng = stream(options.seed, "payload")
    loaded = rng.random(len(repeat)) < 0.5
    for group in np.unique(repeat[repeat != ""]):
        loaded[repeat == group] = rng.random() < 0.5
    return np.where(loaded & on_plane, options.payload, 0.0)
