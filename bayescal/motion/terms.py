"""Columns of torque: what a parameter adds to the torque of one joint, or of all.

The torque of joint j is linear in nearly all that matters: rigid body, rotor, friction, offset. A parameter
is a `Term`, its column the torque by one unit of it. The two that are not linear, the time of the torque and
the speed at which friction reverses, are linearised at an `Operating` point that the estimate moves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy.interpolate import CubicSpline

from bayescal.logs import Log, Mechanism
from bayescal.logs.types import PAIRS, SERVO, TRACKING, TRANSITION, inertial
from bayescal.motion.dynamics import Followed, carried, followed, inertia_matrix, inertial_of
from bayescal.motion.fit_settings import SERVOS
from bayescal.motion.settings import BASELINE, SIGNALS
from bayescal.motion.signals import Signals, derivative, low_passed
from bayescal.robots.schema import SIX

BODY = ("mass", "centre x", "centre y", "centre z", *(f"inertia {'xyz'[i]}{'xyz'[j]}" for i, j in PAIRS))
"""Parameters of a body."""
FORM = "reversal form"
"""Of the reversal of friction, which no law gives: t - c t (1 - t2), where t is a hyperbolic tangent. Where a
model is linearised it is 0: with the speed of the reversal, which says nearly as much, steps went astray."""
ALL = -1
"""In place of a channel: a term of the torques of all joints."""


def channel(log: Log, kind: str, j: int) -> int:
    """Number of the channel of a joint, from 0."""
    return log.kinds.index(kind) * log.n + j


@dataclass(frozen=True)
class Term:
    """One parameter: its name, unit, prior standard deviation about 0 (nominal), and channel."""

    name: str
    unit: str
    sd: float
    channel: int = ALL
    moves: bool = False  # whether it is a torque of the arm, which also displaces a position servo
    most: float = np.inf  # of the prior standard deviation, at any scale: the size of the part itself


Column = tuple[Term, np.ndarray]
"""A term with its column: (N,) of its channel, (N, n) of the torques of all joints."""


@dataclass(frozen=True)
class Operating:
    """Where the model is linearised: parameters that are not linear, and those that drivers depend on."""

    bodies: np.ndarray  # (n, 10), mass, centre and inertia about it, as `BODY`
    armature: np.ndarray  # (n,) kg m2
    coulomb: np.ndarray  # (n,) N m
    viscous: np.ndarray  # (n,) N m s/rad
    offset: np.ndarray  # (n,) N m
    transition: np.ndarray  # (n,) rad/s
    shift: np.ndarray  # (n,) s by which torques are later than positions
    gain: np.ndarray  # (n,) measured torque over the true one

    def moved(self, values: Mapping[str, float]) -> Operating:
        """The operating point at deviations of terms."""
        each = partial(by_joint, values, len(self.armature))
        bodies = np.column_stack([each(f"{name} of link") for name in BODY])
        slower = np.exp(np.clip(each("transition") + values.get("transition", 0.0), -1.5, 1.5))
        return Operating(
            self.bodies + bodies, self.armature + each("armature"), self.coulomb + each("coulomb"),
            self.viscous + each("viscous"), self.offset + each("offset"), self.transition * slower,
            self.shift + values.get("alignment", 0.0) + delayed(values, len(self.shift)),
            self.gain + each("constant"),
        )  # fmt: skip

    def mechanism(self, m: Mechanism, servo: bool) -> Mechanism:
        """A mechanism with these bodies, rotors and friction; of servos at their estimated stiffness."""
        mass, centre, inertia = self.bodies[:, 0], self.bodies[:, 1:4], self.bodies[:, 4 + SIX]
        by = self.gain if servo else 1.0
        return replace(
            m, mass=mass, centre=centre, inertia=inertia, armature=self.armature / by,
            coulomb=self.coulomb / by, viscous=self.viscous / by,
            transition=float(np.exp(np.mean(np.log(self.transition)))) if m.transition or not servo else 0.0,
        )  # fmt: skip

    @property
    def inertials(self) -> np.ndarray:
        """Parameters (n, 10) in which torques are linear, as `Mechanism.inertials`."""
        return np.array([inertial_of(b) for b in self.bodies])

    def load(self, s: Signals) -> np.ndarray:
        """Torque (N, n) that the gears carry: rigid bodies and payload, without rotor and friction."""
        inertials = self.inertials
        key = inertials.tobytes()
        if key not in s.loads:  # a long log forgets its regressors, not these
            s.loads.clear()
            s.loads[key] = carried(s.rigid, inertials, s.log.mechanism, s.payload)
        return s.loads[key]

    def reversal(self, s: Signals) -> np.ndarray:
        """Direction of motion (N, n), -1 to 1; of a servo the error that friction holds, over its largest."""
        if s.log.torque_kind == SERVO:
            return self.followed(s).friction
        return np.tanh(s.turning / self.transition)

    def followed(self, s: Signals) -> Followed:
        """What servos do by their commands."""
        key = b"".join(x.tobytes() for x in vars(self).values())
        if key not in s.follows:
            s.follows.clear()
            s.follows[key] = self._followed(s)
        return s.follows[key]

    def _followed(self, s: Signals) -> Followed:
        stiffness = s.log.controller.stiffness
        assert stiffness is not None
        least = SERVOS.narrow * stiffness
        # with the rotors: otherwise simulations would not converge
        few = slice(None, None, max(len(s.q) // SERVOS.poses, 1))
        matrices = inertia_matrix(s.log.mechanism, self.inertials, s.q[few], s.payload[few])
        links = self.gain * np.mean(np.diagonal(matrices, axis1=1, axis2=2), axis=0)
        drive = np.array([stiffness, self.coulomb, self.viscous, self.armature + links, self.transition])
        drive = np.maximum(drive, np.multiply.outer([1.0, 1.0, 1.0, 0.0, 0.0], least))
        load = self.gain * self.load(s) + self.offset - links * s.ddq
        command = self.commands(s)
        first = command[0] - self.measured(s)[0] / stiffness
        return Followed(*followed(command, load, drive, first, s.step))

    def simulated(self, s: Signals) -> Signals:
        """Signals with the motion of servos by their commands in place of the measured one.

        What disturbs a servo moves it too: measured speeds and accelerations have the noise of the errors.
        """
        q = low_passed(self.followed(s).position, s.step, s.band * SIGNALS.over[-1])
        dq = derivative(q, s.step)
        ddq = derivative(dq, s.step)
        return replace(s, q=q, dq=dq, ddq=ddq, reversing=None, measured=s.measured or s)

    def commands(self, s: Signals) -> np.ndarray:
        """Commands (N, n), at the times at which the servos act on them."""
        assert s.command is not None
        return _shifted(s, s.command, np.clip(s.time[:, None] - self.shift, s.time[0], s.time[-1]))

    def torque(self, s: Signals) -> np.ndarray:
        """Torque of the motors (N, n) that the model predicts."""
        friction = self.coulomb * self.reversal(s) + self.viscous * s.dq
        return self.load(s) + self.armature * s.ddq + friction

    def driven(self, s: Signals) -> np.ndarray:
        """Torque of the servos (N, n): of the model, and as measured where stiction may hold a joint."""
        return s.weight * self.torque(s) + (1.0 - s.weight) * (self.measured(s) - self.offset) / self.gain

    def shown(self, s: Signals) -> np.ndarray:
        """What a sensor of this torque shows (N, n)."""
        if s.log.torque_kind == SERVO:  # friction and rotors are of the same scale as the stiffness
            return self.torque(s) + (self.gain - 1.0) * self.load(s) + self.offset
        return self.gain * self.torque(s) + self.offset

    def measured(self, s: Signals) -> np.ndarray:
        """Measured torque (N, n), at the times of the positions."""
        if s.log.torque_kind == SERVO:
            return s.torque + s.log.controller.stiffness * (self.commands(s) - s.command)
        return _shifted(s, s.torque, s.time[:, None] + self.shift) if np.any(self.shift) else s.torque


def _shifted(s: Signals, x: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Samples (N, n) of each joint at times (N, n) of its own."""
    spline = CubicSpline(s.time, x)
    return np.column_stack([spline(t)[:, j] for j, t in enumerate(times.T)])


