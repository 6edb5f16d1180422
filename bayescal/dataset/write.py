"""Rows that are taken or appended, and a `Dataset` to a folder on disk, atomically."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from operator import eq
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.chain import Ground
from bayescal.dataset.join import PAUSE, stacked
from bayescal.dataset.read import SETTINGS, TABLE
from bayescal.dataset.schema import CERTIFICATES, SCHEMA, NoiseEntry, RegionEntry, ToolEntry, VolumeEntry
from bayescal.dataset.session import NAMING, artefact_text, field_of
from bayescal.dataset.solids import hull_stl, solid_values
from bayescal.dataset.table import LABELS, csv_text, fields_of_columns
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Certificate, Dataset, Measurements, PlanSettings, Record, Target, Tool
from bayescal.errors import BayescalError
from bayescal.robots import builtin_robots, load_robot, robot_to_yaml
from bayescal.storage.files import FILL_IN, si, stem_of
from bayescal.storage.files import Keys as Model
from bayescal.storage.folders import whole
from bayescal.storage.writing import Block, Keys, block_lines, flow, flow_list, number, scalar


def taken(m: Measurements, rows: np.ndarray) -> Measurements:
    """Some rows (R,) of a session, in the given order."""
    table = {f.name: getattr(m, f.name) for f in fields(Measurements)}
    picked = {name: values[rows] for name, values in table.items() if name != "ids" and values is not None}
    return Measurements(**table | picked | {"ids": tuple(m.ids[k] for k in rows)})


def appended(
    m: Measurements, source: np.ndarray, changed: Mapping[str, Any], ids: Sequence[str]
) -> Measurements:
    """The rows of a session (N,), followed by rows (C,) that repeat some of them with other values.

    Parameters
    ----------
    m : Measurements
    source : np.ndarray of int, shape (C,)
        The row that each new row repeats.
    changed : mapping
        New values (C, ...), or one for all, of columns by their name; a column that the session lacks is not
        added, except a payload, which is 0 in its rows.
    ids : sequence of str
        Names of the new rows.

    The new rows have the role validate: a model of the fitted measurements does not change by them.
    """
    later = taken(m, source)
    if later.payload is None and "payload" in changed:
        later = replace(later, payload=np.zeros(len(source)))
    columns = {name: getattr(later, name) for name in changed}
    other = {name: np.broadcast_to(changed[name], v.shape) for name, v in columns.items() if v is not None}
    role = np.full(len(source), "validate")
    columns, _ = stacked([m, replace(later, ids=tuple(ids), role=role, **other)])
    return Measurements(**columns)


def followed(m: Measurements, later: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """The rows of a session, followed by rows that were measured later, on the same targets.

    Times that begin again continue `PAUSE` after the session. A label of the later rows that the session has
    too is another label.

    Returns
    -------
    Measurements
    tuple of str
        Columns that only one of both has and that have no empty cell: they are left out.
    """
    table, lost = stacked([m, later])
    of_later = np.arange(len(table["ids"])) >= len(m.ids)
    for name in LABELS:
        if (labels := table[name]) is not None:
            again = of_later & (labels != "") & np.isin(labels, labels[~of_later])
            table[name] = np.where(again, np.char.add(labels, ".later"), labels)
    if table["time"] is not None and np.min(later.time) <= np.max(m.time):  # type: ignore[arg-type]
        table["time"][len(m.ids) :] += np.max(m.time) + PAUSE - np.min(later.time)  # type: ignore[arg-type]
    return Measurements(**table), lost


ROBOT, ARTEFACT = "robot.yaml", "artefact.yaml"

DECIMALS = {"deg": 7, "mps2": 9} | dict.fromkeys(("mm", "degps", "mmps", "n", "kg", "nm"), 6)
DECIMALS |= dict.fromkeys(("s", "c", "px", "degc"), 4)
"""Decimals of a value in a file's unit: a nanometre, two nanoradians; finer than anything measured."""

DIRECTION = 12
"""Decimals of a unit vector."""

UNCERTAINTY = 9
"""Significant digits of an uncertainty."""


