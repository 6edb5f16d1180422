"""From a log, its map and further information to a dataset, in memory and on disk."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Dataset, read_dataset
from bayescal.dataset.consistency import away
from bayescal.dataset.plausibility import Suspicion, suspicion
from bayescal.dataset.read import SETTINGS, TABLE
from bayescal.dataset.write import followed, write_files
from bayescal.errors import BayescalError
from bayescal.importing import ask, mapping
from bayescal.importing.ask import Request, base_of, furnished
from bayescal.importing.columns import Columns, columns_of, missing_in
from bayescal.importing.log import read_log
from bayescal.importing.mapping import OF_CONTACTS, OF_JOINTS, Column, Map
from bayescal.importing.onto import files_of, measured_before, onto
from bayescal.importing.orientations import Loose, compared
from bayescal.importing.pair import is_measured, pair, rows_words, stacked, unfolded, with_points
from bayescal.importing.programs import LISTINGS, format_of, read_listing, read_records
from bayescal.importing.roles import SINGLE, measurements, readings, role_note, with_roles
from bayescal.importing.units import SPELLED, UNITS, meant
from bayescal.robots import only_revolute
from bayescal.statistics import grouped

SHOWN = 12
"""Unused columns in a message."""


def mapping_words(columns: Columns) -> tuple[str, ...]:
    """The columns with their units, joints together, and the columns that are not used."""
    entries = [f"{key} = {_source(column)}" for key, column in _folded(columns.said).items()]
    lines = [f"columns of {columns.name}: {'; '.join(entries)}"]
    if columns.unused:
        more = f", ... ({len(columns.unused)} in all)" if len(columns.unused) > SHOWN else ""
        lines.append(f"columns not used: {', '.join(columns.unused[:SHOWN])}{more}")
    return (*lines, *columns.notes)


def row_words(dataset: Dataset, line: int) -> str:
    """The first row as it was understood; `line` is its line in the log."""
    rows, robot = dataset.measurements, dataset.robot
    parts = [
        f"id {rows.ids[0]}",
        f"target {dataset.targets[rows.target[0]].name}",
        *([f"tool {dataset.tools[rows.tool[0]].name}"] if len(dataset.tools) > 1 else []),
        f"joints {_numbers(robot.shown(rows.readings[0]), 4)} {robot.unit_words}",
    ]
    if rows.xyz is not None:
        parts.append(f"point {_numbers(1e3 * rows.xyz[0], 4)} mm")
    if rows.rpy is not None:
        parts.append(f"roll, pitch, yaw {_numbers(np.degrees(rows.rpy[0]), 4)} deg")
    for name, unit in SINGLE.items():
        values, scale = getattr(rows, name), 1e3 if unit == "mm" else 1.0
        if values is not None and np.isfinite(values[0]):
            parts.append(f"{name} {values[0] * scale:.6g} {unit}")
    return f"first row (line {line}): {', '.join(parts)}"


def _numbers(values: np.ndarray, decimals: int) -> str:
    return " ".join(f"{v:.{decimals}f}" for v in values)


def _folded(said: dict[str, Column]) -> dict[str, Column]:
    """Entries with those of all joints as the first and the last, where they differ by the number alone."""
    groups = grouped((re.sub(r"^j\d+", "j*", key), key) for key in said)
    out: dict[str, Column] = {}
    for key, column in said.items():
        keys = groups[re.sub(r"^j\d+", "j*", key)]
        if len({(re.sub(r"\d+", "*", said[k].name), said[k].unit) for k in keys}) > 1 or len(keys) < 2:
            out[key] = column
        elif key == keys[0]:
            out[f"{key} to {keys[-1]}"] = replace(column, name=f"{column.name} to {said[keys[-1]].name}")
    return out


def _source(column: Column) -> str:
    if column.constant:
        return f"'{column.name}'"
    unit = column.stamp or (column.unit.name if column.unit else "")
    return " ".join(filter(None, (column.name, column.turn, unit)))


def unit_words(wrong: Suspicion, columns: Columns) -> str:
    """A message: the stated unit, the probable unit, and the errors of the rows with both."""
    first, last = wrong.quantities[0], wrong.quantities[-1]
    noun = f"`{first}`" if first == last else f"`{first}` to `{last}`"
    unit = columns.unit(first) or UNITS["deg" if first.startswith("j") else "mm"]
    other = meant(unit, wrong.factor)
    size = f"{max(wrong.factor, 1 / wrong.factor):.0f} times too {'small' if wrong.factor > 1 else 'large'}"
    agree = f"{f'in {other}' if other else 'corrected,'} they agree with the nominal arm within"
    within = f"{1e3 * wrong.other:.2g} mm, in {unit.name} within {1e3 * wrong.stated:.0f} mm"
    return f"{noun} cannot be in {unit.name}: the numbers are {size}; {agree} {within}"


def located_words(dataset: Dataset, loose: Loose) -> tuple[str, ...]:
    """Located instruments and reflectors, and the error of the nominal arm."""
    reflectors = (tool for tool in dataset.tools if tool.name in loose.tools)
    lines = [f"reflector `{t.name}` located at {_mm(t.centre)} mm in the flange frame" for t in reflectors]
    for target in (t for t in dataset.targets if t.name in loose.targets):
        turn = ", ".join(f"{v:.3f}" for v in np.rad2deg(target.values["rpy"]))
        place = f"{_mm(target.values['xyz'])} mm, rpy {turn} deg"
        lines.append(f"instrument `{target.name}` located at {place}")
    off = 1e3 * away(dataset, dataset.measurements.readings)
    lines.append(f"error of the nominal arm: median {np.median(off):.2g} mm, maximum {off.max():.2g} mm")
    return tuple(lines)


def _mm(point: np.ndarray | float) -> str:
    return ", ".join(f"{1e3 * v:.2f}" for v in np.atleast_1d(point))


@dataclass(frozen=True)
class Draft:
    """A dataset before it is written: what was read, notes, what is wrong (or ""), and its source."""

    dataset: Dataset
    headline: str
    notes: tuple[str, ...]
    wrong: str = ""
    log: str = ""  # of the rows, for messages; "" where they are of no table
    line: np.ndarray = field(default_factory=lambda: np.zeros(0, int))  # (N,) of each row in the log
    understood: tuple[str, ...] = ()  # the columns, and the first row as it was read
    before: int = 0  # rows that were measured before those of the log
    beside: Mapping[str, bytes] = field(default_factory=dict)  # further files by name
    noun: ClassVar[str] = "dataset"

    def write(self, stage: Path, judge: bool) -> None:
        """Write the files, and check that they can be read, with plausible values if asked to `judge`."""
        write_files(self.dataset, stage)
        try:
            read_dataset(stage, judge=judge)
        except BayescalError as error:
            raise BayescalError(error.what, self._whence(error.where), error.remedy) from None
        for name, content in self.beside.items():
            (stage / name).write_bytes(content)

    def _whence(self, where: str) -> str:
        """The log's line for one of the measurements.csv that would be."""
        file, _, line = where.rpartition(":")
        if not self.log:
            return where
        if file == TABLE and 0 <= (row := int(line) - 2 - self.before) < len(self.line):
            return f"{self.log}:{self.line[row]}"
        return f"{self.log} as a dataset" if file in (SETTINGS, TABLE) else where


