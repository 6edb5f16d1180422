"""The arm of a joint log in MuJoCo: withheld motions replayed, and the torques that they need there.

A replay begins at the first row of a motion and has the logged commands alone; the drives act by the
controller of the log. What an arm file cannot hold, such as friction that grows with load, is a torque along
the motion of the simulation before: after a few simulations both agree.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError, refused_as
from bayescal.exporting.log_arm import mechanism_of_run, text_of, values_of
from bayescal.exporting.written import mujoco
from bayescal.logs import Log, Mechanism, read_log
from bayescal.logs.types import SERVO, VALIDATE
from bayescal.motion.controller import Law, law_of, with_torques
from bayescal.motion.diagnose import MotionGap, Tracking
from bayescal.motion.dynamics import payload_of, regressor
from bayescal.motion.effects import Scale
from bayescal.motion.estimate import Estimate, estimate_of
from bayescal.motion.fit_settings import CONTROLLER
from bayescal.motion.pool import Pool
from bayescal.motion.possible import NamedArm, effect_of, named_arm
from bayescal.motion.settings import OUTCOME
from bayescal.motion.signals import Signals, derivative, low_passed
from bayescal.motion.terms import by_joint
from bayescal.motion.terms import nominal as at_nominal
from bayescal.storage.reading import decoded, run_record

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
            far = np.max(np.abs(q - s.position)) if np.all(np.isfinite(q)) else np.inf
            if far > CONTROLLER.lost:
                what = "nowhere near" if np.isinf(far) else f"{far:.2g} rad off"
                return f"motion {s.name} of the {name} arm ends {what} the log: the replay is not a measure"
            moving = np.any(np.abs(s.unfiltered(s.dq)) > OUTCOME.moving, axis=1)
            position.append(s.unfiltered(q - s.position)[moving])
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
    commands, measured = _commands(s, arm.late), s.position
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
        error = np.sqrt(np.mean((q - measured) ** 2))
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
    return replace(s, q=q, dq=smooth, ddq=derivative(smooth, s.step), reversing=None)


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
    values = {key: np.nan_to_num(getattr(m, key)) for key in ("armature", "coulomb", "viscous")}
    return Arm(text_of(replace(m, **values), "mjcf", log.gravity), late=late)


def arm_in_file(arm: NamedArm, text: str = "") -> Arm:
    """An arm, in a file of its own or in another text, with what acts beside it."""
    text = text or text_of(arm.mechanism, "mjcf", arm.gravity)
    log = arm.estimate.parts[0].log
    late = log.alignment + arm.values.get("alignment", 0.0) if log.torque_kind == SERVO else 0.0
    return Arm(text, arm.further, arm.gain, arm.offset, late)


COPY = "dataset"
SLIDING = 0.1
"""rad/s of a joint, below which a simulator's friction holds it and no motion determines the torque."""
ALIKE = 1e-6
"""N m: differences of rigid-body torques between simulator and model that are rounding."""


@dataclass(frozen=True)
class LogVerification:
    """An exported arm in MuJoCo: by joint (n,), N m."""

    name: str
    joints: tuple[str, ...]
    path: Path
    software: str
    difference: np.ndarray  # largest, of rigid bodies, rotors and friction between simulator and model
    nominal: np.ndarray  # RMS of measured torques less those of the nominal arm in the simulator
    fitted: np.ndarray  # the same of the exported file
    rows: int  # of withheld motions; each joint counts where it moves faster than `SLIDING`
    tracking: Mapping[str, Tracking] | str  # replays of the arms, or why there are none

    @property
    def passed(self) -> bool:
        """Whether the file is the arm that was fitted."""
        return bool(np.max(self.difference) < ALIKE)


