"""The compensation of a file: a table of targets or a robot program, with corrected positions.

A table of targets is a CSV file with poses or nominal readings. Columns have their unit in their name: `x_mm`
... `rz_deg` (rx, ry, rz: fixed-axis roll, pitch and yaw of the tool's frame, R = Rz(rz) Ry(ry) Rx(rx)), or
`j1_deg` ... (`j1_mm` of a prismatic joint), or both: then the solution nearest to these readings is taken.
Also `j1_degps` ... (their signs are the direction of approach), `payload_kg`, `tool`. Others are kept.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.compensating.position import BASE
from bayescal.compensating.solve import compensated
from bayescal.dataset.table import RPY, XYZ, check_groups, check_names, csv_text, joint_columns, read_cells
from bayescal.errors import BayescalError
from bayescal.fitted.arm import FittedArm
from bayescal.programs import PROGRAMS
from bayescal.programs.text import Corrected, Format, Program, Target, line_of, rewritten
from bayescal.programs.tools import check_stated, tool_of
from bayescal.robots import only_one_arm, only_revolute
from bayescal.storage.files import stem_of, unknown, write_together
from bayescal.storage.reading import content_of

DEGREES = 7  # decimals of a reading in degrees or mm
OUTPUT = ("u_mm", "inside_probed_region", "reason", "error_mm", "solutions", "U_mm", "verdict")


@dataclass(frozen=True)
class TargetTable:
    """A table of M targets, its cells as text, and the character that ends its lines."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    targets: tuple[Target, ...]
    newline: str
    kept: tuple[str, ...]  # columns that state nothing of a target


def is_target_table(text: str) -> bool:
    """Whether a CSV file has a header of this format, or one that is meant to be it."""
    columns = [c.strip() for c in text.split("\n", 1)[0].split(",")]
    return any(stem_of(c)[1] for c in columns)


def read_targets(path: Path, robot: Robot, payload_kg: float = 0.0) -> TargetTable:
    """Read a table of targets for an arm; without its column, `payload_kg` is that of all.

    Raises
    ------
    BayescalError
        With the line, for columns that are missing, ambiguous or written by a compensation, and for cells
        that are empty or not numbers.
    """
    table = read_cells(path, lambda header, where: _check_header(header, where, robot.units))
    count = len(table.line)
    xyz, rpy = table.block(XYZ, True), table.block(RPY, True)
    payload, tools, ids = table.optional("payload_kg"), table.texts("tool"), table.texts("id")
    if payload is not None:
        table.first(payload < 0, "`payload_kg` is {payload_kg}", "give a mass of 0 or more")
    given: dict[str, Sequence[Any] | np.ndarray | None] = {
        "readings": table.block(joint_columns("deg", robot.units), True),
        "velocity": table.block(joint_columns("degps", robot.units), True),
        "payload": [payload_kg] * count if payload is None else payload.tolist(),
    }
    if xyz is not None and rpy is not None:
        given["pose"] = [rigid(r, p) for r, p in zip(rpy_matrix(rpy), xyz, strict=True)]
    if tools is not None:
        given["tool"] = [str(tool) or None for tool in tools]
    given["id"] = None if ids is None else ids.tolist()
    columns = {name: column for name, column in given.items() if column is not None}
    targets = tuple(
        Target(f"{table.name}:{line}", **{name: column[k] for name, column in columns.items()})
        for k, line in enumerate(table.line)
    )
    rows = tuple(zip(*table.cells.values(), strict=True))
    newline = "\r\n" if b"\r\n" in table.content else "\n"
    kept = tuple(c for c in table.cells if c not in ("id", *_stated(robot.units)))
    return TargetTable(tuple(table.cells), rows, targets, newline, kept)


def _stated(units: Sequence[str]) -> tuple[str, ...]:
    """Columns that state something of a target."""
    return (*XYZ, *RPY, *joint_columns("deg", units), *joint_columns("degps", units), "payload_kg", "tool")


