"""The arm of a joint log: a built-in one, a file that is copied, or an MJCF model that is written out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.transforms import rpy_of
from bayescal.errors import BayescalError, listed
from bayescal.exporting.sidecar import mujoco
from bayescal.importing.joint_formats import DEG
from bayescal.logs.mechanism import PAIRS, TURNING_PART, bounds_of
from bayescal.robots import builtin_robots, full_name, load_robot, only_revolute
from bayescal.robots.markup import LARGEST, parse_markup
from bayescal.robots.servos import GRIPPER
from bayescal.storage.reading import content_of

MJCF = (".xml", ".mjcf")


@dataclass(frozen=True)
class Arm:
    """An arm of n joints, and how a joint log states it.

    `limits` (n, 2) rad, of the angles `coupling` (n, n) times the readings; `entry` of the key `robot`, a
    `file` to copy with its content, further `settings` of dataset.yaml, and what was assumed.
    """

    name: str
    joint_names: tuple[str, ...]
    limits: np.ndarray
    coupling: np.ndarray
    entry: Any
    file: tuple[str, bytes] | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)


def arm_of(reference: str, allow_xacro: bool) -> Arm:
    """The arm that a reference names: a built-in one, robot.yaml, URDF, xacro, or MJCF.

    Raises
    ------
    BayescalError
        As `load_robot`; of MJCF also without MuJoCo, and where its hinges are no serial chain.
    """
    file, mark, tip = reference.partition("#")
    if Path(file).suffix.lower() in MJCF:
        return _of_mjcf(Path(file))
    robot, content = load_robot(full_name(reference), allow_xacro=allow_xacro)
    only_revolute(robot, "joint logs", TURNING_PART)
    coupling = robot.link_from_reading
    signed = coupling * np.sign(np.diag(coupling))[:, None]
    bounds = bounds_of(robot)
    limits = np.where(np.isnan(bounds), (-np.inf, np.inf), bounds)
    if full_name(reference) in builtin_robots() and not Path(reference).is_file():
        return Arm(robot.name, robot.joint_names, limits, signed, full_name(reference))
    markup = Path(file).suffix.lower() in (".urdf", ".xacro")
    name = f"{Path(file).stem}.urdf" if markup else "robot.yaml"
    entry = name + mark + tip if markup else name
    return Arm(robot.name, robot.joint_names, limits, signed, entry, (name, content))


def _of_mjcf(path: Path) -> Arm:
    """The hinges of an MJCF model in order, without a gripper; a body belongs to the last one before it."""
    root = parse_markup(content_of(path, LARGEST), path.name)
    if root.tag != "mujoco":
        raise BayescalError(f"<{root.tag}> is no MJCF", f"{path.name}:1", "give a model of MuJoCo, or a URDF")
    from bayescal.exporting.mjcf.scene_arm import above  # slow to import

    mj = mujoco()
    try:
        model = mj.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise BayescalError(f"MuJoCo cannot load it: {error}", path.name, "correct the model") from None
    data = mj.MjData(model)
    hinges = [j for j in range(model.njnt) if model.jnt_type[j] == mj.mjtJoint.mjJNT_HINGE]
    arms = [j for j in hinges if not GRIPPER.search(model.joint(j).name)]
    names = tuple(model.joint(j).name or f"J{k + 1}" for k, j in enumerate(arms))
    chains = {j: above(model, int(model.jnt_bodyid[j])) for j in arms}
    apart = [b for a, b in pairwise(arms) if model.jnt_bodyid[a] not in chains[b]]
    if apart or not arms:
        what = f"the joints {listed(names, 12)} are no serial chain" if arms else "no hinge joints"
        raise BayescalError(what, path.name, "give a model of the arm alone")
    sliding = [j for j in range(model.njnt) if model.jnt_type[j] == mj.mjtJoint.mjJNT_SLIDE]
    if carrying := [j for j in sliding if int(model.jnt_bodyid[j]) in chains[arms[-1]]]:
        what = f"{model.joint(carrying[0]).name} is a slide joint: joint logs know revolute joints only"
        raise BayescalError(what, path.name, "give a model of the arm alone")
    data.qpos[[model.jnt_qposadr[j] for j in hinges]] = 0.0
    mj.mj_kinematics(model, data)
    mj.mj_comPos(model, data)
    carriers = [int(model.jnt_bodyid[j]) for j in arms]
    owners = [sum(carrier in above(model, b) for carrier in carriers) - 1 for b in range(model.nbody)]
    bodies = [[b for b, owner in enumerate(owners) if owner == k] for k in range(len(arms))]
    entries = [_joint(model, data, arms, k, names[k], bodies[k]) for k in range(len(arms))]
    limits = np.array([model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf) for j in arms])
    left = [model.joint(j).name for j in hinges if j not in arms]
    notes = [f"the arm is written out from {path.name}: {listed(names, 12)}"]
    if left or model.njnt > len(hinges):
        still = listed(left, 12) or "those that do not turn"
        notes.append(f"joints at zero, as parts of the last body: {still}")
    settings = {"gravity_mps2": [float(f"{g:.9g}") for g in model.opt.gravity]}
    entry, name = {"joints": entries}, root.get("model") or path.stem
    return Arm(name, names, limits, np.eye(len(arms)), entry, None, settings, tuple(notes))


def _joint(
    model: Any, data: Any, arms: Sequence[int], k: int, name: str, bodies: Sequence[int]
) -> dict[str, Any]:
    """The entry of a joint: its frame, and the masses of the bodies that it carries as one."""
    joint, frame = arms[k], np.asarray(data.xmat[model.jnt_bodyid[arms[k]]]).reshape(3, 3)
    before = np.asarray(data.xmat[model.jnt_bodyid[arms[k - 1]]]).reshape(3, 3) if k else np.eye(3)
    origin = data.xanchor[arms[k - 1]] if k else np.zeros(3)
    mass = float(sum(model.body_mass[b] for b in bodies))
    centre = sum((model.body_mass[b] * data.xipos[b] for b in bodies), np.zeros(3)) / max(mass, 1e-12)
    inertia = np.zeros((3, 3))
    for b in bodies:
        axes, arm = np.asarray(data.ximat[b]).reshape(3, 3), data.xipos[b] - centre
        inertia += axes @ np.diag(model.body_inertia[b]) @ axes.T
        inertia += model.body_mass[b] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    inertia = frame.T @ inertia @ frame
    of = int(model.jnt_dofadr[joint])
    values = {
        "origin_mm": 1e3 * (before.T @ (data.xanchor[joint] - origin)),
        "rpy_deg": DEG * rpy_of(before.T @ frame),
        "axis": frame.T @ data.xaxis[joint],
        "mass_kg": mass,
        "centre_of_mass_mm": 1e3 * (frame.T @ (centre - data.xanchor[joint])) if mass else np.zeros(3),
        "inertia_kgm2": np.array([inertia[i, j] for i, j in PAIRS]),
        "armature_kgm2": float(model.dof_armature[of]),
        "coulomb_Nm": float(model.dof_frictionloss[of]),
        "viscous_Nms_per_rad": float(np.ravel(model.dof_damping[of])[0]),
    }
    if model.jnt_limited[joint]:
        values["limits_deg"] = DEG * model.jnt_range[joint]
    known = {key: v for key, v in values.items() if np.ndim(v) or key == "mass_kg" or v}
    return {"name": name} | {key: _rounded(value) for key, value in known.items()}


def _rounded(value: Any) -> Any:
    return [float(f"{v:.12g}") + 0.0 for v in value] if np.ndim(value) else float(f"{value:.12g}")
