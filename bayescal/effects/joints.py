"""Functions that several effects share: links moved by a reading, periodic terms, significant torques."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.motion import Term
from bayescal.effects import location
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Form, Parameter, Where

NO_TORQUE = 1e-6  # N m: smaller torques of a joint do not identify a torque-driven effect


LINK, READING = "link", "reading"
"""Sides of coupled axes on which an encoder and a gear may be: between two links, or at the displayed axis.

On the link side an error turns only the joint's own link, and its driver is the motion between the two links.
On the reading side it turns all links that the reading moves, and its driver is the reading.
"""


def side_of(robot: Robot) -> str:
    """The side of encoders and gears in the robot file; without coupled axes both sides are equal."""
    return LINK if robot.coupling == "display" else READING


def motion(robot: Robot, joint: int, readings: np.ndarray, side: str) -> np.ndarray:
    """Motion at the encoder and the gear of `joint` (from 1), (N,), from readings or their rates (N, n)."""
    return readings[:, joint - 1] if side == READING else readings @ robot.link_from_reading[joint - 1]


def turned(robot: Robot, joint: int, driver: np.ndarray, side: str) -> tuple[Term, ...]:
    """Rotations by an error of the encoder or gear of `joint` (from 1), rad in its own sense of rotation."""
    if side == LINK:
        return (Term(joint, "rz", driver),)
    column = robot.link_from_reading[:, joint - 1]
    return tuple(Term(i, "rz", share * driver) for i, share in enumerate(column, start=1) if share)


SIDES = {LINK: "by the motion between its links", READING: "by the readings shown"}


Sided = Callable[[Circumstances, str], list[Parameter]]


def sides(make: Sided) -> tuple[Form, ...]:
    """Forms of an effect of encoders or gears: one for each side, made by `make(c, side)`."""
    return tuple(Form(side, words, _on(make, side)) for side, words in SIDES.items())


def _on(make: Sided, side: str) -> Callable[[Circumstances], list[Parameter]]:
    return lambda c: make(c, side)


def waves(c: Circumstances, effect: str, joint: int, order: float, sd: float) -> list[Parameter]:
    """Sine and cosine of `order` times the link-relative angle of `joint` (from 1) as errors of that angle.

    `sd` is the prior standard deviation of each, rad.
    """
    angle = order * c.q[:, joint - 1]
    name = f"{effect} {c.robot.joint_names[joint - 1]}"
    where = at(joint, Driver("angle", joint, order))
    return [
        Parameter(f"{name} {wave}", "rad", (Term(joint, "rz", driver),), sd, **where)
        for wave, driver in (("sin", np.sin(angle)), ("cos", np.cos(angle)))
    ]


def at(joint: int, driver: Driver) -> Where:
    """Site and driver of a parameter that acts at a joint (from 1)."""
    return {"site": location.joint(joint), "driver": driver}


def carries(torque: np.ndarray) -> bool:
    """Whether any row of a torque (...), N m, is above `NO_TORQUE`."""
    return bool(np.max(np.abs(torque), initial=0.0) >= NO_TORQUE)


def usual(c: Circumstances, torque: np.ndarray) -> float:
    """90th percentile of the absolute torque (N m) over the fitted contacts, from a joint's torques (N,)."""
    return max(float(np.quantile(np.abs(torque[c.fitted]), 0.9)), NO_TORQUE)


def without_masses(c: Circumstances) -> str:
    """A message if the robot has no masses, which gravity moments need, or ""."""
    return "" if c.moments is not None else "the robot file gives no links (mass_kg, centre_of_mass_mm)"


def without_torques(c: Circumstances) -> str:
    """A message if the torques of the joints are neither measured nor computed, or ""."""
    return "" if c.torques is not None else without_masses(c)


def without_velocity(c: Circumstances) -> str:
    """A message if the session has no joint velocities, or ""."""
    return "" if c.velocity is not None else "no j1_degps ...: the session records no joint velocities"


def without_surface(c: Circumstances) -> str:
    """A message if no ball touches a surface, or ""."""
    return "" if np.any(c.touching) else "no target is a surface (plane, sphere, cylinder)"
