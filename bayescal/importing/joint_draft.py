"""From a log of motions to a joint log: dataset.yaml, motion.csv.gz or motion.parquet, and the robot.

The arm is a built-in one, a file that is copied, or an MJCF model that is written out.
"""

import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from bayescal.arm.transforms import rpy_of
from bayescal.errors import BayescalError, listed, refused_as
from bayescal.exporting.written import mujoco
from bayescal.importing.ask import MOTION_FORMATS, Request
from bayescal.importing.joint_bags import is_bag, read_bag
from bayescal.importing.joint_formats import AIDS, DEG, FORMATS, SINGLE, Record, of_logs
from bayescal.importing.joint_rows import Rows, divided, repeats, roles
from bayescal.importing.joint_tables import is_lerobot, read_lerobot, read_sage, read_table, sage_folders
from bayescal.importing.joint_torques import contradiction, one_torque
from bayescal.logs import SCHEMA, read_log
from bayescal.logs.read import PER_JOINT
from bayescal.logs.types import PAIRS, mechanism_of
from bayescal.robots import builtin_robots, full_name, load_robot
from bayescal.robots.servos import GRIPPER
from bayescal.robots.urdf import LARGEST, parse_markup
from bayescal.storage.files import si
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
    m, _ = mechanism_of(robot)
    limits = np.where(np.isnan(m.limits), (-np.inf, np.inf), m.limits)
    if full_name(reference) in builtin_robots() and not Path(reference).is_file():
        return Arm(m.name, m.joint_names, limits, m.coupling, full_name(reference))
    markup = Path(file).suffix.lower() in (".urdf", ".xacro")
    name = f"{Path(file).stem}.urdf" if markup else "robot.yaml"
    entry = name + mark + tip if markup else name
    return Arm(m.name, m.joint_names, limits, m.coupling, entry, (name, content))


def _of_mjcf(path: Path) -> Arm:
    """The hinges of an MJCF model in order, without a gripper; a body belongs to the last one before it."""
    root = parse_markup(content_of(path, LARGEST), path.name)
    if root.tag != "mujoco":
        raise BayescalError(f"<{root.tag}> is no MJCF", f"{path.name}:1", "give a model of MuJoCo, or a URDF")
    from bayescal.exporting.mjcf.scene_arm import above  # slow to import

    mj = mujoco()
    with refused_as("MuJoCo cannot load it", path.name, "correct the model", ValueError):
        model = mj.MjModel.from_xml_path(str(path))
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
    entries = [{"name": names[k]} | _joint(model, data, arms, k, bodies[k]) for k in range(len(arms))]
    limits = np.array([model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf) for j in arms])
    gripper_joints = [model.joint(j).name for j in hinges if j not in arms]
    notes = [f"the arm is written out from {path.name}: {listed(names, 12)}"]
    if gripper_joints or model.njnt > len(hinges):
        still = listed(gripper_joints, 12) or "those that do not turn"
        notes.append(f"joints at zero, as parts of the last body: {still}")
    settings = {"gravity_mps2": [float(f"{g:.9g}") for g in model.opt.gravity]}
    entry, name = {"joints": entries}, root.get("model") or path.stem
    return Arm(name, names, limits, np.eye(len(arms)), entry, None, settings, tuple(notes))


def _joint(model: Any, data: Any, arms: Sequence[int], k: int, bodies: Sequence[int]) -> dict[str, Any]:
    """The entry of a joint but its name: its frame, and the masses of the bodies that it carries as one."""
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
    nonzero = {key: v for key, v in values.items() if np.ndim(v) or key == "mass_kg" or v}
    return {key: _rounded(value) for key, value in nonzero.items()}


def _rounded(value: Any) -> Any:
    return [float(f"{v:.12g}") + 0.0 for v in value] if np.ndim(value) else float(f"{value:.12g}")


TABLES = ("csv", "parquet")
DECIMALS = 7
"""Of a value in motion.csv: two nanoradians, a tenth of a microsecond."""
COMMON = ("robot", "format", "name", "validate", "allow_xacro", "motions", "torque", "table")