def by_joint(values: Mapping[str, float], n: int, name: str) -> np.ndarray:
    """Values (n,) of the terms of a name, one of each joint; 0 where there is none."""
    return np.array([values.get(f"{name} {j + 1}", 0.0) for j in range(n)])


DELAY = "delay"
"""Name of the effect that changes the time of torques."""


def delayed(values: Mapping[str, float], n: int) -> np.ndarray:
    """Times (n,), s, by which torques of joints are later, of the terms of the effect."""
    every = sum(v for name, v in values.items() if name.startswith(f"{DELAY} log "))
    starts = [f"{DELAY} joint {j + 1} " for j in range(n)]
    of_joint = [sum(v for name, v in values.items() if name.startswith(start)) for start in starts]
    return every + np.array(of_joint, float)


def later(s: Signals, model: Operating) -> np.ndarray:
    """Columns (N, n) of a later torque: minus its rate; of servos the rate of the commands."""
    if s.log.torque_kind != SERVO:
        return -derivative(model.measured(s), s.step)
    return s.log.controller.stiffness * derivative(model.commands(s), s.step)


def nominal(log: Log, rms: np.ndarray) -> Operating:
    """The nominal model; what is not stated is 0, of friction a share of the torque."""
    m = log.mechanism
    bodies = np.column_stack([m.mass, m.centre, m.inertia[:, *np.transpose(PAIRS)]])
    coulomb = np.where(np.isnan(m.coulomb), BASELINE.friction * rms, m.coulomb)
    transition = m.transition or (SERVOS.transition if log.torque_kind == SERVO else TRANSITION)
    return Operating(
        bodies, np.nan_to_num(m.armature), coulomb, np.nan_to_num(m.viscous), np.zeros(m.n),
        np.full(m.n, transition), np.full(m.n, log.alignment), np.ones(m.n),
    )  # fmt: skip


