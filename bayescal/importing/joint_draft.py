"""From a log of motions to a joint log: dataset.yaml, motion.csv.gz or motion.parquet, and the robot."""

from __future__ import annotations

import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.dataset.write import check_new
from bayescal.errors import BayescalError
from bayescal.importing.ask import MOTION_FORMATS, Request
from bayescal.importing.joint_arms import Arm, arm_of
from bayescal.importing.joint_bags import is_bag, read_bag
from bayescal.importing.joint_formats import AIDS, SINGLE, Record, of_logs
from bayescal.importing.joint_rows import Rows, divided, repeats, roles, speeds
from bayescal.importing.joint_tables import is_lerobot, read_lerobot, read_sage, read_table, sage_folders
from bayescal.importing.joint_torques import contradiction, one_torque
from bayescal.logs import SCHEMA, read_log
from bayescal.logs.read import PER_JOINT
from bayescal.storage.files import si
from bayescal.storage.folders import whole

TABLES = ("csv", "parquet")
DECIMALS = 7
"""Of a value in motion.csv: two nanoradians, a tenth of a microsecond."""
COMMON = ("robot", "format", "name", "validate", "allow_xacro", "motions", "torque", "table")
APPLY = {
    "rosbag": ("joints", "topic"),
    "lerobot": ("joints", "map", "calibration"),
    "sage": ("joints",),
    "csv": ("map", "decimal", "calibration"),
    "ur-rtde": ("map", "decimal"),
}
"""Options of each format, beside `COMMON`."""


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

    @property
    def headline(self) -> str:
        """What was read, in words."""
        return f"{len(self.columns['t_s'])} rows in {len(self.settings['motions'])} motions from {self.log}"


def format_of(request: Request) -> str:
    """The format of a log of motions; "" of a log of contacts."""
    path = request.log
    if request.format in MOTION_FORMATS:
        return request.format
    if request.format == "csv":
        if _bags(path):
            return "rosbag"
        if is_lerobot(path):
            return "lerobot"
        if sage_folders(path):
            return "sage"
    of_motions = request.format in ("csv", "ur-rtde") and (request.motions or path.is_dir())
    return request.format if of_motions else ""


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
    request.refuse_other((*COMMON, *APPLY[format_]), f"joint logs ({format_})")
    if request.table not in TABLES:
        raise BayescalError(f"`{request.table}` is not known", "--table", f"must be {' or '.join(TABLES)}")
    if not request.robot:
        remedy = "give its name, or a URDF, MJCF or robot.yaml"
        raise BayescalError("the robot is not stated", "--robot", remedy)
    arm = arm_of(request.robot, request.allow_xacro)
    records = _records(request, format_, arm)
    rows, notes = divided(records, request.motions)
    role, words = roles(rows, request.validate)
    velocity = speeds(rows.time, rows.cells["position"], rows.motion)
    rows, torque, said = one_torque(rows, velocity, records[0].torque, request.torque)
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
        "schema": SCHEMA,
        "name": request.name or request.log.stem,
        "robot": arm.entry,
        **arm.settings,
        "rate_hz": round(1 / step, 3),
        "torque": torque,
        "position": {"side": side},
        "controller": {"kind": "torque" if torque else "position"},
        "clock": {"kind": "index" if "frame" in clocks else "stamps", "u_alignment_ms": u_clock},
        "motions": [_motion(rows, k, role[k], same[k]) for k in range(len(rows.ids))],
    }
    notes = (
        *arm.notes,
        *notes,
        words,
        f"repeats of one trajectory: {'; '.join(again)}" if again else "no motion repeats another",
        *said,
        *more,
        f"positions are of the {side} side of the gears (assumed)",
        f"torque and position of a row are of one time within {u_clock:g} ms (u, assumed: "
        f"{'one step' if two else 'half a step'})",
        *([] if "gravity_mps2" in settings else ["gravity acts along -z of the base (assumed)"]),
    )
    columns = _columns(rows, role)
    wrong = contradiction(rows, velocity, arm)
    return MotionDraft(settings, columns, arm.file, notes, wrong, request.log.name, request.table)


