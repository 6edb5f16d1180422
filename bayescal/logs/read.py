"""A folder with a joint log to a `Log`: dataset.yaml, motion.csv (.gz) or motion.parquet, and the robot."""

from __future__ import annotations

import gzip
import hashlib
import io
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.errors import BayescalError, listed, refused_as
from bayescal.logs import types
from bayescal.logs.schema import OF_JOINTS, SCHEMA, Arm, LogFile, MotionEntry, Payload, known_keys
from bayescal.logs.types import CALIBRATE, VALIDATE, Controller, Log, Mechanism, Motion
from bayescal.robots import load_robot
from bayescal.robots.schema import SIX
from bayescal.storage.files import Document, check_schema, column_of, in_si, read_document, si
from bayescal.storage.reading import LARGEST, check_inside, content_of, library, table_beside

if TYPE_CHECKING:
    from pandas import DataFrame

GRAVITY = (0.0, 0.0, -9.80665)
"""m/s2, standard gravity (CGPM 1901)."""
TABLES = ("motion.csv", "motion.csv.gz", "motion.parquet")
COLUMNS = table_beside(__file__, "columns.toml")
PER_JOINT = {quantity: of["column"] for quantity, of in COLUMNS.items()}
"""Columns of each joint, numbered from 1, by the quantity that they hold."""
MEASURED = ("time", "position", "velocity", "command", "torque", "link", "temperature", "payload")
"""Quantities of a `Motion`."""
PLAIN = ("t_s", "motion", "role", "temperature_degC", "payload_kg")
VALIDATED = 5
"""One motion of so many is withheld, if the file does not state roles (assumed)."""
ROWS = 100_000
"""Rows that are read at once."""


def is_log(folder: Path) -> bool:
    """Whether a folder holds a joint log; a folder that cannot be read does not."""
    try:
        given = read_document(folder / "dataset.yaml").data.get("schema")
    except BayescalError:
        return False
    return isinstance(given, str) and given.startswith(SCHEMA.partition("/")[0])


def read_log(folder: Path) -> Log:
    """Read a joint log.

    Parameters
    ----------
    folder : Path
        With dataset.yaml of schema ``bayescal-motion/1``, the table, and the robot if it is a file.

    Raises
    ------
    BayescalError
        With the file and the line: for stamps that go back, values that are not finite or beyond any arm,
        fewer than two motions, and whatever the schema does not know.
    """
    document = read_document(folder / "dataset.yaml")
    check_schema(document, SCHEMA)
    accepted, ignored = known_keys(document.data, LogFile)
    stated = replace(document, data=accepted).parse(LogFile)
    file, written = _with_arm(stated, folder)
    mechanism, notes, robot = _mechanism(file, document, folder)
    table, content, name = _table(folder)
    further = [str(c) for c in table.columns if c not in known_columns(mechanism.n)]
    columns = _columns(table, mechanism.n, name)
    torque, kind, assumed = _torque(file, columns, mechanism, document)
    columns["torque"] = torque
    if file.torque.sign == "none":
        assumed.append("torques have no sign: they are not assessed")
    motions = _motions(file, table, columns, name, document)
    if not any(m.role == CALIBRATE for m in motions):
        raise BayescalError("no motion has the role calibrate", document.where(("motions",)), "set one")
    gravity = file.gravity_mps2 or getattr(file.robot, "gravity_mps2", None)
    control = file.controller
    robot_file = folder / stated.robot.partition("#")[0] if isinstance(stated.robot, str) else folder
    digest = hashlib.sha256(document.content + content + written + robot).hexdigest()
    return Log(
        name=file.name,
        mechanism=mechanism,
        motions=motions,
        gravity=np.array(gravity or GRAVITY),
        controller=Controller(
            control.kind,
            _per_joint(control.kp_Nm_per_rad, mechanism, "kp_Nm_per_rad"),
            _per_joint(control.kd_Nms_per_rad, mechanism, "kd_Nms_per_rad"),
        ),
        torque_kind=kind,
        signed=file.torque.sign == "joint",
        u_constant=file.torque.u_constant if kind == "current" else 0.0,
        alignment=1e-3 * file.clock.alignment_ms,
        u_alignment=1e-3 * file.clock.u_alignment_ms,
        link_side=file.position.side == "joint",
        notes=(*notes, *assumed, *_not_read("keys of dataset.yaml", ignored), *_not_read("columns", further)),
        digest=digest,
        files=tuple(filter(Path.is_file, (folder / "dataset.yaml", folder / name, robot_file))),
        noise=_per_joint(file.noise.torque_Nm, mechanism, "torque_Nm"),
    )


