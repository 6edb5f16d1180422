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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.effects import named
from bayescal.effects.backlash import BACKLASH, STANDSTILL
from bayescal.effects.common import READING, SIDES, side_of
from bayescal.effects.selection import Selection
from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.elastic import Content
from bayescal.exporting.xml_text import add

DEFAULT = "bayescal"
"""Class of all added elements."""
STIFF, DAMPED = 1e10, 1e6
"""Stiffness, N m/rad, and damping, N m s/rad, of servos and tendons: under 100 N m they yield by 1e-8 rad."""
FRICTION = 30.0
"""Least friction, N m, that holds a link within its lost motion; twice the largest torque otherwise."""
TIGHT = {"class": DEFAULT, "solref": ".004 1", "solimp": ".999 .999 .001 .5 2"}
"""Equalities of a yoke; they carry no load."""
AWAY = (0.0, 0.0, -3.0)
"""Place of cranks and slides, m."""


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
        speed = velocity @ self.nominal.T @ self.geared.T
        return speed / np.hypot(speed, STANDSTILL)

    def lag(self, sense: np.ndarray) -> np.ndarray:
        """Angles (C, n) of links by the lost motion, rad, for the places (C, n) of gears in it."""
        return -(self.lost * sense) @ np.linalg.inv(self.geared).T


def law_of(content: Content) -> Law:
    """The law of an arm."""
    robot = content.arm.model.scene.dataset.robot
    lost = np.zeros(robot.n)
    for p, value in content.driven("direction"):
        lost[p.site.number - 1] -= value
    return Law(
        robot.link_from_reading,
        robot.link_from_reading + _linear(content),
        robot.offset,
        _waves(content),
        lost,
        np.linalg.inv(robot.link_from_reading) if _side(content) == READING else np.eye(robot.n),
    )


def bare(law: Law) -> Law:
    """The law without errors."""
    return replace(law, exact=law.nominal, waves=(), lost=0.0 * law.lost)


def _side(content: Content) -> str:
    asked = [s.setting for s in map(Selection.read, content.arm.effects) if s.effect == BACKLASH.name]
    return asked[0] if asked and asked[0] in SIDES else side_of(content.arm.model.scene.dataset.robot)


def _linear(content: Content) -> np.ndarray:
    """Additional rotation (n, n) of the links by a radian of each reading."""
    n = content.arm.model.scene.chain.n
    values = {p.name: value for p, value in content.driven("angle") if not p.driver.order}
    unit = replace(content.circumstances, readings=np.eye(n), q=np.zeros((n, n)))
    out = np.zeros((n, n))
    for name in content.arm.effects if values else ():
        effect, setting = named(name)
        if not any(p.effect == effect.name and p.name in values for p in content.arm.model.parameters):
            continue
        for p in effect.at(unit, setting):
            for term in p.terms if p.name in values else ():
                out[term.frame - 1] += values[p.name] * np.broadcast_to(np.asarray(term.driver, float), (n,))
    return out


def _waves(content: Content) -> tuple[Wave, ...]:
    amplitudes: dict[tuple[int, float], dict[str, float]] = {}
    for p, value in content.driven("angle"):
        if p.driver.order:
            amplitudes.setdefault((p.site.number - 1, p.driver.order), {})[p.name.rpartition(" ")[2]] = value
    return tuple(
        Wave(joint, order, parts.get("sin", 0.0), parts.get("cos", 0.0))
        for (joint, order), parts in amplitudes.items()
        if any(parts.values())
    )


Linear = Mapping[str, float]
"""Coefficients by joint: a fixed tendon."""


@dataclass(frozen=True)
class Joints:
    """Joints of a file: names, and senses (n,) of rotation, +1 or -1, relative to the arm's model."""

    names: Sequence[str]
    signs: np.ndarray

    @classmethod
    def of(cls, names: Sequence[str]) -> Joints:
        """Joints of a new file."""
        return cls(names, np.ones(len(names)))


def section(root: ET.Element, tag: str) -> ET.Element:
    """A section of an MJCF file, which is made where the file has none."""
    old = root.find(tag)
    return ET.SubElement(root, tag) if old is None else old


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


