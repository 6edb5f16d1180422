"""Generic cells: a smooth function of one coordinate at one site, for effects that are not known.

They locate the gap independently of its cause. Together they are the hypothesis 'unknown'. A cell has the
same form as an effect: a site is displaced by parameters times drivers.

Cells of cameras are what images show that neither an arm nor a tool moves: a distortion that the model of the
lens lacks, a clock that runs otherwise or reads the image row by row, and points of a board that are not
where they should be. A lens that varies is a site of `makers.movers`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from bayescal.arm import chain as reference
from bayescal.arm.motion import IMAGE, TURN, Term
from bayescal.effects import EFFECTS, Circumstances, Parameter, View
from bayescal.effects.by_time import reflectors
from bayescal.effects.common import added_load, by_reading, motion, sense, tilts
from bayescal.effects.imaging import at_view, late_images
from bayescal.effects.location import BASE, BOARD, CAMERA, PROBE, TOOL, Driver, face, joint, link
from bayescal.estimate.families import cosines, lobes
from bayescal.gap.search import makers
from bayescal.gap.search.cell_kinds import FURTHER, MEASURING
from bayescal.gap.search.makers import (
    Cell,
    Mover,
    at_contact,
    at_joint,
    measured,
    movers,
    moves,
    shifts,
    smooth,
)
from bayescal.gap.settings import CELLS
from bayescal.statistics import rms


def of_images(c: Circumstances) -> Iterator[Cell]:
    """Displacements of corners by their place in the image; clocks that depend on it or on any quantity."""
    for v in c.views:
        site, place = at_view(v, CAMERA), _place(v)
        pixel = v.centre.by[:, [0, 1], [0, 1]]  # (N, 2) m/px
        each = [[np.ones(len(x)), *cosines(x, c.fitted, CELLS.image_waves)] for x in place.T]
        field = [x * y for x, y in itertools.product(*each)][1:]
        radius = np.sum(place**2, axis=1)
        moved = [
            tuple(
                Parameter("", "px", (Term(IMAGE, "uv"[k], pixel[:, k] * f),), CELLS.pixels)
                for f in field for k in range(2)
            ),
            tuple(
                Parameter("", "px", shifts(pixel * place * (radius**n / scale)[:, None]), CELLS.pixels)
                for n in range(1, 4) if (scale := float(np.max(radius ** (n + 0.5)))) > 0
            ),
        ]  # fmt: skip
        yield Cell(site, Driver("image"), tuple(filter(None, moved)))
        if c.velocity is not None and late_images(c, v):
            others = [a.functions for a in makers.arguments(c)]
            for form, ways in (("in the image", [*place.T[..., None]]), ("and another", others)):
                clocks = (
                    tuple(Parameter("", "s", late_images(c, v, f), CELLS.late) for f in (1.0, *of.T))
                    for of in ways
                )
                yield Cell(site, Driver("clock", form=form), tuple(clocks))


def of_each_image(c: Circumstances) -> Iterator[Cell]:
    """Errors that are drawn anew for each image: shifts along its sides, and the time of its readings."""
    for v in c.views:
        site, images = at_view(v, CAMERA), makers.repeated(c, c.readings)
        for k in range(2):
            moved = Parameter("", "px", shifts(v.centre.by[:, :, k]), CELLS.pixels)
            yield Cell(site, Driver("pose", form="uv"[k]), ((moved,),), clusters=images)
        if c.velocity is not None and (late := late_images(c, v)):
            clock = Parameter("", "s", late, CELLS.late)
            yield Cell(site, Driver("clock", form="anew"), ((clock,),), clusters=images)


def of_points(c: Circumstances) -> Iterator[Cell]:
    """Errors of a board that are drawn anew for each of its points: across its plane, and within it."""
    for v in c.views:
        for axis, form in ((2, "heights"), (0, "places"), (1, "places")):
            error = Parameter("", "m", shifts(v.shift[:, :, axis]), CELLS.point)
            yield Cell(at_view(v, BOARD), Driver("board", form=form), ((error,),), clusters=v.point)


def _place(v: View) -> np.ndarray:
    """Places of the corners in the image over the focal length, from its axis, (N, 2); 0 in other rows."""
    focal, centre = (e.by[:, [0, 1], [0, 1]] for e in (v.focal, v.centre))
    return np.divide(focal, centre, out=np.zeros_like(focal), where=centre != 0)


IMAGES = (of_points, of_images, of_each_image)
"""Functions that list the cells of cameras and boards, in the order of the cells."""


def cells(c: Circumstances) -> Iterator[Cell]:
    """All cells of a session, one after another, always in the same order."""
    for make in MAKERS:
        for cell in make(c):
            if any(cell.sets):  # a joint that did not move has no function of its angle
                yield cell


def sets_of(cell: Cell, number: int, c: Circumstances) -> tuple[tuple[Parameter, ...], ...]:
    """The sets of a cell, by its number in `cells`: made anew where a large session has not kept them."""
    return cell.sets or next(itertools.islice(cells(c), number, None)).sets


def _joints(c: Circumstances) -> Iterator[Cell]:
    n = c.robot.n
    courses = [_courses(c, k) for k in range(1, n + 1)]
    for j in range(1, n + 1):
        site = joint(j)
        for k, forms in enumerate(courses, start=1):
            waves = [at_joint(c, j, functions, side) for side in moves(c, j) for functions, _ in forms]
            yield Cell(site, by_reading(c.robot, k), tuple(waves))
            bends = [at_joint(c, j, [d], side) for side in moves(c, j) for _, knees in forms for d in knees]
            yield Cell(site, by_reading(c.robot, k, form="beyond"), tuple(bends))
        jumps = [at_joint(c, j, [d], side) for side in moves(c, j) for d in _jumps(c, j)]
        yield Cell(site, by_reading(c.robot, j, form="jump"), tuple(jumps))
        if not c.robot.slides[j - 1]:
            yield Cell(site, Driver("angle", j, form="one place"), tuple(_bumps(c, j)))
        if c.torques is not None:
            torque = c.torques[:, j - 1]
            load = smooth(torque, c.fitted)
            if load and np.ptp(torque[c.fitted]) > 1e-3:
                yield Cell(site, Driver("torque", j), (at_joint(c, j, load),))
                late = [at_joint(c, j, [d]) for d in _past(c, torque)]
                yield Cell(site, Driver("torque", j, form="past"), tuple(late))
        if c.velocity is not None:
            speeds = [(side, motion(c.robot, j, c.velocity, side)) for side in makers.sides_of(c, j)]
            speeds = [(side, speed) for side, speed in speeds if np.any(speed[c.fitted])]
            play = [at_joint(c, j, [sense(v)], side) for side, v in speeds]
            yield Cell(site, Driver("direction", j), tuple(play), of_known_effect="backlash" in EFFECTS)
            late = [at_joint(c, j, [v / rms(v[c.fitted])], side) for side, v in speeds]
            yield Cell(site, Driver("joint speed", j), tuple(late))


def _courses(c: Circumstances, k: int) -> list[tuple[list[np.ndarray], list[np.ndarray]]]:
    """Functions of the angle of joint k, smooth ones and those beyond a value, by each of its motions."""
    angles = [motion(c.robot, k, c.readings, of) for of in makers.passes(c, k)]
    return [(waves, list(_beyond(x, c.fitted))) for x in angles if (waves := smooth(x, c.fitted))]


def _beyond(x: np.ndarray, fitted: np.ndarray) -> Iterator[np.ndarray]:
    """Piecewise linear functions with a knee at a value of a coordinate x (N,), on either side of it."""
    for knee in np.quantile(x[fitted], CELLS.bends):
        for side in (1.0, -1.0):
            line = np.maximum(side * (x - knee), 0.0)
            most = float(np.max(line[fitted]))
            if most > 0 and np.sum(line[fitted] > 0) >= CELLS.fewest:
                yield 2.0 * line / most


def _jumps(c: Circumstances, j: int) -> Iterator[np.ndarray]:
    """Functions (N,) with one value below an angle of a joint and another above it."""
    for of in makers.passes(c, j):
        x = motion(c.robot, j, c.readings, of)
        for angle in np.unique(np.quantile(x[c.fitted], np.linspace(0, 1, CELLS.jumps + 2)[1:-1])):
            yield np.where(x > angle, 1.0, -1.0)


def _past(c: Circumstances, load: np.ndarray) -> Iterator[np.ndarray]:
    """Difference between a low-pass filtered load (N,) and the present load."""
    if c.time is None or not np.ptp(c.time) > 0:
        return
    wait = np.maximum(np.diff(c.time, prepend=c.time[0]), 0.0)
    for memory in CELLS.memory:
        lag, keep = np.zeros(len(load)), np.exp(-wait / memory)
        for k in range(1, len(load)):
            lag[k] = keep[k] * (lag[k - 1] + load[k - 1] - load[k])
        size = rms(lag[c.fitted])
        if size > 0:
            yield lag / size


def _bumps(c: Circumstances, j: int) -> Iterator[tuple[Parameter, ...]]:
    """Local defects within a revolution: Gaussian functions of the link-relative angle."""
    angle = c.q[:, j - 1]
    mine = angle[c.fitted]
    for width in CELLS.bump_widths:
        centres = np.arange(np.min(mine), np.max(mine) + width, width)
        drivers = np.exp(-0.5 * ((angle - centres[:, None]) / width) ** 2)
        seen = np.sum(drivers[:, c.fitted] > 0.5, axis=1) >= CELLS.fewest / 2
        for driver in drivers[seen]:
            yield (makers.along(j, "rz", driver),)


def _bending(c: Circumstances) -> Iterator[Cell]:
    for j in range(1, c.robot.n + 1):
        waves = smooth(c.q[:, j - 1], c.fitted)
        axes = ("rx", "ry", "tx", "ty") if c.robot.slides[j - 1] else ("rx", "ry")
        turns = tuple(makers.along(j, axis, w) for axis in axes for w in waves)
        yield Cell(link(j), by_reading(c.robot, j), (turns,))
    for tilt in tilts(c):
        waves = smooth(tilt.moment, c.fitted, 3)
        if waves and np.ptp(tilt.moment[c.fitted]) > 1e-3:
            yield Cell(BASE, Driver("base moment"), (tuple(makers.tilted(c, tilt.axis, w) for w in waves),))


def _time(c: Circumstances) -> Iterator[Cell]:
    order = np.arange(len(c.q), dtype=float)
    clocks = {"time": [order if c.time is None else c.time]}
    if c.temperature is not None:
        clocks["temperature"] = [c.temperature]
    if np.ptp(added_load(c)[c.fitted]) > 0:
        clocks["load"] = [added_load(c)]
    if c.time is not None:
        clocks |= {"count": [order], "activity": list(_activity(c, c.time)), "wait": list(_waits(c, c.time))}
    if late := [[d, *also] for d in _past(c, added_load(c)) for also in ([], [added_load(c)])]:
        sets = (tuple(p for d in drivers for p in movers(c)[TOOL][0](d)) for drivers in late)
        yield Cell(TOOL, Driver("load", form="past"), tuple(sets))
    count = len(c.fitted)
    moments = CELLS.moments if count > 3 * CELLS.fewest else 0
    positions = np.linspace(CELLS.fewest, count - CELLS.fewest, moments).round().astype(int)
    for site, ways in movers(c).items():
        for name, of in clocks.items():
            courses = [smooth(clock, c.fitted, 3 if site == BASE else CELLS.waves) for clock in of]
            if site.kind == CAMERA.kind and name == "time":
                courses += _settling(of[0], c.fitted)
            sets = (tuple(p for w in waves for p in move(w)) for waves in courses if waves for move in ways)
            yield Cell(site, Driver(name), tuple(sets))
    named = {BASE, *makers.bodies(c), *([TOOL] if reflectors(c) else [])} if "step" in EFFECTS else set()
    for site, ways in (movers(c) | makers.bodies(c)).items():
        steps = [
            tuple(move((order >= c.fitted[k]).astype(float)))
            for move in ways
            for k in _within(c, move, positions)
        ]
        yield Cell(site, Driver("event"), tuple(steps), of_known_effect=site in named)


def _settling(clock: np.ndarray, fitted: np.ndarray) -> list[list[np.ndarray]]:
    """Exponential functions of a clock (N,), each by itself: what warms up, as a focus."""
    span = float(np.ptp(clock[fitted]))
    since = (clock - clock[fitted].min()) / span if span > 0 else clock
    return [[np.exp(-since / share)] for share in CELLS.settled if span > 0]


def _within(c: Circumstances, move: Mover, positions: np.ndarray) -> np.ndarray:
    """Places among the fitted rows with enough contacts before and after that a change there would move.

    Without any before it, a change is a constant: an error of a certified value.
    """
    driven = [np.asarray(t.driver) for p in move(np.ones(len(c.q))) for t in p.terms]
    moved = np.cumsum(np.any(np.not_equal(driven, 0.0), axis=0)[c.fitted])
    before = np.concatenate([[0], moved])[positions]
    return positions[(before >= CELLS.few) & (moved[-1] - before >= CELLS.few)]


def _waits(c: Circumstances, time: np.ndarray) -> Iterator[np.ndarray]:
    """Ranks (N,) of the times from the row before: of very different waits, each has as much weight."""
    order = measured(c)
    wait = np.empty(len(time))
    wait[order] = np.diff(time[order], prepend=time[order[0]])
    if np.ptp(wait[c.fitted]) > 0:
        yield np.unique(wait, return_inverse=True)[1].astype(float)


def _activity(c: Circumstances, time: np.ndarray) -> Iterator[np.ndarray]:
    """Motion of all joints before each row (N,), rad, forgotten with a time constant."""
    order = measured(c)
    wait = np.maximum(np.diff(time[order], prepend=time[order[0]]), 0.0)
    way = np.sum(np.abs(np.diff(c.readings[order], axis=0, prepend=c.readings[order[:1]])), axis=1)
    for length in CELLS.warm:
        out, state = np.empty(len(order)), 0.0
        for k, row in enumerate(order):
            state = state * np.exp(-wait[k] / length) + way[k]
            out[row] = state
        if np.ptp(out[c.fitted]) > 0:
            yield out


def hanging(c: Circumstances) -> Iterator[Cell]:
    """A tool that deflects under its weight: by the direction of gravity in its frame."""
    parts = [p for p in makers.at_tool(c).T if np.ptp(p[c.fitted]) > 1e-3]
    if not parts:
        return
    flips = [np.tanh(p / CELLS.flip) for p in parts]
    squares = [p * q for p, q in itertools.combinations_with_replacement(parts, 2)]
    moves = movers(c)[TOOL][0]
    sets = [[q for p in of for q in moves(p)] for of in (parts, *([p] for p in flips))]
    sets += map(list, zip(*(moves(p) for p in (*parts, *squares[:5])), strict=True))  # squares sum to 1
    sets += list(_mount(c)) if c.turned_tools else []
    yield Cell(TOOL, Driver("gravity direction"), tuple(map(tuple, sets)))


def _mount(c: Circumstances) -> Iterator[list[Parameter]]:
    """A mount that bends under the weight of what it holds, at any place and alike in all directions.

    It turns by r x g, and shifts by g times a factor; together, or without the shift.
    """
    down, frame = makers.at_tool(c), c.chain.n + 1
    ways = (zip(makers.TURNS, np.cross(place, down).T, strict=True) for place in np.eye(3))
    turned = [Parameter("", "rad", tuple(Term(TURN, a, t) for a, t in of), CELLS.angle) for of in ways]
    shifted = tuple(Term(frame, a, d) for a, d in zip(makers.SHIFTS, down.T, strict=True))
    yield [*turned, Parameter("", "m", shifted, CELLS.length)]
    yield turned


def _around(c: Circumstances) -> Iterator[Cell]:
    """A base that moves with the direction in which the arm reaches."""
    waves = smooth(c.q[:, 0], c.fitted, 3)
    (base,) = movers(c)[BASE]
    yield Cell(BASE, by_reading(c.robot, 1), (tuple(q for w in waves for q in base(w)),))


def _sway(c: Circumstances) -> Iterator[Cell]:
    """A base, tool or probe that goes to and fro by time, or by the number of rows; a base may only tilt.

    What alternates between two states has most of its variance in one wave.
    """
    order = np.arange(len(c.q), dtype=float)
    clocks = [order] if c.time is None else [c.time, order]
    least, most, step = CELLS.swings
    turns = np.arange(least, min(most, len(c.fitted) / CELLS.rows_a_swing), step)
    phases = [
        2 * np.pi * k * x / np.ptp(x[c.fitted]) for x in clocks if np.ptp(x[c.fitted]) > 0 for k in turns
    ]
    for site, (move, *_) in movers(c).items():
        if site not in (BASE, TOOL, PROBE):
            continue
        sets = [(*move(np.sin(phase)), *move(np.cos(phase))) for phase in phases]
        if site == BASE:
            sets = sets[: len(turns)]  # cost
            sets += [tuple(p for p in each if p.terms[0].axis in ("rx", "ry")) for each in sets]
        yield Cell(site, Driver("time", form="to and fro"), tuple(sets))


def _artefacts(c: Circumstances) -> Iterator[Cell]:
    """Bodies of targets that move or grow by a quantity; they, and pieces of them, that bend under a contact.

    A piece is the same in all placements of a body. What bends, or has another form, shows in the direction
    of contact in F0. In one placement a piece may move; its mean displacement there is a wrong certificate.
    """
    pieces = {name for name, *_ in c.pieces}
    of_all = {name.partition("@")[0] for name in pieces if "@" in name}  # placements, beside each of them
    order = np.arange(len(c.q), dtype=float)
    clocks = {
        "time": order if c.time is None else c.time,
        "temperature": c.temperature,
        "load": added_load(c),
    }
    flange = reference.frames(c.chain, c.q)[:, -1, :3, :3]
    pointing = lobes(replace(c, approach=np.einsum("nij,nj->ni", flange, c.approach)))
    for name, rows, _ in (*c.artefacts, *c.pieces):
        mine = c.fitted[rows[c.fitted] > 0]
        if len(mine) < CELLS.fewest or len(mine) == len(c.fitted) or name in {f.name for f in c.faces}:
            continue
        on, site = rows * c.touching, face(name)
        axes = makers.SHIFTS, (*makers.SHIFTS, *makers.TURNS)
        ways = [makers.displaced({0: some}, rows) for some in axes]
        of_one = name in pieces - of_all
        if np.any(on[mine]) and not (of_one and "@" in name):
            ways.append(partial(_grown, on))
            forms = tuple(at_contact(on, f) for f in (pointing[:5], pointing))
            yield Cell(site, Driver("contact direction"), forms)
        for kind, clock in clocks.items() if name not in of_all & pieces else ():
            if clock is not None and (waves := smooth(clock, mine, 2)):
                moved = [w - np.mean(w[mine]) for w in waves] if of_one else waves
                sets = (tuple(p for w in moved for p in move(w)) for move in ways)
                yield Cell(site, Driver(kind), tuple(sets))


def _grown(on: np.ndarray, d: np.ndarray) -> list[Parameter]:
    """What is touched in the rows (N,) where `on` is 1, larger by a function (N,)."""
    return list(at_contact(on, [d]))


MAKERS = (_joints, _bending, _time, _sway, _artefacts, hanging, _around, *MEASURING, *FURTHER, *IMAGES)
"""Functions that list the cells of a session, in the order of the cells."""
