"""Joint logs in tables: text with a map, records of RTDE, LeRobot data sets, SAGE folders."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError, listed, refused_as
from bayescal.importing.columns import columns_of, missing_in
from bayescal.importing.joint_formats import LEROBOT, OTHERS, SAGE, UR_RTDE, Record, Stream, of_logs, places
from bayescal.importing.joint_torques import NORMALISED, misread
from bayescal.importing.log import read_log
from bayescal.importing.mapping import OF_JOINTS, Map, calibrated, read_map
from bayescal.importing.units import SPELLED, is_number, unit_of
from bayescal.robots.servos import Servo, angles
from bayescal.storage.reading import read_json

INFO = "meta/info.json"
STATES, CONTROL, EVENTS, JOINTS = "state_motor.csv", "control.csv", "event.csv", "joint_list.txt"
OF_FRAME = 1e-3
"""s: stamps that are the number of the frame over the rate within this, as LeRobot writes them (float32)."""
MICROSECONDS = 1.0
"""Stamps whose median step is larger are in µs: SAGE writes s of a simulation and µs of a robot."""


def read_table(
    path: Path, map_: str, format_: str, decimal: str, joints: Sequence[str], servos: Sequence[Servo] = ()
) -> Record:
    """A text file or workbook by its map, or a record of RTDE; `joints` are their names, for ``*name``.

    Raises
    ------
    BayescalError
        As `columns_of`; without the time or the positions of all joints.
    """
    formal = UR_RTDE if format_ == "ur-rtde" else ""
    n = len(joints)
    units = ("deg",) * n
    entries: Map = read_map(formal, units, formal=True) | read_map(map_, units, names=joints)
    entries = calibrated(entries, servos) if servos else entries
    columns = columns_of(read_log(path, missing=missing_in(entries), cut=True), entries, decimal)
    if "time" not in columns.cells:
        remedy = "map it: `time=t s`, or `time=stamp epoch_s`"
        raise BayescalError("no column holds the time", path.name, remedy)
    keys = {name: [f"j{i + 1}{end}" for i in range(n)] for end, (_, name) in OF_JOINTS.items()}
    cells = {name: block for name, each in keys.items() if (block := columns.block(each)) is not None}
    cells |= {k: columns.cells[k] for k in OTHERS if k in columns.cells}
    stream = Stream(path.name, columns.cells["time"], cells, columns.line)
    unused = [f"columns not used: {listed(columns.unused, 12)}"] if columns.unused else []
    notes = (*columns.notes, *unused)
    kind = path.stem.rstrip("0123456789-_. ")
    clock = "session" if columns.clock in ("UTC", "local", "counter", "day") else "record"
    unit = columns.unit("j1")
    wrong = misread(cells["position"] / unit.scale, unit.name) if unit and "position" in cells else ""
    return Record(path.name, stream, kind=kind, clock=clock, notes=notes, wrong=wrong)


def is_lerobot(path: Path) -> bool:
    """Whether a path is a LeRobot data set, or a parquet file of one."""
    return path.suffix == ".parquet" or (path / INFO).is_file()


def read_lerobot(
    path: Path, unit: str, joints: Sequence[str], limits: np.ndarray, stated: str, servos: Sequence[Servo]
) -> list[Record]:
    """Episodes of a LeRobot data set.

    Parameters
    ----------
    path : Path
        Its folder (of format v2.1 or v3), or a parquet file.
    unit : str
        Of positions and actions: deg, rad, steps or `normalised`.
    joints : sequence of str
        Joint names of the robot.
    limits : np.ndarray
        (n, 2) rad, of the joints: of normalised values -100 is the lower, 100 the upper.
    stated : str
        As of `joint_order`.
    servos : sequence of Servo
        Of the joints, where a calibration is given: angles follow from their ranges.

    Raises
    ------
    BayescalError
        Without pyarrow or the unit, and for files or columns that are not there.
    """
    if unit != NORMALISED and unit not in SPELLED:
        what = f"the unit of {LEROBOT['position']} is not stated"
        remedy = f"write `--map deg`, `rad`, `steps` or `{NORMALISED}` (-100 to 100)"
        raise BayescalError(what, path.name, remedy)
    info = read_json(path / INFO, "give the folder of a LeRobot data set") if path.is_dir() else {}
    files = sorted((path / "data").rglob("*.parquet")) if path.is_dir() else [path]
    if not files:
        raise BayescalError("no parquet file below data/", path.name, "give the folder of a LeRobot data set")
    table = _parquet(files)
    lacking = [c for c in (LEROBOT["position"], "timestamp", "episode_index") if c not in table]
    if lacking:
        raise BayescalError(f"no column `{lacking[0]}`", path.name, f"it has {listed(table, 12)}")
    width = table[LEROBOT["position"]].shape[1]
    order, how = places(_names(info, width), width, joints, stated, path.name)
    notes = [how, _units(table, unit, order, servos)]
    wrong = misread(table[LEROBOT["position"]][:, order], unit)
    there = {q: c for q, c in LEROBOT.items() if c in table}
    blocks = {q: table[c][:, order] for q, c in there.items() if table[c].shape[1] > max(order)}
    if unused := [c for q, c in there.items() if q not in blocks]:
        notes.append(f"not used, of another size: {', '.join(unused)}")
    turning = blocks.keys() & {"position", "command"}
    blocks |= {quantity: _angles(blocks[quantity], unit, limits, servos) for quantity in turning}
    if "velocity" in blocks and unit == NORMALISED:
        del blocks["velocity"]
        notes.append(f"{LEROBOT['velocity']} is not used: its unit is not known")
    elif "velocity" in blocks:
        blocks["velocity"] = np.radians(blocks["velocity"]) if unit == "deg" else blocks["velocity"]
        notes.append(f"{LEROBOT['velocity']} is in {'deg/s' if unit == 'deg' else 'rad/s'} (assumed)")
    episode, time = table["episode_index"].astype(int), table["timestamp"].astype(float)
    rate = info.get("fps") if isinstance(info, dict) else None
    frames = table.get("frame_index") if isinstance(rate, int | float) and rate > 0 else None
    made = frames is not None and bool(np.abs(time - frames / rate).max() < OF_FRAME)
    if made:
        what = f"stamps are the number of the frame / {rate:g} Hz"
        notes.append(f"{what}: they show no jitter of the recording")
    task = table.get("task_index", np.zeros(len(time)))
    clock = "frame" if made else "record"
    out: list[Record] = []
    for number in dict.fromkeys(episode.tolist()):
        rows = np.flatnonzero(episode == number)
        stream = Stream(f"episode {number}", time[rows], {k: v[rows] for k, v in blocks.items()})
        kind = f"task {int(task[rows[0]])}"
        out.append(Record(stream.name, stream, (), kind, "", clock, () if out else tuple(notes), wrong))
    return out


def _parquet(files: Sequence[Path]) -> dict[str, np.ndarray]:
    """Columns of numbers, lists side by side, of parquet files one below the other."""
    parquet = of_logs("pyarrow.parquet", files[0].name)
    parts: list[dict[str, np.ndarray]] = []
    for file in files:
        # pyarrow fails in any way at damaged files
        with refused_as("not a parquet file", file.name, "give the file as it was written", Exception):
            table, part = parquet.read_table(file), {}
            for name in table.column_names:
                column = table.column(name).combine_chunks()
                lists = hasattr(column, "flatten") and hasattr(column.type, "value_type")
                values = (column.flatten() if lists else column).to_numpy(zero_copy_only=False)
                if values.dtype.kind in "fiu" and len(values) % max(len(table), 1) == 0:
                    part[name] = values.reshape(len(table), -1) if lists else values
        parts.append(part)
    return {k: np.concatenate([p[k] for p in parts]) for k in parts[0] if all(k in p for p in parts)}


def _names(info: Any, width: int) -> list[str]:
    """Names of the joints in info.json: a list, or lists by group; [] if there are not as many as values."""
    names = info
    for key in ("features", LEROBOT["position"], "names"):
        names = names.get(key) if isinstance(names, dict) else None
    groups = list(names.values()) if isinstance(names, dict) else [names]
    flat = [str(name) for group in groups if isinstance(group, list) for name in group]
    return flat if len(flat) == width else []


def _units(table: dict[str, np.ndarray], unit: str, order: Sequence[int], servos: Sequence[Servo]) -> str:
    """In words how values become angles; normalised ones beyond 100 are refused."""
    if unit != NORMALISED:
        ways = {
            "steps": f"4096 a turn; zero is {'the middle of the range' if servos else 'half a turn'}",
            "deg": "of 4095 steps a turn, corrected to 4096" if servos else "LeRobot's are 0.024 % too large",
        }
        how = f" ({ways[unit]})" if unit in ways else ""
        return f"{LEROBOT['position']} and {LEROBOT['command']} are in {unit}, as stated{how}"
    most = float(np.nanmax(np.abs(table[LEROBOT["position"]][:, order])))
    if most > 100 * (1 + 1e-3):
        what = f"normalised values up to {most:.4g}, at most 100"
        raise BayescalError(what, LEROBOT["position"], "is it `--map deg`?")
    whose = "servo in the calibration" if servos else "joint in the robot file (assumed)"
    return f"normalised values: -100 to 100 is the range of each {whose}"


def _angles(values: np.ndarray, unit: str, limits: np.ndarray, servos: Sequence[Servo]) -> np.ndarray:
    if servos:
        return angles(values, unit, servos)
    if unit == NORMALISED:
        if not np.isfinite(limits).all():
            what = "the robot states no limits of its joints"
            raise BayescalError(what, "--robot", "normalised values need them")
        return np.asarray(limits[:, 0] + (values + 100) / 200 * (limits[:, 1] - limits[:, 0]))
    stated = unit_of(unit, "angle", "--map")
    return np.asarray(stated.scale * values + stated.offset)


def sage_folders(path: Path) -> list[Path]:
    """Folders of motions below a path that SAGE wrote."""
    folder = path.parent if path.name == STATES else path
    return sorted(p.parent for p in folder.rglob(STATES)) if folder.is_dir() else []


def read_sage(folder: Path, joints: Sequence[str], stated: str) -> Record:
    """A motion that SAGE recorded: states, commands, events.

    Raises
    ------
    BayescalError
        For a file or a column that is not there, and lists of another length than the joints.
    """
    place = f"{folder.name}/{STATES}"
    time, lists, scale = _listed(folder / STATES, SAGE)
    lines = (folder / JOINTS).read_text("utf-8").splitlines() if (folder / JOINTS).is_file() else []
    names = [last for line in lines if (last := line.strip().rsplit("/", 1)[-1])]
    width = lists[SAGE["position"]].shape[1]
    if names and len(names) != width:
        what = f"{width} positions, {len(names)} names in {JOINTS}"
        raise BayescalError(what, place, "give the files of one motion")
    order, how = places(names, width, joints, stated, place)
    blocks = {quantity: lists[c][:, order] for quantity, c in SAGE.items() if c in lists}
    notes = [how, f"angles are in rad, torques in N m, times in {'µs' if scale < 1 else 's'} (SAGE's README)"]
    others: tuple[Stream, ...] = ()
    keep = np.ones(len(time), bool)
    if (folder / EVENTS).is_file():
        events = read_log(folder / EVENTS, headed=True)
        if not {"event", "timestamp"} <= set(events.header):
            raise BayescalError("no columns `event` and `timestamp`", f"{folder.name}/{EVENTS}", "remove it")
        name, stamp = (events.header.index(column) for column in ("event", "timestamp"))
        when = {row[name]: scale * float(row[stamp]) for row in events.rows if is_number(row[stamp])}
        begin, end = when.get("MOTION_START", -np.inf), when.get("DISABLE", np.inf)
        keep = (time >= begin) & (time <= end)
        notes.append(f"{int((~keep).sum())} rows before MOTION_START or after DISABLE left out")
    if (folder / CONTROL).is_file():
        sent, commands, _ = _listed(folder / CONTROL, {"command": SAGE["position"]})
        command = commands[SAGE["position"]]
        if command.shape[1] != width:
            what = f"{command.shape[1]} positions, {width} in {STATES}"
            raise BayescalError(what, f"{folder.name}/{CONTROL}", "give the files of one motion")
        others = (Stream(CONTROL, sent, {"command": command[:, order]}, held=True),)
        notes.append(f"the command of a row is the last one sent before it ({CONTROL})")
    kept = {k: v[keep] for k, v in blocks.items()}
    rows = Stream(folder.name, time[keep], kept, line=2 + np.flatnonzero(keep))
    kind = folder.name.rstrip("0123456789-_. ")
    return Record(folder.name, rows, others, kind, torque="motor", notes=tuple(notes))


def _listed(path: Path, wanted: dict[str, str]) -> tuple[np.ndarray, dict[str, np.ndarray], float]:
    """Times (N,), s, lists (N, k) by column, and the factor to s, of a table whose cells are lists."""
    log = read_log(path, headed=True, cut=True)
    remedy = "expected are the columns timestamp, positions, ..., with lists of one length"
    with refused_as("not a table of SAGE", f"{path.parent.name}/{path.name}", remedy, ValueError):
        time = np.array([float(row[log.header.index("timestamp")]) for row in log.rows])
        index = {c: log.header.index(c) for c in wanted.values() if c in log.header}
        lists = {c: np.array([json.loads(row[k]) for row in log.rows], float) for c, k in index.items()}
        lists = {c: v for c, v in lists.items() if v.ndim == 2 and v.shape[1]}
        first = next(iter(wanted.values()))
        if first not in lists:
            raise ValueError(f"no lists in a column `{first}`")
    scale = 1e-6 if len(time) > 1 and np.median(np.diff(time)) > MICROSECONDS else 1.0
    return time * scale, lists, scale