def parts(root: ET.Element, law: Law, joints: Joints, torques: np.ndarray) -> None:
    """Append tendons and yokes that hold the hinges of the errors.

    Parameters
    ----------
    root : ET.Element
        Of an MJCF file.
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
    wrong = erring(law)
    for w in law.waves:
        _yoke(root, joints, w, float(law.offset[w.joint]))
    for k, (row, half) in enumerate(zip(law.geared, law.lost, strict=True)):
        turned: dict[str, float] = {}
        for j in np.flatnonzero(row * wrong):
            for name, share in held(law, joints, int(j)).items():
                turned[name] = turned.get(name, 0.0) + float(row[j]) * share
        if not turned:
            continue
        slack = [-half, half]
        name = joints.names[k]
        _tendon(root, f"{name}_gear", turned, springlength=slack, stiffness=STIFF)
        if half > 0:
            gear: dict[str, float] = {}
            for i in np.flatnonzero(row).tolist():  # the angle of a link: its joint, and its error
                gear[joints.names[i]] = float(row[i] * joints.signs[i])
                if wrong[i]:
                    gear[error(joints.names[i])] = float(row[i])
            limit = max(FRICTION, 2.0 * float(np.max(torques)))
            _tendon(
                root, f"{name}_friction", gear, springlength=[0.0, 0.0], stiffness=STIFF,
                springyield=limit / STIFF,
            )  # fmt: skip


def held(law: Law, joints: Joints, j: int) -> Linear:
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
        moved = {
            "crank": now - before,
            "cos": np.cos(now) - np.cos(before),
            "sin": np.sin(now) - np.sin(before),
        }
        out |= {f"{name}_{part}": float(value) for part, value in moved.items()}
    return out


def servos(root: ET.Element, law: Law, joints: Sequence[str]) -> None:
    """Append a stiff servo and a sensor for each reading; a servo's command is the reading, rad."""
    tendon, actuator, sensor = (section(root, tag) for tag in ("tendon", "actuator", "sensor"))
    inverse = np.linalg.inv(law.nominal)
    for i, name in enumerate(joints):
        if np.array_equal(inverse[i], np.eye(len(joints))[i]):
            add(actuator, "position", name=name, joint=name, kp=STIFF, kv=DAMPED)
            add(sensor, "jointpos", name=name, joint=name)
            continue
        fixed = add(tendon, "fixed", name=f"{name}_reading")
        for j in np.flatnonzero(inverse[i]):
            add(fixed, "joint", joint=joints[int(j)], coef=inverse[i, j])
        add(actuator, "position", name=name, tendon=f"{name}_reading", kp=STIFF, kv=DAMPED)
        add(sensor, "tendonpos", name=name, tendon=f"{name}_reading")


def _tendon(root: ET.Element, name: str, parts: Linear, **attributes: object) -> None:
    fixed = add(section(root, "tendon"), "fixed", **{"class": DEFAULT}, name=name, **attributes)  # type: ignore[arg-type]
    for joint, coefficient in parts.items():
        if coefficient:
            add(fixed, "joint", joint=joint, coef=coefficient)


def _body(root: ET.Element, name: str) -> ET.Element:
    """A body beside the arm, without weight."""
    body = add(section(root, "worldbody"), "body", name=name, pos=AWAY, gravcomp="1", childclass=DEFAULT)
    add(body, "inertial", pos=[0.0, 0.0, 0.0], mass=1.0, diaginertia=[1.0, 1.0, 1.0])
    return body


def _yoke(root: ET.Element, joints: Joints, wave: Wave, offset: float) -> None:
    joint = joints.names[wave.joint]
    name, phase = yoke(joint, wave), wave.order * offset
    pin = np.array([np.cos(phase), np.sin(phase), 0.0])
    add(_body(root, f"{name}_crank"), "joint", name=f"{name}_crank", axis=[0.0, 0.0, 1.0])
    equality = section(root, "equality")
    slides = _body(root, f"{name}_slides")
    add(slides, "joint", name=f"{name}_cos", type="slide", axis=[1.0, 0.0, 0.0])
    add(slides, "joint", name=f"{name}_sin", type="slide", axis=[0.0, 1.0, 0.0])
    add(equality, "connect", name=name, body1=f"{name}_crank", body2=f"{name}_slides", anchor=pin, **TIGHT)
    geared = [0.0, wave.order * float(joints.signs[wave.joint]), 0.0, 0.0, 0.0]
    add(
        equality,
        "joint",
        name=f"{name}_crank",
        joint1=f"{name}_crank",
        joint2=joint,
        polycoef=geared,
        **TIGHT,
    )
