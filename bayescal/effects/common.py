"""Functions that several effects share: joints and their sides, successive rows, sessions, the base."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.polynomial.legendre import legvander

from bayescal.arm.chain import Robot
from bayescal.arm.motion import Term
from bayescal.effects import location
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Form, Parameter, Session, Where

NO_TORQUE = 1e-6  # N m, N: smaller torques of a joint do not identify a torque-driven effect
FALL = 2.0
"""Exponent by which its amplitudes fall with the order (assumed: a beam whose curvature is random)."""
ORDERS = 16
"""Highest order of an error by the position of a carriage: waves of a quarter of a metre on a rail of 3 m."""


LINK, READING = "link", "reading"
"""Sides of coupled axes on which an encoder and a gear may be: between two links, or at the displayed axis.

On the link side an error turns only the joint's own link, and its driver is the motion between the two links.
On the reading side it turns all links that the reading moves, and its driver is the reading.
"""


STANDSTILL = np.radians(0.03)
"""rad/s, m/s: below it, a joint may rest anywhere within its lost motion, and has no direction of motion."""


def sense(speed: np.ndarray) -> np.ndarray:
    """Directions of motion, -1 to 1, of joints with speeds of any shape, rad/s; near 0 at standstill."""
    return speed / np.hypot(speed, STANDSTILL)


def side_of(robot: Robot) -> str:
    """The side of encoders and gears in the robot file; without coupled axes both sides are equal."""
    return LINK if robot.coupling == "display" else READING


def motion(robot: Robot, joint: int, readings: np.ndarray, side: str) -> np.ndarray:
    """Motion at the encoder and the gear of `joint` (from 1), (N,), from readings or their rates (N, n)."""
    return readings[:, joint - 1] if side == READING else readings @ robot.link_from_reading[joint - 1]


def turned(robot: Robot, joint: int, driver: np.ndarray, side: str) -> tuple[Term, ...]:
    """Rotations by an error of the encoder or gear of `joint` (from 1), rad in its own sense of rotation.

    Of a prismatic joint shifts, m.
    """
    if side == LINK:
        return (Term(joint, robot.axes[joint - 1], driver),)
    column = zip(robot.axes, robot.link_from_reading[:, joint - 1], strict=True)
    return tuple(Term(i, axis, share * driver) for i, (axis, share) in enumerate(column, start=1) if share)


def added_load(c: Circumstances) -> np.ndarray:
    """Load (N,), kg, beyond the least with the same tool."""
    least = np.full(int(np.max(c.tool)) + 1, np.inf)
    np.minimum.at(least, c.tool, c.load_mass)
    return np.asarray(c.load_mass - least[c.tool])


def by_reading(robot: Robot, joint: int, order: float = 0.0, form: str = "") -> Driver:
    """The driver of an error by the angle of `joint` (from 1), or by the position of a prismatic one."""
    return Driver("position" if robot.slides[joint - 1] else "angle", joint, order, form)


SIDES = {LINK: "by the motion between its links", READING: "by the readings shown"}


def sides(make: Callable[..., list[Parameter]]) -> tuple[Form, ...]:
    """Forms of an effect of encoders or gears: one for each side, made by `make(c, side)`."""
    return tuple(Form(side, words, partial(make, side=side)) for side, words in SIDES.items())


def waves(
    c: Circumstances, label: str, orders: np.ndarray, sd: float, along: float | None = None
) -> list[Parameter]:
    """Sine and cosine of multiples of the link-relative angle of each joint, as errors of that angle.

    `orders` (n, K) or (1, K) are the multiples, with which `label` is formatted; `sd` is the prior standard
    deviation of each, rad. Of a prismatic joint they are waves per metre, with the standard deviation
    `along`, m; without it, it has none.
    """
    names, slides = c.robot.joint_names, c.robot.slides.tolist()
    of_joint = np.broadcast_to(orders, (len(names), np.shape(orders)[1])).tolist()
    return [
        Parameter(
            f"{label.format(order)} {name} {wave}", unit,
            (Term(j, c.robot.axes[j - 1], shape(per * order * c.q[:, j - 1])),), u,
            **site_and_driver(j, by_reading(c.robot, j, order)),
        )
        for j, (name, every) in enumerate(zip(names, of_joint, strict=True), start=1)
        for unit, per, u in (("m", 2.0 * np.pi, along) if slides[j - 1] else ("rad", 1.0, sd),)
        if u is not None
        for order in every
        for wave, shape in (("sin", np.sin), ("cos", np.cos))
    ]  # fmt: skip


def site_and_driver(joint: int, driver: Driver) -> Where:
    """Site and driver of a parameter that acts at a joint (from 1)."""
    return {"site": location.joint(joint), "driver": driver}


def at_gears(
    c: Circumstances,
    effect: str,
    moving: np.ndarray,
    side: str,
    prior: tuple[str, float],
    kind: str,
    shape: Callable[[np.ndarray], np.ndarray] = lambda by: by,
    along: tuple[str, float] | None = None,
) -> list[Parameter]:
    """Parameters of every joint that moves: errors of its encoder or gear, by its motion there.

    Parameters
    ----------
    c : Circumstances
    effect : str
    moving : np.ndarray, shape (N, n)
        Readings of the joints, or their rates.
    side : str
    prior : (str, float)
        SI unit and standard deviation.
    kind : str
        Of the driver.
    shape : callable
        The driver (N,) as a function of the motion (N,).
    along : (str, float), optional
        `prior` of prismatic joints, if another.
    """
    out = []
    for j, name in enumerate(c.robot.joint_names, start=1):
        by = motion(c.robot, j, moving, side)
        if np.any(by):
            terms = turned(c.robot, j, shape(by), side)
            driver = by_reading(c.robot, j) if kind == "angle" else Driver(kind, j)
            unit, sd = along if along and c.robot.slides[j - 1] else prior
            out.append(Parameter(f"{effect} {name}", unit, terms, sd, **site_and_driver(j, driver)))
    return out


def along_travel(
    c: Circumstances, effect: str, axes: Mapping[str, str], first: int, prior: tuple[str, float]
) -> list[Parameter]:
    """Smooth errors of the carriage of every prismatic joint by its position, along or about some axes.

    Legendre polynomials of the position over the joint's limits, of the orders `first` to `ORDERS`, with a
    root mean square of 1 over the travel: the length of their values is the root mean square of the error.
    The prior standard deviation of order m is that of the lowest one times (first / m)^`FALL`, so that the
    curve is smooth.

    Parameters
    ----------
    c : Circumstances
    effect : str
    axes : mapping
        Names of displacements of the joint's frame, by those in reports.
    first : int
        Lowest order; those below are parameters of other effects.
    prior : (str, float)
        SI unit, and standard deviation of the lowest order.
    """
    out, (unit, sd), orders = [], prior, np.arange(first, ORDERS + 1)
    for j in (np.flatnonzero(c.robot.slides) + 1).tolist():
        (low, high), sign = c.robot.limits[j - 1], np.sign(c.robot.link_from_reading[j - 1, j - 1])
        place = np.clip((2.0 * sign * c.q[:, j - 1] - (low + high)) / (high - low), -1.0, 1.0)
        shapes = legvander(place, ORDERS)[:, orders] * np.sqrt(2 * orders + 1)
        if np.ptp(place):
            out += [
                Parameter(
                    f"{effect} {c.robot.joint_names[j - 1]} {label} {order}", unit, (Term(j, axis, shape),),
                    sd * float(first / order) ** FALL,
                    **site_and_driver(j, by_reading(c.robot, j, form="smooth")),
                )
                for label, axis in axes.items()
                for order, shape in zip(orders.tolist(), shapes.T, strict=True)
            ]  # fmt: skip
    return out


NO_SLIDE, NO_CAMERA, NO_PLANE = ELSEWHERE = (
    "the robot has no prismatic joint", "no target is a camera", "no plane is fitted",
)  # fmt: skip
"""Why an effect cannot be in an arm or with its targets, whatever is recorded."""


def without_slides(c: Circumstances) -> str:
    """A message if no joint is prismatic, or ""."""
    return "" if c.robot.slides.any() else NO_SLIDE


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
    first = "j1_mmps" if c.robot.slides[0] else "j1_degps"
    return "" if c.velocity is not None else f"no {first} ...: the session records no joint velocities"


def without_surface(c: Circumstances) -> str:
    """A message if no ball touches a surface, or ""."""
    return "" if np.any(c.touching) else "no target is a surface (plane, sphere, cylinder)"


def successions(c: Circumstances) -> list[np.ndarray]:
    """Rows of each session in the order of measurement: of time if recorded, else of the file."""
    groups = [np.flatnonzero(s.rows) for s in c.sessions] or [np.arange(len(c.q))]
    return groups if c.time is None else [rows[np.argsort(c.time[rows], kind="stable")] for rows in groups]


def lagging(c: Circumstances, goal: np.ndarray, path: np.ndarray, length: float) -> np.ndarray:
    """A state (N,) that follows a goal (N,) along a path (N,), and starts at it.

    After a step of the path by d, the distance from the new goal is exp(-abs(d) / length) times that of the
    state before it.
    """
    out = np.empty(len(goal))
    for rows in successions(c):
        keep = np.exp(-np.abs(np.diff(path[rows], prepend=path[rows[:1]])) / length)
        state = 0.0
        for k, row in enumerate(rows):
            state = goal[row] + (state - goal[row]) * keep[k] if k else goal[row]
            out[row] = state
    return out


def alone(c: Circumstances, session: Session) -> Circumstances:
    """The circumstances of one session: still N rows, but only its own rows are fitted and vary."""
    temperature = c.temperature
    if temperature is not None and np.any(session.rows):
        temperature = np.where(session.rows, temperature, temperature[np.argmax(session.rows)])
    fitted = c.fitted[session.rows[c.fitted]]
    return replace(c, sessions=(), fitted=fitted, tied_base=session.tied_base, temperature=temperature)


def each(c: Circumstances) -> tuple[Circumstances, ...]:
    """The circumstances of every session that has rows to fit; of a single session, its own."""
    every = (alone(c, session) for session in c.sessions)
    return tuple(one for one in every if len(one.fitted)) if c.sessions else (c,)


def within(p: Parameter, session: Session) -> Parameter:
    """A parameter that acts in the rows of one session only; its name has the session as prefix."""
    terms = tuple(Term(t.frame, t.axis, np.where(session.rows, t.driver, 0.0)) for t in p.terms)
    return replace(p, name=f"{session.name}:{p.name}", terms=terms)


def apart(c: Circumstances, make: Callable[[Circumstances], Iterable[Parameter]]) -> list[Parameter]:
    """Separate parameters for every session: those of `make` for its circumstances, in its rows."""
    if not c.sessions:
        return list(make(c))
    sessions = ((session, alone(c, session)) for session in c.sessions)
    return [within(p, session) for session, one in sessions if len(one.fitted) for p in make(one)]


def by_session(make: Callable[[Circumstances], list[Parameter]]) -> Form:
    """The form of an effect that belongs to a session: a base on its stand, a tool as it was mounted.

    Each session has its own parameters, at a site of its own. A single session has none in this form, which
    is then the usual one.
    """

    def parameters(c: Circumstances) -> list[Parameter]:
        return [
            replace(p, site=p.site.of(session.name))
            for session in c.sessions
            for p in apart(replace(c, sessions=(session,)), make)
        ]

    return Form("session", "in one session of several", parameters)


LEANING = np.sin(np.radians(5.0))
"""Sine of an angle below which two axes count as parallel."""


@dataclass(frozen=True)
class Tilt:
    """A horizontal axis about which the gravity moment turns the base; vectors are unit, in F0.

    A weight has no moment about the vertical, so there are two.
    """

    name: str  # of the axis of F0 nearest to it
    axis: np.ndarray  # (3,)
    across: np.ndarray  # (3,) the other horizontal axis: a hinge below the base displaces it along this
    moment: np.ndarray  # (N,) about the axis through the undisplaced base's origin, N m


def vertical(c: Circumstances) -> np.ndarray:
    """Upwards in F0, (3,); zeros without gravity, and where F0 moves."""
    size = float(np.linalg.norm(c.gravity))
    return -c.gravity / size if size > 0 and c.chain.ground is None else np.zeros(3)


def first_axis(c: Circumstances) -> np.ndarray:
    """Axis of the first joint in F0, (3,), nominal."""
    return (c.chain.base @ c.chain.link[0])[:3, 2]


def tilts(c: Circumstances) -> tuple[Tilt, ...]:
    """Horizontal axes about which a moment acts in any row."""
    up = vertical(c)
    if c.moments is None or not up.any():
        return ()
    a, b = (k for k in range(3) if k != int(np.argmax(np.abs(up))))
    first = np.eye(3)[a] - up[a] * up
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    second *= np.sign(second[b])
    moment = c.moments[:, 0] @ c.chain.base[:3, :3].T  # in F0's axes
    pairs = (("xyz"[a], first, second), ("xyz"[b], second, first))
    candidates = (Tilt(name, axis, across, moment @ axis) for name, axis, across in pairs)
    return tuple(t for t in candidates if carries(t.moment))


def base_terms(c: Circumstances, kind: str, along: np.ndarray, driver: np.ndarray) -> tuple[Term, ...]:
    """Rotation ("r") or translation ("t") of the base, about or along a vector (3,) in F0; driver (N,)."""
    parts = c.chain.base[:3, :3].T @ along
    return tuple(
        Term(0, f"{kind}{axis}", part * driver)
        for axis, part in zip("xyz", parts, strict=True)
        if abs(part) > 1e-12
    )
