"""What the baseline absorbs of an effect, and its detectability lambda.

The baseline has the inertial parameters and the armatures within their uncertainties, Coulomb friction with
its transition speed, viscous friction, an offset of each joint, the alignment of the clocks, and the torque
constants where a current is measured. lambda is the squared norm of what it leaves of an effect in the
calibration rows, whitened by the true noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq

from analysis.world.motion.arms import Arm, U
from analysis.world.motion.dynamics import PARTS
from analysis.world.motion.log import Act, Change, Log
from analysis.world.motion.noise import process, white
from analysis.world.motion.plan import Session

FLAT = 1e4
"""Prior standard deviation of what is not known, in its SI unit."""
LINK, TRACK, WANDER_S = 0.03, 0.01, 0.15
"""RMS of the noise of a link-side encoder and of the tracking error, deg, and its time constant, s."""


@dataclass(frozen=True)
class Baseline:
    """Whitened normal equations of the calibration rows, and the columns of all rows by joint."""

    log: Log
    columns: list[np.ndarray]  # of joint j (rows, c)
    places: list[np.ndarray]  # of these columns among all parameters
    white: list[np.ndarray]
    factor: tuple
    size: int

    def absorbed(self, torque: np.ndarray) -> np.ndarray:
        """Return the parameters that explain a torque (rows, n) best, from the calibration rows."""
        s, right = self.log.session, np.zeros(self.size)
        for j, (g, place) in enumerate(zip(self.white, self.places, strict=True)):
            right[place] += g.T @ white(self.log.noise, j, torque[:, j], s.of("calibrate"), s.step)
        return cho_solve(self.factor, right)

    def residual(self, torque: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Return a torque (rows, n) less what parameters explain."""
        pairs = zip(self.columns, self.places, strict=True)
        return torque - np.stack([g @ parameters[place] for g, place in pairs], axis=1)

    def squared(self, torque: np.ndarray) -> float:
        """Return the squared norm, whitened, of what the baseline leaves of a torque (rows, n)."""
        s, right, total = self.log.session, np.zeros(self.size), 0.0
        for j, (g, place) in enumerate(zip(self.white, self.places, strict=True)):
            w = white(self.log.noise, j, torque[:, j], s.of("calibrate"), s.step)
            right[place] += g.T @ w
            total += float(w @ w)
        return total - float(right @ cho_solve(self.factor, right))


def baseline(log: Log, regressor: np.ndarray, drawn: Arm) -> Baseline:
    """Return the baseline of a log at its true parameters.

    Parameters
    ----------
    log : Log
        The log without effects.
    regressor : numpy.ndarray
        By joint and inertial parameter (rows, n, 10 n).
    drawn : Arm
        The nominal arm, about which the priors are.
    """
    s, arm, n = log.session, log.arm, log.arm.size
    priors = [_inertial_prior(drawn)]
    v = arm.transition
    bend = -s.dq / v / np.cosh(np.clip(s.dq / v, -30, 30)) ** 2 * arm.coulomb  # by the logarithm of v
    own = [
        (s.ddq, U["armature"] * drawn.armature),
        (np.tanh(s.dq / v), FLAT),
        (s.dq, FLAT),
        (np.ones_like(s.dq), FLAT),
    ]
    if log.current:
        own.append((log.torque, log.u_constant))
    count, columns, places = PARTS * n + 2, [], []
    priors.append(np.array([log.u_alignment, U["friction_transition"]]))
    for j in range(n):
        parts = [regressor[:, j, PARTS * j :], log.rate[:, j : j + 1], bend[:, j : j + 1]]
        place = [np.arange(PARTS * j, PARTS * n), np.arange(PARTS * n, PARTS * n + 2)]
        for column, sd in own:
            parts.append(column[:, j : j + 1])
            place.append(np.array([count]))
            priors.append(np.array([np.broadcast_to(sd, n)[j]]))
            count += 1
        columns.append(np.hstack(parts))
        places.append(np.concatenate(place))
    normal = np.diag(1 / np.concatenate(priors) ** 2)
    lean = []
    for j, (g, place) in enumerate(zip(columns, places, strict=True)):
        lean.append(white(log.noise, j, g, s.of("calibrate"), s.step))
        normal[np.ix_(place, place)] += lean[-1].T @ lean[-1]
    return Baseline(log, columns, places, lean, cho_factor(normal), count)


