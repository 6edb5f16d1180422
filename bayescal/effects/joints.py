"""What several effects share: where a reading acts, which angles turn with a joint, which torques count."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.motion import Term
from bayescal.arm.robot import Robot
from bayescal.effects import location
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Form, Parameter, Where

NO_TORQUE = 1e-6  # N m: a joint that never carries more tells nothing of what torque does to it


LINK, READING = "link", "reading"
"""Sides of coupled axes on which an encoder and a gear may sit: between two links, or at the axis shown.

On the side of the links an error turns the joint's own link, and goes by the motion between the two links.
On that of the readings it turns all links that the reading moves, and goes by the reading.
"""


def side_of(robot: Robot) -> str:
    """The side on which the robot file puts encoders and gears; without coupled axes both are one."""
    return LINK if robot.coupling == "display" else READING


def motion(robot: Robot, joint: int, readings: np.ndarray, side: str) -> np.ndarray:
    """What passes the encoder and the gear of `joint` (from 1), (N,), of readings or their rates (N, n)."""
    return readings[:, joint - 1] if side == READING else readings @ robot.link_from_reading[joint - 1]


def turned(robot: Robot, joint: int, driver: np.ndarray, side: str) -> tuple[Term, ...]:
    """Turns by an error of the encoder or the gear of `joint` (from 1), rad in its own sense of rotation."""
    if side == LINK:
        return (Term(joint, "rz", driver),)
    column = robot.link_from_reading[:, joint - 1]
    return tuple(Term(i, "rz", share * driver) for i, share in enumerate(column, start=1) if share)


SIDES = {LINK: "by the motion between its links", READING: "by the readings shown"}


Sided = Callable[[Circumstances, str], list[Parameter]]


def sides(make: Sided) -> tuple[Form, ...]:
    """Forms of an effect of encoders or gears: that of either side, made by `make(c, side)`."""
    return tuple(Form(side, words, _on(make, side)) for side, words in SIDES.items())


def _on(make: Sided, side: str) -> Callable[[Circumstances], list[Parameter]]:
    return lambda c: make(c, side)


def waves(c: Circumstances, effect: str, joint: int, order: float, sd: float) -> list[Parameter]:
    """Sine and cosine of `order` times the link-relative angle of `joint` (from 1), each turning it.

    `sd` is the prior standard deviation of each, rad.
    """
    angle = order * c.q[:, joint - 1]
    name = f"{effect} {c.robot.joint_names[joint - 1]}"
    return [
        Parameter(
            f"{name} {wave}",
            "rad",
            (Term(joint, "rz", driver),),
            sd,
            **at(joint, Driver("angle", joint, order)),
        )
        for wave, driver in (("sin", np.sin(angle)), ("cos", np.cos(angle)))
    ]


def at(joint: int, driver: Driver) -> Where:
    """Site and driver of a parameter that acts at a joint (from 1)."""
    return {"site": location.joint(joint), "driver": driver}


def carries(torque: np.ndarray) -> bool:
    """Whether any row of a torque (...), N m, is one to speak of."""
    return bool(np.max(np.abs(torque), initial=0.0) >= NO_TORQUE)


def usual(c: Circumstances, torque: np.ndarray) -> float:
    """Torque (N m) that nine in ten of the fitted contacts stay below, of a joint's torques (N,)."""
    return max(float(np.quantile(np.abs(torque[c.fitted]), 0.9)), NO_TORQUE)


def without_masses(c: Circumstances) -> str:
    """What is missing where gravity moments are needed and the robot has no masses, or ""."""
    return "" if c.moments is not None else "the robot file gives no links (mass_kg, centre_of_mass_mm)"


def without_velocity(c: Circumstances) -> str:
    """What is missing where velocities are needed and the session has none, or ""."""
    return "" if c.velocity is not None else "no j1_degps ...: the session records no joint velocities"


def without_surface(c: Circumstances) -> str:
    """What is missing where a ball must touch a surface and none does, or ""."""
    return "" if np.any(c.touching) else "no target is a surface (plane, sphere, cylinder)"
