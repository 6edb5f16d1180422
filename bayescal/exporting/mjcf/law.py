"""The law from readings to angles of the links: scales, couplings, periodic errors and lost motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.effects import named
from bayescal.effects.backlash import BACKLASH, STANDSTILL
from bayescal.effects.joints import READING, SIDES, side_of
from bayescal.effects.selection import Selection
from bayescal.effects.vocabulary import Parameter
from bayescal.exporting.mjcf.content import Content


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
