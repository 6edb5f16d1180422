"""Verification of a written file in its simulator: model levels, the gap, and whether it passed.

An MJCF file stands in MuJoCo; of a URDF the kinematics of its constant geometry are compared, in MuJoCo and
in Pinocchio.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.effects import ALWAYS
from bayescal.effects.geometry import GEOMETRY
from bayescal.errors import BayescalError, refused_as
from bayescal.exporting.geometry import constant
from bayescal.exporting.mjcf.elastic import sprung
from bayescal.exporting.written import AGAIN, mujoco, pinocchio, read_sidecar, sidecar_of
from bayescal.fitted.arm import FittedArm, refitted
from bayescal.fitted.file import open_run
from bayescal.fitted.unmodelled import state_row
from bayescal.robots.tree import BETWEEN
from bayescal.robots.urdf import parse_markup
from bayescal.storage.reading import decoded
from bayescal.storage.stopping import Progress, silent
from bayescal.verifying.gap import After, Before, Gap, in_simulator, read_reported, simulated_gap
from bayescal.verifying.simulator import File, Level, chosen, levels, limit, modelled

Compared = tuple[tuple[Level, ...], Before, After, str]
"""Levels; TCP positions of another arm and of the file in rows of the session; the simulators."""


@dataclass(frozen=True)
class Verification:
    """A written file in its simulator."""

    arm: FittedArm
    path: Path
    format: str
    state: int
    software: str
    levels: tuple[Level, ...]
    gap: Gap | None
    missing: Mapping[str, float]  # RMS, m, of each effect that is not in the file
    carried: float = 0.0  # kg on the last body of a user's file, besides the tool

    @property
    def passed(self) -> bool:
        """Whether all differences are within their limits."""
        return all(level.passed for level in self.levels)


def verify(run: Path, path: Path, progress: Progress = silent) -> Verification:
    """Load a written file in its simulator, and replay the session.

    Raises
    ------
    BayescalError
        If the run folder has no arm, the simulator is not installed, or the file is not of this arm.
    """
    try:
        text = decoded(path)[0]
    except BayescalError as error:
        raise BayescalError(error.what, str(path), "give a file of bayescal export") from None
    sidecar = read_sidecar(path)
    if sidecar["format"] not in VERIFIED:
        what = f"is a file of the format {sidecar['format']}"
        raise BayescalError(what, str(path), f"bayescal verifies {' and '.join(VERIFIED)}")
    arm = _arm(run, sidecar, str(path))
    _check_alike(arm, sidecar, str(sidecar_of(path)))
    state = state_row(arm.dataset, row=sidecar["state"]["row"])
    arm, reported = sprung(arm) if sidecar["format"] == "mjcf" else arm, read_reported(run)
    compared, before, after, software = VERIFIED[sidecar["format"]](arm, path, text, sidecar, state, progress)
    progress("replay", 0.0)
    gap = simulated_gap(arm, before, after, reported)
    sizes = {e["effect"]: e["rms_um"] for e in sidecar["not_expressed"]}
    missing = {name: 1e-6 * size for name, size in sizes.items() if size}
    carried = float(sidecar.get("carried_kg", 0.0))
    return Verification(arm, path, sidecar["format"], state, software, compared, gap, missing, carried)


def _mjcf(
    arm: FittedArm, path: Path, text: str, sidecar: Mapping[str, Any], state: int, progress: Progress
) -> Compared:
    file = File.of(arm, text, path, sidecar)
    compared = levels(arm, file, state, progress)

    def before(other: FittedArm, rows: np.ndarray) -> np.ndarray:
        return in_simulator(other, File.new(other, state, file.script), rows, state)

    software = f"MuJoCo {mujoco().__version__}"
    return compared, before, lambda rows: in_simulator(arm, file, rows, state), software


def _urdf(
    arm: FittedArm, path: Path, text: str, sidecar: Mapping[str, Any], state: int, progress: Progress
) -> Compared:
    simulated, rows, rigid = simulators(text, sidecar, str(path)), chosen(arm), held(arm)
    model = modelled(rigid, rows, arm.dataset.measurements.readings[rows], state)
    compared = []
    for name, poses in simulated.items():
        off = np.linalg.norm(tool_points(arm, poses, sidecar, rows) - model, axis=1)
        compared.append(Level(f"geometry, {name}", off, limit((GEOMETRY.name,))))
    first = next(iter(simulated.values()))
    return (
        tuple(compared),
        lambda other, rows: held(other).at_rows(rows).points,
        lambda rows: tool_points(arm, first, sidecar, rows),
        ", ".join(simulated),
    )


def _arm(run: Path, sidecar: Mapping[str, Any], where: str) -> FittedArm:
    """The arm that was exported: that of the run, or of the same refit.

    Raises
    ------
    BayescalError
        If the file is of another session.
    """
    arm = open_run(run)
    if sidecar["dataset"]["name"] != arm.dataset.name or sidecar["robot"] != arm.dataset.robot.name:
        what = f"was exported from the session {sidecar['dataset']['name']}, not from {arm.dataset.name}"
        raise BayescalError(what, where, "give the run that was exported")
    more = [name for name in sidecar["model"] if name not in arm.effects]
    less = [name for name in arm.effects if name not in sidecar["model"]]
    less += [part for part in sidecar["without"] if part not in arm.origin.options.omitted]
    return refitted(arm, more, less) if more or less else arm


def _check_alike(arm: FittedArm, sidecar: Mapping[str, Any], where: str) -> None:
    """Refuse a sidecar with another row, other tools or other joints than the arm has."""
    n = arm.dataset.robot.n
    names = [t.name for t in arm.dataset.tools]
    sizes = [len(sidecar[key]) for key in ("joints", "signs", "joint_from_reading") if key in sidecar]
    sizes += [len(row) for row in sidecar.get("joint_from_reading", ())]
    for alike, what in (
        (sidecar["state"]["row"] in arm.dataset.measurements.ids, "the session has no row `state.row`"),
        ([t["name"] for t in sidecar["tools"]] == names, f"`tools` are not {', '.join(names)}"),
        (all(size == n for size in sizes), f"`joints` or their matrices are not of an arm with {n} joints"),
    ):
        if not alike:
            raise BayescalError(what, where, AGAIN)


SHOWN = ("visual", "collision")
"""Elements that need files of meshes."""
Poses = Callable[[np.ndarray], np.ndarray]
"""Poses (C, 4, 4) of the tip in the root of a file, at angles (C, n) of its joints, rad."""


def held(arm: FittedArm) -> FittedArm:
    """The arm with the parameters that a URDF holds; others are nominal."""
    kept = [constant(p) or p.effect in ALWAYS for p in arm.model.parameters]
    return arm.valued(np.where(kept, arm.values, 0.0))


def tool_points(arm: FittedArm, poses: Poses, sidecar: Mapping[str, Any], rows: np.ndarray) -> np.ndarray:
    """TCP positions (C, 3), m, in F0, in rows of the session."""
    m = arm.dataset.measurements
    angles = m.readings[rows] @ np.array(sidecar["joint_from_reading"]).T
    flange = np.array(sidecar["root_in_f0"]) @ poses(angles) @ np.array(sidecar["flange_in_tip"])
    tips = 1e-3 * np.array([tool["centre_mm"] for tool in sidecar["tools"]])[m.tool[rows]]
    return (flange[:, :3, :3] @ tips[..., None])[..., 0] + flange[:, :3, 3]


def simulators(text: str, sidecar: Mapping[str, Any], where: str) -> dict[str, Poses]:
    """Kinematics of a file by each simulator that is installed, by its name.

    Raises
    ------
    BayescalError
        If none is installed, or one refuses the file.
    """
    root = parse_markup(text.encode(), where)
    for link in root.iter("link"):
        for tag in SHOWN:
            for element in link.findall(tag):
                link.remove(element)
    joints, out, missing = list(sidecar["joints"].values()), {}, None
    for name, (module, kinematics) in SIMULATORS.items():
        try:
            library = module()
        except BayescalError as error:
            missing = error
            continue
        ends = sidecar["tip"].split(BETWEEN)
        *first, tip = [kinematics(library, root, joints, link, where) for link in ends]
        out[f"{name} {library.__version__}"] = partial(_between, first[0], tip) if first else tip
    if missing is not None and not out:
        raise missing
    return out


def _between(first: Poses, tip: Poses, angles: np.ndarray) -> np.ndarray:
    """Poses of the tip in the frame of a chain's first link."""
    return np.asarray(np.linalg.inv(first(angles)) @ tip(angles))


