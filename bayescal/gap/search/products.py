"""Cells of an error that depends on two quantities, and of one that depends on any quantity of the session.

An error of a joint is a function of one of its quantities (angle, torque, direction, speed, earlier travel)
times a function of any quantity of the session: friction that grows with a load, drag of a cold gear. Links,
base and tool move along one axis by any quantity, and the probe's error by the direction of contact and
any quantity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects import Circumstances, Parameter
from bayescal.effects.common import base_terms, by_reading, motion, tilts
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, Site, joint, link
from bayescal.gap.search.makers import (
    Cell,
    at_contact,
    at_joint,
    fading,
    measured,
    movers,
    moves,
    passes,
    slack,
    smooth,
)
from bayescal.gap.search.quantities import arguments, at_tool, signs
from bayescal.gap.settings import CELLS
from bayescal.statistics import rms

Functions = Sequence[np.ndarray]
BY_READING = ("angle", "position")


def products(c: Circumstances) -> Iterator[Cell]:
    """Cells of a quantity of a joint and any other one."""
    given = arguments(c)
    for j in range(1, c.robot.n + 1):
        for driver, ways in _own(c, j).items():
            sets = tuple(
                at_joint(c, j, [*_alone(driver, own), *(u * v for u in own for v in a.functions.T)], side)
                for own in ways
                for a in given
                if a.driver != driver
                for side in moves(c, j)
            )
            yield Cell(joint(j), replace(driver, form="and another"), sets, weight=CELLS.paired)


def _alone(driver: Driver, own: Functions) -> Functions:
    """Functions of a quantity by itself; an angle has cells of its own."""
    return [] if driver.kind in BY_READING else own


def _own(c: Circumstances, j: int) -> dict[Driver, list[Functions]]:
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
                out.setdefault(Driver("direction", j), []).append([signs(speed)])
                out.setdefault(Driver("joint speed", j), []).append([speed / rms(speed[c.fitted])])
    if c.torques is not None and np.ptp(c.torques[c.fitted, j - 1]) > 1e-3:
        out[Driver("torque", j)] = [smooth(c.torques[:, j - 1], c.fitted, CELLS.pair_waves)]
    return out


def by_any(c: Circumstances) -> Iterator[Cell]:
    """Links, base and tool that move along one of their axes by any quantity, and links by two."""
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
        for site in (BASE, TOOL):
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
    for by in tilts(c):
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
