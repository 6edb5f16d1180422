"""Logs of position servos without torques: the error of a servo is a torque sensor.

A servo with proportional gain drives by kp (u(t - d) - q): with that as the torque, such a log is one of
torques. Friction holds a joint until the error exceeds it: its memory follows from the commands. The delay d
is alike to viscous friction, to first order.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.arm.transforms import compiled
from bayescal.errors import BayescalError, listed
from bayescal.logs import Log
from bayescal.logs.types import CALIBRATE, SERVO, Controller
from bayescal.motion.dynamics import carried, regressor
from bayescal.motion.fit_settings import SERVOS

SUBSTEPS = 8
"""Of the integration of a joint between two rows (assumed)."""


def is_servo(log: Log) -> bool:
    """Whether the errors of position servos stand for the torques of a log, which has none."""
    commanded = all(m.torque is None and m.command is not None for m in log.motions)
    return commanded and not log.torque_kind and log.controller.kind == "position"


def with_torques(log: Log) -> Log:
    """A log with torques: as it is, or of position servos the torques by their errors.

    Raises
    ------
    BayescalError
        If there are no torques with a sign, and no commands of position servos.
    """
    if all(m.torque is not None for m in log.motions):
        return log
    if not log.signed:
        raise BayescalError("torques have no sign: the log is not assessed", log.name, "log torque1_Nm ...")
    if not is_servo(log):
        what = "no torques are logged, and no commands of position servos"
        raise BayescalError(what, log.name, "log torque1_Nm ..., or command1_deg ... and `kind: position`")
    control, m = log.controller, log.mechanism
    stiffness, note = (control.stiffness, ()) if control.stiffness is not None else _stiffness(log)
    if control.damping is not None:  # is viscous friction where there are no torques
        m = replace(m, viscous=np.nan_to_num(m.viscous) + control.damping)
    step = float(np.median(np.concatenate([np.diff(m.time) for m in log.motions])))
    motions = tuple(
        replace(o, torque=stiffness * (o.command - o.position), velocity=None) for o in log.motions
    )
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
    names = [
        name for name, value in zip(log.mechanism.joint_names, estimated, strict=True) if np.isnan(value)
    ]
    stiffness = np.where(np.isnan(estimated), np.nanmedian(estimated), estimated)
    text = ", ".join(f"{value:.3g}" for value in stiffness)
    note = f"; of {listed(names)}, which gravity does not load enough, the median is assumed" if names else ""
    return stiffness, (f"stiffness of the servos by gravity on the stated masses: {text} N m/rad{note}",)


@compiled()
def stuck(
    command: np.ndarray, load: np.ndarray, drive: np.ndarray, first: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Friction of servos that follow commands, by an implicit integration of each joint.

    Parameters
    ----------
    command, load : np.ndarray, shape (N, n)
        rad; N m, of links and payload.
    drive : np.ndarray, shape (4, n)
        Stiffness, Coulomb and viscous friction, inertia of the rotor; SI, positive.
    first : np.ndarray, shape (n,)
        Positions at the first row, where the joints rest.
    step : float
        s, between rows.

    Returns
    -------
    tuple of np.ndarray, shape (N, n)
        Friction over its largest, -1 to 1; the side on which it was largest last; whether the joint moves.
    """
    rows, n = command.shape
    out, side, moving = np.zeros((rows, n)), np.zeros((rows, n)), np.zeros((rows, n))
    small = step / SUBSTEPS
    for j in range(n):
        stiffness, most, viscous, inertia = drive[:, j]
        heavy = viscous + stiffness * small + inertia / small
        q, v, last, held = first[j], 0.0, 0.0, 0.0
        for k in range(rows):
            before = max(k - 1, 0)
            went = 0.0
            for part in range(1, SUBSTEPS + 1):
                x = part / SUBSTEPS
                u = command[before, j] + x * (command[k, j] - command[before, j])
                w = load[before, j] + x * (load[k, j] - load[before, j])
                pull = stiffness * (u - q) - w + inertia / small * v
                if pull > most:
                    held, last, v = most, 1.0, (pull - most) / heavy
                elif pull < -most:
                    held, last, v = -most, -1.0, (pull + most) / heavy
                else:
                    held, v = pull, 0.0
                went += 1.0 if v != 0.0 else 0.0
                q += small * v
            out[k, j], side[k, j], moving[k, j] = held / most, last, went / SUBSTEPS
    return out, side, moving
