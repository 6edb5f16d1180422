"""The controller of a log, from commands to torques: as stated, or by least squares on the log.

torque = stiffness (u - q) + ahead du - damping dq + bias, of each joint. A delay of the command is alike to a
smaller `ahead`, to first order. A controller with feed-forward torques is not of this form, and is refused.
Damping is of the speed in some controllers (`ahead` is 0), of its error in others (`ahead` is the damping):
measured torques tell which.

A servo with proportional gain drives by kp (u(t - d) - q): with that as the torque, a log of position servos
without torques is one of torques. Friction holds a joint until the error exceeds it: its memory follows from
the commands. The delay d is alike to viscous friction, to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.errors import BayescalError, listed
from bayescal.logs import Log
from bayescal.logs.types import CALIBRATE, SERVO, VALIDATE, Controller
from bayescal.motion.dynamics import carried, regressor
from bayescal.motion.fit_settings import CONTROLLER, SERVOS
from bayescal.motion.settings import SIGNALS
from bayescal.motion.signals import Signals, derivative, each, low_passed
from bayescal.motion.terms import nominal


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


def with_controller(parts: tuple[Signals, ...]) -> tuple[Signals, ...]:
    """Signals with a log whose stated controller acts as the measured torques say.

    Where they are no function of commands and positions the controller is not complete.
    """
    log = parts[0].log
    control = log.controller
    measured = log.torque_kind not in (SERVO, "sensor")  # a sensor behind the gear does not show the drive
    if control.stiffness is None or not measured or any(m.command is None for m in log.motions):
        return parts
    moves = np.any([np.ptp(m.position, axis=0) > SIGNALS.rest_range for m in log.motions], axis=0)
    if not np.any(moves):  # the torque of a joint at rest tells nothing of its gains
        return parts
    gains, unexplained = _fitted(parts)
    damping = np.zeros(log.n) if control.damping is None else control.damping
    acts = moves & (damping > 0.0) & (gains[2] > 0.0)
    of_errors = bool(np.any(acts)) and float(np.median(gains[1][acts] / gains[2][acts])) > CONTROLLER.ahead
    complete = bool(np.median(unexplained[moves]) <= CONTROLLER.further)
    complete = complete and float(np.median(_beside_gains(parts)[moves])) <= CONTROLLER.beside
    control = replace(control, ahead=damping if of_errors else 0.0 * damping, complete=complete)
    notes = log.notes
    if control.kind == "position" and not complete:
        what = "the stated gains do not give the measured torques: there is feed-forward or an integral"
        notes += (f"tracking errors are not assessed: {what}",)
    log = replace(log, controller=control, notes=notes)
    return tuple(s.changed(log=log) for s in parts)


def _beside_gains(parts: tuple[Signals, ...]) -> np.ndarray:
    """Share (n,) of the nominal torques of links and rotors that stands beside the gains.

    1 with feed-forward, and of slow motions with an integral; near 0 of gains alone, whose errors carry them.
    """
    used = tuple(s for s in parts if s.role == CALIBRATE)
    rows, model = _rows(used), nominal(used[0].log, np.ones(used[0].log.n))
    asked = np.concatenate([s.unfiltered(model.load(s) + model.armature * s.ddq) for s in each(used)])
    of_joints = zip(rows.transpose(1, 0, 2), asked.T, strict=True)
    problems = ((np.column_stack([x[:, :-1], load]), x[:, -1]) for x, load in of_joints)
    return np.array([np.linalg.lstsq(x, y, rcond=None)[0][-1] for x, y in problems])


def law_of(log: Log, parts: tuple[Signals, ...]) -> Law | str:
    """The controller, or in words why it does not follow from the log."""
    if any(m.command is None for m in log.motions):
        return "no commands are logged: there is nothing to replay"
    control, none = log.controller, np.zeros(log.n)
    if control.stiffness is not None and control.complete:
        damping = none if control.damping is None else control.damping
        ahead = damping if control.kind == "torque" else none
        ahead = ahead if control.ahead is None else control.ahead
        return Law(control.stiffness, damping, ahead, none, log.torque_kind != SERVO)
    gains, unexplained = _fitted(parts)
    if np.max(unexplained) > CONTROLLER.unexplained or np.min(gains[0]) <= 0.0:
        if np.min(gains[0]) <= 0.0:
            unexplained = np.where(np.arange(log.n) == np.argmin(gains[0]), unexplained, 0.0)
        why = f"the controller does not follow from the log: {_further(log, unexplained)}"
        return why if control.stiffness is not None else f"{why}; state `kp_Nm_per_rad` and `kd_Nms_per_rad`"
    return Law(gains[0], gains[2], gains[1], gains[3], False)


def _further(log: Log, unexplained: np.ndarray) -> str:
    """What a controller leaves of the torques, in words, by shares (n,) of their variances."""
    worst = int(np.argmax(unexplained))
    share, name = f"{100 * min(unexplained[worst], 1.0):.0f} %", log.mechanism.joint_names[worst]
    return f"{share} of the variance of the torque of {name} is no function of command and position"


def _fitted(parts: tuple[Signals, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Gains (4, n), as `TERMS`, and the share (n,) of the variance of withheld torques that they leave."""
    fitted = _rows(tuple(s for s in parts if s.role == CALIBRATE))
    held = _rows(tuple(s for s in parts if s.role == VALIDATE) or parts)
    gains = np.empty((len(TERMS), fitted.shape[1]))
    unexplained = np.empty(fitted.shape[1])
    for j in range(len(unexplained)):
        x, y = fitted[:, j, :-1], fitted[:, j, -1]
        gains[:, j] = np.linalg.lstsq(x, y, rcond=None)[0]
        off = held[:, j, -1] - held[:, j, :-1] @ gains[:, j]
        unexplained[j] = np.var(off) / max(np.var(held[:, j, -1]), 1e-300)
    return gains, unexplained