def slopes_of(body: np.ndarray) -> np.ndarray:
    """Derivatives (10, 10) of the linear parameters by mass, centre and inertia, of a body (10,)."""
    return _slopes(float(body[0]), tuple(body[1:4].tolist()))


@lru_cache(maxsize=256)  # the same of every motion
def _slopes(mass: float, centre_of_mass: tuple[float, ...]) -> np.ndarray:
    centre = np.array(centre_of_mass)
    zero, none = np.zeros(3), np.zeros((3, 3))
    by = np.zeros((10, 10))
    by[:, 0] = inertial(1.0, centre, none)
    for axis, step in enumerate(np.eye(3)):
        both = inertial(mass, centre + step, none) - inertial(mass, centre - step, none)
        by[:, 1 + axis] = both / 2.0
    for p, (i, j) in enumerate(PAIRS):
        unit = none.copy()
        unit[i, j] = unit[j, i] = 1.0
        by[:, 4 + p] = inertial(0.0, zero, unit)
    return by


def prior_of_body(m: Mechanism, k: int) -> np.ndarray:
    """Prior standard deviations (10,) of mass, centre and inertia of a body; 0 of a link without mass."""
    if not m.mass[k] > 0.0:
        return np.zeros(len(BODY))
    size = size_of_body(m, k)
    return np.array([m.u.mass * size[0], *[m.u.centre] * 3, *(m.u.inertia * size[4:])])


def size_of_body(m: Mechanism, k: int) -> np.ndarray:
    """Mass, extent (3) and inertia (6) of a body: an error of them is seldom larger.

    The extent is the radius of gyration, or half of the way to the next joint.
    """
    mass, inertia = m.mass[k], m.inertia[k]
    way = np.linalg.norm(m.place[k + 1, :3, 3]) / 2.0 if k + 1 < m.n else 0.0
    extent = max(np.sqrt(np.trace(inertia) / max(2.0 * mass, 1e-12)), way)
    size = np.maximum(np.diag(inertia), BASELINE.least_inertia * max(np.trace(inertia), 1e-12))
    return np.array([mass, *[extent] * 3, *(np.sqrt(size[i] * size[j]) for i, j in PAIRS)])


