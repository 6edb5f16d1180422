"""Rows of a log as the contacts of a plan: what was measured from the log, all else from the plan, by id."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Dataset, Measurements, Target
from bayescal.dataset.read import SETTINGS, measurements_of
from bayescal.dataset.table import table_of
from bayescal.dataset.target_kinds import KINDS
from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns, columns_of, first
from bayescal.importing.log import read_log
from bayescal.importing.mapping import TEXTS, own_map
from bayescal.importing.pair import check_ids, rows_words
from bayescal.importing.programs import CONTACT, numbered, state_of, unmade
from bayescal.storage.reading import content_of

PLAN = "plan.csv"
MEASURED = "measured.csv"
"""Rows of the session that a plan continues, beside the plan."""
UNTOUCHED = 1e-6
"""rad: a contact whose joints all read what was planned, to this, was not made: an arm is not so exact."""
NEAR = 1e-4
"""rad: most uncalibrated arms have larger errors; contacts this close to the plan may be commanded poses."""
FAR = np.radians(5.0)
"""rad: a contact this far from the plan, at any joint, is another contact (assumed)."""
SHOWN = 4
"""Ids in a message."""
SAME = ("target", "tool", "role")
"""Texts that a log may repeat, but not change."""


@dataclass(frozen=True)
class Joined:
    """Rows of a log with what was planned for them.

    Attributes
    ----------
    columns : Columns
        The rows that were measured, in the order of the log.
    notes : tuple of str
        What is missing or left out.
    commanded : bool
        The log has no joint readings: they are those of the plan.
    far : np.ndarray, shape (N,)
        Rows that are far from their plan.
    by_order : bool
        The log has no ids, or numbers of another plan: its rows must be those of the plan, in their order.
    """

    columns: Columns
    notes: tuple[str, ...]
    commanded: bool
    far: np.ndarray
    by_order: bool

    def check(self) -> None:
        """Refuse rows that are far from their plan where only their order says which contact they are."""
        if self.by_order:
            ids, what = self.columns.cells["id"], "not at the readings of `{}`, the contact at this place"
            remedy = "map `id`, so that rows are assigned by id"
            first(self.columns, self.far, lambda row: f"{what.format(ids[row])} of the plan", remedy)


def files_of(plan: Path) -> tuple[Path, Path]:
    """The table of a plan and its dataset.yaml; `plan` is a run folder or the table in it.

    Raises
    ------
    BayescalError
        If one of them does not exist.
    """
    table = plan / PLAN if plan.is_dir() else plan
    files = table, table.parent / SETTINGS
    for path in files:
        if not path.is_file():
            remedy = "give a run folder of bayescal plan"
            raise BayescalError(f"there is no {path.name}", str(path.parent), remedy)
    return files


def measured_before(plan: Path, base: Dataset) -> Measurements | None:
    """The rows of the session that a plan continues; None of a plan that begins one.

    Parameters
    ----------
    plan : Path
        The table of the plan.
    base : Dataset
        The setup of the plan.
    """
    path = plan.parent / MEASURED
    if not path.is_file():
        return None
    units = base.robot.units
    table = table_of(content_of(path), path.name, units)
    return measurements_of(table, units, base.tools, base.targets, base.noise)


def onto(log: Columns, plan: Path, targets: Sequence[Target], robot: Robot) -> Joined:
    """Assign the rows of a log to the contacts of a plan.

    Parameters
    ----------
    log : Columns
        What was measured; with the column `id`, or a row for each contact of the plan in its order.
    plan : Path
        The table of the plan.
    targets : sequence of Target
        Of the plan.
    robot : Robot

    Raises
    ------
    BayescalError
        For ids that are not in the plan, are given twice or contradict it, and for a log without the joint
        readings of contacts or in which nothing was measured.
    """
    table = read_log(plan, headed=True)
    planned = columns_of(table, own_map(table.header, robot.units, table.name))
    by_order = "id" not in log.cells
    if by_order:
        log = _in_order(log, planned)
    check_ids(log)
    check_ids(planned)
    log, registers = _of_registers(log, planned)
    log, planned, notes = _by_id(log, planned)
    for key in SAME:
        if key in log.cells and key in planned.cells:
            _check_same(log, planned, key)
    reads = _reads(planned.cells["target"], targets)
    deviation, state, commanded = _deviations(log, planned, reads, robot.n)
    ids = log.cells["id"]
    notes += unmade(dict(zip(ids.tolist(), state.tolist(), strict=True)))
    made = np.where(reads == "", deviation >= UNTOUCHED, _given(log, reads)) & np.isfinite(deviation)
    if not made.any():
        what = "nothing was measured: its rows are empty or state what was planned"
        raise BayescalError(what, log.name, "write the readings at which each contact was made")
    idle = ~made & (state == CONTACT)
    notes += _counted(ids[idle], f"of {log.name} without a measurement (empty, or as planned)")

    def mm(limit: float) -> str:
        """The same limit of prismatic joints, if there are any."""
        return f" ({1e3 * limit:.2g} mm)" if robot.slides.any() else ""

    far, near = made & (deviation > FAR), made & (deviation < NEAR) & (reads == "")
    count = made.sum()
    if 2 * near.sum() > count:
        what = f"{near.sum()} of {count} contacts are within {np.degrees(NEAR):.2g} deg{mm(NEAR)} of the plan"
        notes.append(f"{what}: check that the log has the readings at the contact, not the commanded ones")
    notes += _counted(ids[far], f"more than {np.degrees(FAR):.0f} deg{mm(FAR)} from the plan")
    other = registers and 2 * far.sum() > count  # registers of another program
    columns = _joined(log, planned).take(made)
    return Joined(columns, tuple(notes), commanded, far[made], by_order or other)


def _of_registers(log: Columns, planned: Columns) -> tuple[Columns, bool]:
    """The log by the ids of the plan, and whether it has the numbered registers of a program instead."""
    if np.isin(log.cells["id"], planned.cells["id"]).any():
        return log, False
    ids = numbered(log.cells["id"], planned.cells["id"].tolist())
    of_plan = ids != log.cells["id"]
    if not of_plan.any():
        return log, False
    return replace(log, cells=log.cells | {"id": ids}).take(of_plan), True


def _deviations(
    log: Columns, planned: Columns, reads: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Largest difference from the plan (N,), rad, nan without a contact; states (N,); whether commanded."""
    joints, remedy = [f"j{i + 1}" for i in range(n)], f"map j1 to j{n}"
    missing = [key for key in joints if key not in log.cells]
    if commanded := len(missing) == n:
        what = "needs the joint readings at which it was measured"
        first(log, reads == "", lambda row: f"`{log.cells['id'][row]}` {what}", remedy)
    elif missing:
        raise BayescalError(f"no column holds `{missing[0]}`", log.name, remedy)
    stated = np.column_stack([planned.cells[key] for key in joints])
    readings = stated if commanded else np.column_stack([log.cells[key] for key in joints])
    state = state_of(readings[:, 0])
    return np.where(state == CONTACT, np.max(np.abs(readings - stated), axis=1), np.nan), state, commanded


