"""What the parameters of a fitted arm mean for a simulator, sorted by their drivers.

Elements and numbers of an MJCF file.

The law from readings to angles of the links: scales, couplings, periodic errors and lost motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import AXES
from bayescal.effects import named
from bayescal.effects.backlash import BACKLASH, STANDSTILL
from bayescal.effects.joints import READING, SIDES, side_of
from bayescal.effects.selection import Selection
from bayescal.effects.sessions import alone
from bayescal.effects.vocabulary import Circumstances, Parameter
from bayescal.exporting.geometry import number, numbers
from bayescal.fitted.arm import FittedArm

STATE = ("constant", "time", "temperature", "event")
"""Drivers that are constant while an arm moves: a file has their values in one row, its state."""
TOUCHED = ("contact speed", "contact direction", "face", "certificate")
"""Drivers of errors of the probe and the artefact: they move no link."""

UNHELD = ("late", "level", "uneven")
"""Forms of a dependence that no element of MuJoCo has: a memory of earlier rows, a curve of an angle,
a spring that differs between the signs of the torque."""


@dataclass(frozen=True)
class Content:
    """Parameters of an arm with their values, as they apply in one row of its session.

    A common factor of several parameters is resolved into these. Parameters of other sessions are left out.
    """

    arm: FittedArm
    row: int

    @cached_property
    def circumstances(self) -> Circumstances:
        """The circumstances of the session's fitted measurements."""
        scene = self.arm.model.scene
        c = scene.circumstances(scene.rows("calibrate"))
        own = next((s for s in c.sessions if s.rows[self.row]), None)
        return c if own is None else alone(c, own)

    @cached_property
    def valued(self) -> tuple[tuple[Parameter, float], ...]:
        """Parameters and their deviations from nominal, SI."""
        out: list[tuple[Parameter, float]] = []
        for p, value in zip(self.arm.model.parameters, self.arm.values.tolist(), strict=True):
            if self._applies(p):
                out += [(own, value * own.centre) for own in p.stands_for] or [(p, value)]
        return tuple(out)

    def _applies(self, p: Parameter) -> bool:
        sessions = self.arm.model.scene.dataset.sessions
        rows = self.arm.model.scene.circumstances(np.zeros(0, int)).sessions if sessions else ()
        other = [s.name for s in rows if not s.rows[self.row]]
        return not any(p.name.startswith(f"{name}:") for name in other)

    def driven(self, *kinds: str) -> Iterator[tuple[Parameter, float]]:
        """Parameters with a driver of some kinds, and their values; none of a form in `UNHELD`."""
        own = ((p, value) for p, value in self.valued if p.driver.form not in UNHELD)
        return ((p, value) for p, value in own if p.driver.kind in kinds)

    def constants(self, row: int | None = None) -> np.ndarray:
        """Constant displacements of the frames, (n + 2, 6), rad and m, in a row; default: the state."""
        at = self.row if row is None else row
        out = np.zeros((self.arm.model.scene.chain.n + 2, 6))
        for p, value in self.driven(*STATE):
            for term in p.terms:
                if term.frame >= 0:
                    driver = np.asarray(term.driver)
                    out[term.frame, AXES.index(term.axis)] += value * float(
                        driver[at] if driver.ndim else driver
                    )
        return out


DEFAULT = "bayescal"
"""Class of all added elements."""


def place(pose: np.ndarray) -> dict[str, str]:
    """Attributes `pos` and `quat` of a pose (4, 4)."""
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return {"pos": numbers(pose[:3, 3]), "quat": numbers((w, x, y, z))}


def add(parent: ET.Element, tag: str, **attributes: str | float | Iterable[float]) -> ET.Element:
    """Append an element; numbers are written with all their digits."""
    return ET.SubElement(parent, tag, {k: _text(v) for k, v in attributes.items()})


def _text(value: str | float | Iterable[float]) -> str:
    if isinstance(value, str):
        return value
    return number(value) if isinstance(value, float | int) else numbers(value)


def document(root: ET.Element) -> str:
    """The text of a file."""
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


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
    found: dict[tuple[int, float], dict[str, float]] = {}
    for p, value in content.driven("angle"):
        if p.driver.order:
            found.setdefault((p.site.number - 1, p.driver.order), {})[_part(p)] = value
    return tuple(
        Wave(joint, order, parts.get("sin", 0.0), parts.get("cos", 0.0))
        for (joint, order), parts in found.items()
        if any(parts.values())
    )


def _part(p: Parameter) -> str:
    return p.name.rpartition(" ")[2]
