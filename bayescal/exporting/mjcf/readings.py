"""The law from readings to angles of the links, and its errors as parts of a machine.

Any controller that commands the joints sees the errors: scales, couplings, periodic errors and lost motion.

Behind a joint, which turns by the nominal angle of its link, stands a hinge for its error. A stiff tendon
holds the hinge at what the readings give:

- Scales and couplings are coefficients of the tendon.
- A periodic error is the motion of a Scotch yoke: a crank that turns `order` times as far as the joint moves
  two slides by its cosine and its sine, and these are coefficients of the tendon.
- Lost motion is a dead band of the tendon. Friction holds the link, so that it lags: a spring to the ground
  that yields at the friction torque (an ideal elasto-plastic one, so that the link does not creep under its
  load).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bayescal.effects.common import READING, sense
from bayescal.effects.lost_motion import BACKLASH
from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.elastic import Content
from bayescal.exporting.robot import side_in

STIFF, DAMPED = 1e10, 1e6
"""Stiffness, N m/rad, and damping, N m s/rad, of servos and tendons: under 100 N m they yield by 1e-8 rad."""
FRICTION = 30.0
"""Least friction, N m, that holds a link within its lost motion; twice the largest torque otherwise."""


@dataclass(frozen=True)
class Wave:
    """A periodic error of a joint, rad: sine and cosine of `order` times its nominal angle."""

    joint: int  # from 0
    order: float
    sine: float
    cosine: float


@dataclass(frozen=True)
class Law:
    """Angles of links from readings r: ``exact r + waves(nominal r + offset) - lost sign(motion)``.

    Parameters
    ----------
    nominal : np.ndarray, shape (n, n)
        Links from readings of the robot file.
    exact : np.ndarray, shape (n, n)
        The same with fitted scales and couplings.
    offset : np.ndarray, shape (n,)
        rad, nominal.
    waves : tuple of Wave
    lost : np.ndarray, shape (n,)
        Half-widths of the lost motion, rad; a negative one is a lead.
    geared : np.ndarray, shape (n, n)
        Angles at the gears, where motion is lost, from those of the links.
    """

    nominal: np.ndarray
    exact: np.ndarray
    offset: np.ndarray
    waves: tuple[Wave, ...]
    lost: np.ndarray
    geared: np.ndarray

    def turned(self, readings: np.ndarray) -> np.ndarray:
        """Angles (N, n) of links, without offsets and lost motion, at readings (N, n), rad."""
        out = readings @ self.exact.T
        angles = readings @ self.nominal.T + self.offset
        for w in self.waves:
            phase = w.order * angles[:, w.joint]
            out[:, w.joint] += w.sine * np.sin(phase) + w.cosine * np.cos(phase)
        return out

    def sense(self, velocity: np.ndarray) -> np.ndarray:
        """Places (C, n) of gears in their lost motion, -1 to 1, after a velocity (C, n) of readings, rad/s.

        Below `STANDSTILL` a gear rests within its lost motion, as in the model.
        """
        return sense(velocity @ self.nominal.T @ self.geared.T)

    def lag(self, sense: np.ndarray) -> np.ndarray:
        """Angles (C, n) of links by the lost motion, rad, for the places (C, n) of gears in it."""
        return -(self.lost * sense) @ np.linalg.inv(self.geared).T


def law_of(content: Content) -> Law:
    """The law of an arm."""
    robot, side = content.arm.model.scene.dataset.robot, side_in(content.arm.model, BACKLASH.name)
    lost = np.zeros(robot.n)
    for p, value in content.driven("direction"):
        lost[p.site.number - 1] -= value
    nominal = robot.link_from_reading
    geared = np.linalg.inv(nominal) if side == READING else np.eye(robot.n)
    return Law(nominal, nominal + _linear(content), robot.offset, _waves(content), lost, geared)


def bare(law: Law) -> Law:
    """The law without errors."""
    return replace(law, exact=law.nominal, waves=(), lost=0.0 * law.lost)


def _linear(content: Content) -> np.ndarray:
    """Additional motion (n, n) of the links by a unit of each reading, rad and m."""
    n = content.arm.model.scene.chain.n
    values = {p.name: value for p, value in content.driven("angle", "position") if not p.driver.order}
    unit = replace(content.circumstances, readings=np.eye(n), q=np.zeros((n, n)))
    out = np.zeros((n, n))
    effects = {p.effect for p in content.arm.model.parameters if p.name in values}
    for p in content.at(unit, effects):
        for term in p.terms if p.name in values else ():
            out[term.frame - 1] += values[p.name] * np.broadcast_to(np.asarray(term.driver, float), (n,))
    return out


def _waves(content: Content) -> tuple[Wave, ...]:
    amplitudes: dict[tuple[int, float], dict[str, float]] = {}
    for p, value in content.driven("angle"):
        if p.driver.order:
            amplitudes.setdefault((p.site.number - 1, p.driver.order), {})[p.name.rpartition(" ")[2]] = value
    waves = (Wave(*place, of.get("sin", 0.0), of.get("cos", 0.0)) for place, of in amplitudes.items())
    return tuple(wave for wave in waves if wave.sine or wave.cosine)


@dataclass(frozen=True)
class Joints:
    """Joints of a file: names, and senses (n,) of rotation, +1 or -1, relative to the arm's model.

    `references` (n,), rad, are their values as the file is written; it states angles in deg if `degree`.
    """

    names: Sequence[str]
    signs: np.ndarray
    references: np.ndarray = field(default_factory=lambda: np.zeros(1))
    degree: bool = False

    @classmethod
    def of(cls, names: Sequence[str]) -> Joints:
        """Joints of a new file."""
        return cls(names, np.ones(len(names)))


def error(name: str) -> str:
    """Name of the hinge for the error of a joint."""
    return f"{name}_error"


def yoke(name: str, wave: Wave) -> str:
    """Name of the yoke of a periodic error of a joint."""
    return f"{name}_wave_{wave.order:g}"


def erring(law: Law) -> np.ndarray:
    """Which links (n,) have an error of the readings."""
    out = np.any(law.exact != law.nominal, axis=1)
    for w in law.waves:
        out[w.joint] = True
    return out | np.any(np.linalg.inv(law.geared)[:, law.lost != 0] != 0, axis=1)


def parts(law: Law, joints: Joints, torques: np.ndarray) -> dict[str, list[dict[str, Any]]]:
    """Tendons and yokes that hold the hinges of the errors, as fields of the template.

    Parameters
    ----------
    law : Law
    joints : Joints
        Of the links; they turn by the nominal angles.
    torques : np.ndarray, shape (n,)
        Largest torque on each link, N m.

    Raises
    ------
    BayescalError
        If a fitted lost motion leads.
    """
    for k in np.flatnonzero(law.lost < 0).tolist():
        what = f"the fitted backlash of {joints.names[k]} leads by {-1e3 * law.lost[k]:.2g} mrad"
        remedy = "no gear does; say --readings script, which holds it, or leave it out"
        raise BayescalError(what, "--readings plain", remedy)
    wrong, tendons = erring(law), list[dict[str, Any]]()
    for name, row, half in zip(joints.names, law.geared, law.lost, strict=True):
        turned = Counter[str]()
        for j in np.flatnonzero(row * wrong).tolist():
            for joint, share in _held(law, joints, j).items():
                turned[joint] += row[j] * share
        if not turned:
            continue
        slack = {"slack": (-half, half), "stiffness": STIFF, "springyield": 0.0}
        tendons.append(slack | {"name": f"{name}_gear", "of": {j: c for j, c in turned.items() if c}})
        if half > 0:
            gear: dict[str, float] = {}
            for i in np.flatnonzero(row).tolist():  # the angle of a link: its joint, and its error
                gear[joints.names[i]] = row[i] * joints.signs[i]
                if wrong[i]:
                    gear[error(joints.names[i])] = row[i]
            most = max(FRICTION, 2.0 * float(np.max(torques))) / STIFF
            friction = {"name": f"{name}_friction", "of": gear, "slack": (0, 0), "springyield": most}
            tendons.append(slack | friction)
    return {"tendons": tendons, "yokes": [_yoke(law, joints, w) for w in law.waves]}


def _yoke(law: Law, joints: Joints, w: Wave) -> dict[str, Any]:
    """Crank and slides of a wave: their values are zero where the joint's is, not where the file has it."""
    name, ratio, zero = joints.names[w.joint], w.order * joints.signs[w.joint], w.order * law.offset[w.joint]
    turn = ratio * np.broadcast_to(joints.references, len(joints.names))[w.joint]
    before, here = (np.array([np.cos(phase), np.sin(phase), 0.0]) for phase in (zero, zero + turn))
    references = np.degrees(turn) if joints.degree else turn, *(here - before)[:2]
    return {"name": yoke(name, w), "joint": name, "pin": here, "ratio": ratio, "references": references}