def _check_header(header: list[str], where: str, units: Sequence[str]) -> None:
    check_names(header, where)
    joints, speeds = joint_columns("deg", units), joint_columns("degps", units)
    columns = _stated(units)
    stems = {stem_of(c)[0] for c in columns}
    written = {*OUTPUT, *(nominal(c) for c in joints)}
    for column in header:
        if column in written:
            what = f"column `{column}` is written by a compensation"
            raise BayescalError(what, where, "rename or delete it, and give targets that are not corrected")
        if column not in columns and stem_of(column)[0] in stems:
            what, remedy = unknown("column", column, columns)
            raise BayescalError(what, where, remedy)
    check_groups(header, where, ((*XYZ, *RPY), joints, speeds))
    if "x_mm" not in header and joints[0] not in header:
        what = "the table has neither poses nor joints"
        raise BayescalError(what, where, f"give {', '.join((*XYZ, *RPY))}, or {joints[0]} to {joints[-1]}")


def nominal(column: str) -> str:
    """The column that keeps the readings of the input: ``j1_nominal_deg``."""
    stem, unit = stem_of(column)
    return f"{stem}_nominal_{unit}"


def written(table: TargetTable, corrected: Sequence[Corrected], robot: Robot, verdict: str) -> str:
    """The table with corrected readings, its own readings as ``j1_nominal_deg`` ... and the verdict."""
    joints = joint_columns("deg", robot.units)
    header = [nominal(c) if c in joints else c for c in table.header]
    return csv_text([*header, *joints, *OUTPUT], (
        [*row, *cells(target, robot, verdict)] for row, target in zip(table.rows, corrected, strict=True)
    ), table.newline)  # fmt: skip


def cells(target: Corrected, robot: Robot, verdict: str) -> list[str]:
    """Cells of a corrected target: readings, then the columns of `OUTPUT`."""
    if target.readings is None:
        return [*[""] * robot.n, "", "", target.reason, "", "", "", verdict]
    readings = [f"{x:.{DEGREES}f}" for x in robot.shown(target.readings)]
    inside = "true" if target.inside else "false"
    count = "" if target.solutions is None else str(target.solutions)
    errors = [f"{1e3 * target.error:.5f}", count, f"{1e3 * target.expanded:.5f}", verdict]
    return [*readings, f"{1e3 * target.u:.5f}", inside, "", *errors]


TABLE = "csv"
FORMATS = (TABLE, *PROGRAMS)
"""Formats of targets: the table, and robot programs."""
LIST = ".positions.csv"
"""Appended to the name of a program: the table of its positions."""


@dataclass(frozen=True)
class Compensation:
    """Corrected targets of a file.

    `text` is the corrected file; `positions` the table of a program's positions, None for a table of targets.
    """

    source: str
    format: str
    frame: str
    targets: tuple[Target, ...]
    corrected: tuple[Corrected, ...]
    text: bytes
    positions: bytes | None = None
    notes: tuple[str, ...] = ()
    warning: str = ""

    def save(self, out: Path) -> tuple[str, ...]:
        """Write the corrected file, and the table of a program's positions beside it; return their names.

        Raises
        ------
        BayescalError
            If one of them exists with another content.
        """
        contents: dict[Path, bytes] = {out: self.text}
        if self.positions is not None:  # first: no corrected program is without it, also after a kill
            contents = {out.with_name(out.name + LIST): self.positions, **contents}
        for path, content in contents.items():
            if path.exists() and not (path.is_file() and path.read_bytes() == content):
                raise BayescalError("exists with another content", str(path), "give another --out")
        write_together(contents)
        return tuple(path.name for path in reversed(contents))


