"""Location (site), dependence (driver) and size of an error: types, their text, and coordinates.

Files contain the `str` of a site or driver, which the output contract defines. Reports contain its `text`.
Only `--without` parses the `str` (`Site.read`). An amplitude is a number with a name, of one parameter or
more.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bayescal.effects.vocabulary import Circumstances

NUMBERED = ("joint", "link")
"""Kinds of site that have a number, from 1."""
PLAIN = ("base", "tool", "probe", "arm", "artefact", "camera", "board")
"""Kinds of site without a number."""


@dataclass(frozen=True)
class Site:
    """Where an error acts: a kind of `PLAIN`, a kind of `NUMBERED` with its number, or a named face.

    A kind of `PLAIN` with a name is that of one of several sessions: ``base of B``.
    """

    kind: str
    number: int = 0
    name: str = ""

    def __str__(self) -> str:
        if self.name:
            return f"{self.kind} of {self.name}" if self.kind in PLAIN else self.name
        return f"{self.kind} {self.number}" if self.number else self.kind

    @property
    def text(self) -> str:
        """Its name in a sentence: ``joint 4``, ``the base``."""
        return f"the {self}" if self.kind in PLAIN else str(self)

    @property
    def anywhere(self) -> Site:
        """The same site without regard to the session."""
        return Site(self.kind) if self.kind in PLAIN else self

    @property
    def of_arm(self) -> bool:
        """Whether it is on the arm or its base, not on tool, camera, probe or target."""
        return bool(self.number) or self.anywhere in (BASE, ARM)

    @property
    def also(self) -> tuple[Site, ...]:
        """Sites that include it: a joint includes its link."""
        return (joint(self.number), self) if self.kind == "link" else (self,)

    def of(self, session: str) -> Site:
        """The same site in one of several sessions; blanks and commas separate other parts of a name."""
        return replace(self, name=re.sub(r"[\s,]+", "-", session))

    @classmethod
    def read(cls, words: str) -> Site:
        """The site that a user names: ``joint 4``, ``base``, or else a face."""
        if match := re.fullmatch(rf"({'|'.join(NUMBERED)}) (\d+)", words):
            return cls(match[1], int(match[2]))
        if match := re.fullmatch(rf"({'|'.join(PLAIN)})(?: of (\S+))?", words):
            return cls(match[1], name=match[2] or "")
        return face(words)


BASE, TOOL, PROBE, ARM, ARTEFACT, CAMERA, BOARD = (Site(kind) for kind in PLAIN)
PLACEMENT = "placement"
"""Effect of a parameter that places targets: a displacement of the base in form, by which no arm moves."""


def joint(number: int) -> Site:
    """A joint, from 1."""
    return Site("joint", number)


def link(number: int) -> Site:
    """The link that a joint (from 1) moves."""
    return Site("link", number)


def face(name: str) -> Site:
    """A face, by the name of its target."""
    return Site("face", name=name)


def words_of(sites: tuple[Site, ...]) -> str:
    """Several sites in words: ``joint 4 and link 3``; "" for none."""
    return " and ".join(map(str, sites))


@dataclass(frozen=True)
class Coordinate:
    """The quantity of a driver, one value per row (N,); without a name and unit, the number of the row."""

    name: str
    unit: str
    values: np.ndarray

    @property
    def label(self) -> str:
        """Name with unit, or ""."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