def _held(law: Law, joints: Joints, j: int) -> dict[str, float]:
    """Error of a link minus its lawful value without lost motion: zero, as coefficients of the joints."""
    extra = (law.exact - law.nominal) @ np.linalg.inv(law.nominal)
    joint = joints.names[j]
    out = {error(joint): 1.0}
    out |= {name: -float(c) for name, c in zip(joints.names, extra[j] * joints.signs, strict=True) if c}
    for w in law.waves:
        if w.joint == j:
            out |= {f"{yoke(joint, w)}_sin": -w.sine, f"{yoke(joint, w)}_cos": -w.cosine}
    return out


def posture(law: Law, joints: Joints, readings: np.ndarray) -> Mapping[str, float]:
    """Positions of all joints at readings (n,), rad, without load, in the middle of any lost motion."""
    angles = law.nominal @ readings
    errors = law.turned(np.vstack([readings, 0.0 * readings])) - np.vstack([angles, 0.0 * angles])
    out = dict(zip(joints.names, (joints.signs * angles).tolist(), strict=True))
    for j in np.flatnonzero(erring(law)).tolist():
        out[error(joints.names[j])] = float(errors[0, j] - errors[1, j])
    for w in law.waves:
        before, now = w.order * law.offset[w.joint], w.order * (law.offset + angles)[w.joint]
        name = yoke(joints.names[w.joint], w)
        out[f"{name}_crank"] = float(now - before)
        for part, of in (("cos", np.cos), ("sin", np.sin)):
            out[f"{name}_{part}"] = float(of(now) - of(before))
    return out


def shown(law: Law, joints: Sequence[str]) -> dict[str, dict[str, float]]:
    """Each reading as a sum of the joints, by their coefficients."""
    inverse = np.linalg.inv(law.nominal).tolist()
    sums = (dict(zip(joints, row, strict=True)) for row in inverse)
    return {name: {j: c for j, c in of.items() if c} for name, of in zip(joints, sums, strict=True)}