def convert_contacts(request: Request) -> Draft:
    """Read a log into a dataset.

    Parameters
    ----------
    request : Request
        Files, what their columns hold, and the robot, or a template with tools and targets.

    Returns
    -------
    Draft
        Its `wrong` states in one line which numbers are in another unit than stated.

    Raises
    ------
    BayescalError
        For a file or a map that cannot be read, or where required information is missing.
    """
    request.check()
    if request.plan is not None and request.format == "csv" and not request.map:
        request = replace(request, format=format_of(request.log))
    base = base_of(request)
    columns, centres, notes, mapped = _columns(request, base.robot)
    _refuse_motions(columns)
    columns, late = _from_the_beginning(columns)
    notes = (*notes, *late)
    joined = None
    if request.plan is not None:
        joined = onto(columns, files_of(request.plan)[0], base.targets, base.robot)
        columns, notes = joined.columns, (*notes, *joined.notes)
        if joined.commanded:
            base = replace(base, readings="command")
            notes = (*notes, "joint readings are those of the plan, as commanded")
    columns, hidden = with_points(columns, base.targets)
    notes = (*notes, *hidden)
    joints = readings(columns, base.robot.n)
    base, loose = furnished(base, request, columns, centres)
    dataset = replace(base, measurements=measurements(columns, joints, base.tools, base.targets))
    loose.check(dataset)
    dataset = loose.settled(dataset)
    suspected = suspicion(dataset, loose.settled)
    wrong = "" if suspected is None else unit_words(suspected, columns)
    if joined is not None and not wrong:
        joined.check()
    turned, agree = compared(dataset, columns)
    wrong = wrong or ("" if agree else turned)
    dataset, roles = roles_of(request, dataset, "role" in columns.cells)
    notes = (*notes, *located_words(dataset, loose), *filter(None, [turned if agree else ""]), roles)
    understood = (*mapped, row_words(dataset, int(columns.line[0])))
    dataset, before, said = _continuing(request, dataset)
    headline = f"{columns.count} rows of {dataset.robot.name} from {columns.name}"
    return Draft(dataset, headline, (*notes, *said), wrong, columns.name, columns.line, understood, before)


