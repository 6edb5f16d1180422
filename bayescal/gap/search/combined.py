"""Generic cells of two coordinates, of orders between harmonics and gear mesh, and of a rocking base."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from bayescal.effects import Circumstances, Parameter
from bayescal.effects.location import BASE, Driver, joint
from bayescal.effects.stand import base_terms, tilts
from bayescal.gap.search.cell import Cell, at_joint, moves, smooth
from bayescal.gap.settings import CELLS


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
        load = torque / np.sqrt(np.mean(torque[c.fitted] ** 2))
        turns = [load * f(k * c.q[:, j - 1]) for k in CELLS.own_orders for f in (np.sin, np.cos)]
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
    for j in range(1, c.robot.n + 1):
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


MAKERS = (torque_and_angle, two_angles, between_orders, rocking)
"""Functions that list the cells of a session."""