FORMS = {
    "": ("{}", "{}"),
    "sign": ("sign of {}", "sign of the {}"),
    "past": ("past {}", "earlier {}"),
    "level": ("{}, levelling off", "{}, levelling off"),
    "uneven": ("{}, by its sign", "{}, another at each sign"),
    "late": ("{}, late", "{}, followed late"),
    "one place": ("{}, one place", "{}, local"),
    "jump": ("{}, jump", "{}, one value below a threshold and another above it"),
    "beyond": ("{}, beyond one place", "{} beyond a threshold"),
    "heights": ("{}, height of each point", "height of each of its points"),
    "places": ("{}, place of each point", "place of each of its points"),
    "one spot": ("{}, one spot", "{}, local"),
    "one region": ("{}, one region", "{}, local"),
    "masses": ("{}, masses unknown", "{}, masses not stated"),
    "own angle": ("{}, by its angle", "{} times a function of its angle"),
    "other angle": ("{}, by another angle", "{} times a function of another angle"),
    "and angle": ("{}, and its angle", "{} and angle together"),
    "and another": ("{}, times another quantity", "{} times another quantity"),
    "in the image": ("{}, by place in the image", "{} times the place in the image"),
    "u": ("{}, along u", "{}, across the image"),
    "v": ("{}, along v", "{}, down the image"),
    "anew": ("{}, anew", "{}, at each image anew"),
    "repeats": ("{}, not smoothly", "{}, not smoothly"),
    "blocks": ("{}, anew in each block", "{}, another value in each block of them"),
    "smooth": ("{}, smoothly", "{}, a smooth function of it"),
    "waves": ("{}, 3 to 20 waves a turn", "{}, 3 to 20 periods per revolution"),
    "to and fro": ("{}, to and fro", "{}, oscillating"),
}
"""Forms of the dependence of an error on its coordinate; "" if the form is not specified.

Format strings for files and for reports, for the text of the coordinate.
"""


@dataclass(frozen=True)
class Driver:
    """The dependence of an error: a kind of `KINDS` (or a user's own), its joint if it has one, and a form.

    `order` is the number of periods per revolution of an angle, 0 if the error is not periodic.
    """

    kind: str
    joint: int = 0
    order: float = 0.0
    form: str = ""

    def __str__(self) -> str:
        plain = KINDS[self.kind].words if self.kind in KINDS else self.kind
        return self._formed(0, f"{plain} {self.joint}" if self.joint else plain, "a turn")

    @property
    def text(self) -> str:
        """Its name in a report: ``direction of motion of J3``."""
        plain = KINDS[self.kind].text if self.kind in KINDS else self.kind
        return self._formed(1, f"{plain} of J{self.joint}" if self.joint else plain, "per revolution")

    def _formed(self, place: int, coordinate: str, turn: str) -> str:
        """Its form and its order beside its coordinate, by their text at a place (0: files, 1: reports)."""
        every = {0.0: "", 1.0: f", once {turn}", 2.0: f", twice {turn}"}
        if self.kind == "position":
            every, turn = {0.0: ""}, "per metre"
        order = every.get(self.order, f", {self.order:g} times {turn}")
        return FORMS[self.form][place].format(coordinate) + order

    @property
    def course(self) -> Driver:
        """The driver of its coordinate, without order and form; a dependence on the past is not changed."""
        return self if self.form == "past" else replace(self, order=0.0, form="")

    def coordinate(self, site: Site, c: Circumstances) -> Coordinate:
        """Its coordinate at a site of a session; the number of the row if the session does not record it."""
        recorded = None
        if self.kind in KINDS and self.form != "past":
            recorded = KINDS[self.kind].coordinate(self, site, c)
        return recorded or Coordinate("", "", np.arange(1.0, len(c.q) + 1))


CONSTANT = Driver("constant")
FOLDED = 6.0
"""Periods per revolution, or per metre, beyond which an error is shown over its phase (assumed)."""

Found = Coordinate | None


@dataclass(frozen=True)
class Kind:
    """A kind of driver: its text in files and in reports, and its coordinate if a session records it."""

    words: str
    text: str
    coordinate: Callable[[Driver, Site, Circumstances], Found] = lambda driver, site, c: None


def _shown(joint: int, c: Circumstances, readings: np.ndarray) -> tuple[str, np.ndarray]:
    """Unit of a joint in reports, and its column (N,) of readings (N, n) in it."""
    return c.robot.units[joint - 1], c.robot.shown(readings)[:, joint - 1]