def compensate_file(
    arm: FittedArm,
    source: Path,
    *,
    format_: str = "",
    frame: str | None = None,
    tool: str | None = None,
    tcp: np.ndarray | None = None,
    payload: float = 0.0,
    time: float | None = None,
    row: str | None = None,
    warning: str = "",
) -> Compensation:
    """Correct the positions of a file.

    Parameters
    ----------
    arm : FittedArm
    source : Path
        A table of targets, or a robot program.
    format_ : str
        One of `FORMATS`; by default, that of the file's name.
    frame : str, optional
        Of the poses: `base` (default), or a target of the session; needed where a program states another.
    tool, tcp : optional
        As of `compensated`; needed where a program states a tool whose pose it does not have.
    time, row : optional
        As of `compensated`.
    payload : float
        additional payload, kg, of targets that state none.
    warning : str
        What speaks against the fit; it stands in the corrected file.

    Raises
    ------
    BayescalError
        With the line, for a file that cannot be read as its format; for a program also if a position that it
        uses has no solution, or if it has another frame or tool.
    """
    content = _content(source)
    if not content.strip():
        raise BayescalError("there are no targets", source.name, "give a row for each, below a header")
    name = format_ or _format_of(source, content)
    if name not in FORMATS:
        raise BayescalError(f"there is no format `{name}`", "--format", f"known: {', '.join(FORMATS)}")
    robot = arm.dataset.robot
    state: dict[str, Any] = {"frame": frame or BASE, "tool": tool, "tcp": tcp, "time": time, "row": row}
    only_one_arm(robot, "corrected targets")
    if name == TABLE:
        table = read_targets(source, robot, payload)
        corrected = compensated(arm, table.targets, **state)
        content = written(table, corrected, robot, warning).encode()
        both = table.targets, tuple(corrected)
        return Compensation(source.name, name, frame or BASE, *both, content, warning=warning)
    only_revolute(robot, "robot programs", "give the targets as a table (CSV)")
    form, code = PROGRAMS[name], content.decode("latin-1")
    try:
        program = form.read(code, robot.n)
        _check(program, form, source, frame)
        if program.tools:
            check_stated(program.tools, tool_of(arm, tool, tcp))
    except BayescalError as error:
        where = error.where if error.where.startswith(source.name) else f"{source.name}, {error.where}"
        raise BayescalError(error.what, where, error.remedy) from None
    slots = [replace(s, target=replace(s.target, where=f"{source.name}, {s.target.where}", payload=payload))
             for s in program.slots]  # fmt: skip
    targets = [s.target for s in slots]
    corrected = compensated(arm, targets, **state, in_sequence=True)
    text = rewritten(code, form, slots, corrected)
    if warning and form.remarked is not None:
        text = form.remarked(text, warning.encode("latin-1", "replace").decode("latin-1"))
    lines = [(s.name, line_of(code, s.place)) for s in slots]
    unused = [f"{s.target.where}: not used by the program, and without solution; kept"
              for s, result in zip(slots, corrected, strict=True) if result.reason]  # fmt: skip
    return Compensation(
        source.name, name, frame or BASE, tuple(targets), tuple(corrected), text.encode("latin-1"),
        _positions(lines, corrected, robot, warning).encode(), (*unused, *program.notes), warning,
    )  # fmt: skip


def _content(source: Path) -> bytes:
    try:
        return content_of(source)
    except BayescalError as error:
        raise BayescalError(error.what, str(source), "give a file of targets") from None


def _format_of(source: Path, content: bytes) -> str:
    suffix = source.suffix.lower()
    if suffix == ".csv" and is_target_table(content.decode("utf-8-sig", "replace")):
        return TABLE
    for form in PROGRAMS.values():
        if suffix in form.suffixes:
            return form.name
    what = f"no format has files named *{source.suffix}"
    raise BayescalError(what, source.name, f"give --format: {', '.join(FORMATS)}")


def _check(program: Program, form: Format, source: Path, frame: str | None) -> None:
    """Refuse a program without positions, and one whose frame is another and is not stated."""
    if not program.slots:
        raise BayescalError(f"there are no positions of {form.summary}", source.name, "check --format")
    if program.elsewhere and frame is None:
        what = f"its poses are not in the frame of the base ({program.elsewhere})"
        remedy = "give --frame: the target of the session that is this frame, or base if both are equal"
        raise BayescalError(what, source.name, remedy)


def _positions(
    lines: Sequence[tuple[str, int]], corrected: Sequence[Corrected], robot: Robot, warning: str
) -> str:
    """The table of a program's positions, in the order in which they are visited."""
    joints = joint_columns("deg", robot.units)

    def rows() -> Iterator[list[str]]:
        for (name, line), target in zip(lines, corrected, strict=True):
            before = [""] * robot.n
            if target.nominal is not None:
                before = [f"{x:.{DEGREES}f}" for x in robot.shown(target.nominal)]
            yield [name, str(line), *before, *cells(target, robot, warning)]

    return csv_text(["position", "line", *map(nominal, joints), *joints, *OUTPUT], rows())