def check_new(folder: Path) -> None:
    """Refuse a folder in which a session would be written over other files."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BayescalError("the folder is there already and not empty", str(folder), "give a new one")


def write_dataset(dataset: Dataset, folder: Path | str) -> None:
    """Write dataset.yaml, measurements.csv and, unless it is a built-in one as it stands, robot.yaml.

    Parameters
    ----------
    dataset : Dataset
        What to write. Values are rounded to `DECIMALS`.
    folder : Path or str
        Made by this; may exist only if empty.

    Raises
    ------
    BayescalError
        If the folder holds something already. Whatever fails, no half-written folder stays.
    """
    folder = Path(folder)
    check_new(folder)
    with whole(folder, SETTINGS) as stage:
        write_files(dataset, stage)


def write_files(dataset: Dataset, folder: Path) -> None:
    """Write the files of a dataset into a folder that is there, as `write_dataset` does."""
    write_setup(dataset, folder)
    (folder / TABLE).write_text(table_text(dataset), encoding="utf-8", newline="")


def write_setup(dataset: Dataset, folder: Path) -> tuple[str, ...]:
    """Write dataset.yaml and, unless it is a built-in one, robot.yaml into a folder; return their names."""
    reference, robot = dataset.robot_reference, robot_to_yaml(dataset.robot)
    builtin = reference in builtin_robots() and robot_to_yaml(load_robot(reference)[0]) == robot
    files = {SETTINGS: _settings(dataset, reference if builtin else ROBOT)}
    if not builtin:
        files[ROBOT] = robot
    for points in (c.points for c in dataset.certificates if c.points is not None):
        files[ARTEFACT] = artefact_text(points)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8", newline="")
    meshes = {s.file: s.points for s in dataset.solids if s.file}
    for name, corners in meshes.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(hull_stl(corners))
    return (*files, *meshes)


def _text(key: str, value: np.ndarray | float | str) -> str:
    """A value in SI as `key` writes it: a number or a list, in the key's unit, rounded; or a text."""
    if isinstance(value, str):
        return scalar(value)
    if np.ndim(value) == 2:
        return flow_list([_text(key, row) for row in np.asarray(value)])
    texts = _numbers(key, np.atleast_1d(value))
    return flow_list(texts) if np.ndim(value) else texts[0]


def _numbers(key: str, values: np.ndarray) -> list[str]:
    """Numbers (N,) in SI as a key or column writes them: in its unit, rounded; nan is empty."""
    stem, unit = stem_of(key)
    # the column `u_px` is a coordinate
    of_u, decimals = key != "u_px" and f"{stem}_".startswith("u_"), DECIMALS.get(unit, DIRECTION)

    def text(value: float) -> str:
        return number(value, UNCERTAINTY) if of_u else number(round(value, decimals), 15)

    return ["" if math.isnan(v) else text(v) for v in (np.asarray(values, float) / si(key)).tolist()]


def _keys(model: type[Model], of: object) -> Keys:
    """The keys of an entry whose fields have a value."""
    return _keys_of((key, getattr(of, field_of(key))) for key in model.model_fields)


def _keys_of(values: Iterable[tuple[str, np.ndarray | float | str | None]]) -> Keys:
    """Keys with a value in SI, and its text."""
    return ((key, _text(key, value)) for key, value in values if value is not None)


def _held(ground: Ground) -> Keys:
    return _keys_of((("mass_kg", ground.held), ("centre_of_mass_mm", ground.held_centre)))


def tool_keys(tool: Tool) -> Keys:
    """The entry of a tool."""
    return ((key, text) for key, text in _keys(ToolEntry, tool) if tool.mass or key != "mass_kg")


def target_keys(target: Target) -> Keys:
    """The entry of a target."""
    yield "kind", target.kind
    keys, optional = KINDS[target.kind].keys, KINDS[target.kind].optional
    yield from _keys_of((key, target.texts[key]) for key in keys if key in target.texts)
    given = dict.fromkeys((stem_of(key)[0] for key in optional), np.nan) | target.values
    of_kind = ((key, given[stem_of(key)[0]]) for key in keys if key not in target.texts)
    values = (*of_kind, ("u_mm", target.u), ("u_rad", target.u_angle))
    yield from _keys_of((k, v) for k, v in values if v is not None and not np.isnan(v).any())


def certificate_keys(certificate: Certificate) -> Keys:
    """The entry of a certificate."""
    yield "kind", certificate.kind
    names = [scalar(name) for name in certificate.targets]
    for key in CERTIFICATES[certificate.kind].model_fields:
        if key in NAMING:
            yield key, names[0] if key == "target" else flow_list(names)
        elif stem_of(key)[1]:
            yield key, _text(key, getattr(certificate, field_of(key)))


