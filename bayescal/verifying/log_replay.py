"""Withheld motions replayed in MuJoCo from their first row and the logged commands alone.

The drives act by the controller of the log. What an arm file cannot hold, such as friction that grows with
load, is a torque along the motion of the simulation before: after a few simulations both agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.log_arm import text_of
from bayescal.exporting.sidecar import mujoco
from bayescal.logs import Log
from bayescal.logs.types import SERVO, VALIDATE
from bayescal.motion.controller import Law, law_of
from bayescal.motion.fit_settings import CONTROLLER
from bayescal.motion.named import NamedArm
from bayescal.motion.result import MotionGap, Tracking
from bayescal.motion.settings import OUTCOME
from bayescal.motion.signals import Signals, derivative, low_passed

Further = Callable[[Signals], tuple[np.ndarray, np.ndarray]]
"""Torques (N, n), N m, that act on the joints of a motion beside the file of the arm, and of the drives."""


@dataclass(frozen=True)
class Arm:
    """An arm in the simulator: its file as text, and what acts beside it."""

    text: str
    further: Further | None = None
    gain: np.ndarray | float = 1.0  # shown torque over the true one
    offset: np.ndarray | float = 0.0  # N m, of the shown torque
    late: float = 0.0  # s, of the commands


def replayed(
    simulator: Any, log: Log, parts: tuple[Signals, ...], arms: Mapping[str, Arm]
) -> dict[str, Tracking] | str:
    """Tracking and torque errors of withheld motions by arm, or in words why there are none.

    Parameters
    ----------
    simulator : module
        MuJoCo.
    log : Log
    parts : tuple of Signals
        All motions.
    arms : mapping of str to Arm
    """
    if log.mechanism.coupled:
        return "the joints are coupled, which the file of an arm cannot hold"
    law = law_of(log, parts)
    if isinstance(law, str):
        return law
    held = [s for s in parts if s.role == VALIDATE]
    lasting = np.cumsum([len(s.time) * s.step for s in held])
    held = held[: 1 + int(np.searchsorted(lasting, CONTROLLER.seconds))]
    out: dict[str, Tracking] = {}
    for name, arm in arms.items():
        position, torque, blocks = [], [], []
        for s in held:
            q, applied = _motion(simulator, arm, law.over(np.asarray(arm.gain)), s)
            far = np.max(np.abs(q - s.q)) if np.all(np.isfinite(q)) else np.inf
            if far > CONTROLLER.lost:
                what = "nowhere near" if np.isinf(far) else f"{far:.2g} rad off"
                return f"motion {s.name} of the {name} arm ends {what} the log: the replay is not a measure"
            moving = np.any(np.abs(s.unfiltered(s.dq)) > OUTCOME.moving, axis=1)
            position.append(s.unfiltered(q - s.q)[moving])
            torque.append(s.unfiltered(applied * arm.gain + arm.offset - _measured(s, arm.late))[moving])
            count = max(round(len(position[-1]) * s.step / OUTCOME.block), 1)
            blocks += [np.mean(part**2, axis=0) for part in np.array_split(position[-1], count)]
        out[name] = Tracking(rms(position), rms(torque), np.array(blocks), len(held))
    return out


def rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    """RMS (n,) of errors (N, n) in several motions, without those that are nan."""
    return np.asarray(np.sqrt(np.nanmean(np.concatenate(parts) ** 2, axis=0)))


def _motion(simulator: Any, arm: Arm, law: Law, s: Signals) -> tuple[np.ndarray, np.ndarray]:
    """Positions and torques (N, n) of a simulated motion."""
    commands = _commands(s, arm.late)
    s = replace(s, command=commands)
    model = _driven(simulator, arm.text, law, s)
    last = s
    acts = drives = np.zeros_like(s.q)
    for _ in range(CONTROLLER.passes):
        if arm.further is not None:
            acts, drives = arm.further(last)
        q, dq = _simulated(simulator, model, law, s, acts + drives)
        if not np.all(np.isfinite(q)):
            break
        change, last = np.sqrt(np.mean((q - last.q) ** 2)), _along(s, q, dq)
        error = np.sqrt(np.mean((q - s.q) ** 2))
        if arm.further is None or change < CONTROLLER.settled * error:
            break
    return q, law.torque(commands, _speed(s), q, dq) + drives


def _commands(s: Signals, late: float) -> np.ndarray:
    """Commands (N, n), rad, that were given so many seconds before each row."""
    assert s.command is not None
    return np.column_stack([np.interp(s.time - late, s.time, u) for u in s.command.T])


def _measured(s: Signals, late: float) -> np.ndarray:
    """Measured torques (N, n), N m; of position servos those by the commands on which they act."""
    if s.log.torque_kind != SERVO:
        return s.torque
    assert s.log.controller.stiffness is not None
    assert s.command is not None
    return s.torque + s.log.controller.stiffness * (_commands(s, late) - s.command)


def _along(s: Signals, q: np.ndarray, dq: np.ndarray) -> Signals:
    """A motion with the positions and speeds of a simulation."""
    smooth = low_passed(dq, s.step)
    return replace(s, q=q, dq=smooth, ddq=derivative(smooth, s.step))


def _speed(s: Signals) -> np.ndarray:
    assert s.command is not None
    return derivative(low_passed(s.command, s.step), s.step)


def _driven(simulator: Any, text: str, law: Law, s: Signals) -> Any:
    """The arm with the payload of a motion and a drive with the controller at each joint."""
    spec = simulator.MjSpec.from_string(text)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    payload, m = float(np.mean(s.payload)), s.log.mechanism
    if payload > 0.0:
        about = payload * np.full(3, max(m.payload_gyration, 1e-4) ** 2)
        body = spec.joints[-1].parent.add_body(pos=m.payload_centre, mass=payload, inertia=about)
        body.explicitinertial, body.ipos = True, np.zeros(3)
    for j, joint in enumerate(spec.joints):
        joint.name = joint.name or f"joint {j + 1}"
        joint.limited = simulator.mjtLimited.mjLIMITED_FALSE  # a machine may stand at the limits of its file
        drive = spec.add_actuator(target=joint.name, trntype=simulator.mjtTrn.mjTRN_JOINT)
        drive.gainprm[0], drive.biastype = law.stiffness[j], simulator.mjtBias.mjBIAS_AFFINE
        drive.biasprm[:3] = law.bias[j], -law.stiffness[j], -law.damping[j]
    spec.option.integrator = simulator.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    data = simulator.MjData(model)
    data.qpos[:] = s.q[0]
    simulator.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    simulator.mj_fullM(model, data, full)
    fastest = np.sqrt(np.max(law.stiffness / np.diag(full)))
    wanted = min(CONTROLLER.step, CONTROLLER.turn / fastest)
    model.opt.timestep = s.step / min(int(np.ceil(s.step / wanted)), CONTROLLER.steps)
    return model


def _simulated(
    simulator: Any, model: Any, law: Law, s: Signals, further: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and speeds (N, n) at the rows of a motion."""
    from mujoco import rollout

    assert s.command is not None
    n, every = s.log.n, round(s.step / model.opt.timestep)
    rows = np.arange(len(s.time), dtype=float)
    fine = np.arange((len(rows) - 1) * every) / every
    control = s.command + law.ahead / law.stiffness * _speed(s)
    inputs = [np.interp(fine, rows, x[:, j]) for x in (control, further) for j in range(n)]
    data = simulator.MjData(model)
    data.qpos[:], data.qvel[:] = s.q[0], s.dq[0]
    kind = simulator.mjtState
    start = np.zeros(simulator.mj_stateSize(model, kind.mjSTATE_FULLPHYSICS))
    simulator.mj_getState(model, data, start, kind.mjSTATE_FULLPHYSICS)
    spec = int(kind.mjSTATE_CTRL) | int(kind.mjSTATE_QFRC_APPLIED)
    states, _ = rollout.rollout(model, data, start, np.column_stack(inputs)[None], control_spec=spec)
    kept = np.vstack([start, states[0][every - 1 :: every]])[:, 1 : 1 + 2 * n]
    return kept[:, :n], kept[:, n:]