def _with_arm(file: LogFile, folder: Path) -> tuple[LogFile, bytes]:
    """dataset.yaml with the arm of a file that writes out its joints as dataset.yaml may, and its content."""
    if isinstance(file.robot, Arm) or Path(file.robot).suffix.lower() not in (".yaml", ".yml"):
        return file, b""
    check_inside(folder / file.robot, folder, f"robot `{file.robot}`")
    document = read_document(folder / file.robot)
    if "schema" in document.data or "joints" not in document.data:
        return file, b""
    accepted, _ = known_keys(document.data, Arm)
    return file.model_copy(update={"robot": replace(document, data=accepted).parse(Arm)}), document.content


def _mechanism(file: LogFile, document: Document, folder: Path) -> tuple[Mechanism, tuple[str, ...], bytes]:
    """The nominal mechanism, what was assumed of it, and the content of its file."""
    if isinstance(file.robot, str):
        robot, content = load_robot(file.robot, folder, inside=True)
        mechanism, notes = types.mechanism_of(robot)
        payload, u = file.payload or Payload(), file.u
    else:
        mechanism, notes, content = written_out(file.robot, file.name), (), b""
        payload, u = file.payload or file.robot.payload, file.u or file.robot.u
    if np.isnan(mechanism.mass).any():
        remedy = "give a robot with `mass_kg`, `centre_of_mass_mm` and `inertia_kgm2` of each link"
        raise BayescalError("the robot states no masses", document.where(("robot",)), remedy)
    mechanism, more = types.with_bodies(mechanism)
    notes = (*notes, *more)
    if u is not None:
        mechanism = replace(mechanism, u=types.Uncertain(*starmap(in_si, u)))
    centre = in_si("centre_of_mass_mm", payload.centre_of_mass_mm)
    gyration = 1e-3 * payload.radius_of_gyration_mm
    return replace(mechanism, payload_centre=centre, payload_gyration=gyration), notes, content


def written_out(arm: Arm, name: str) -> Mechanism:
    """The mechanism of an arm that dataset.yaml writes out."""
    joints = arm.joints
    axes = np.array([j.axis for j in joints], float)
    size = np.linalg.norm(axes, axis=1)
    if np.any(size == 0.0):
        wrong = joints[int(np.argmin(size))].name
        raise BayescalError(f"the axis of {wrong} is zero", "dataset.yaml", "write its direction")

    columns = {field: column_of(joints, [key] * len(joints)) for key, field in OF_JOINTS.items()}
    shapes = {"limits": (len(joints), 2)}
    values = {f: types.or_nan(column, *shapes.get(f, (len(joints),))) for f, column in columns.items()}
    turned = np.flatnonzero(values["limits"][:, 0] >= values["limits"][:, 1])
    if len(turned):
        what = f"limits of {joints[turned[0]].name} are not in order"
        raise BayescalError(what, "dataset.yaml", "write [lower, upper]")
    transition = in_si("friction_transition_degps", arm.friction_transition_degps)
    frames = [rigid(rpy_matrix(in_si("rpy_deg", j.rpy_deg)), in_si("origin_mm", j.origin_mm)) for j in joints]
    return Mechanism(
        name=name,
        joint_names=tuple(j.name for j in joints),
        place=np.array(frames),
        axis=axes / size[:, None],
        coupling=np.eye(len(joints)),
        transition=transition or 0.0,
        **values | {"inertia": values["inertia"][:, SIX]},  # type: ignore[arg-type]
    )


def _per_joint(values: Sequence[float] | None, mechanism: Mechanism, key: str) -> Any:
    if values is None:
        return None
    if len(values) != mechanism.n:
        what = f"`{key}` has {len(values)} entries, the robot {mechanism.n} joints"
        raise BayescalError(what, "dataset.yaml", "give one a joint")
    return np.array(values, float)


