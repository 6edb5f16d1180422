"""Kinds of cells: of two quantities, with a memory of earlier contacts, and of what measures.

These are cells of two coordinates, of orders between harmonics and gear mesh, of a rocking base, of joints
with a memory of earlier contacts, and of random errors of their readings.

An error of a joint is also a function of one of its quantities (angle, torque, direction, speed, earlier
travel) times a function of any quantity of the session: friction that grows with a load, drag of a cold gear.
Links, base and tool move along one axis by any quantity, and the probe's error by the direction of contact
and any quantity.

What measures is a probe, the faces that it touches, or an instrument.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm import chain as reference
from bayescal.arm.motion import Term
from bayescal.arm.statics import gravity_in_f0
from bayescal.effects import EFFECTS, Circumstances, Parameter, location
from bayescal.effects.common import by_reading, motion, sense, tilts
from bayescal.effects.imaging import at_view
from bayescal.effects.location import ARM, BASE, CAMERA, PROBE, TOOL, Driver, Site, joint, link
from bayescal.effects.probe import shapes
from bayescal.estimate.families import lobes, unit_range
from bayescal.gap.search import makers
from bayescal.gap.search.makers import Cell, at_contact, at_joint, measured, movers, moves, smooth
from bayescal.gap.settings import CELLS
from bayescal.statistics import rms

Functions = Sequence[np.ndarray]
BY_READING = ("angle", "position")


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


def masses_unknown(c: Circumstances) -> Iterator[Cell]:
    """Joints that yield to gravity where no masses are stated: by the torque of a mass at each frame."""
    if c.torques is not None or not np.any(c.gravity):
        return
    pose = reference.frames(c.chain, c.q)
    down = gravity_in_f0(c.chain, pose, c.gravity / np.linalg.norm(c.gravity))
    places = [*np.moveaxis(pose[:, 1:, :3, 3], 1, 0), makers.points(c)]
    for j in (np.flatnonzero(~c.robot.slides) + 1).tolist():
        torques = [
            np.sum(pose[:, j, :3, 2] * np.cross(place - places[j - 1], down), axis=1) for place in places[j:]
        ]
        spread = [float(np.ptp(torque[c.fitted])) for torque in torques]
        varying = [t for t, lever in zip(torques, spread, strict=True) if lever > 1e-3]  # m
        if varying:
            drivers = [2.0 * t / max(spread) for t in varying]
            yield Cell(joint(j), Driver("torque", j, form="masses"), (at_joint(c, j, drivers),))


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
            sets.append((makers.tilted(c, axis, np.tanh((moment - threshold) / (knee * size))),))
    yield Cell(BASE, Driver("base moment", form="sign"), tuple(sets))


def travel(c: Circumstances) -> Iterator[Cell]:
    """Errors of a joint by its travel since earlier contacts."""
    order = measured(c)
    motions = [(j, side) for j in range(1, c.robot.n + 1) for side in makers.sides_of(c, j)]
    angles = np.stack([motion(c.robot, j, c.readings, side)[order] for j, side in motions])
    lengths, widths = np.radians(CELLS.forgotten), np.radians(CELLS.slack)
    states = np.empty((len(motions), len(lengths) + len(widths), len(order)))
    parts = makers.fading(angles, lengths), makers.slack(angles, widths)
    states[..., order] = np.concatenate(parts, axis=1)
    for j in range(1, c.robot.n + 1):
        mine = [
            (side, s) for (k, side), courses in zip(motions, states, strict=True) if k == j for s in courses
        ]
        sets = [at_joint(c, j, [s], side) for side, s in mine if np.ptp(s[c.fitted]) > 0]
        yield Cell(joint(j), Driver("travel", j), tuple(sets))


def scatter(c: Circumstances) -> Iterator[Cell]:
    """Errors drawn anew at every reading of a joint; and at every pose, which repeated contacts do not show.

    That of a pose is the lack of fit: more scatter than that of repeated contacts, whatever its location, or
    at a joint, where it is any function of the angle.
    """
    for j in range(1, c.robot.n + 1):
        error, angle = (at_joint(c, j, [np.ones(len(c.q))]),), c.readings[:, j - 1]
        every = [makers.repeated(c, angle, anew) for anew in (True, False)]
        yield Cell(joint(j), Driver("reading", j), error, clusters=every[0])
        if np.max(every[1]) < np.max(every[0]):
            yield Cell(joint(j), by_reading(c.robot, j, form="repeats"), error, clusters=every[1])
    if np.any(c.touching):
        moved = at_contact(c.touching.astype(float), [np.ones(len(c.q))])
        yield Cell(ARM, Driver("pose"), (moved,), clusters=makers.repeated(c, c.readings))


def blocks(c: Circumstances) -> Iterator[Cell]:
    """Errors drawn anew for each block of consecutive rows: of what takes a few positions, or wanders."""
    order = measured(c).argsort()
    driver = Driver("count", form="blocks")
    for site, (move, *_) in movers(c).items():
        each = [p for p in move(np.ones(len(c.q))) if p.unit == "m" or site.number]
        lengths = [length for length in CELLS.blocks if len(c.q) >= CELLS.fewest * length]
        for length, p in itertools.product(lengths, each):
            weight = 1.0 / (len(each) * len(lengths))
            yield Cell(site, driver, ((p,),), weight=weight, clusters=order // length)


def with_another(c: Circumstances) -> Iterator[Cell]:
    """Cells of a quantity of a joint and any other one."""
    given = makers.arguments(c)
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
    for side in makers.passes(c, j):
        angle, travel = motion(c.robot, j, c.readings, side), np.empty(len(order))
        if waves := smooth(angle, c.fitted, CELLS.pair_waves):
            travel[order] = makers.fading(angle[order], np.radians(CELLS.forgotten[1:2]))[0]
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
    given = [a for a in makers.arguments(c) if a.driver.kind != "contact direction"]
    weight = CELLS.paired / max(len(given), 1)
    clock = [f for a in given if a.driver.kind == "time" for f in a.functions.T]
    for a in given:
        for j in range(1, c.robot.n + 1):
            both = [list(a.functions.T)]
            if a.driver.kind in BY_READING:
                both.append([*a.functions.T, *(u * v for u in a.functions.T for v in clock)])
            sets = tuple(tuple(makers.along(j, axis, f) for f in of) for of in both for axis in ("rx", "ry"))
            yield Cell(link(j), a.driver, sets, weight=weight)
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
    """A base on clearance; a tool that gravity lays on one of two seats, or that contacts pushed aside."""
    order, sets = measured(c), list[tuple[Parameter, ...]]()
    for by in (t for t in tilts(c) if np.ptp(t.moment[c.fitted]) > 0):
        mine = by.moment[order] - np.median(by.moment[c.fitted])
        state = np.empty((len(CELLS.clearance), len(order)))
        state[:, order] = makers.slack(mine, np.array(CELLS.clearance) * np.std(by.moment[c.fitted]))
        sets += [(makers.tilted(c, by.axis, s),) for s in state]
    yield Cell(BASE, Driver("base moment", form="past"), tuple(sets))
    shift, down = movers(c)[TOOL][0], makers.at_tool(c)
    states = np.empty((3, len(CELLS.seated), len(order)))
    states[..., order] = makers.seats(down[order].T, np.array(CELLS.seated))
    seated = [tuple(shift(s)) for s in states.reshape(-1, len(order)) if np.ptp(s[c.fitted]) > 0]
    yield Cell(TOOL, Driver("gravity direction", form="past"), tuple(seated))
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
    way, on = np.where(c.touching[:, None], c.approach, 0.0), c.touching.astype(float)
    down = makers.at_tool(c)
    along = np.sum(way * down, axis=1)
    sets = [[u * v for u in way.T for v in down.T], [along, *(along * f for f in (*down.T, *np.abs(down.T)))]]
    sets = sets if np.ptp(along[c.fitted]) > 0 else []
    others = [a.functions.T for a in makers.arguments(c) if a.driver.kind != "contact direction"]
    sets += [[*of, *(u * v for u in way.T for v in of)] for of in others]
    cell = Driver("contact direction", form="and another")
    yield Cell(PROBE, cell, tuple(at_contact(on, of) for of in sets))


def probe(c: Circumstances) -> Iterator[Cell]:
    """A probe by the direction and the speed of contact."""
    if not np.any(c.touching):
        return
    on = c.touching.astype(float)
    yield Cell(PROBE, Driver("contact direction"), (at_contact(on, lobes(c)),))
    if c.speed is not None:
        waves = smooth(np.where(c.touching, c.speed, 0.0), c.fitted, 2)
        yield Cell(PROBE, Driver("contact speed"), (at_contact(on, waves),) if waves else ())


def region(c: Circumstances) -> Iterator[Cell]:
    """A probe or an instrument by the position in the workspace: everywhere, or in one region."""
    place = makers.points(c)
    low, high = place[c.fitted].min(axis=0), place[c.fitted].max(axis=0)
    half = np.maximum(0.5 * (high - low), 1e-3)
    u = np.clip((place - 0.5 * (low + high)) / half, -1.2, 1.2)
    on = c.touching.astype(float)
    spots = [
        1.0 / (1.0 + (np.linalg.norm(u - centre, axis=1) / CELLS.region_size) ** 3)
        for centre in itertools.product(CELLS.region_grid, repeat=3)
    ]
    seen = [s for s in spots if np.sum(s[c.fitted] > 0.5) >= CELLS.fewest / 2]
    local = Driver("workspace", form="one region")
    if np.any(c.touching):
        products = [u[:, i] * u[:, j] for i in range(3) for j in range(i, 3)]
        yield Cell(PROBE, Driver("workspace"), (at_contact(on, [*u.T, *products]),))
        yield Cell(PROBE, local, tuple(at_contact(on, [s]) for s in seen))
    if instruments := _instruments(c):
        (base,), read = movers(c)[BASE], np.sum([rows for _, rows, _ in instruments], axis=0)
        yield Cell(BASE, local, tuple(tuple(p for p in base(read * s) if p.unit == "m") for s in seen))


def beams(c: Circumstances) -> Iterator[Cell]:
    """An instrument by its distance, azimuth and elevation: smoothly, at one place, or in waves.

    It reads these, as a joint reads its angle: warm air in one direction, a cyclic error of the distance,
    the eccentricity of an encoder.
    """
    for name, rows, place in _instruments(c):
        mine = c.fitted[rows[c.fitted] > 0]
        if len(mine) < CELLS.fewest:
            continue
        quantities, axes = _polar(makers.points(c) - place, mine)
        along = axes @ c.chain.base[:3, :3]  # as the base is displaced
        smoothly, local, waves = [], [], []
        for k, x in enumerate(quantities):
            share = unit_range(x, mine)
            if share is None:
                continue
            smoothly += [_shifted(rows, axis, smooth(x, mine)) for axis in along]
            for bump in _bumps(share, mine):
                local += [_shifted(rows, axis, bump) for axis in along]
            least, most, step = CELLS.beam_waves
            for turns in np.arange(least, min(most, len(mine) / 3), step):
                phase = 2 * np.pi * turns * share
                waves.append(_shifted(rows, along[k], [np.sin(phase), np.cos(phase)]))
        for form, sets in (("", smoothly), ("one place", local), ("to and fro", waves)):
            yield Cell(location.face(name), Driver("beam", form=form), tuple(sets))


def _instruments(c: Circumstances) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Instruments that are no cameras, as `Circumstances.instruments`: these have cells of their images."""
    views = {v.name for v in c.views}
    return [one for one in c.instruments if one[0] not in views]