def _rows(parts: tuple[Signals, ...]) -> np.ndarray:
    """Rows (N, n, 5) of each joint: error, commanded speed, minus speed, 1, torque."""
    out = []
    for s in parts:
        assert s.command is not None
        u = low_passed(s.command, s.step)
        columns = (u - s.q, derivative(u, s.step), -s.dq, np.ones_like(u), low_passed(s.torque, s.step))
        out.append(s.unfiltered(np.stack(columns, axis=2)))
    return np.concatenate(out)


def is_servo(log: Log) -> bool:
    """Whether the errors of position servos stand for the torques of a log, which has none."""
    commanded = all(m.torque is None and m.command is not None for m in log.motions)
    return commanded and not log.torque_kind and log.controller.kind == "position"


def unfollowed(log: Log) -> str:
    """In words the joints whose positions do not follow their commands; "" of none, and without commands.

    By the correlation of positions with commands at the delay at which it is largest.
    """
    step = float(np.median(np.concatenate([np.diff(m.time) for m in log.motions])))
    every = max(round(CONTROLLER.coarse / step), 1)
    pairs = [(m.command[::every], m.position[::every]) for m in log.motions if m.command is not None]
    if not pairs:
        return ""
    now, _ = _correlations(pairs, 0)
    most = min(round(CONTROLLER.latest / (step * every)), max(len(u) for u, _ in pairs) // 2)
    late = [_correlations(pairs, k) for k in range(-most, most + 1)]
    commanded, moved = (np.ptp(np.concatenate(x), axis=0) for x in zip(*pairs, strict=True))
    names, out = log.mechanism.joint_names, dict[str, list[str]]()
    for j in np.flatnonzero(np.maximum(commanded, moved) > CONTROLLER.moved).tolist():
        r, slope = max((of[j, j], by[j, j]) for of, by in late)
        other, what, name = int(np.argmax(now[j])), "positions do not follow commands", names[j]
        if now[j, j] < -CONTROLLER.follows:
            what = "positions move against commands"
        elif r <= CONTROLLER.follows and now[j, other] > CONTROLLER.follows:
            what, name = "positions follow the command of another joint", f"{name} that of {names[other]}"
        elif r > CONTROLLER.follows:
            what = f"positions move {slope:.2g} times as far as commands"
            if 1.0 / CONTROLLER.times < slope < CONTROLLER.times:
                continue
        out.setdefault(what, []).append(name)
    return "; ".join(f"{what} ({listed(of)})" for what, of in out.items())


def _correlations(pairs: Sequence[tuple[np.ndarray, np.ndarray]], late: int) -> tuple[np.ndarray, np.ndarray]:
    """Correlations (n, n) of positions with commands so many rows before, and slopes by these."""
    u, q = (
        np.concatenate([x[max(k, 0) : len(x) + min(k, 0)] for x in of if len(x) > abs(late)])
        for of, k in zip(zip(*pairs, strict=True), (-late, late), strict=True)
    )
    u, q = u - u.mean(axis=0), q - q.mean(axis=0)
    products, square = q.T @ u, np.maximum(np.sum(u**2, axis=0), np.finfo(float).tiny)
    size = np.sqrt(np.outer(np.maximum(np.sum(q**2, axis=0), np.finfo(float).tiny), square))
    return products / size, products / square


MISMATCHED = "check the unit (deg), the sign and the order of `command1_deg` ..."
"""Remedy of positions that do not follow commands."""


def with_torques(log: Log) -> Log:
    """A log with torques: as it is, or of position servos the torques by their errors.

    Raises
    ------
    BayescalError
        If there are no torques with a sign, and no commands of position servos, or positions do not follow
        the commands.
    """
    if all(m.torque is not None for m in log.motions):
        return log
    if not log.signed:
        raise BayescalError("torques have no sign: the log is not assessed", log.name, "log torque1_Nm ...")
    if not is_servo(log):
        what = "no torques are logged, and no commands of position servos"
        raise BayescalError(what, log.name, "log torque1_Nm ..., or command1_deg ... and `kind: position`")
    if wrong := unfollowed(log):
        raise BayescalError(wrong, log.name, MISMATCHED)
    control, m = log.controller, log.mechanism
    stiffness, note = (control.stiffness, ()) if control.stiffness is not None else _stiffness(log)
    if control.damping is not None:  # is viscous friction where there are no torques
        m = replace(m, viscous=np.nan_to_num(m.viscous) + control.damping)
    step = float(np.median(np.concatenate([np.diff(m.time) for m in log.motions])))
    torques = ((o, stiffness * (o.command - o.position)) for o in log.motions)
    motions = tuple(replace(o, torque=torque, velocity=None) for o, torque in torques)
    return replace(
        log, motions=motions, mechanism=m, torque_kind=SERVO,
        controller=Controller(control.kind, stiffness, None, control.stiffness is not None),
        alignment=0.5 * step, u_alignment=SERVOS.delay, u_constant=SERVOS.gain, notes=(*log.notes, *note),
    )  # fmt: skip


def _stiffness(log: Log) -> tuple[np.ndarray, tuple[str, ...]]:
    """Stiffness (n,) by which gravity makes servos sag, N m/rad, and a note; of others it is the median.

    The load by gravity counts where it varies by more than the u of masses and centres makes of it.
    """
    errors, columns, doubts = [], [], []
    body = log.mechanism.inertials[:, :4]
    centre = np.eye(4)[1:, None] * (log.mechanism.u.centre * body[:, :1])
    u = np.concatenate([[log.mechanism.u.mass * body], centre])  # of mass, and of each coordinate
    for m in (m for m in log.motions if m.role == CALIBRATE):
        assert m.command is not None
        still, speed = np.zeros_like(m.position), np.gradient(m.command, m.time, axis=0)
        by = regressor(log.mechanism, m.position, still, still, log.gravity)
        load = carried(by, log.mechanism.inertials, log.mechanism, m.payload)
        errors.append(m.command - m.position)
        doubts.append(np.einsum("njkp,dkp->njdk", by[..., :4], u).reshape(*load.shape, -1))
        columns.append(np.stack([load, speed, np.tanh(speed / SERVOS.speed), np.ones_like(speed)], axis=2))
    e, x = np.concatenate(errors), np.concatenate(columns)
    doubt = np.sqrt(np.sum(np.var(np.concatenate(doubts), axis=0), axis=1))
    loaded = np.std(x[:, :, 0], axis=0) > SERVOS.loaded * doubt
    estimated = np.full(log.n, np.nan)
    for j in range(log.n):
        gains, *_ = np.linalg.lstsq(x[:, j], e[:, j], rcond=None)
        moves = abs(gains[0]) * np.std(x[:, j, 0])
        if loaded[j] and gains[0] > 0.0 and moves > SERVOS.sag * np.std(e[:, j] - x[:, j] @ gains):
            estimated[j] = 1.0 / gains[0]
    if np.all(np.isnan(estimated)):
        what = "the stiffness of the servos does not follow from the log: no joint sags by gravity"
        raise BayescalError(what, log.name, "state `kp_Nm_per_rad`")
    every = zip(log.mechanism.joint_names, estimated, strict=True)
    names = [name for name, value in every if np.isnan(value)]
    stiffness = np.where(np.isnan(estimated), np.nanmedian(estimated), estimated)
    text = ", ".join(f"{value:.3g}" for value in stiffness)
    note = f"; of {listed(names)}, which gravity does not load enough, the median is assumed" if names else ""
    return stiffness, (f"stiffness of the servos by gravity on the stated masses: {text} N m/rad{note}",)
