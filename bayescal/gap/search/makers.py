"""One generic cell, smooth functions and rotations at a joint that cells share, and further kinds of cells.

These are cells of two coordinates, of orders between harmonics and gear mesh, of a rocking base, of joints
with a memory of earlier contacts, and of random errors of their readings.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.arm.motion import CONTACT, TURN, Term
from bayescal.effects import Circumstances, Parameter, location
from bayescal.effects.common import LINK, READING, base_terms, motion, side_of, tilts, turned
from bayescal.effects.location import ARM, BASE, PROBE, TOOL, Driver, Site, joint
from bayescal.estimate.families import cosines
from bayescal.gap.settings import CELLS
from bayescal.statistics import rms


@dataclass(frozen=True)
class Cell:
    """A site, a coordinate, and its sets of columns: one smooth set, or many local ones.

    With `clusters` it is a random error, drawn anew in each cluster of rows: its only set has one
    parameter, the motion by that error. Without sets they are those of `cells.sets_of`.
    """

    site: Site
    driver: Driver
    sets: tuple[tuple[Parameter, ...], ...]
    known: bool = False  # whether a known effect has this same function
    weight: float = 1.0  # number of cells of its kind of site that its prior is worth
    clusters: np.ndarray | None = None  # (N,) int, equal for rows that share a random error


def smooth(x: np.ndarray, fitted: np.ndarray, waves: int = CELLS.waves) -> list[np.ndarray]:
    """Cosines of 1 to `waves` half periods over the range of a coordinate x (N,)."""
    return cosines(x, fitted, waves)


def at_joint(c: Circumstances, j: int, drivers: list[np.ndarray], side: str = LINK) -> tuple[Parameter, ...]:
    """Rotations of the link of a joint, or of all links that its reading moves; shifts of a prismatic one."""
    unit, sd = ("m", CELLS.length) if c.robot.slides[j - 1] else ("rad", CELLS.angle)
    return tuple(Parameter("", unit, turned(c.robot, j, d, side), sd) for d in drivers)


def moves(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides of a joint where an error rotates different links: both where its reading moves several links."""
    return (LINK, READING) if np.count_nonzero(c.robot.link_from_reading[:, j - 1]) > 1 else (LINK,)