UNITS = ("kg", "m", "m", "m", *["kg m2"] * 6)


def baseline(s: Signals, model: Operating, rms: np.ndarray) -> Iterator[Column]:
    """Columns of what every model has: bodies, rotors, friction, offsets, times of the torques.

    `rms` (n,), N m, is that of the measured torques: the scale of what is not stated.
    """
    m, log = s.log.mechanism, s.log
    for k in range(m.n):
        by, sd = slopes_of(model.bodies[k]), prior_of_body(m, k)
        columns = model.gain[:, None] * (s.rigid[:, :, k] @ by)
        for p, name in enumerate(BODY):
            if sd[p] > 0.0:
                yield Term(f"{name} of link {k + 1}", UNITS[p], sd[p], moves=True), columns[:, :, p]
    servo = log.torque_kind == SERVO
    way, gain = model.reversal(s), np.ones(m.n) if servo else model.gain
    slopes = -gain * model.coulomb * (1.0 - way**2) * s.turning / model.transition
    forms = -gain * model.coulomb * (1.0 - way**2) * way
    scale = np.where(np.isnan(m.rated), rms, np.minimum(m.rated, 3.0 * rms))
    for j in range(m.n):
        stated, sd = m.u.armature * m.armature[j], BASELINE.friction * scale[j]
        armature = stated if stated > 0.0 else scale[j] / BASELINE.acceleration
        yield Term(f"armature {j + 1}", "kg m2", armature, j, True), gain[j] * s.ddq[:, j]
        yield Term(f"coulomb {j + 1}", "N m", sd, j, True), gain[j] * way[:, j]
        yield Term(f"viscous {j + 1}", "N m s/rad", sd, j, True), gain[j] * s.dq[:, j]
        yield Term(f"offset {j + 1}", "N m", BASELINE.offset * scale[j], j), np.ones(len(way))
        if m.transition or not servo:
            yield Term(f"transition {j + 1}", "1", BASELINE.transition, j, True), slopes[:, j]
        if not servo:
            yield Term(f"{FORM} {j + 1}", "1", BASELINE.reversal, j, True), forms[:, j]
        if log.u_constant:
            shown = model.load(s) if servo else model.torque(s)
            yield Term(f"constant {j + 1}", "1", log.u_constant, j), shown[:, j]
    if m.transition or not servo:
        yield Term("transition", "1", m.u.transition, moves=True), slopes
    if not servo:
        yield Term(FORM, "1", BASELINE.reversals, moves=True), forms
    yield Term("alignment", "s", log.u_alignment), later(s, model)
    driven = model.driven(s) if TRACKING in log.kinds else None
    for kind in log.kinds[1:]:
        for j in range(m.n):
            number = channel(log, kind, j)
            yield Term(f"{kind} offset {j + 1}", "rad", BASELINE.angle, number), np.ones(len(way))
            yield Term(f"{kind} lag {j + 1}", "s", BASELINE.lag, number), s.dq[:, j]
            if kind == TRACKING and log.controller.stiffness is not None and driven is not None:
                yield Term(f"{kind} lag squared {j + 1}", "s2", BASELINE.lag**2, number), s.ddq[:, j]
                # above its bandwidth a servo does not answer as its stiffness says
                asked = driven[:, j] / log.controller.stiffness[j]
                fast = asked - low_passed(asked, s.step, BASELINE.servo)
                rate = derivative(asked, s.step)
                yield Term(f"{kind} fast torque {j + 1}", "1", 1.0, number), fast
                yield Term(f"{kind} rate of torque {j + 1}", "s", BASELINE.answer, number), rate


