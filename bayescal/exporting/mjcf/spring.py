"""A torsional spring of any odd characteristic, from springs that simulators have.

The torque is a polygon of the deflection. Where the stiffness increases, a tendon with a dead band -w ... w
adds a spring beyond it. Where it decreases, two tendons under tension, each slack on one side, release each
other at -w and w: together they have twice their stiffness within, and once their stiffness beyond. All
stiffnesses are positive: an implicit integrator can use them, and the arm comes to rest in few steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

KNOTS = (4, 8, 12, 16, 24, 32)
"""Numbers of corners that are tried in turn."""
CLOSE = 1.5e-7
"""Largest error, rad, of a deflection: 0.15 µm at one metre."""
LINEAR = 1e-12
"""Relative deviation from a straight line below which a characteristic is linear."""
SLACK = 1e3
"""rad: an edge that no deflection reaches."""


@dataclass(frozen=True)
class Band:
    """A spring that is slack from `lower` to `upper`, rad, and has a stiffness beyond, N m/rad."""

    lower: float
    upper: float
    stiffness: float

    def torque(self, x: np.ndarray) -> np.ndarray:
        """Restoring torque, N m, at deflections x, rad."""
        return self.stiffness * (np.maximum(x - self.upper, 0.0) - np.maximum(self.lower - x, 0.0))


@dataclass(frozen=True)
class Spring:
    """A linear spring, N m/rad, with further ones in parallel."""

    stiffness: float
    bands: tuple[Band, ...] = ()

    def torque(self, x: np.ndarray) -> np.ndarray:
        """Restoring torque, N m, at deflections x, rad."""
        return np.sum([self.stiffness * x, *(b.torque(x) for b in self.bands)], axis=0)

    @property
    def slope(self) -> float:
        """Stiffness at zero, N m/rad."""
        return self.stiffness + sum(b.stiffness for b in self.bands if not b.lower <= 0.0 <= b.upper)


def linear(compliance: float) -> Spring:
    """The spring of a compliance, rad/(N m), above zero."""
    return Spring(1.0 / compliance)


def spring_of(torque: np.ndarray, deflection: np.ndarray) -> Spring:
    """The spring of a characteristic: deflections (G,), rad, at increasing torques (G,) above zero, N m.

    The deflection must increase with the torque: no spring has another characteristic.
    """
    assert np.all(np.diff(np.append(0.0, deflection)) > 0)
    if np.ptp(deflection / torque) <= LINEAR * deflection[-1] / torque[-1]:
        return linear(float(deflection[-1] / torque[-1]))
    slope = np.gradient(deflection, torque)
    for count in KNOTS:
        found = _polygon(torque, deflection, slope, count)
        if np.max(np.abs(found.torque(deflection) - torque) * slope) <= CLOSE:
            break
    return found


def _polygon(torque: np.ndarray, deflection: np.ndarray, slope: np.ndarray, count: int) -> Spring:
    """Least squares in the deflection, with `count` corners where the characteristic bends most."""
    bend = np.sqrt(np.abs(np.gradient(slope, torque)))
    bend += 1e-3 * bend.max()
    spent = np.concatenate([[0.0], np.cumsum(0.5 * (bend[1:] + bend[:-1]) * np.diff(torque))])
    w = np.interp((np.arange(count) + 0.5) / count * spent[-1], spent, deflection)
    bands = [Band(-own, own, 1.0) for own in w]
    pairs = [(Band(own, SLACK, 1.0), Band(-SLACK, -own, 1.0)) for own in w]
    columns = [deflection, *(b.torque(deflection) for b in bands)]
    columns += [a.torque(deflection) + b.torque(deflection) for a, b in pairs]
    a = np.array(columns).T * slope[:, None]
    scale = np.linalg.norm(a, axis=0)
    k = (nnls(a / scale, torque * slope)[0] / scale).tolist()
    beyond = [Band(b.lower, b.upper, own) for b, own in zip(bands, k[1 : count + 1], strict=True) if own]
    within = [
        Band(b.lower, b.upper, own)
        for pair, own in zip(pairs, k[count + 1 :], strict=True)
        if own
        for b in pair
    ]
    return Spring(k[0], (*beyond, *within))