def replay_gap(gap: MotionGap) -> MotionGap:
    """A diagnosis with the replay of its withheld motions: nominal arm, model, and with the named effects."""
    log = gap.model.estimate.parts[0].log
    try:
        simulator = mujoco()
    except BayescalError as error:
        return replace(gap, tracking=f"{error.what}: motions are not replayed")
    arms = {"nominal": nominal_arm(log), "model": arm_in_file(gap.model)}
    if gap.arm is not gap.model:
        arms["effects"] = arm_in_file(gap.arm)
    return replace(gap, tracking=replayed(simulator, log, gap.model.estimate.parts, arms))


def nominal_arm(log: Log) -> Arm:
    """The nominal arm, with zero for what its mechanism does not state."""
    late, m = log.alignment if log.torque_kind == SERVO else 0.0, log.mechanism
    known = {key: np.nan_to_num(getattr(m, key)) for key in ("armature", "coulomb", "viscous")}
    return Arm(text_of(replace(m, **known), "mjcf", log.gravity), late=late)


def arm_in_file(arm: NamedArm, text: str = "") -> Arm:
    """An arm, in a file of its own or in another text, with what acts beside it."""
    text = text or text_of(arm.mechanism, "mjcf", arm.gravity)
    log = arm.estimate.parts[0].log
    late = log.alignment + arm.values.get("alignment", 0.0) if log.torque_kind == SERVO else 0.0
    return Arm(text, arm.further, arm.gain, arm.offset, late)
