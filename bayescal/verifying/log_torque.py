"""The arm of a joint log in MuJoCo: the torques that withheld motions need there, against measured ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.log_arm import mechanism_of_run, values_of
from bayescal.exporting.sidecar import mujoco
from bayescal.logs import Log, Mechanism, read_log
from bayescal.logs.types import VALIDATE
from bayescal.motion.controller import law_of
from bayescal.motion.dynamics import payload_of, regressor
from bayescal.motion.effects import Scale
from bayescal.motion.estimate import estimated
from bayescal.motion.named import NamedArm, effect_of, named_arm
from bayescal.motion.pool import Pool
from bayescal.motion.result import Tracking
from bayescal.motion.servo import with_torques
from bayescal.motion.signals import Signals, all_signals
from bayescal.motion.terms import nominal as at_nominal
from bayescal.storage.reading import decoded, read_record
from bayescal.verifying.log_replay import Arm, arm_in_file, nominal_arm, replayed, rms

FITTED, NAMED, COPY = "fit.json", "gap.json", "dataset"
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
    name, schema = (NAMED, "bayescal-gap/1") if (run / NAMED).is_file() else (FITTED, "bayescal-fit/1")
    record = read_record(run / name, schema, "repeat the command with this version")
    log = with_torques(read_log(run / COPY))
    if not log.of_role(VALIDATE):
        raise BayescalError("no motion was withheld", str(run), "fit a log with a motion of role validate")
    fitted = mechanism_of_run(run, str(record["robot"]))
    simulator, text = mujoco(), decoded(path)[0]
    if "<mujoco" not in text:
        what = "is no MJCF: the torques of a joint log are verified with the rotors, which other formats lack"
        raise BayescalError(what, str(path), "export the arm with --to mjcf, and verify that file")
    try:
        model = simulator.MjModel.from_xml_string(text)
    except ValueError as error:
        raise BayescalError(f"MuJoCo does not load it: {error}", str(path), "export the arm again") from None
    if model.nv != log.n:
        raise BayescalError(f"has {model.nv} joints, the log {log.n}", str(path), "export the arm again")
    nominal = simulator.MjModel.from_xml_string(nominal_arm(log).text)
    for arm in (model, nominal):
        arm.jnt_limited[:] = 0  # a machine may stand at the limits of its file
    values, parts = values_of(record), all_signals(log)

    def each(name: str) -> np.ndarray:
        return np.array([values.get(f"{name} {j + 1}", 0.0) for j in range(log.n)])

    offset, gain = each("offset"), 1.0 + each("constant")
    gravity, start = np.array(record["gravity_mps2"]), at_nominal(log, np.ones(log.n))
    at = replace(start, shift=np.full(log.n, 1e-3 * record["torque_shift_ms"]))
    before: list[np.ndarray] = []
    after: list[np.ndarray] = []
    differences: list[np.ndarray] = []
    for s in parts:
        if s.role != VALIDATE:
            continue
        tilted = regressor(fitted, s.q, s.dq, s.ddq, gravity)
        load = payload_of(log.mechanism) * s.payload[:, None, None]
        slow = np.abs(s.unfiltered(s.dq)) < SLIDING
        for errors, arm, shown, by in (
            (before, nominal, start.measured(s), s.rigid),
            (after, model, (at.measured(s) - offset) / gain, tilted),
        ):
            off = s.unfiltered(shown - inverse(simulator, arm, s) - np.sum(by[:, :, -1] * load, axis=2))
            errors.append(np.where(slow, np.nan, off))
        rigid = np.einsum("njkp,kp->nj", tilted, fitted.inertials) + fitted.armature * s.ddq
        bodies = np.max(np.abs(_without_friction(simulator, model, s) - rigid), axis=0)
        differences.append(bodies + _friction(model, fitted, np.max(np.abs(s.dq), axis=0)))
    return LogVerification(
        name=log.name,
        joints=log.mechanism.joint_names,
        path=path,
        software=f"MuJoCo {simulator.__version__}",
        difference=np.max(differences, axis=0),
        nominal=rms(before),
        fitted=rms(after),
        rows=sum(map(len, after)),
        tracking=replayed(simulator, log, parts, _arms(log, parts, fitted, values, text)),
    )


def _arms(
    log: Log, parts: tuple[Signals, ...], fitted: Mechanism, values: Mapping[str, float], text: str
) -> dict[str, Arm]:
    """The arms to be replayed: nominal, fitted, and with the effects of a diagnosis."""
    if isinstance(law_of(log, parts), str):
        return {}
    estimate = estimated(parts)
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


def _friction(model: Any, m: Mechanism, fastest: np.ndarray) -> np.ndarray:
    """Largest difference (n,), N m, of the friction of both up to speeds (n,), rad/s."""
    return np.asarray(
        np.abs(model.dof_frictionloss - m.coulomb) + np.abs(model.dof_damping - m.viscous) * fastest
    )


def record_of(v: LogVerification) -> Mapping[str, Any]:
    """The content of verify.json."""
    rows = zip(v.joints, v.difference, v.nominal, v.fitted, strict=True)
    tracked = {} if isinstance(v.tracking, str) else v.tracking
    return {
        "schema": "bayescal-log-verify/1",
        "dataset": {"name": v.name},
        "file": str(v.path),
        "simulator": v.software,
        "passed": v.passed,
        "rows": v.rows,
        "joints": [
            {"joint": n, "difference_Nm": d, "nominal_rms_Nm": b, "rms_Nm": a}
            for n, d, b, a in ((n, *map(float, x)) for n, *x in rows)
        ],
        "tracking": {
            name: {"rms_deg": np.rad2deg(of.rms).tolist(), "torque_rms_Nm": of.torque.tolist()}
            for name, of in tracked.items()
        }
        or {"not_assessed": v.tracking},
    }
