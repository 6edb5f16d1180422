"""A table of targets: CSV with poses or nominal readings, and the same table with corrected readings.

Columns have their unit in their name: `x_mm` ... `rz_deg` (rx, ry, rz: fixed-axis roll, pitch and yaw of the
tool's frame, R = Rz(rz) Ry(ry) Rx(rx)), or `j1_deg` ..., or both: then the solution nearest to these readings
is taken. Also `j1_degps` ... (their signs are the direction of approach), `payload_kg`, `tool`. Others are
kept.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset.table import RPY, XYZ, check_groups, check_names, joint_columns, read_cells
from bayescal.errors import BayescalError
from bayescal.exporting.compensate.targets import Corrected, Target
from bayescal.files import stem_of, unknown

DEGREES = 7  # decimals of a reading in degrees
OUTPUT = ("u_mm", "inside_probed_region", "reason", "error_mm", "solutions", "U_mm", "verdict")


@dataclass(frozen=True)
class TargetTable:
    """A table of M targets, its cells as text, and the character that ends its lines."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    targets: tuple[Target, ...]
    newline: str


def is_target_table(text: str) -> bool:
    """Whether a CSV file has a header of this format, or one that is meant to be it."""
    columns = [c.strip() for c in text.split("\n", 1)[0].split(",")]
    return any(stem_of(c)[1] for c in columns)


def read_targets(path: Path, n: int, payload_kg: float = 0.0) -> TargetTable:
    """Read a table of targets for an arm with `n` joints; without its column, `payload_kg` is that of all.

    Raises
    ------
    BayescalError
        With the line, for columns that are missing, ambiguous or written by a compensation, and for cells
        that are empty or not numbers.
    """
    table = read_cells(path, lambda header, where: _check_header(header, where, n))
    count = len(table.line)
    nothing = [None] * count
    xyz, rpy = table.block(XYZ, True), table.block(RPY, True)
    poses: Sequence[np.ndarray | None] = nothing
    if xyz is not None and rpy is not None:
        poses = [rigid(r, p) for r, p in zip(rpy_matrix(rpy), xyz, strict=True)]
    readings = table.block(joint_columns("deg", n), True)
    velocity = table.block(joint_columns("degps", n), True)
    payload = table.optional("payload_kg", True)
    if payload is not None:
        table.first(payload < 0, "`payload_kg` is {payload_kg}", "give a mass of 0 or more")
    tools = table.texts("tool")
    targets = tuple(
        Target(
            f"{table.name}:{table.line[k]}",
            poses[k],
            None if readings is None else readings[k],
            velocity=None if velocity is None else velocity[k],
            payload=payload_kg if payload is None else float(payload[k]),
            tool=None if tools is None else str(tools[k]) or None,
        )
        for k in range(count)
    )
    rows = tuple(zip(*table.cells.values(), strict=True))
    newline = "\r\n" if b"\r\n" in table.content else "\n"
    return TargetTable(tuple(table.cells), rows, targets, newline)


def _check_header(header: list[str], where: str, n: int) -> None:
    check_names(header, where)
    known = [*XYZ, *RPY, *joint_columns("deg", n), *joint_columns("degps", n), "payload_kg", "tool"]
    stems = {stem_of(c)[0] for c in known}
    written = {*OUTPUT, *(nominal(c) for c in joint_columns("deg", n))}
    for column in header:
        if column in written:
            what = f"column `{column}` is written by a compensation"
            raise BayescalError(what, where, "rename or delete it, and give targets that are not corrected")
        if column not in known and stem_of(column)[0] in stems:
            what, remedy = unknown("column", column, known)
            raise BayescalError(what, where, remedy)
    check_groups(header, where, ((*XYZ, *RPY), joint_columns("deg", n), joint_columns("degps", n)))
    if "x_mm" not in header and "j1_deg" not in header:
        what = "the table has neither poses nor joints"
        raise BayescalError(what, where, f"give {', '.join((*XYZ, *RPY))}, or j1_deg to j{n}_deg")


def nominal(column: str) -> str:
    """The column that keeps the readings of the input: ``j1_nominal_deg``."""
    return f"{stem_of(column)[0]}_nominal_deg"


def written(table: TargetTable, found: Sequence[Corrected], n: int, verdict: str) -> str:
    """The table with corrected readings, its own readings as ``j1_nominal_deg`` ... and the verdict."""
    joints = joint_columns("deg", n)
    header = [nominal(c) if c in joints else c for c in table.header]
    return csv_text([*header, *joints, *OUTPUT], (
        [*row, *cells(own, n, verdict)] for row, own in zip(table.rows, found, strict=True)
    ), table.newline)  # fmt: skip


def cells(own: Corrected, n: int, verdict: str) -> list[str]:
    """Cells of a corrected target: readings, then the columns of `OUTPUT`."""
    if own.readings is None:
        return [*[""] * n, "", "", own.reason, "", "", "", verdict]
    readings = [f"{x:.{DEGREES}f}" for x in np.degrees(own.readings)]
    inside = "true" if own.inside else "false"
    rest = [f"{1e3 * own.error:.5f}", str(own.solutions), f"{1e3 * own.expanded:.5f}", verdict]
    return [*readings, f"{1e3 * own.u:.5f}", inside, "", *rest]


def csv_text(header: Sequence[str], rows: object, newline: str = "\n") -> str:
    """A CSV table as text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator=newline)
    writer.writerow(header)
    writer.writerows(rows)  # type: ignore[arg-type]
    return out.getvalue()
