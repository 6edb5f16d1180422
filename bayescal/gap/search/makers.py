"""One generic cell, smooth functions and rotations at a joint that cells share, and further kinds of cells.

These are cells of two coordinates, of orders between harmonics and gear mesh, of a rocking base, of joints
with a memory of earlier contacts, and of random errors of their readings.

An error of a joint is also a function of one of its quantities (angle, torque, direction, speed, earlier
travel) times a function of any quantity of the session: friction that grows with a load, drag of a cold gear.
Links, base and tool move along one axis by any quantity, and the probe's error by the direction of contact
and any quantity.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.motion import CONTACT, IMAGE, TURN, Term
from bayescal.effects import Circumstances, Parameter, View, location
from bayescal.effects.common import (
    LINK,
    READING,
    base_terms,
    by_reading,
    motion,
    sense,
    side_of,
    tilts,
    turned,
)
from bayescal.effects.imaging import at_view
from bayescal.effects.location import ARM, BASE, CAMERA, PROBE, TOOL, Driver, Site, joint, link
from bayescal.estimate.families import cosines
from bayescal.gap.search.quantities import arguments, at_tool
from bayescal.gap.settings import CELLS
from bayescal.statistics import rms

Functions = Sequence[np.ndarray]
BY_READING = ("angle", "position")


@dataclass(frozen=True)
class Cell:
    """A site, a coordinate, and its sets of columns: one smooth set, or many local ones.

    With `clusters` it is a random error, drawn anew in each cluster of rows: its only set has one
    parameter, the motion by that error. Without sets they are those of `cells.sets_of`.
    """

    site: Site
    driver: Driver
    sets: tuple[tuple[Parameter, ...], ...]
    of_known_effect: bool = False  # whether a known effect has this same function
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
            driver = d * rows  # one array for all axes
            return [
                Parameter("", "m" if a[0] == "t" else "rad", (Term(f, a, driver),), sd) for f, a, sd in every
            ]

        return move

    def turn(j: int) -> Mover:
        return lambda d: list(at_joint(c, j, [d], side_of(c.robot)))

    def contact(rows: np.ndarray) -> Mover:
        return lambda d: list(at_contact(rows, [d]))

    out: dict[Site, tuple[Mover, ...]] = {BASE: (displaced({0: (*SHIFTS, *TURNS)}),)}
    out |= {joint(j): (turn(j),) for j in range(1, c.robot.n + 1)}
    of_tool = {c.chain.n + 1: SHIFTS} | ({TURN: TURNS} if c.turned_tools else {})
    single = [(c.tool == k).astype(float) for k in c.fitted_tools] if len(c.fitted_tools) > 1 else []
    out[TOOL] = tuple(displaced(of_tool, rows) for rows in (1.0, *single))
    if np.any(c.touching):
        out[PROBE] = (contact(c.touching.astype(float)),)
    out |= {location.face(face.name): (contact(face.rows),) for face in c.faces}
    out |= {at_view(v, CAMERA): (_lens(v),) for v in c.views}
    return out


def _lens(v: View) -> Mover:
    """Errors of the focal lengths and the optical axis of a view."""
    every = [(e, k) for e in (v.focal, v.centre) for k in range(e.by.shape[2])]

    def move(d: np.ndarray) -> list[Parameter]:
        return [Parameter("", e.unit, shifts(e.by[:, :, k] * d[:, None]), CELLS.pixels) for e, k in every]

    return move


def shifts(lengths: np.ndarray) -> tuple[Term, ...]:
    """Terms that move corners in the image by lengths (N, 2), m."""
    return tuple(Term(IMAGE, way, lengths[:, k]) for k, way in enumerate("uv") if lengths[:, k].any())


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
        own_angle = [turns, [load * w for w in angles[j - 1]]]
        other_angle = [[load * w for w in angles[k]] for k in range(c.robot.n) if k != j - 1]
        alone = smooth(c.readings[:, j - 1], c.fitted, CELLS.surface_waves)
        falling = [w / k for k, w in enumerate(alone, start=1)]
        both = [[*falling, *(load * w for w in falling)]]
        for form, groups in (("own angle", own_angle), ("other angle", other_angle), ("and angle", both)):
            sets = tuple(at_joint(c, j, drivers) for drivers in groups if drivers)
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
    axes = [(by.axis, by.moment) for by in tilts(c)]
    if len(axes) == 2:
        (first, one), (second, two) = axes
        axes += [((first + s * second) / np.sqrt(2.0), (one + s * two) / np.sqrt(2.0)) for s in (1, -1)]
    sets = []
    for axis, moment in axes:
        mine = moment[c.fitted]
        if not np.ptp(mine) > 1e-3:
            continue
        size = float(np.quantile(np.abs(mine), 0.9))
        for knee, threshold in itertools.product(CELLS.knees, (0.0, float(np.median(mine)))):
            terms = base_terms(c, "r", axis, np.tanh((moment - threshold) / (knee * size)))
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
    motions = [(j, side) for j in range(1, c.robot.n + 1) for side in sides_of(c, j)]
    angles = np.stack([motion(c.robot, j, c.readings, side)[order] for j, side in motions])
    lengths, widths = np.radians(CELLS.forgotten), np.radians(CELLS.slack)
    states = np.empty((len(motions), len(lengths) + len(widths), len(order)))
    states[..., order] = np.concatenate([fading(angles, lengths), slack(angles, widths)], axis=1)
    for j in range(1, c.robot.n + 1):
        mine = [
            (side, s) for (k, side), courses in zip(motions, states, strict=True) if k == j for s in courses
        ]
        sets = [at_joint(c, j, [s], side) for side, s in mine if np.ptp(s[c.fitted]) > 0]
        yield Cell(joint(j), Driver("travel", j), tuple(sets))


def scatter(c: Circumstances) -> Iterator[Cell]:
    """Errors drawn anew at every reading of a joint, or at every pose, which repeated contacts do not show.

    That of a pose is the lack of fit, whatever its location: more scatter than that of repeated contacts.
    """
    for j in range(1, c.robot.n + 1):
        clusters = repeated(c, c.readings[:, j - 1])
        yield Cell(joint(j), Driver("reading", j), (at_joint(c, j, [np.ones(len(c.q))]),), clusters=clusters)
    if np.any(c.touching):
        moved = at_contact(c.touching.astype(float), [np.ones(len(c.q))])
        yield Cell(ARM, Driver("pose"), (moved,), clusters=repeated(c, c.readings))


def repeated(c: Circumstances, readings: np.ndarray) -> np.ndarray:
    """Numbers (N,), equal for rows with equal readings (N, ...) and for repetitions of one contact."""
    out = np.unique(np.round(readings, 8), axis=0, return_inverse=True)[1].ravel()
    if c.repeat is not None:
        labels = c.repeat.astype(str)
        has = labels != ""
        out[has] = len(out) + np.unique(labels[has], return_inverse=True)[1]
    return np.unique(out, return_inverse=True)[1]


def with_another(c: Circumstances) -> Iterator[Cell]:
    """Cells of a quantity of a joint and any other one."""
    given = arguments(c)
    for j in range(1, c.robot.n + 1):
        for driver, ways in _by_quantity(c, j).items():
            sets = tuple(
                at_joint(c, j, [*_alone(driver, basis), *(u * v for u in basis for v in a.functions.T)], side)
                for basis in ways
                for a in given
                if a.driver != driver
                for side in moves(c, j)
            )
            yield Cell(joint(j), replace(driver, form="and another"), sets, weight=CELLS.paired)


def _alone(driver: Driver, functions: Functions) -> Functions:
    """Functions of a quantity by itself; an angle has cells of its own."""
    return [] if driver.kind in BY_READING else functions


def _by_quantity(c: Circumstances, j: int) -> dict[Driver, list[Functions]]:
    """Functions of each quantity of a joint, by each of its motions."""
    order, out = measured(c), dict[Driver, list[Functions]]()
    for side in passes(c, j):
        angle, travel = motion(c.robot, j, c.readings, side), np.empty(len(order))
        if waves := smooth(angle, c.fitted, CELLS.pair_waves):
            travel[order] = fading(angle[order], np.radians(CELLS.forgotten[1:2]))[0]
            out.setdefault(by_reading(c.robot, j), []).append(waves)
            out.setdefault(Driver("travel", j), []).append([travel])
        if c.velocity is not None:
            speed = motion(c.robot, j, c.velocity, side)
            if np.any(speed[c.fitted]):
                out.setdefault(Driver("direction", j), []).append([sense(speed)])
                out.setdefault(Driver("joint speed", j), []).append([speed / rms(speed[c.fitted])])
    if c.torques is not None and np.ptp(c.torques[c.fitted, j - 1]) > 1e-3:
        out[Driver("torque", j)] = [smooth(c.torques[:, j - 1], c.fitted, CELLS.pair_waves)]
    return out


def by_any(c: Circumstances) -> Iterator[Cell]:
    """Links, base, tool and lens that change along one of their axes by any quantity, and links by two."""
    given = [a for a in arguments(c) if a.driver.kind != "contact direction"]
    weight = CELLS.paired / max(len(given), 1)
    clock = [f for a in given if a.driver.kind == "time" for f in a.functions.T]
    for a in given:
        for j in range(1, c.robot.n + 1):
            both = [list(a.functions.T)]
            if a.driver.kind in BY_READING:
                both.append([*a.functions.T, *(u * v for u in a.functions.T for v in clock)])
            sets = [
                tuple(Parameter("", "rad", (Term(j, axis, f),), CELLS.angle) for f in of)
                for of in both
                for axis in ("rx", "ry")
            ]
            yield Cell(link(j), a.driver, tuple(sets), weight=weight)
        for site in (BASE, TOOL, *(at_view(v, CAMERA) for v in c.views)):
            yield Cell(site, a.driver, tuple(_each_axis(c, site, list(a.functions.T))), weight=weight)
    smoothest = smooth(measured(c).argsort().astype(float), c.fitted, CELLS.rough_waves)
    for site in (BASE, TOOL):
        rough = tuple(_each_axis(c, site, smoothest))
        yield Cell(site, Driver("count", form="to and fro"), rough)


def _each_axis(c: Circumstances, site: Site, functions: Functions) -> Iterator[tuple[Parameter, ...]]:
    """Displacements of a site by functions, along each of its axes."""
    for move in movers(c)[site]:
        yield from zip(*map(move, functions), strict=True)


def remembering(c: Circumstances) -> Iterator[Cell]:
    """A base on clearance, and a tool that earlier contacts have pushed aside."""
    order, sets = measured(c), list[tuple[Parameter, ...]]()
    for by in (t for t in tilts(c) if np.ptp(t.moment[c.fitted]) > 0):
        mine = by.moment[order] - np.median(by.moment[c.fitted])
        state = np.empty((len(CELLS.clearance), len(order)))
        state[:, order] = slack(mine, np.array(CELLS.clearance) * np.std(by.moment[c.fitted]))
        sets += [(Parameter("", "rad", base_terms(c, "r", by.axis, s), CELLS.angle),) for s in state]
    yield Cell(BASE, Driver("base moment", form="past"), tuple(sets))
    if not np.any(c.touching):
        return
    way, sets = np.where(c.touching[:, None], c.approach, 0.0), []
    for keep in CELLS.kept:
        past, aside = np.zeros_like(way), np.zeros(3)
        for row in order:
            past[row], aside = aside, keep * aside + way[row]
        sets += [tuple(q for f in past.T for q in move(f)) for move in movers(c)[TOOL]]
    yield Cell(TOOL, Driver("contact direction", form="past"), tuple(sets))


def pointing(c: Circumstances) -> Iterator[Cell]:
    """An error of the probe by the direction of contact and any quantity, gravity among them."""
    if not np.any(c.touching):
        return
    way, down, on = np.where(c.touching[:, None], c.approach, 0.0), at_tool(c), c.touching.astype(float)
    along = np.sum(way * down, axis=1)
    sets = [[u * v for u in way.T for v in down.T], [along, *(along * f for f in (*down.T, *np.abs(down.T)))]]
    sets = sets if np.ptp(along[c.fitted]) > 0 else []
    others = [a.functions.T for a in arguments(c) if a.driver.kind != "contact direction"]
    sets += [[*of, *(u * v for u in way.T for v in of)] for of in others]
    cell = Driver("contact direction", form="and another")
    yield Cell(PROBE, cell, tuple(at_contact(on, of) for of in sets))


FURTHER = (
    torque_and_angle, two_angles, between_orders, rocking, travel, scatter,
    with_another, by_any, remembering, pointing,
)  # fmt: skip
"""Functions that list the cells of a session, in the order of the cells."""