def plan_block(plan: PlanSettings, units: Sequence[str]) -> Block:
    """What is below `plan`, in the order of its model; `units` of the joints as of `Robot.units`."""
    keys = [f"reading_{unit}" for unit in units]
    poses = [flow_list(map(_text, keys, pose)) for pose in plan.poses]
    values = {
        "table_mm": plan.table,
        "payload_kg": np.array(plan.payloads) if plan.payloads else None,
        "cone_deg": plan.cone,
        "clearance_mm": plan.clearance,
    }
    return {
        "volume_of_interest": None if plan.volume is None else flow(_keys(VolumeEntry, plan.volume)),
        "regions": {name: flow(_keys(RegionEntry, patch)) for name, patch in plan.regions.items()},
        **dict(_keys_of(values.items())),
        "poses_deg": flow_list(poses) if poses else None,
    }


def _record(record: Record) -> Block:
    """What is below `record`, in the order of its model."""
    warm = record.temperature
    return {
        "date": record.date and scalar(record.date),
        "operator": record.operator and scalar(record.operator),
        "serials": record.serials and flow((key, scalar(text)) for key, text in record.serials.items()),
        "certificates": flow_list(map(scalar, record.certificates)) if record.certificates else None,
        "temperature_degC": None if warm is None else _text("temperature_degC", warm),
    }


def _settings(dataset: Dataset, robot: str) -> str:
    """dataset.yaml, in the contract's order; values that are only assumed are marked again."""

    def marked(items: Keys, *path: str | int) -> Keys:
        for key, text in items:
            place = (*path, key)
            # a mark of an entry marks all below it, and one below marks the entry
            assumed = any(all(map(eq, place, mark)) for mark in dataset.unfilled)
            yield key, f"{FILL_IN} {text}" if assumed else text

    noise = {key: getattr(dataset.noise, field_of(key)) for key in NoiseEntry.model_fields}
    stated = ((key, number(v / si(key), UNCERTAINTY)) for key, v in noise.items() if v is not None)
    certificates = enumerate(c for c in dataset.certificates if c.points is None and not c.derived)
    plan = None if dataset.plan is None else plan_block(dataset.plan, dataset.robot.units)
    block: Block = {
        "schema": SCHEMA,
        "name": scalar(dataset.name),
        "robot": scalar(robot),
        "readings": dataset.readings,
        "gravity_mps2": _text("gravity_mps2", dataset.gravity),
        "tools": {t.name: flow(marked(tool_keys(t), "tools", t.name)) for t in dataset.tools},
        "held": None if not (ground := dataset.robot.ground) or not ground.held else flow(_held(ground)),
        "noise": dict(marked(stated, "noise")),
        "targets": {t.name: flow(marked(target_keys(t), "targets", t.name)) for t in dataset.targets},
        "certificates": [flow(marked(certificate_keys(c), "certificates", i)) for i, c in certificates],
        "artefact": ARTEFACT if any(c.points is not None for c in dataset.certificates) else None,
        "temperature_of": dataset.temperature_of,
        "torques": dataset.torques if dataset.torques != "computed" else None,
        "solids": {s.name: flow(_keys_of(solid_values(s))) for s in dataset.solids},
        "plan": "{}" if dataset.plan == PlanSettings() else plan,
        "record": None if dataset.record == Record() else _record(dataset.record),
        "source": None if dataset.source is None else scalar(dataset.source),
    }
    return "\n".join(block_lines(block)) + "\n"


def table_text(dataset: Dataset, name_tool: bool = False) -> str:
    """The content of measurements.csv, in the contract's order of columns; `name_tool`: also an only tool."""
    rows = dataset.measurements
    columns: dict[str, Iterable[str]] = {"id": rows.ids, "role": map(str, rows.role)}
    columns["target"] = [dataset.targets[i].name for i in rows.target]
    if name_tool or len(dataset.tools) > 1:
        columns["tool"] = [dataset.tools[i].name for i in rows.tool]
    for field, names in fields_of_columns(dataset.robot.units).items():
        values = getattr(rows, field)
        if values is not None and field in LABELS:
            columns[field] = map(str, values)
        elif values is not None:
            each = zip(names, np.atleast_2d(values.T), strict=True)
            columns |= {name: _numbers(name, column) for name, column in each}
    return csv_text(columns, zip(*columns.values(), strict=True))