def _table(folder: Path) -> tuple[DataFrame, bytes, str]:
    """The table with texts as they are written, the content of its file, and its name."""
    import pandas as pd

    there = [name for name in TABLES if (folder / name).exists()]
    if len(there) != 1:
        what = "no table of motions" if not there else f"several tables: {listed(there)}"
        raise BayescalError(what, str(folder.name), f"give one of {', '.join(TABLES)}")
    name = there[0]
    content = content_of(folder / name)
    if name.endswith(".parquet"):
        return _parquet(content, name), content, name
    text = _unpacked(content, name) if name.endswith(".gz") else content
    texts = {"motion": "category", "role": "category"}
    kinds = pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError
    with refused_as("not a CSV table", name, "one cell a column, commas between", *kinds):
        # in parts: the words of a whole log take three times the memory of its numbers
        parts = pd.read_csv(io.BytesIO(text), dtype=texts, skip_blank_lines=False, chunksize=ROWS)
        table = pd.concat(parts, ignore_index=True)
    if not len(table):
        raise BayescalError("no rows below the header", f"{name}:1", "add rows")
    return table.rename(columns=str.strip), content, name


def _parquet(content: bytes, name: str) -> DataFrame:
    import pandas as pd

    library("pyarrow", "Parquet needs pyarrow", name, "install bayescal[logs]")
    with refused_as("not a Parquet table", name, "write it again", OSError, ValueError):
        table = pd.read_parquet(io.BytesIO(content))
    for column in {"motion", "role"} & set(table.columns):
        table[column] = table[column].astype(str)
    return table


def _unpacked(content: bytes, name: str) -> bytes:
    """Text of a gzip file, of bounded size: a small file can stand for a very large one."""
    with refused_as("not a gzip file", name, "pack it again", OSError, EOFError, zlib.error):
        text = gzip.GzipFile(fileobj=io.BytesIO(content)).read(4 * LARGEST + 1)
    if len(text) > 4 * LARGEST:
        raise BayescalError(f"unpacks to more than {4 * LARGEST / 1e9:.0f} GB", name, "divide it")
    return text


def known_columns(n: int) -> tuple[str, ...]:
    """All columns that are read of an arm with `n` joints."""
    return (*PLAIN, *(form.format(j + 1) for form in PER_JOINT.values() for j in range(n)))


def _not_read(what: str, names: Sequence[str]) -> list[str]:
    return [f"{what} that are not known were not read: {listed(names)}"] if names else []


def _columns(table: DataFrame, n: int, name: str) -> dict[str, np.ndarray | None]:
    """The columns as numbers, SI, by quantity: (N, n) of joints, (N,) of others; None where absent."""
    for column in ("t_s", "motion", "q1_deg"):
        if column not in table:
            raise BayescalError(f"column `{column}` is missing", f"{name}:1", "add it")
    single = {"time": "t_s", "temperature": "temperature_degC", "payload": "payload_kg"}
    out = {key: _numbers(table, column, name) for key, column in single.items()}
    for quantity, form in PER_JOINT.items():
        names = [form.format(j + 1) for j in range(n)]
        missing = [column for column in names if column not in table]
        if missing and len(missing) < n:
            raise BayescalError(f"column `{missing[0]}` is missing", f"{name}:1", "give all joints, or none")
        if missing:
            out[quantity] = None
            continue
        limit = COLUMNS[quantity]["largest"]
        out[quantity] = np.column_stack([_numbers(table, c, name) for c in names]) * si(names[0])
        why = f"beyond {limit / si(names[0]):g}, more than any arm has"
        _refuse(np.abs(out[quantity]) > limit, names, name, why)
    return out


def _numbers(table: DataFrame, column: str, name: str) -> Any:
    import pandas as pd

    if column not in table:
        return None
    values = pd.to_numeric(table[column], errors="coerce").to_numpy(float)
    _refuse(~np.isfinite(values)[:, None], [column], name, "not a finite number")
    return values


def _refuse(bad: np.ndarray, columns: Sequence[str], name: str, why: str) -> None:
    """Refuse the first bad cell, with its line."""
    if bad.any():
        row, k = np.argwhere(bad)[0]
        raise BayescalError(f"`{columns[k]}` is {why}", f"{name}:{row + 2}", "remove the row, or correct it")


