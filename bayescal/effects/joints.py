"""What several effects share: where a reading acts, which angles turn with a joint, which torques count."""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.vocabulary import Circumstances, Parameter, Where

TURNS = {1.0: "once a turn", 2.0: "twice a turn"}
NO_TORQUE = 1e-6  # N m: a joint that never carries more tells nothing of what torque does to it


def moved(c: Circumstances, joint: int, driver: np.ndarray) -> tuple[Term, ...]:
    """An error of the reading of `joint` (from 1), rad, times the driver: turns of all links it moves."""
    column = c.robot.link_from_reading[:, joint - 1]
    return tuple(Term(i, "rz", share * driver) for i, share in enumerate(column, start=1) if share)


def waves(c: Circumstances, effect: str, joint: int, order: float, sd: float) -> list[Parameter]:
    """Sine and cosine of `order` times the link-relative angle of `joint` (from 1), each turning it.

    `sd` is the prior standard deviation of each, rad.
    """
    angle = order * c.q[:, joint - 1]
    name = f"{effect} {c.robot.joint_names[joint - 1]}"
    turns = TURNS.get(order, f"{order:g} times a turn")
    return [
        Parameter(
            f"{name} {wave}", "rad", (Term(joint, "rz", driver),), sd, **at(joint, f"angle {joint}, {turns}")
        )
        for wave, driver in (("sin", np.sin(angle)), ("cos", np.cos(angle)))
    ]


def at(joint: int, driver: str) -> Where:
    """Site and driver, in words, of a parameter that acts at a joint (from 1)."""
    return {"site": f"joint {joint}", "driver": driver}


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