def _polar(away: np.ndarray, fitted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance, azimuth and elevation (3, N) of points (N, 3) from an instrument, and their axes (3, N, 3).

    The azimuth is zero where most of the fitted points are.
    """
    x, y, z = away.T
    middle = np.arctan2(np.mean(y[fitted]), np.mean(x[fitted]))
    distance, level = np.linalg.norm(away, axis=1), np.hypot(x, y)
    azimuth = (np.arctan2(y, x) - middle + np.pi) % (2 * np.pi) - np.pi
    beam = away / np.maximum(distance, 1e-9)[:, None]
    aside = np.cross([0.0, 0.0, 1.0], beam)
    quantities = np.stack([distance, azimuth, np.arctan2(z, level)])
    return quantities, np.stack([beam, aside, np.cross(beam, aside)])


def _shifted(rows: np.ndarray, axis: np.ndarray, drivers: Sequence[np.ndarray]) -> tuple[Parameter, ...]:
    """Displacements of points along an axis that varies with the row (N, 3), at rows (N,) where it is 1."""
    return tuple(
        Parameter("", "m", tuple(Term(0, f"t{a}", rows * u * d) for a, u in zip("xyz", axis.T, strict=True)),
                  CELLS.length)
        for d in drivers
    )  # fmt: skip


def _bumps(share: np.ndarray, fitted: np.ndarray) -> Iterator[list[np.ndarray]]:
    """Functions at one place of a range: what rises there, and what is to one side and the other."""
    for width in CELLS.beam_widths:
        for centre in np.arange(0.0, 1.0 + width, width):
            far = (share - centre) / width
            rise = np.exp(-0.5 * far**2)
            if np.sum(rise[fitted] > 0.5) >= CELLS.fewest / 2:
                yield [rise, far * rise]


def faces(c: Circumstances) -> Iterator[Cell]:
    """A face by the position on it: everywhere, or at one spot."""
    for face in c.faces:
        site = location.face(face.name)
        spots = []
        for width, end, count in CELLS.face_spots:
            centre = np.linspace(-end, end, count)[:, None, None]
            first, second = np.moveaxis(((face.place - centre) / width) ** 2, -1, 0)  # (count, N) each
            every = np.exp(-0.5 * (first[:, None] + second)).reshape(count**2, -1) * face.rows
            seen = np.sum(every[:, c.fitted] > 0.5, axis=1) >= CELLS.fewest_on_spot
            spots += [at_contact(face.rows, [spot]) for spot in every[seen]]
        yield Cell(site, Driver("face", form="one spot"), tuple(spots))
        form = at_contact(face.rows, [values for _, _, values in shapes(face)])
        yield Cell(site, Driver("face"), (form,), of_known_effect="plane-form" in EFFECTS)


MEASURING = (probe, region, beams, faces)
"""Functions that list the cells of what measures, in the order of the cells."""
FURTHER = (
    torque_and_angle, masses_unknown, two_angles, between_orders, rocking, travel, scatter, blocks,
    with_another, by_any, remembering, pointing,
)  # fmt: skip
"""Functions that list the cells of a session, in the order of the cells."""