def _torque(
    file: LogFile, columns: Mapping[str, Any], mechanism: Mechanism, document: Document
) -> tuple[np.ndarray | None, str, list[str]]:
    """Torques at the joints (N, n), N m, their kind, and what was assumed."""
    given = [key for key in ("torque", "current", "magnitude") if columns[key] is not None]
    if len(given) > 1:
        raise BayescalError(f"both {' and '.join(given)} are given", "motion table:1", "keep one")
    if not given:
        return None, "", []
    values, kind = columns[given[0]], "current" if given[0] == "current" else file.torque.kind
    notes = []
    if given[0] == "current":
        constants = _per_joint(file.torque.constant_Nm_per_A, mechanism, "constant_Nm_per_A")
        if constants is None:
            remedy = "state torque per current of each joint"
            raise BayescalError("currents without `constant_Nm_per_A`", document.where(("torque",)), remedy)
        values = values * constants
    if file.torque.referred_to == "motor":
        if np.isnan(mechanism.gear_ratio).any():
            what, where = "torques of the motors need `gear_ratio`", document.where(("torque",))
            raise BayescalError(what, where, "state it of each joint")
        values = values * mechanism.gear_ratio
        notes.append("torques were converted to the joints by the gear ratios, without losses")
    return values, kind, notes


def _motions(
    file: LogFile, table: DataFrame, columns: Mapping[str, Any], name: str, document: Document
) -> tuple[Motion, ...]:
    labels = table["motion"].astype(str).str.strip().to_numpy()
    first = np.flatnonzero(np.r_[True, labels[1:] != labels[:-1]])
    order = labels[first]
    if len(set(order)) < len(order):
        again = next(k for k in range(len(order)) if order[k] in order[:k])
        what = f"motion `{order[again]}` begins twice"
        raise BayescalError(what, f"{name}:{first[again] + 2}", "give each motion a label of its own")
    if len(order) < 2:
        raise BayescalError("fewer than two motions", f"{name}:2", "one is fitted, another withheld")
    entries = _entries(file, list(order), table, first, document)
    out = []
    for label, start, end in zip(order, first, [*first[1:], len(labels)], strict=True):
        rows, entry = slice(start, end), entries[label]
        if end - start < types.FEWEST_ROWS:
            what = f"motion `{label}` has {end - start} rows, at least {types.FEWEST_ROWS} are needed"
            raise BayescalError(what, f"{name}:{start + 2}", "remove it, or log it longer")
        back = np.flatnonzero(np.diff(columns["time"][rows]) <= 0.0)
        if len(back):
            where = f"{name}:{start + back[0] + 3}"
            raise BayescalError("`t_s` does not increase", where, "sort, or repair it")
        part = {key: None if values is None else values[rows] for key, values in columns.items()}
        if file.torque.sign == "none" or part["magnitude"] is not None:
            part["torque"] = None
        if part["payload"] is None:
            part["payload"] = np.full(end - start, entry.payload_kg)
        same_as, line = entry.same_as or label, int(start) + 2
        measured: dict[str, Any] = {key: part[key] for key in MEASURED}
        out.append(Motion(label, entry.role, entry.kind, same_as, **measured, line=line))
    return tuple(out)


def _entries(
    file: LogFile, order: list[str], table: DataFrame, first: np.ndarray, document: Document
) -> dict[str, MotionEntry]:
    """The entry of each motion, from dataset.yaml or the column `role`."""
    stated = {entry.id: entry for entry in file.motions or []}
    if file.motions is not None:
        for label in order:
            if label not in stated:
                what = f"motion `{label}` of the table is not in `motions`"
                raise BayescalError(what, document.where(("motions",)), "add it, or remove its rows")
        for k, entry in enumerate(file.motions):
            where = document.where(("motions", k))
            if entry.id not in order:
                raise BayescalError(f"motion `{entry.id}` has no rows", where, "remove it")
            if entry.same_as and entry.same_as not in stated:
                raise BayescalError(f"`same_as` names no motion: `{entry.same_as}`", where, "correct it")
    elif "role" in table:
        for label, row in zip(order, first, strict=True):
            role = str(table["role"].iloc[row])
            if role not in (CALIBRATE, VALIDATE):
                raise BayescalError(f"unknown role `{role}`", f"table:{row + 2}", "calibrate or validate")
            stated[label] = MotionEntry(id=label, role=role)  # type: ignore[arg-type]
    else:
        held = order[-max(len(order) // VALIDATED, 1) :]
        stated = {k: MotionEntry(id=k, role="validate" if k in held else "calibrate") for k in order}
    return stated