@dataclass(frozen=True)
class MotionDraft:
    """A joint log before it is written: settings, columns, file of the robot, notes, what is wrong or ""."""

    settings: Mapping[str, Any]
    columns: Mapping[str, np.ndarray]
    robot: tuple[str, bytes] | None
    notes: tuple[str, ...]
    wrong: str
    log: str
    table: str
    understood: tuple[str, ...] = ()

    noun: ClassVar[str] = "log"

    @property
    def headline(self) -> str:
        """What was read, in words."""
        return f"{len(self.columns['t_s'])} rows in {len(self.settings['motions'])} motions from {self.log}"

    def write(self, stage: Path, judge: bool) -> None:
        """Write the files, and check that they can be read; no value is judged."""
        import pandas as pd
        import yaml

        head = "".join(f"# {line}\n" for line in (f"imported from {self.log}", *self.notes))
        usual: dict[str, Any] = {"sort_keys": False, "default_flow_style": None, "allow_unicode": True}
        text = yaml.safe_dump(dict(self.settings), width=10**6, **usual)
        (stage / "dataset.yaml").write_text(head + text, encoding="utf-8", newline="")
        table = pd.DataFrame(self.columns)
        if self.table == "parquet":
            of_logs("pyarrow.parquet", "--table parquet")
            table.to_parquet(stage / "motion.parquet", engine="pyarrow", index=False)
        else:
            content = table.round(DECIMALS).to_csv(index=False, lineterminator="\n").encode()
            with (stage / "motion.csv.gz").open("wb") as file, gzip.GzipFile("", "wb", 4, file, 0) as packed:
                packed.write(content)
        if self.robot is not None:
            (stage / self.robot[0]).write_bytes(self.robot[1])
        read_log(stage)


def format_of(request: Request) -> str:
    """The format of a log of motions; "" of a log of contacts."""
    if request.format in MOTION_FORMATS:
        return request.format
    signs = {"rosbag": _bags, "lerobot": is_lerobot, "sage": sage_folders}
    recognised = (name for name, sign in signs.items() if request.format == "csv" and sign(request.log))
    of_motions = request.format in ("csv", "ur-rtde") and (request.motions or request.log.is_dir())
    return next(recognised, request.format if of_motions else "")


def _bags(path: Path) -> list[Path]:
    """The bag at a path, or those in it."""
    if is_bag(path):
        return [path]
    return sorted(filter(is_bag, path.iterdir())) if path.is_dir() else []


def convert_motions(request: Request) -> MotionDraft:
    """Read a log of motions.

    Parameters
    ----------
    request : Request

    Returns
    -------
    MotionDraft
        Its `wrong` states in one line which numbers are in another unit, or of another joint, than stated.

    Raises
    ------
    BayescalError
        For options of contacts, files that cannot be read, and where required information is missing.
    """
    format_ = format_of(request)
    request.refuse_other((*COMMON, *FORMATS["options"][format_]), f"joint logs ({format_})")
    if request.table not in TABLES:
        raise BayescalError(f"`{request.table}` is not known", "--table", f"must be {' or '.join(TABLES)}")
    if not request.robot:
        remedy = "give its name, or a URDF, MJCF or robot.yaml"
        raise BayescalError("the robot is not stated", "--robot", remedy)
    arm = arm_of(request.robot, request.allow_xacro)
    records = _records(request, format_, arm)
    rows, notes = divided(records, request.motions)
    role, words = roles(rows, request.validate)
    rows, torque, said = one_torque(rows, records[0].torque, request.torque)
    same = repeats(rows)
    groups = {k: [rows.ids[i] for i, s in enumerate(same) if s == k] for k in dict.fromkeys(same)}
    again = [", ".join(names) for names in groups.values() if len(names) > 1]
    step = float(np.median(np.diff(rows.time)))
    rows, more = _temperature(rows)
    clocks = {r.clock for r in records}
    two = bool(records[0].others) or "frame" in clocks
    u_clock = float(f"{1e3 * step * (1.0 if two else 0.5):.3g}")
    side = "joint" if torque.get("kind") == "sensor" else "motor"
    settings: dict[str, Any] = {
        "schema": SCHEMA, "name": request.name or request.log.stem, "robot": arm.entry, **arm.settings,
        "rate_hz": round(1 / step, 3), "torque": torque, "position": {"side": side},
        "controller": {"kind": "torque" if torque else "position"},
        "clock": {"kind": "index" if "frame" in clocks else "stamps", "u_alignment_ms": u_clock},
        "motions": [_motion(rows, k, role[k], same[k]) for k in range(len(rows.ids))],
    }  # fmt: skip
    notes = (
        *arm.notes, *notes, words,
        f"repeats of one trajectory: {'; '.join(again)}" if again else "no motion repeats another", *said,
        *more, f"positions are of the {side} side of the gears (assumed)",
        f"torque and position of a row are of one time within {u_clock:g} ms (u, assumed: "
        f"{'one step' if two else 'half a step'})",
        *([] if "gravity_mps2" in settings else ["gravity acts along -z of the base (assumed)"]),
    )  # fmt: skip
    columns = _columns(rows, role)
    wrong = contradiction(rows, arm.coupling, arm.limits) or next((r.wrong for r in records if r.wrong), "")
    return MotionDraft(settings, columns, arm.file, notes, wrong, request.log.name, request.table)