def _in_order(log: Columns, planned: Columns) -> Columns:
    if log.count != planned.count:
        what = f"{log.count} rows without ids, but {planned.count} contacts in {planned.name}"
        raise BayescalError(what, log.name, "map `id`, so that rows are assigned by id")
    return replace(log, cells=log.cells | {"id": planned.cells["id"]})


def _by_id(log: Columns, planned: Columns) -> tuple[Columns, Columns, list[str]]:
    """Rows of both with the same id, in the log's order, and what is missing in either."""
    place = {name: row for row, name in enumerate(planned.cells["id"].tolist())}
    ids = log.cells["id"]
    in_plan = np.isin(ids, list(place))
    if not in_plan.any():
        what = f"no id of {log.name} is in {planned.name}"
        examples = f"`{ids[0]}` and `{planned.cells['id'][0]}` are the first ids"
        raise BayescalError(what, log.name, f"{examples}; map the column of the ids")
    notes = _counted(ids[~in_plan], f"of {log.name} excluded: not in the plan")
    absent = planned.cells["id"][~np.isin(planned.cells["id"], ids)]
    notes += _counted(absent, f"of the plan missing in {log.name}")
    rows = np.array([place[name] for name in ids[in_plan].tolist()])
    return log.take(in_plan), planned.take(rows), notes


def _check_same(log: Columns, planned: Columns, key: str) -> None:
    """Refuse a target, tool or role (`key`) that is not the planned one."""
    ids, names, expected = log.cells["id"], log.cells[key], planned.cells[key]

    def what(row: int) -> str:
        return f"{key} `{names[row]}`, but `{expected[row]}` in the plan of `{ids[row]}`"

    first(log, (names != "") & (names != expected), what, "correct the cell, or the id")


def _reads(names: np.ndarray, targets: Sequence[Target]) -> np.ndarray:
    """What an instrument reads at the named targets (N,): xyz, length, or "" where the arm measures."""
    stated = {t.name for t in targets if np.isfinite(t.values.get("length", np.nan))}
    reads = {t.name: "" if t.name in stated else KINDS[t.kind].reads for t in targets}
    return np.array([reads.get(name, "") for name in names.tolist()])


def _given(log: Columns, reads: np.ndarray) -> np.ndarray:
    """Rows (N,) that have what an instrument reads: coordinates or a length."""
    out = np.ones(log.count, bool)
    for key, kind in (*dict.fromkeys("xyz", "xyz").items(), ("length", "length")):
        out &= (reads != kind) | np.isfinite(log.cells.get(key, np.full(log.count, np.nan)))
    return out


def _joined(log: Columns, planned: Columns) -> Columns:
    """What the log states; where it is silent, what was planned."""
    cells = dict(planned.cells)
    for key, column in log.cells.items():
        stated = column != "" if key in TEXTS else np.isfinite(column)
        cells[key] = np.where(stated, column, planned.cells.get(key, column))
    return replace(log, cells=cells, said=planned.said | log.said)


def _counted(ids: Iterable[str], what: str) -> list[str]:
    """A note on some rows, with their first ids; nothing for none."""
    names = [str(name) for name in ids]
    if not names:
        return []
    more = ", ..." if len(names) > SHOWN else ""
    return [f"{rows_words(len(names))} {what}: {', '.join(names[:SHOWN])}{more}"]