def write_motions(draft: MotionDraft, folder: Path, force: bool = False) -> None:
    """Write a draft as a folder, atomically, and check that it can be read.

    Parameters
    ----------
    draft : MotionDraft
    folder : Path
        A new or an empty one.
    force : bool
        Write also values that are probably in a wrong unit.

    Raises
    ------
    BayescalError
        For a folder that is not empty, a failed check, and whatever the format does not allow.
    """
    if draft.wrong and not force:
        raise BayescalError(draft.wrong, draft.log, "correct the map, or write the log with --force")
    check_new(folder)
    with whole(folder, "dataset.yaml") as stage:
        _write(draft, stage)
        read_log(stage)


def _write(draft: MotionDraft, folder: Path) -> None:
    import pandas as pd
    import yaml

    head = "".join(f"# {line}\n" for line in (f"imported from {draft.log}", *draft.notes))
    usual: dict[str, Any] = {"sort_keys": False, "default_flow_style": None, "allow_unicode": True}
    text = yaml.safe_dump(dict(draft.settings), width=10**6, **usual)
    (folder / "dataset.yaml").write_text(head + text, encoding="utf-8", newline="")
    table = pd.DataFrame(draft.columns)
    if draft.table == "parquet":
        of_logs("pyarrow.parquet", "--table parquet")
        table.to_parquet(folder / "motion.parquet", engine="pyarrow", index=False)
    else:
        content = table.round(DECIMALS).to_csv(index=False, lineterminator="\n").encode()
        with (folder / "motion.csv.gz").open("wb") as file, gzip.GzipFile("", "wb", 4, file, 0) as stream:
            stream.write(content)
    if draft.robot is not None:
        (folder / draft.robot[0]).write_bytes(draft.robot[1])


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
        bags, robot = _bags(path), f"{request.robot} {arm.name}"
        if not bags:
            remedy = "give the folder of a bag, or a .mcap, .db3 or .bag file"
            raise BayescalError("not a bag", path.name, remedy)
        return [read_bag(bag, arm.joint_names, robot, request.joints, request.topic) for bag in bags]
    files = sorted(p for p in path.iterdir() if p.suffix in (".csv", ".txt")) if path.is_dir() else [path]
    if not files:
        remedy = "give a folder of .csv files, bags, or a data set"
        raise BayescalError("no log in the folder", path.name, remedy)
    if format_ == "csv" and not request.map:
        what = "the contents and units of the columns are not stated"
        example = "time=t s, j*=q* rad, j*_velocity=dq* radps, j*_command=qd* rad, j*_torque=tau* Nm"
        raise BayescalError(what, path.name, f'write --map "{example}"')
    return [read_table(file, request.map, format_, request.decimal, arm.n, servos) for file in files]


def _temperature(rows: Rows) -> tuple[Rows, tuple[str, ...]]:
    """The rows without aids, with one temperature a row."""
    cells = {k: v for k, v in rows.cells.items() if k not in AIDS}
    each = rows.cells.get("temperatures")
    if each is None or "temperature" in cells:
        return replace(rows, cells=cells), ()
    cells["temperature"] = each.mean(axis=1)
    return replace(rows, cells=cells), ("the temperature is the mean of those of the joints",)


def _motion(rows: Rows, k: int, role: str, same: int) -> dict[str, Any]:
    own = rows.of(k + 1)
    payload = float(np.median(rows.cells["payload"][own])) if "payload" in rows.cells else 0.0
    names = (str(rows.ids[k]), role, str(rows.kinds[k]), str(rows.ids[same - 1]))
    out = dict(zip(("id", "role", "kind", "same_as"), names, strict=True))
    return {key: value for key, value in out.items() if value} | {"payload_kg": float(f"{payload:.6g}")}


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
