"""The controller of a log, from commands to torques: as stated, or by least squares on the log.

torque = stiffness (u - q) + ahead du - damping dq + bias, of each joint. A delay of the command is alike to a
smaller `ahead`, to first order. A controller with feed-forward torques is not of this form, and is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.logs import Log
from bayescal.logs.types import CALIBRATE, SERVO, VALIDATE
from bayescal.motion.fit_settings import CONTROLLER
from bayescal.motion.signals import Signals, derivative, low_passed


@dataclass(frozen=True)
class Law:
    """Gains (n,) at the joints, SI, and where they are from."""

    stiffness: np.ndarray  # N m/rad
    damping: np.ndarray  # N m s/rad
    ahead: np.ndarray  # N m s/rad, of the commanded speed
    bias: np.ndarray  # N m
    stated: bool  # in N m: measured torques do not scale it

    def torque(self, u: np.ndarray, du: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torques (N, n) of the drives at commands and positions (N, n)."""
        return self.stiffness * (u - q) + self.ahead * du - self.damping * dq + self.bias

    def over(self, gain: np.ndarray) -> Law:
        """The controller of true torques, if it was estimated by torques that are `gain` (n,) times these."""
        if self.stated:
            return self
        return replace(self, **{name: getattr(self, name) / gain for name in TERMS})


TERMS = ("stiffness", "ahead", "damping", "bias")


def law_of(log: Log, parts: tuple[Signals, ...]) -> Law | str:
    """The controller, or in words why it does not follow from the log."""
    if any(m.command is None for m in log.motions):
        return "no commands are logged: there is nothing to replay"
    control, none = log.controller, np.zeros(log.n)
    if control.stiffness is not None:
        damping = none if control.damping is None else control.damping
        ahead = damping if control.kind == "torque" else none
        return Law(control.stiffness, damping, ahead, none, log.torque_kind != SERVO)
    fitted = _rows(tuple(s for s in parts if s.role == CALIBRATE))
    held = _rows(tuple(s for s in parts if s.role == VALIDATE))
    gains = np.empty((len(TERMS), log.n))
    left = np.empty(log.n)
    for j in range(log.n):
        x, y = fitted[:, j, :-1], fitted[:, j, -1]
        gains[:, j] = np.linalg.lstsq(x, y, rcond=None)[0]
        off = held[:, j, -1] - held[:, j, :-1] @ gains[:, j]
        left[j] = np.var(off) / max(np.var(held[:, j, -1]), 1e-300)
    worst = int(np.argmax(left))
    if left[worst] > CONTROLLER.unexplained or np.min(gains[0]) <= 0.0:
        worst = int(np.argmin(gains[0])) if np.min(gains[0]) <= 0.0 else worst
        return (
            f"the controller does not follow from the log: {100 * min(left[worst], 1.0):.0f} % of the "
            f"variance of the torque of {log.mechanism.joint_names[worst]} is no function of command and "
            "position; state `kp_Nm_per_rad` and `kd_Nms_per_rad`"
        )
    return Law(gains[0], gains[2], gains[1], gains[3], False)


def _rows(parts: tuple[Signals, ...]) -> np.ndarray:
    """Rows (N, n, 5) of each joint: error, commanded speed, minus speed, 1, torque."""
    out = []
    for s in parts:
        assert s.command is not None
        u = low_passed(s.command, s.step)
        each = (u - s.q, derivative(u, s.step), -s.dq, np.ones_like(u), low_passed(s.torque, s.step))
        out.append(s.unfiltered(np.stack(each, axis=2)))
    return np.concatenate(out)