def _inertial_prior(drawn: Arm) -> np.ndarray:
    """Return standard deviations of the inertial parameters (10 n,)."""
    mass, far = U["mass"] * drawn.mass, np.linalg.norm(drawn.centre, axis=1)
    first = np.hypot(
        U["mass"] * drawn.mass[:, None] * np.abs(drawn.centre), (drawn.mass * drawn.centre_u)[:, None]
    )
    own = np.trace(drawn.inertia, axis1=1, axis2=2) / 3
    about = np.hypot(U["inertia"] * (own + drawn.mass * far**2), 2 * drawn.mass * far * drawn.centre_u)
    return np.hstack([mass[:, None], first, np.repeat(about[:, None], 6, axis=1)]).ravel()


def detectability(base: Baseline, change: Change) -> dict[str, float]:
    """Return lambda of a change in the torque, in the link-side encoders, and in the tracking error."""
    s, out = base.log.session, {"torque": base.squared(change.torque)}
    for name, moved, spread in (("link", change.link, LINK), ("track", change.track, TRACK)):
        if moved is not None and np.any(moved):
            out[name] = _of_angles(s, moved, np.radians(spread))
    return out


def _of_angles(s: Session, moved: np.ndarray, spread: float) -> float:
    """Return lambda of a change of angles (rows, n), rad, beyond an offset of each joint."""
    keep, total = np.exp(-s.step / WANDER_S), 0.0
    known = np.stack([moved, np.ones_like(moved)], axis=2)
    rows = np.concatenate([known[run][1:] - keep * known[run][:-1] for run in s.of("calibrate")])
    for j in range(moved.shape[1]):
        y, g = rows[:, j, 0], rows[:, j, 1:]
        total += float(np.sum((y - g @ np.linalg.lstsq(g, y)[0]) ** 2))
    return total / (spread**2 * (1 - keep**2))


def wander(rng: np.random.Generator, s: Session, spread: float) -> np.ndarray:
    """Draw the correlated noise of angles (rows, n) of an RMS in deg, in rad."""
    lengths, n = [run.stop - run.start for run in s.runs], s.q.shape[1]
    parts = [np.stack([process(rng, k, s.step, WANDER_S) for _ in range(n)], axis=1) for k in lengths]
    return np.radians(spread) * np.concatenate(parts)


def solved(base: Baseline, act: Act, usual: float, most: float, goal: float) -> float:
    """Return the size at which an effect has a lambda, or the largest that is possible.

    Parameters
    ----------
    base : Baseline
        Of the log.
    act : Act
        The effect.
    usual, most : float
        A size to begin with, and the largest.
    goal : float
        The wanted lambda.
    """

    def value(size: float) -> float:
        return sum(detectability(base, base.log.seen(act, size)).values())

    low, size = 0.0, min(usual, most)
    for _ in range(12):  # nearly all effects are nearly linear: the square root of lambda is
        now = value(size)
        if abs(now - goal) < 1e-3 * goal:
            return size
        if now > goal:
            return (
                float(brentq(lambda x: value(x) - goal, low, size, rtol=1e-4))
                if low
                else _down(value, size, now, goal)
            )
        if size >= most:
            return most
        low, size = size, min(most, size * float(np.clip(1.02 * np.sqrt(goal / max(now, 1e-9)), 1.02, 30)))
    return size


def _down(value: Callable[[float], float], size: float, now: float, goal: float) -> float:
    """Return the same from a size whose lambda is too large."""
    for _ in range(12):
        high, size = size, size * float(np.clip(0.98 * np.sqrt(goal / now), 0.02, 0.98))
        now = value(size)
        if abs(now - goal) < 1e-3 * goal:
            return size
        if now < goal:
            return float(brentq(lambda x: value(x) - goal, size, high, rtol=1e-4))
    return size