def residuals(s: Signals, model: Operating) -> np.ndarray:
    """Residuals (N, C) of all channels: torques less those of the model; tracking; links.

    They are of the measured motion. Where columns are those of a simulated one, noise is in residuals alone.
    """
    if s.measured is not None:
        s = s.measured if s.torque is s.measured.torque else s.measured.changed(torque=s.torque)
    out = [model.measured(s) - model.shown(s)]
    for kind in s.log.kinds[1:]:
        if kind == TRACKING:
            assert s.command is not None
            assert s.log.controller.stiffness is not None
            # by the torque of the model: the noise of a measured torque is in the residual too
            out.append(s.command - s.q - (model.driven(s) + damped(s)) / s.log.controller.stiffness)
        else:
            assert s.link is not None
            out.append(s.link - s.q)
    return np.column_stack(out)


def from_nominal(
    s: Signals, model: Operating, columns: Iterable[Column], moved: Mapping[str, float]
) -> np.ndarray:
    """Residuals (N, C) of a model plus what its columns are at the deviations by which it is moved."""
    out = residuals(s, model)
    moving = np.zeros_like(s.torque)
    for term, column in columns:
        if term.name in moved and not term.name.startswith(tuple(s.log.kinds[1:])):
            for j, value in by_channel(term, column):
                out[:, j] += moved[term.name] * value
                if term.moves:
                    moving[:, j] += moved[term.name] * value
    if np.any(late := delayed(moved, s.log.n)):
        out[:, : s.log.n] += late * later(s, model)
    for j in range(s.log.n) if TRACKING in s.log.kinds else ():
        out[:, channel(s.log, TRACKING, j)] += displaced(s, s.step, s.weight[:, j] * moving[:, j], j)
    return out


def damped(s: Signals) -> np.ndarray:
    """Torque (N, n) by which a servo brakes: by the speed, or by the speed beyond that of the command."""
    control, out = s.log.controller, np.zeros_like(s.dq)
    if control.damping is not None:
        out += control.damping * s.dq
    if control.ahead is not None and s.command is not None:
        out -= control.ahead * derivative(s.command, s.step)
    return out


def assembled(columns: Iterable[Column], s: Signals) -> tuple[list[Term], list[list[int]], list[np.ndarray]]:
    """Terms, and for each channel the numbers of those that it has and their columns (N, K)."""
    terms: list[Term] = []
    log = s.log
    count = len(log.kinds) * log.n
    numbers: list[list[int]] = [[] for _ in range(count)]
    values: list[list[np.ndarray]] = [[] for _ in range(count)]
    moving: list[list[int]] = [[] for _ in range(count)]  # which of them displace a servo
    for term, column in columns:
        for j, value in by_channel(term, column):
            if term.moves:
                moving[j].append(len(values[j]))
            numbers[j].append(len(terms))
            values[j].append(value)
        terms.append(term)
    rows = max((len(v[0]) for v in values if v), default=0)
    out = []
    for v in values:
        out.append(np.column_stack(v) if v else np.empty((rows, 0)))
        v.clear()
    for j in range(log.n) if TRACKING in log.kinds else ():
        if not moving[j]:
            continue
        t = channel(log, TRACKING, j)
        numbers[t] = [*(numbers[j][k] for k in moving[j]), *numbers[t]]
        out[t] = np.hstack([displaced(s, s.step, s.weight[:, j, None] * out[j][:, moving[j]], j), out[t]])
    return terms, numbers, out


def by_channel(term: Term, column: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """The channels that a term is of, and its column (N,) in each."""
    joints = range(column.shape[1]) if term.channel == ALL else (term.channel,)
    yield from ((j, column[:, j] if column.ndim == 2 else column) for j in joints)


def displaced(s: Signals, step: float, torque: np.ndarray, j: int) -> np.ndarray:
    """Displacement of the position servo of a joint by torques of the arm (N, ...), rad.

    A servo moves under a torque as its stiffness says, within its bandwidth.
    """
    assert s.log.controller.stiffness is not None
    return low_passed(torque, step, BASELINE.servo) / s.log.controller.stiffness[j]