def roles_of(request: Request, dataset: Dataset, stated: bool) -> tuple[Dataset, str]:
    """The dataset with its validation data, by the option or the entry of the map, and a note on them."""
    rule, where = mapping.validation_rule(request.map)
    if rule and request.validate:
        raise BayescalError("`validate` is stated by the map already", "--validate", "remove one of the two")
    if request.validate:
        rule, where = request.validate, "--validate"
    if not rule:
        return dataset, role_note(dataset)
    if stated:
        what = f"{'the plan' if request.plan else 'a column'} states the role of each row already"
        raise BayescalError(what, where, "remove one of the two")
    return with_roles(dataset, rule, where)


def _continuing(request: Request, dataset: Dataset) -> tuple[Dataset, int, list[str]]:
    """The dataset behind the rows of the session that its plan continues, with their number, and notes."""
    old = None if request.plan is None else measured_before(files_of(request.plan)[0], dataset)
    if old is None:
        return dataset, 0, []
    rows, lost = followed(old, dataset.measurements)
    notes = [f"they continue {len(old.ids)} rows that were measured before, on unmoved targets"]
    notes += [f"not in all rows, left out: {', '.join(lost)}"] if lost else []
    return replace(dataset, measurements=rows), len(old.ids), notes


def _refuse_motions(columns: Columns) -> None:
    """Refuse quantities that only a joint log has."""
    for key in columns.cells:
        if key in ("motion", "kind") or key.lstrip("j0123456789") in OF_JOINTS.keys() - OF_CONTACTS:
            what = f"`{key}` is a quantity of joint logs"
            raise BayescalError(what, "--map", "remove it, or give --motions too")


def _from_the_beginning(columns: Columns) -> tuple[Columns, tuple[str, ...]]:
    """The columns with times since the first of them, of time stamps; and a note on their order."""
    if "time" not in columns.cells:
        return columns, ()
    time = columns.cells["time"]
    back = int((np.diff(time[np.isfinite(time)]) < 0).sum())
    note = f"{back} rows are earlier than the row above: the order of rows is taken as the order of time"
    if columns.clock:
        columns = replace(columns, cells=columns.cells | {"time": time - np.nanmin(time)}, clock="")
    return columns, (note,) if back else ()


Read = tuple[Columns, dict[str, np.ndarray], tuple[str, ...], tuple[str, ...]]
"""Rows by quantity; TCP positions that the log itself holds; what was left out; the columns in words."""


def _columns(request: Request, robot: Robot) -> Read:
    """All rows of a request."""
    centres: dict[str, np.ndarray] = {}
    notes: list[str] = []
    n, servos = robot.n, request.servos(robot.joint_names)
    if request.format != "csv" or servos:
        only_revolute(robot, f"logs of {request.format}", "import a table, with a map")
    if request.format == "robodk" and not request.map:
        log = read_log(request.log)
        columns, centres = ask.robodk(log, n)
        if count := len(log.rows) - columns.count:
            notes.append(f"{rows_words(count)} of {log.name} excluded: not measured (0, 0, 0)")
    elif request.format == "csv" and not request.map:
        log = read_log(request.log, headed=True)
        columns = columns_of(log, mapping.own_map(log.header, robot.units, log.name), request.decimal)
    else:
        map_: Map = mapping.read_map(ask.MAPS[request.format], robot.units, formal=True)
        map_ = {**map_, **mapping.read_map(request.map, robot.units)}
        map_ = mapping.calibrated(map_, servos) if servos else map_
        if request.format == "probing":
            columns = columns_of(read_records(request.log, n), map_)
        elif request.format in LISTINGS:
            columns = columns_of(read_listing(request.log, request.format, n), map_)
        else:
            columns = _mapped(request.log, map_, request.decimal)
    files = [_points(request, path, said, robot) for path, said in request.files] if request.points else []
    mapped = tuple(words for part in (columns, *files) for words in mapping_words(part))
    parts = []
    for points in sorted(files, key=is_measured):  # conditions first: they are those of all measurements
        both, left_out = pair(request.pair, columns, points)
        notes += left_out
        if is_measured(points):
            parts.append(both)
        else:
            columns = both
    unfolds = [unfolded(part) for part in parts or [columns]]
    notes += [note for _, left_out in unfolds for note in left_out]
    columns = stacked([part for part, _ in unfolds]) if len(unfolds) > 1 else unfolds[0][0]
    return columns, centres, tuple(notes), mapped


def _points(request: Request, path: Path, said: str, robot: Robot) -> Columns:
    """A file beside the log; its map may be the unit of its points alone."""
    if said.strip() in SPELLED:
        log = read_log(path)
        return columns_of(log, ask.points_map(log, said.strip()), request.decimal)
    return _mapped(path, mapping.read_map(said, robot.units), request.decimal)


def _mapped(path: Path, map_: Map, decimal: str) -> Columns:
    """A file by its map; it has a header where any column is called by its name."""
    return columns_of(read_log(path, missing=missing_in(map_)), map_, decimal)