def _in_mujoco(mj: Any, root: ET.Element, joints: list[str], tip: str, where: str) -> Poses:
    tree = ET.fromstring(ET.tostring(root))
    ET.SubElement(ET.SubElement(tree, "mujoco"), "compiler", fusestatic="false", balanceinertia="true",
                  boundmass="1e-6", boundinertia="1e-9")  # fmt: skip
    with refused_as("MuJoCo refuses the file", where, AGAIN, ValueError, KeyError):
        model = mj.MjModel.from_xml_string(ET.tostring(tree, encoding="unicode"))
        addresses = [model.joint(name).qposadr[0] for name in joints]
        body = model.body(tip).id
    data = mj.MjData(model)

    def poses(angles: np.ndarray) -> np.ndarray:
        out = np.tile(np.eye(4), (len(angles), 1, 1))
        for k, angles_of_pose in enumerate(angles):
            data.qpos[addresses] = angles_of_pose
            mj.mj_kinematics(model, data)
            out[k, :3, :3], out[k, :3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        return out

    return poses


def _in_pinocchio(pin: Any, root: ET.Element, joints: list[str], tip: str, where: str) -> Poses:
    with refused_as("Pinocchio refuses the file", where, AGAIN, ValueError, RuntimeError):
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    for exists, kind, names in ((model.existJointName, "joint", joints), (model.existFrame, "link", [tip])):
        for name in names:
            if not exists(name):
                raise BayescalError(f"Pinocchio finds no {kind} `{name}`", where, AGAIN)
    data, frame = model.createData(), model.getFrameId(tip)
    moving = [model.joints[model.getJointId(name)] for name in joints]

    def poses(angles: np.ndarray) -> np.ndarray:
        out = []
        for angles_of_pose in angles.tolist():
            q = pin.neutral(model)
            for joint, angle in zip(moving, angles_of_pose, strict=True):
                # a continuous joint has the cosine and the sine of its angle
                turn = angle if joint.nq == 1 else (np.cos(angle), np.sin(angle))
                q[joint.idx_q : joint.idx_q + joint.nq] = turn
            pin.framesForwardKinematics(model, data, q)
            out.append(data.oMf[frame].homogeneous.copy())
        return np.array(out)

    return poses


SIMULATORS = {"MuJoCo": (mujoco, _in_mujoco), "Pinocchio": (pinocchio, _in_pinocchio)}
"""Module and kinematics of each simulator of a URDF."""


VERIFIED = {"mjcf": _mjcf, "urdf": _urdf}
"""Formats that are verified."""