def verify_log(run: Path, path: Path) -> LogVerification:
    """Load an exported arm of a joint log in MuJoCo, and compute the torques of the withheld motions.

    Raises
    ------
    BayescalError
        If the run has no copy of its log, MuJoCo is not installed, or it does not load the file.
    """
    if not (run / COPY).is_dir():
        what = "the run folder has no copy of its log, which was too large"
        raise BayescalError(what, str(run), "fit a part of it, and verify by that")
    _, record = run_record(run, "gap", "fit")
    log = with_torques(read_log(run / COPY))
    if not log.of_role(VALIDATE):
        raise BayescalError("no motion was withheld", str(run), "fit a log with a motion of role validate")
    fitted = mechanism_of_run(run, str(record["robot"]))
    simulator, text = mujoco(), decoded(path)[0]
    if "<mujoco" not in text:
        what = "is no MJCF: the torques of a joint log are verified with the rotors, which other formats lack"
        raise BayescalError(what, str(path), "export the arm with --to mjcf, and verify that file")
    with refused_as("MuJoCo does not load it", str(path), "export the arm again", ValueError):
        model = simulator.MjModel.from_xml_string(text)
    if model.nv != log.n:
        raise BayescalError(f"has {model.nv} joints, the log {log.n}", str(path), "export the arm again")
    nominal = simulator.MjModel.from_xml_string(nominal_arm(log).text)
    for arm in (model, nominal):
        arm.jnt_limited[:] = 0  # a machine may stand at the limits of its file
    values, estimate = values_of(record), estimate_of(log)  # in the band of the run
    parts, log = estimate.parts, estimate.parts[0].log
    offset, gain = by_joint(values, log.n, "offset"), 1.0 + by_joint(values, log.n, "constant")
    gravity, start = np.array(record["gravity_mps2"]), at_nominal(log, np.ones(log.n))
    aligned = replace(start, shift=np.full(log.n, 1e-3 * record["torque_shift_ms"]))
    before, after, differences = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for s in (part for part in parts if part.role == VALIDATE):
        tilted = regressor(fitted, s.q, s.dq, s.ddq, gravity)
        load = payload_of(log.mechanism) * s.payload[:, None, None]
        slow = np.abs(s.unfiltered(s.dq)) < SLIDING
        for errors, arm, shown, by in (
            (before, nominal, start.measured(s), s.rigid),
            (after, model, (aligned.measured(s) - offset) / gain, tilted),
        ):
            off = s.unfiltered(shown - inverse(simulator, arm, s) - np.sum(by[:, :, -1] * load, axis=2))
            errors.append(np.where(slow, np.nan, off))
        rigid = np.einsum("njkp,kp->nj", tilted, fitted.inertials) + fitted.armature * s.ddq
        bodies = np.max(np.abs(_without_friction(simulator, model, s) - rigid), axis=0)
        viscous = np.abs(model.dof_damping - fitted.viscous) * np.max(np.abs(s.dq), axis=0)
        differences.append(bodies + (np.abs(model.dof_frictionloss - fitted.coulomb) + viscous))
    return LogVerification(
        name=log.name, joints=log.mechanism.joint_names, path=path,
        software=f"MuJoCo {simulator.__version__}", difference=np.max(differences, axis=0),
        nominal=rms(before), fitted=rms(after), rows=sum(map(len, after)),
        tracking=replayed(simulator, log, parts, _arms(estimate, fitted, values, text)),
    )  # fmt: skip


def _arms(estimate: Estimate, fitted: Mechanism, values: Mapping[str, float], text: str) -> dict[str, Arm]:
    """The arms to be replayed: nominal, fitted, and with the effects of a diagnosis."""
    log = estimate.parts[0].log
    if isinstance(law_of(log, estimate.parts), str):
        return {}
    named = any(map(effect_of, values))
    scale = Pool.of(estimate).scale if named else Scale(estimate.rms, estimate.rms, 0.0)
    arm = arm_in_file(NamedArm(estimate, scale, fitted, log.gravity, values), text)
    if not named:
        return {"nominal": nominal_arm(log), "model": arm}
    model = named_arm(estimate, estimate.fit(), scale)
    return {"nominal": nominal_arm(log), "model": arm_in_file(model), "effects": arm}


def inverse(simulator: Any, model: Any, s: Signals) -> np.ndarray:
    """Torques (N, n) that the simulator needs for a motion, with friction."""
    data, out = simulator.MjData(model), np.empty_like(s.q)
    for k in range(len(s.q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = s.q[k], s.dq[k], s.ddq[k]
        simulator.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def _without_friction(simulator: Any, model: Any, s: Signals) -> np.ndarray:
    """Torques (N, n) of rigid bodies and rotors in the simulator."""
    kept = model.dof_frictionloss.copy(), model.dof_damping.copy()
    model.dof_frictionloss[:], model.dof_damping[:] = 0.0, 0.0
    out = inverse(simulator, model, s)
    model.dof_frictionloss[:], model.dof_damping[:] = kept
    return out


def record_of(v: LogVerification) -> dict[str, Any]:
    """The content of verify.json."""
    rows = zip(v.joints, v.difference, v.nominal, v.fitted, strict=True)
    tracked = {} if isinstance(v.tracking, str) else v.tracking
    return {
        "schema": "bayescal-log-verify/1", "dataset": {"name": v.name}, "file": str(v.path),
        "simulator": v.software, "passed": v.passed, "rows": v.rows,
        "joints": [
            {"joint": n, "difference_Nm": d, "nominal_rms_Nm": b, "rms_Nm": a}
            for n, d, b, a in ((n, *map(float, x)) for n, *x in rows)
        ],
        "tracking": {
            name: {"rms_deg": np.rad2deg(of.rms).tolist(), "torque_rms_Nm": of.torque.tolist()}
            for name, of in tracked.items()
        }
        or {"not_assessed": v.tracking},
    }  # fmt: skip
