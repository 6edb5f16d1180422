"""The compensation of a file: a table of targets or a robot program, with corrected positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.dataset.table import joint_columns
from bayescal.errors import BayescalError
from bayescal.exporting.compensate.formats import PROGRAMS
from bayescal.exporting.compensate.formats.program import Format, Program, line_of, rewritten
from bayescal.exporting.compensate.frames import BASE
from bayescal.exporting.compensate.solve import compensated
from bayescal.exporting.compensate.table import (
    DEGREES,
    OUTPUT,
    cells,
    csv_text,
    is_target_table,
    nominal,
    read_targets,
    written,
)
from bayescal.exporting.compensate.targets import Corrected, Target
from bayescal.exporting.compensate.tools import check_stated, tool_of
from bayescal.exporting.fitted import FittedArm
from bayescal.files import write_together
from bayescal.reading import content_of

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
    found: tuple[Corrected, ...]
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
    name = format_ or _format_of(source, content)
    if name not in FORMATS:
        raise BayescalError(f"there is no format `{name}`", "--format", f"known: {', '.join(FORMATS)}")
    n = arm.dataset.robot.n
    state: dict[str, Any] = {"frame": frame or BASE, "tool": tool, "tcp": tcp, "time": time, "row": row}
    if name == TABLE:
        table = read_targets(source, n, payload)
        found = compensated(arm, table.targets, **state)
        content = written(table, found, n, warning).encode()
        return Compensation(
            source.name, name, frame or BASE, table.targets, tuple(found), content, warning=warning
        )
    form, code = PROGRAMS[name], content.decode("latin-1")
    try:
        program = form.read(code, n)
        _check(program, form, source, frame)
        if program.tools:
            check_stated(program.tools, tool_of(arm, tool, tcp))
    except BayescalError as error:
        where = error.where if error.where.startswith(source.name) else f"{source.name}, {error.where}"
        raise BayescalError(error.what, where, error.remedy) from None
    slots = [replace(s, target=replace(s.target, where=f"{source.name}, {s.target.where}", payload=payload))
             for s in program.slots]  # fmt: skip
    targets = [s.target for s in slots]
    found = compensated(arm, targets, **state, in_sequence=True)
    text = rewritten(code, form, slots, found)
    if warning and form.remarked is not None:
        text = form.remarked(text, warning.encode("latin-1", "replace").decode("latin-1"))
    lines = [(s.name, line_of(code, s.place)) for s in slots]
    unused = [f"{s.target.where}: not used by the program, and without solution; kept"
              for s, own in zip(slots, found, strict=True) if own.reason]  # fmt: skip
    return Compensation(
        source.name, name, frame or BASE, tuple(targets), tuple(found), text.encode("latin-1"),
        _positions(lines, found, n, warning).encode(), (*unused, *program.notes), warning,
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


def _positions(lines: Sequence[tuple[str, int]], found: Sequence[Corrected], n: int, warning: str) -> str:
    """The table of a program's positions, in the order in which they are visited."""
    joints = joint_columns("deg", n)

    def rows() -> Iterator[list[str]]:
        for (name, line), own in zip(lines, found, strict=True):
            before = [""] * n
            if own.nominal is not None:
                before = [f"{x:.{DEGREES}f}" for x in np.degrees(own.nominal)]
            yield [name, str(line), *before, *cells(own, n, warning)]

    return csv_text(["position", "line", *map(nominal, joints), *joints, *OUTPUT], rows())