def passes(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides of a joint with different motions: both where several readings move its link."""
    return (LINK, READING) if np.count_nonzero(c.robot.link_from_reading[j - 1]) > 1 else (LINK,)


def sides_of(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides on which a joint moves, or its error rotates, differently."""
    return max(moves(c, j), passes(c, j), key=len)


def at_contact(on: np.ndarray, drivers: Iterable[np.ndarray]) -> tuple[Parameter, ...]:
    """Displacements of contacts along their normals, at the rows (N,) where `on` is 1."""
    return tuple(Parameter("", "m", (Term(CONTACT, "normal", on * d),), CELLS.length) for d in drivers)


Mover = Callable[[np.ndarray], list[Parameter]]
SHIFTS, TURNS = ("tx", "ty", "tz"), ("rx", "ry", "rz")


def movers(c: Circumstances) -> dict[Site, tuple[Mover, ...]]:
    """Sites that may drift with time or shift suddenly, and their parameters for a driver (N,).

    Of several tools, all may move together, or each alone; a tool whose orientation is read also turns.
    """

    def displaced(axes: Mapping[int, tuple[str, ...]], rows: np.ndarray | float = 1.0) -> Mover:
        every = [
            (f, a, CELLS.length if a[0] == "t" else CELLS.angle / 2) for f, of in axes.items() for a in of
        ]

        def move(d: np.ndarray) -> list[Parameter]:
            own = d * rows  # one array for all axes
            return [
                Parameter("", "m" if a[0] == "t" else "rad", (Term(f, a, own),), sd) for f, a, sd in every
            ]

        return move

    def turn(j: int) -> Mover:
        return lambda d: list(at_joint(c, j, [d], side_of(c.robot)))

    def contact(rows: np.ndarray) -> Mover:
        return lambda d: [Parameter("", "m", (Term(CONTACT, "normal", d * rows),), CELLS.length)]

    out: dict[Site, tuple[Mover, ...]] = {BASE: (displaced({0: (*SHIFTS, *TURNS)}),)}
    out |= {joint(j): (turn(j),) for j in range(1, c.robot.n + 1)}
    of_tool = {c.chain.n + 1: SHIFTS} | ({TURN: TURNS} if c.turned_tools else {})
    single = [(c.tool == k).astype(float) for k in c.fitted_tools] if len(c.fitted_tools) > 1 else []
    out[TOOL] = tuple(displaced(of_tool, rows) for rows in (1.0, *single))
    if np.any(c.touching):
        out[PROBE] = (contact(c.touching.astype(float)),)
    out |= {location.face(face.name): (contact(face.rows),) for face in c.faces}
    return out


def torque_and_angle(c: Circumstances) -> Iterator[Cell]:
    """A stiffness that depends on an angle: the torque of a joint times functions of its angle or of another.

    A torque turns the joint's own link, between which and the link before its gear yields.
    """
    if c.torques is None:
        return
    angles = [smooth(c.readings[:, k], c.fitted, CELLS.factor_waves) for k in range(c.robot.n)]
    for j in range(1, c.robot.n + 1):
        torque = c.torques[:, j - 1]
        if not np.ptp(torque[c.fitted]) > 1e-3:
            continue
        load = torque / rms(torque[c.fitted])
        orders = () if c.robot.slides[j - 1] else CELLS.own_orders
        turns = [load * f(k * c.q[:, j - 1]) for k in orders for f in (np.sin, np.cos)]
        own = [turns, [load * w for w in angles[j - 1]]]
        other = [[load * w for w in angles[k]] for k in range(c.robot.n) if k != j - 1]
        alone = smooth(c.readings[:, j - 1], c.fitted, CELLS.surface_waves)
        falling = [w / k for k, w in enumerate(alone, start=1)]
        both = [[*falling, *(load * w for w in falling)]]
        for form, found in (("own angle", own), ("other angle", other), ("and angle", both)):
            sets = tuple(at_joint(c, j, drivers) for drivers in found if drivers)
            yield Cell(joint(j), Driver("torque", j, form=form), sets)


def two_angles(c: Circumstances) -> Iterator[Cell]:
    """Products of functions of two angles, at every joint, for every pair of angles."""
    angles = [smooth(c.readings[:, k], c.fitted, CELLS.pair_waves) for k in range(c.robot.n)]
    products = [[u * v for u in a for v in b] for a, b in itertools.combinations(filter(None, angles), 2)]
    for j in range(1, c.robot.n + 1):
        sets = tuple(at_joint(c, j, drivers, side) for drivers in products for side in moves(c, j))
        yield Cell(joint(j), Driver("two angles"), sets)


def between_orders(c: Circumstances) -> Iterator[Cell]:
    """Waves of a joint's angle with more periods than its harmonics and fewer than its gear mesh."""
    for j in (np.flatnonzero(~c.robot.slides) + 1).tolist():
        angle = c.q[:, j - 1]
        span = float(np.ptp(angle[c.fitted]))
        if span < CELLS.least_turn:
            continue
        orders = np.arange(*CELLS.orders, np.clip(2.0 / span, *CELLS.order_steps))
        sets = tuple(at_joint(c, j, [np.sin(k * angle), np.cos(k * angle)]) for k in orders)
        yield Cell(joint(j), Driver("angle", j, form="waves"), sets)


def rocking(c: Circumstances) -> Iterator[Cell]:
    """A base that rocks about a horizontal axis: two positions, by its gravity moment about that axis.

    The axes are those of `tilts` and the two between them. The position changes where the moment changes its
    sign or, where other forces hold the base down, passes its median.
    """
    found = [(by.axis, by.moment) for by in tilts(c)]
    if len(found) == 2:
        (first, one), (second, two) = found
        found += [((first + s * second) / np.sqrt(2.0), (one + s * two) / np.sqrt(2.0)) for s in (1, -1)]
    sets = []
    for axis, moment in found:
        mine = moment[c.fitted]
        if not np.ptp(mine) > 1e-3:
            continue
        size = float(np.quantile(np.abs(mine), 0.9))
        for knee, at in itertools.product(CELLS.knees, (0.0, float(np.median(mine)))):
            terms = base_terms(c, "r", axis, np.tanh((moment - at) / (knee * size)))
            sets.append((Parameter("", "rad", terms, CELLS.angle),))
    yield Cell(BASE, Driver("base moment", form="sign"), tuple(sets))


def measured(c: Circumstances) -> np.ndarray:
    """Rows (N,) in the order of measurement: of time if recorded, else of the file."""
    return np.arange(len(c.q)) if c.time is None else np.argsort(c.time, kind="stable")


def fading(angle: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Direction of the travel to each of successive angles (..., N), forgotten over a travel.

    After a travel d the state is sign(d) + (state - sign(d)) exp(-|d| / length), from 0: (..., L, N) in
    -1 to 1, for L lengths.
    """
    step = np.diff(angle, prepend=angle[..., :1])[..., None, :]
    keep, sign = np.exp(-np.abs(step) / lengths[:, None]), np.sign(step)
    out, state = np.empty(keep.shape), np.zeros(keep.shape[:-1])
    for k in range(keep.shape[-1]):
        state = sign[..., k] + (state - sign[..., k]) * keep[..., k]
        out[..., k] = state
    return out


def slack(angle: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Position within lost motion of L widths, along successive angles (..., N): (..., L, N) in -1 to 1.

    The state persists from contact to contact: a travel d moves it by 2 d / width, at most to its end. It
    begins at 0.
    """
    step = 2.0 * np.diff(angle, prepend=angle[..., :1])[..., None, :] / widths[:, None]
    out, state = np.empty(step.shape), np.zeros(step.shape[:-1])
    for k in range(step.shape[-1]):
        state = np.minimum(np.maximum(state + step[..., k], -1.0), 1.0)
        out[..., k] = state
    return out


def travel(c: Circumstances) -> Iterator[Cell]:
    """Errors of a joint by its travel since earlier contacts."""
    order = measured(c)
    at = [(j, side) for j in range(1, c.robot.n + 1) for side in sides_of(c, j)]
    angles = np.stack([motion(c.robot, j, c.readings, side)[order] for j, side in at])
    lengths, widths = np.radians(CELLS.forgotten), np.radians(CELLS.slack)
    states = np.empty((len(at), len(lengths) + len(widths), len(order)))
    states[..., order] = np.concatenate([fading(angles, lengths), slack(angles, widths)], axis=1)
    for j in range(1, c.robot.n + 1):
        mine = [(side, s) for (k, side), own in zip(at, states, strict=True) if k == j for s in own]
        sets = [at_joint(c, j, [s], side) for side, s in mine if np.ptp(s[c.fitted]) > 0]
        yield Cell(joint(j), Driver("travel", j), tuple(sets))


def scatter(c: Circumstances) -> Iterator[Cell]:
    """Errors drawn anew at every reading of a joint, or at every pose, which repeated contacts do not show.

    That of a pose is the lack of fit, whatever its location: more scatter than that of repeated contacts.
    """
    for j in range(1, c.robot.n + 1):
        clusters = _repeated(c, c.readings[:, j - 1])
        yield Cell(joint(j), Driver("reading", j), (at_joint(c, j, [np.ones(len(c.q))]),), clusters=clusters)
    if np.any(c.touching):
        moved = Parameter("", "m", (Term(CONTACT, "normal", c.touching.astype(float)),), CELLS.length)
        yield Cell(ARM, Driver("pose"), ((moved,),), clusters=_repeated(c, c.readings))


def _repeated(c: Circumstances, readings: np.ndarray) -> np.ndarray:
    """Numbers (N,), equal for rows with equal readings (N, ...) and for repetitions of one contact."""
    out = np.unique(np.round(readings, 8), axis=0, return_inverse=True)[1].ravel()
    if c.repeat is not None:
        own = c.repeat.astype(str)
        has = own != ""
        out[has] = len(out) + np.unique(own[has], return_inverse=True)[1]
    return np.unique(out, return_inverse=True)[1]
