"""Errors of the readings as parts of a machine: any controller that commands the joints sees them.

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
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.content import DEFAULT, Law, Wave, add

STIFF, DAMPED = 1e10, 1e6
"""Stiffness, N m/rad, and damping, N m s/rad, of servos and tendons: under 100 N m they yield by 1e-8 rad."""
FRICTION = 30.0
"""Least friction, N m, that holds a link within its lost motion; twice the largest torque otherwise."""
TIGHT = {"class": DEFAULT, "solref": ".004 1", "solimp": ".999 .999 .001 .5 2"}
"""Equalities of a yoke; they carry no load."""
AWAY = (0.0, 0.0, -3.0)
"""Place of cranks and slides, m."""

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


@dataclass(frozen=True)
class Sections:
    """Elements of an MJCF file that receive the parts."""

    world: ET.Element
    tendon: ET.Element
    equality: ET.Element


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


def parts(to: Sections, law: Law, joints: Joints, torques: np.ndarray) -> None:
    """Append tendons and yokes that hold the hinges of the errors.

    Parameters
    ----------
    to : Sections
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
        _yoke(to, joints, w, float(law.offset[w.joint]))
    for k, (row, half) in enumerate(zip(law.geared, law.lost, strict=True)):
        turned: dict[str, float] = {}
        for j in np.flatnonzero(row * wrong):
            for name, share in held(law, joints, int(j)).items():
                turned[name] = turned.get(name, 0.0) + float(row[j]) * share
        if not turned:
            continue
        slack = [-half, half]
        name = joints.names[k]
        _tendon(to, f"{name}_gear", turned, springlength=slack, stiffness=STIFF)
        if half > 0:
            gear: dict[str, float] = {}
            for i in np.flatnonzero(row).tolist():  # the angle of a link: its joint, and its error
                gear[joints.names[i]] = float(row[i] * joints.signs[i])
                if wrong[i]:
                    gear[error(joints.names[i])] = float(row[i])
            limit = max(FRICTION, 2.0 * float(np.max(torques)))
            _tendon(
                to, f"{name}_friction", gear, springlength=[0.0, 0.0], stiffness=STIFF,
                springyield=limit / STIFF,
            )  # fmt: skip


def held(law: Law, joints: Joints, j: int) -> Linear:
    """Error of a link minus its lawful value without lost motion: zero, as coefficients of the joints."""
    extra = (law.exact - law.nominal) @ np.linalg.inv(law.nominal)
    own = joints.names[j]
    out = {error(own): 1.0}
    out |= {name: -float(c) for name, c in zip(joints.names, extra[j] * joints.signs, strict=True) if c}
    for w in law.waves:
        if w.joint == j:
            out |= {f"{yoke(own, w)}_sin": -w.sine, f"{yoke(own, w)}_cos": -w.cosine}
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


def servos(
    actuator: ET.Element, sensor: ET.Element, tendon: ET.Element, law: Law, joints: Sequence[str]
) -> None:
    """Append a stiff servo and a sensor for each reading; a servo's command is the reading, rad."""
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


def _tendon(to: Sections, name: str, parts: Linear, **attributes: object) -> None:
    fixed = add(to.tendon, "fixed", **{"class": DEFAULT}, name=name, **attributes)  # type: ignore[arg-type]
    for joint, coefficient in parts.items():
        if coefficient:
            add(fixed, "joint", joint=joint, coef=coefficient)


def _body(to: Sections, name: str) -> ET.Element:
    """A body beside the arm, without weight."""
    own = add(to.world, "body", name=name, pos=AWAY, gravcomp="1", childclass=DEFAULT)
    add(own, "inertial", pos=[0.0, 0.0, 0.0], mass=1.0, diaginertia=[1.0, 1.0, 1.0])
    return own


def _yoke(to: Sections, joints: Joints, wave: Wave, offset: float) -> None:
    joint = joints.names[wave.joint]
    name, phase = yoke(joint, wave), wave.order * offset
    pin = np.array([np.cos(phase), np.sin(phase), 0.0])
    add(_body(to, f"{name}_crank"), "joint", name=f"{name}_crank", axis=[0.0, 0.0, 1.0])
    slides = _body(to, f"{name}_slides")
    add(slides, "joint", name=f"{name}_cos", type="slide", axis=[1.0, 0.0, 0.0])
    add(slides, "joint", name=f"{name}_sin", type="slide", axis=[0.0, 1.0, 0.0])
    add(to.equality, "connect", name=name, body1=f"{name}_crank", body2=f"{name}_slides", anchor=pin, **TIGHT)
    geared = [0.0, wave.order * float(joints.signs[wave.joint]), 0.0, 0.0, 0.0]
    add(
        to.equality,
        "joint",
        name=f"{name}_crank",
        joint1=f"{name}_crank",
        joint2=joint,
        polycoef=geared,
        **TIGHT,
    )
