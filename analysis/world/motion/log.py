"""A log without effects, as effects see it; and what an effect changes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.world.motion.arms import Arm
from analysis.world.motion.dynamics import PARTS, regressor
from analysis.world.motion.noise import Noise
from analysis.world.motion.plan import Session

SENSED = frozenset({
    "torque-constant", "torque-drift", "delay", "clock-drift", "stamp-jitter", "saturation", "pause-offset",
    "quantised-current", "cross-talk", "thermal-offset", "sensor-hysteresis", "supply-sag",
})  # fmt: skip
"""Effects and causes in the measurement of the torque: the torque itself is as it was."""
GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Change:
    """What an effect adds to torque, link-side encoders, and tracking error (rows, n); SI."""

    torque: np.ndarray
    link: np.ndarray | None = None
    track: np.ndarray | None = None


@dataclass(frozen=True)
class Act:
    """A hidden effect: what it does at a size, and the words for it."""

    name: str
    form: str
    where: list[dict]
    unit: str
    usual: float
    most: float
    apply: Callable[[float], Change]
    detail: dict = field(default_factory=dict)
    sensed: bool = False  # as the names of `SENSED`


@dataclass(frozen=True)
class Log:
    """The true arm in its session: rows of noise-free torque, and its parts."""

    arm: Arm
    session: Session
    noise: Noise
    torque: np.ndarray  # (rows, n), N m
    rigid: np.ndarray  # of the links and the payload alone
    still: np.ndarray  # of gravity alone
    stiffness: np.ndarray | None  # N m/rad, in a log with a position servo
    current: bool
    u_constant: float
    u_alignment: float
    gravity: np.ndarray

    def at(self, delay: np.ndarray) -> np.ndarray:
        """Return the torque (rows, n) of an earlier time, by delays (rows,) or (rows, n), s.

        Friction follows from the speed of that time: its steps have no place in a spline.
        """
        s, out = self.session, np.empty_like(self.torque)
        late = np.broadcast_to(delay if delay.ndim == 2 else delay[:, None], out.shape)
        speed, smooth = np.empty_like(out), self.torque - self.arm.friction(s.dq)
        for run in s.runs:
            t = s.since[run]
            both = np.stack([smooth[run], s.dq[run]], axis=2)
            for j in range(out.shape[1]):
                then = np.clip(t - late[run, j], t[0], t[-1])
                out[run, j], speed[run, j] = CubicSpline(t, both[:, j])(then).T
        return out + self.arm.friction(speed)

    def seen(self, act: Act, size: float) -> Change:
        """Return the change of an effect: a servo is also off by the torque that it needs."""
        change = act.apply(size)
        if self.stiffness is None or act.sensed or act.name in SENSED:
            return change
        track = 0.0 if change.track is None else change.track
        return replace(change, track=track + change.torque / self.stiffness)

    @cached_property
    def rate(self) -> np.ndarray:
        """Rate of the torque (rows, n), N m/s."""
        step = np.full(len(self.torque), 1e-4)
        return (self.at(-step) - self.at(step)) / 2e-4

    def of_load(self, parameters: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
        """Return the torque (rows, n) of a body on the last link; of some rows, elsewhere 0."""
        s, out = self.session, np.zeros_like(self.torque)
        rows = np.ones(len(out), dtype=bool) if rows is None else rows
        moved = (s.q[rows], s.dq[rows], s.ddq[rows])
        out[rows] = regressor(self.arm.chain, *moved, self.gravity, [self.arm.size - 1]) @ parameters
        return out


def rigid(arm: Arm, session: Session, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rigid-body torque of arm and payload (rows, n), and the regressor (rows, n, 10 n)."""
    columns = regressor(arm.chain, session.q, session.dq, session.ddq, gravity)
    torque = columns @ arm.parameters
    for kilos in np.unique(session.payload[session.payload > 0]):
        rows = session.payload == kilos
        torque[rows] += columns[rows][:, :, -PARTS:] @ arm.payload(float(kilos))
    return torque, columns