def _angle(d: Driver, site: Site, c: Circumstances) -> Found:
    """The reading, or a phase where there are too many periods for bins of the reading.

    It is that of an amplitude: by the reading; of coupled joints by their angle without its offset.
    """
    if d.order > FOLDED:
        row = c.robot.link_from_reading[d.joint - 1]
        angle = c.readings @ (row if np.count_nonzero(row) > 1 else np.abs(row))
        turns = angle * d.order * (1.0 if d.kind == "position" else 0.5 / np.pi)
        per = "metre" if d.kind == "position" else "revolution"
        name = f"phase of joint {d.joint}, {d.order:g} periods per {per}"
        return Coordinate(name, "deg", 360.0 * (turns % 1.0))
    return Coordinate(f"reading of joint {d.joint}", *_shown(d.joint, c, c.readings))


def _velocity(d: Driver, site: Site, c: Circumstances) -> Found:
    if c.velocity is None:
        return None
    unit, speed = _shown(d.joint, c, c.velocity)
    return Coordinate(f"speed of joint {d.joint}", f"{unit}/s", speed)


def _remaining(d: Driver, site: Site, c: Circumstances) -> Found:
    if c.command is None:
        return None
    return Coordinate(f"remaining motion of joint {d.joint}", *_shown(d.joint, c, c.command - c.readings))


def _torque(d: Driver, site: Site, c: Circumstances) -> Found:
    if c.torques is None or not d.joint:  # all joints together have no common torque
        return None
    name = "gravity torque" if c.measured_torques is None else "measured torque"
    slides = c.robot.slides[d.joint - 1]
    name, unit = (name.replace("torque", "force"), "N") if slides else (name, "N m")
    return Coordinate(f"{name} on joint {d.joint}", unit, c.torques[:, d.joint - 1])


def _base_moment(d: Driver, site: Site, c: Circumstances) -> Found:
    if c.moments is None:
        return None
    return Coordinate("gravity moment on the base", "N m", np.linalg.norm(c.moments[:, 0], axis=1))


def _time(d: Driver, site: Site, c: Circumstances) -> Found:
    if c.time is None:
        return Coordinate("row", "", np.arange(1.0, len(c.q) + 1))
    return Coordinate("time", "min", c.time / 60.0)


def _order(d: Driver, site: Site, c: Circumstances) -> Found:
    return Coordinate("row", "", np.arange(1.0, len(c.q) + 1))


def _temperature(d: Driver, site: Site, c: Circumstances) -> Found:
    return None if c.temperature is None else Coordinate("temperature", "degC", c.temperature)


def _load(d: Driver, site: Site, c: Circumstances) -> Found:
    return Coordinate("load on the flange", "kg", c.load_mass)


def _speed(d: Driver, site: Site, c: Circumstances) -> Found:
    return None if c.speed is None else Coordinate("speed of contact", "mm/s", 1e3 * c.speed)


def _direction(d: Driver, site: Site, c: Circumstances) -> Found:
    azimuth = np.degrees(np.arctan2(c.approach[:, 1], c.approach[:, 0]))
    return Coordinate("azimuth of contact in the flange", "deg", azimuth)


def _on_face(d: Driver, site: Site, c: Circumstances) -> Found:
    plane = next((f for f in c.faces if f.name == site.name), None)
    return None if plane is None else Coordinate("place along the face", "-1 to 1", plane.place[:, 0])


