"""Columns of torque: what a parameter adds to the torque of one joint, or of all.

The torque of joint j is linear in nearly all that matters: rigid body, rotor, friction, offset. A parameter
is a `Term`, its column the torque by one unit of it. The two that are not linear, the time of the torque and
the speed at which friction reverses, are linearised at an `Operating` point that the estimate moves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from bayescal.logs import Log, Mechanism
from bayescal.logs.mechanism import PAIRS, inertial
from bayescal.motion.dynamics import payload_of
from bayescal.motion.settings import BASELINE
from bayescal.motion.signals import Signals, derivative

BODY = ("mass", "centre x", "centre y", "centre z", *(f"inertia {'xyz'[i]}{'xyz'[j]}" for i, j in PAIRS))
"""Parameters of a body."""
ALL = -1
"""In place of a joint: a term of all joints."""


@dataclass(frozen=True)
class Term:
    """One parameter: its name, unit, prior standard deviation (mean 0: deviation from nominal), and joint."""

    name: str
    unit: str
    sd: float
    joint: int = ALL  # from 0
    positive: float = -np.inf  # least value, of one that is physically bounded


Column = tuple[Term, np.ndarray]
"""A term with its torque: (N,) of its joint, (N, n) of all."""


@dataclass(frozen=True)
class Operating:
    """Where the model is linearised: parameters that are not linear, and those that drivers depend on."""

    inertials: np.ndarray  # (n, 10), estimate of `Mechanism.inertials`
    armature: np.ndarray  # (n,) kg m2
    coulomb: np.ndarray  # (n,) N m
    viscous: np.ndarray  # (n,) N m s/rad
    offset: np.ndarray  # (n,) N m
    transition: np.ndarray  # (n,) rad/s
    shift: np.ndarray  # (n,) s by which torques are later than positions

    def load(self, s: Signals) -> np.ndarray:
        """Torque (N, n) that the gears carry: rigid bodies and payload, without rotor and friction."""
        m = s.log.mechanism
        arm = np.einsum("njkp,kp->nj", s.rigid, self.inertials)
        return arm + s.rigid[:, :, -1] @ payload_of(m) * s.payload[:, None]

    def reversal(self, s: Signals) -> np.ndarray:
        """Direction of motion (N, n), -1 to 1."""
        return np.tanh(s.dq / self.transition)

    def torque(self, s: Signals) -> np.ndarray:
        """Torque of the motors (N, n) that the model predicts."""
        friction = self.coulomb * self.reversal(s) + self.viscous * s.dq
        return self.load(s) + self.armature * s.ddq + friction + self.offset

    def measured(self, s: Signals) -> np.ndarray:
        """Measured torque (N, n), at the times of the positions."""
        if not np.any(self.shift):
            return s.torque
        later = s.time[:, None] + self.shift
        spline = CubicSpline(s.time, s.torque)
        return np.column_stack([spline(later[:, j])[:, j] for j in range(later.shape[1])])


def nominal(log: Log, rms: np.ndarray) -> Operating:
    """The nominal model; what is not stated is 0, of friction a share of the torque."""
    m = log.mechanism
    return Operating(
        m.inertials,
        np.nan_to_num(m.armature),
        np.where(np.isnan(m.coulomb), BASELINE.friction * rms, m.coulomb),
        np.nan_to_num(m.viscous),
        np.zeros(m.n),
        np.full(m.n, m.transition),
        np.full(m.n, log.alignment),
    )


def of_body(m: Mechanism, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (10, 10) of the linear parameters by mass, centre and inertia, and prior sds (10,)."""
    mass, centre, inertia = m.mass[k], m.centre[k], m.inertia[k]
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
    size = np.maximum(np.diag(inertia), BASELINE.least_inertia * max(np.trace(inertia), 1e-12))
    of_inertia = [m.u.inertia * np.sqrt(size[i] * size[j]) for i, j in PAIRS]
    return by, np.array([m.u.mass * mass, *[m.u.centre] * 3, *of_inertia])


UNITS = ("kg", "m", "m", "m", *["kg m2"] * 6)


def baseline(s: Signals, at: Operating, rms: np.ndarray) -> Iterator[Column]:
    """Columns of what every model has: bodies, rotors, friction, offsets, times of the torques.

    `rms` (n,), N m, is that of the measured torques: the scale of what is not stated.
    """
    m, log = s.log.mechanism, s.log
    for k in range(m.n):
        by, sd = of_body(m, k)
        columns = s.rigid[:, :, k] @ by
        for p, name in enumerate(BODY):
            if sd[p] > 0.0:
                yield Term(f"{name} of link {k + 1}", UNITS[p], sd[p]), columns[:, :, p]
    way = at.reversal(s)
    scale = np.where(np.isnan(m.rated), rms, np.minimum(m.rated, 3.0 * rms))
    later = -derivative(at.measured(s), s.step)
    for j in range(m.n):
        armature = m.u.armature * m.armature[j]
        if not armature > 0.0:
            armature = scale[j] / BASELINE.acceleration
        yield Term(f"armature {j + 1}", "kg m2", armature, j), s.ddq[:, j]
        yield Term(f"coulomb {j + 1}", "N m", BASELINE.friction * scale[j], j), way[:, j]
        yield Term(f"viscous {j + 1}", "N m s/rad", BASELINE.friction * scale[j], j), s.dq[:, j]
        yield Term(f"offset {j + 1}", "N m", BASELINE.offset * scale[j], j), np.ones(len(way))
        slope = -at.coulomb[j] * (1.0 - way[:, j] ** 2) * s.dq[:, j] / at.transition[j]
        yield Term(f"transition {j + 1}", "1", m.u.transition, j), slope
        if log.u_constant:
            yield Term(f"constant {j + 1}", "1", log.u_constant, j), at.torque(s)[:, j]
    yield Term("alignment", "s", log.u_alignment), later


def assembled(columns: Iterable[Column], n: int) -> tuple[list[Term], list[list[int]], list[np.ndarray]]:
    """Terms, and for each joint the numbers of those that it has and their columns (N, K)."""
    terms: list[Term] = []
    numbers: list[list[int]] = [[] for _ in range(n)]
    values: list[list[np.ndarray]] = [[] for _ in range(n)]
    for term, column in columns:
        for j in range(n) if term.joint == ALL else (term.joint,):
            numbers[j].append(len(terms))
            values[j].append(column[:, j] if column.ndim == 2 else column)
        terms.append(term)
    return terms, numbers, [np.column_stack(v) if v else np.empty((0, 0)) for v in values]
