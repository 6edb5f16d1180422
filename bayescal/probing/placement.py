"""Where an arm can touch artefacts: a cube with four faces, spheres on a plate, and contacts on both."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import product

import numpy as np

from bayescal.arm.inverse import PASSES
from bayescal.arm.transforms import cone, rotation, rpy_matrix
from bayescal.dataset.regions import LOWEST, STEM, Places, stemmed
from bayescal.errors import BayescalError
from bayescal.probing.clearance import Clearance
from bayescal.probing.contacts import Contacts, Hand, Moving, Sites, reach
from bayescal.probing.motions import Arm, cone_of
from bayescal.probing.scene import FACES, LONGEST, RADIUS, Cube, Sizes, Solid, layout, on_table
from bayescal.statistics import stream

STARTS = 8  # per contact
LOCAL = 12  # steps of a search that starts near its goal; those that converge need 3 to 10
PROBES = 16  # contacts that are tested in a configuration of the arm
TOPS = 3  # configurations of the arm that are tried for a sphere
SERVED = 0.25  # share of the contacts on a sphere that must be reached in one configuration
WEAKEST = 0.2
"""Least spread of the normals along any direction, below which the centre is not identifiable."""
FORWARD, UP = 0.507, 0.169  # relative to the reach: centre of the cube in front of the base
SAMPLES = 30  # contacts that are tested at a position of the cube
ENOUGH, LEAST = 0.4, 0.1  # share of them that must be reached for the first position, and for the best
TRIALS = 200
BATCH = 8  # placements of the artefact that are tried at a time: their searches run together
NEAREST, FARTHEST = 0.25, 0.75  # of the reach: from the base to a sphere
BOTTOM, HIGHEST = -0.05, 0.6  # of the reach: height of a sphere, and of the artefact's middle
ABOVE = 1
SECTORS = ((15.0, 65.0), (-40.0, 40.0), (-65.0, -15.0))
"""deg, seen from the base: on one side of the cube, above it, on the other side; spheres alternate."""


Homes = tuple[np.ndarray, np.ndarray]
"""Configurations that touch spheres from above: the sphere of each (H,), readings (H, n), rad."""


def touching(
    hand: Hand, solid: np.ndarray, places: Places, rng: np.random.Generator, starts: np.ndarray | None = None
) -> tuple[np.ndarray, Contacts]:
    """A contact with a moving ball at each requested position, where a solution is found.

    Parameters
    ----------
    hand : Hand
        Contacts have random directions of the tool within its cone.
    solid : np.ndarray of int, shape (M,)
        Indices of the solids of its clearance that are touched.
    places : tuple of np.ndarray, shape (M, 3)
        Ball centres, m, and outward normals of the surface.
    rng : np.random.Generator
        Of starts, directions and approaches.
    starts : np.ndarray, shape (M, n), optional
        Initial readings of each search, to keep the configuration of the arm; random if not given.

    Returns
    -------
    which : np.ndarray, shape (K,)
        Indices of the points for which a contact was found, in ascending order.
    contacts : Contacts
        The K contacts.
    """
    tries, passes = (STARTS, PASSES) if starts is None else (1, LOCAL)
    index = np.repeat(np.arange(len(solid)), tries)
    points, normals = (part[index] for part in places)
    begin = hand.arm.anywhere(len(index), rng) if starts is None else starts
    sites = Sites.of(points, normals, cone(-normals, hand.cone, rng), solid[index])
    contacts = reach(Moving(hand), sites, begin, rng, index, passes)
    return index[contacts.good], contacts[contacts.good]


def on_face(hand: Hand, cube: Cube, face: str, count: int, rng: np.random.Generator) -> Contacts:
    """Contacts at those of `count` random points of a face that are reached.

    The cube is the first solid around the hand.
    """
    normals = np.tile(cube.normal(face), (count, 1))
    points = cube.on(face, count, rng) + RADIUS * normals
    return touching(hand, np.zeros(count, int), (points, normals), rng)[1]


def on_spheres(
    hand: Hand, centres: np.ndarray, homes: Homes, count: int, rng: np.random.Generator
) -> list[Contacts] | None:
    """Contacts distributed over the upper half of each sphere, each in a single configuration of the arm.

    Parameters
    ----------
    hand : Hand
        The solids around it are the cube, the spheres in their order, and others.
    centres : np.ndarray, shape (S, 3)
        Of the spheres, m.
    homes : Homes
        To start from.
    count : int
        Number of contacts on each sphere.
    rng : np.random.Generator

    Returns
    -------
    list of Contacts or None
        None where too little of a sphere can be reached.
    """

    def around(
        sphere: np.ndarray, readings: np.ndarray, tries: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Contacts]:
        """Contacts in random directions from every configuration: its index, normals, contacts."""
        index = np.repeat(np.arange(len(sphere)), tries)
        normals = cone(np.tile(hand.arm.mount[:3, 2], (len(index), 1)), LOWEST, rng)
        places = centres[sphere[index]] + _touched(hand.arm) * normals, normals
        which, contacts = touching(hand, 1 + sphere[index], places, rng, readings[index])
        return index[which], normals[which], contacts

    sphere, readings = homes
    index, _, _ = around(sphere, readings, np.full(len(sphere), PROBES))
    shares = np.bincount(index, minlength=len(sphere)) / PROBES
    numbers = np.arange(len(centres))
    best = np.array([int(np.argmax(np.where(sphere == k, shares, -1.0))) for k in numbers])
    if not np.all((sphere[best] == numbers) & (shares[best] >= SERVED)):
        return None
    index, normals, contacts = around(numbers, readings[best], (2 * count / shares[best]).astype(int))
    out = []
    for k in numbers:
        rows = np.flatnonzero(index == k)
        if len(rows) < 1.2 * count or not len(chosen := spread(normals, rows, count)):
            return None
        out.append(contacts[chosen])
    return out


def spread(normals: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """`count` of `rows` (M,) with normals far from each other, each the farthest from those before.

    None where they are too few, or on one side only: they would not locate a sphere.
    """
    if len(rows) < count:
        return rows[:0]
    points, chosen = normals[rows], [0]
    away = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    off = points[chosen] - points[chosen].mean(axis=0)
    return rows[chosen] if np.linalg.svd(off, compute_uv=False)[-1] / np.sqrt(count) > WEAKEST else rows[:0]


def _touched(arm: Arm) -> float:
    """From the centre of a sphere to that of the ball that touches it, m."""
    return Sizes.of(arm.robot).diameter / 2 + RADIUS


def depth(arm: Arm) -> float:
    """How far below the origin of the base the table is, m: the lowest sphere stands on its stem there."""
    return STEM - BOTTOM * arm.reach


@lru_cache(maxsize=64)
def clearance_of(arm: Arm) -> Clearance:
    """The check of collisions of the arm on its table."""
    return Clearance.of(arm.robot, Sizes.of(arm.robot).tool, stand=depth(arm))


def among(arm: Arm, cube: Cube, spheres: Sequence[Solid] = ()) -> Hand:
    """The arm among the cube (the first solid), spheres (those behind it) and the table."""
    base = arm.mount
    height = float(base[:3, 2] @ base[:3, 3]) - depth(arm)
    clearance = clearance_of(arm).among(on_table([cube.solid, *spheres], base[:3, 2], height))
    return Hand(arm, clearance, cone_of(arm.robot))


@lru_cache(maxsize=64)
def cube_of(arm: Arm) -> tuple[Cube, tuple[str, ...]]:
    """A cube within reach, aligned with the base, and its four faces that are reached best.

    Two of them are opposite; their certified distance gives the scale. The position depends only on the arm.

    Raises
    ------
    BayescalError
        If no such position is found.
    """
    base, rng, edge = arm.mount, np.random.default_rng(0), Sizes.of(arm.robot).edge
    best: tuple[float, Cube, tuple[str, ...]] | None = None
    for up, forward, azimuth in product((1.0, 2.0), (1.0, 0.8, 1.2), (0, 90, -90, 180)):
        out = rotation(2, np.radians(azimuth)) @ [forward * FORWARD * arm.reach, 0.0, up * UP * arm.reach]
        cube = Cube(np.round(base[:3, :3] @ out + base[:3, 3], 2), base[:3, :3], edge)
        here = among(arm, cube)
        share = {face: len(on_face(here, cube, face, SAMPLES, rng)) / SAMPLES for face in FACES}
        score, faces = _four(share)
        if best is None or score > best[0] + 0.05:
            best = score, cube, faces
        if best[0] >= ENOUGH:
            break
    if best is None or best[0] < LEAST:
        what = f"four faces of a {edge * 1e3:.1f} mm cube are out of its reach of {arm.reach * 1e3:.0f} mm"
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


@lru_cache(maxsize=64)
def placement(arm: Arm, spheres: int, count: int, seed: int, turn: int) -> tuple[np.ndarray, list[Contacts]]:
    """Placement `turn` of the artefact: sphere centres (spheres, 3), m, and `count` contacts on each sphere.

    It depends on the arm, on these counts and on the seed alone.

    Raises
    ------
    BayescalError
        If there is none where the whole upper half of every sphere can be touched.
    """
    rng, cube = stream(seed, "spheres", str(turn)), cube_of(arm)[0]
    diameter, up = Sizes.of(arm.robot).diameter, cube.axes[:, 2]
    for trial in range(0, TRIALS, BATCH):
        options = _options(arm, cube, spheres, None if trial > TRIALS / 3 else turn % len(SECTORS), rng)
        solids = [
            Solid(f"ball {k + 1}", stemmed(c, diameter, up), str(p + 1))
            for p, centres in enumerate(options)
            for k, c in enumerate(centres)
        ]
        sphere, homes = _from_above(among(arm, cube, solids), np.reshape(options, (-1, 3)), rng)
        for p, centres in enumerate(options):
            mine = sphere // spheres == p
            if len(np.unique(sphere[mine])) < spheres:
                continue
            here = among(arm, cube, solids[p * spheres : (p + 1) * spheres])
            contacts = on_spheres(here, centres, (sphere[mine] - p * spheres, homes[mine]), count, rng)
            if contacts is not None:
                return centres, contacts
    what = f"no position is found where {spheres} spheres can be touched from all sides"
    raise BayescalError(what, arm.robot.name, "ask for fewer --spheres or --sphere-contacts")


def _from_above(hand: Hand, centres: np.ndarray, rng: np.random.Generator) -> Homes:
    """Configurations that touch spheres from above."""
    index = np.repeat(np.arange(len(centres)), TOPS)
    tops = np.tile(hand.arm.mount[:3, 2], (len(index), 1))
    which, contacts = touching(hand, 1 + index, (centres[index] + _touched(hand.arm) * tops, tops), rng)
    return index[which], contacts.readings


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
    outside = bool(away.min() > NEAREST * arm.reach and height.min() > BOTTOM * arm.reach)
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
        fit &= height > level + 0.5 * cube.edge
    return middles[fit][:20]