def _records(request: Request, format_: str, arm: Arm) -> list[Record]:
    """All records of a log, in the order of their names."""
    path = request.log
    if not path.exists():
        raise BayescalError("no such file", path.name, f"looked in {path.parent}")
    servos = request.servos(arm.joint_names)
    if format_ == "lerobot":
        return read_lerobot(path, request.map.strip(), arm.joint_names, arm.limits, request.joints, servos)
    if format_ == "sage":
        return [read_sage(folder, arm.joint_names, request.joints) for folder in sage_folders(path)]
    if format_ == "rosbag":
        bags, robot = _bags(path), "" if request.torque else f"{request.robot} {arm.name}"
        if not bags:
            remedy = "give the folder of a bag, or a .mcap, .db3 or .bag file"
            raise BayescalError("not a bag", path.name, remedy)
        return [read_bag(bag, arm.joint_names, robot, request.joints, request.topic) for bag in bags]
    files = (sorted(path.glob("*.csv")) or sorted(path.glob("*.txt"))) if path.is_dir() else [path]
    if not files:
        remedy = "give a folder of .csv files, bags, or a data set"
        raise BayescalError("no log in the folder", path.name, remedy)
    if format_ == "csv" and not request.map:
        what = "the contents and units of the columns are not stated"
        example = "time=t s, j*=q* rad, j*_velocity=dq* radps, j*_command=qd* rad, j*_torque=tau* Nm"
        raise BayescalError(what, path.name, f'write --map "{example}"')
    names = [name.strip() for name in request.joints.split(",")] if request.joints else arm.joint_names
    if len(names) != (n := len(arm.joint_names)):
        raise BayescalError(f"{len(names)} joints, the robot has {n}", "--joints", "name them all")
    return [read_table(file, request.map, format_, request.decimal, names, servos) for file in files]


def _temperature(rows: Rows) -> tuple[Rows, tuple[str, ...]]:
    """The rows without aids, with one temperature a row."""
    cells = {k: v for k, v in rows.cells.items() if k not in AIDS}
    each = rows.cells.get("temperatures")
    if each is None or "temperature" in cells:
        return replace(rows, cells=cells), ()
    cells["temperature"] = each.mean(axis=1)
    return replace(rows, cells=cells), ("the temperature is the mean of those of the joints",)


def _motion(rows: Rows, k: int, role: str, same: int) -> dict[str, Any]:
    indices = rows.of(k + 1)
    payload = float(np.median(rows.cells["payload"][indices])) if "payload" in rows.cells else 0.0
    out = {"id": rows.ids[k], "role": role, "kind": rows.kinds[k], "same_as": rows.ids[same - 1]}
    return {key: str(x) for key, x in out.items() if x} | {"payload_kg": float(f"{payload:.6g}")}


def _columns(rows: Rows, role: Sequence[str]) -> dict[str, np.ndarray]:
    """The columns of motion.csv, in its units."""
    out: dict[str, np.ndarray] = {
        "t_s": rows.time,
        "motion": np.array(rows.ids)[rows.motion - 1],
        "role": np.array(role)[rows.motion - 1],
    }
    for name, form in PER_JOINT.items():
        for j, values in enumerate(rows.cells[name].T if name in rows.cells else (), 1):
            out[form.format(j)] = values * (1.0 / si(form))
    return out | {column: rows.cells[k] for k, column in SINGLE.items() if k in rows.cells}