KINDS = {
    "constant": Kind("1", "constant"),
    "angle": Kind("angle", "angle", _angle),
    "position": Kind("position", "position", _angle),
    "torque": Kind("torque", "gravity torque", _torque),
    "direction": Kind("approach", "direction of motion", _velocity),
    "flank": Kind("flank", "tooth flank", _velocity),
    "joint speed": Kind("speed", "speed", _velocity),
    "remaining motion": Kind("remaining motion", "remaining motion", _remaining),
    "contact speed": Kind("speed", "speed of contact", _speed),
    "contact direction": Kind("direction of contact", "contact direction", _direction),
    "two angles": Kind("two angles", "angles of two joints"),
    "travel": Kind("travel", "earlier travel"),
    "reading": Kind("reading", "each new reading", _angle),
    "time": Kind("time", "time", _time),
    "temperature": Kind("temperature", "temperature", _temperature),
    "load": Kind("load", "load on the flange", _load),
    "event": Kind("moment", "row of the event", _time),
    "base moment": Kind("base moment", "gravity moment on the base", _base_moment),
    "bending moment": Kind("bending moment", "bending moment of the link"),
    "extended moment": Kind("bending moment, extended", "bending moment by the extension"),
    "count": Kind("count of contacts", "count of measurements", _order),
    "wait": Kind("wait before the contact", "time since the measurement before"),
    "pose": Kind("each pose anew", "each pose anew"),
    "activity": Kind("earlier motion", "earlier motion of the arm"),
    "gravity direction": Kind("gravity direction", "direction of gravity at the tool"),
    "face": Kind("place on the face", "position on the face", _on_face),
    "workspace": Kind("place in the workspace", "position in the workspace"),
    "beam": Kind("beam", "distance and direction from the instrument"),
    "mass": Kind("mass", "gravity of tool and payload"),
    "clock": Kind("clock", "speed of all joints"),
    "image": Kind("place in the image", "position in the image"),
    "board": Kind("place on the board", "position on the board"),
    "certificate": Kind("certificate", "certified value"),
}
"""Kinds of driver."""

Gradient = np.ndarray
Value = tuple[float, Gradient]


def micrometres(size: float) -> str:
    """A length, m, in print: in µm with two significant digits."""
    return f"{float(f'{1e6 * size:.2g}'):.9g} µm"


def itself(x: np.ndarray) -> Value:
    """A single parameter with its sign."""
    return float(x[0]), np.ones(1)


def magnitude(x: np.ndarray) -> Value:
    """A single parameter without its sign, which the effect defines."""
    return float(abs(x[0])), np.array([1.0 if x[0] >= 0 else -1.0])


def length(x: np.ndarray) -> Value:
    """Length of a vector; amplitude of a wave from its sine and cosine. At zero: of its first component."""
    size = float(np.linalg.norm(x))
    return size, x / size if size > 0 else np.eye(len(x))[0]


def phase(x: np.ndarray) -> Value:
    """Phase phi of a sin t + b cos t = A sin(t + phi), rad, from -pi to pi."""
    a, b = x
    return float(np.arctan2(b, a)), np.array([-b, a]) / max(float(a * a + b * b), np.finfo(float).tiny)


@dataclass(frozen=True)
class Size:
    """How parameters of one unit at one site, with one driver, read as an amplitude."""

    what: str  # "half-width"
    value: Callable[[np.ndarray], Value] = itself
    phase: Callable[[np.ndarray], Value] | None = None

    @property
    def joins(self) -> bool:
        """Whether it is one number for all of these parameters, not one for each."""
        return self.value is length


def propagated(
    of: Callable[[np.ndarray], Value], x: np.ndarray, covariance: np.ndarray
) -> tuple[float, float]:
    """A function of parameters and its standard uncertainty (GUM, first order).

    Parameters
    ----------
    of : callable
        Value and gradient (k,) at `x`.
    x : np.ndarray, shape (k,)
        Deviations from nominal, SI.
    covariance : np.ndarray, shape (k, k)
    """
    value, gradient = of(x)
    return value, float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))


def of_sign(what: str, value: float) -> tuple[str, float]:
    """An amplitude in words, and its value there: without a sign where words state it."""
    return (OPPOSITE[what], -value) if what in OPPOSITE and value < 0.0 else (what, value)


LATER, OLDER = "readings later than the measurement by", "readings older than the measurement by"
OPPOSITE = {LATER: OLDER}
"""Words of a negative amplitude, by those of a positive one: 'late' has two meanings."""
DEVIATION = Size("deviation")
WAVE = Size("amplitude", length, phase)
COMPLIANT = Size("compliance")
FACTOR = Size("factor on the usual values")
