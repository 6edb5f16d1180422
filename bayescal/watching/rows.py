"""The rows of a session that is being measured: those that are complete, as they are written.

A line counts when it ends. Lines that were read are not parsed again, unless they were changed. A line that
breaks the format is stated once, and read again when the file changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from bayescal.dataset import Dataset
from bayescal.dataset.join import stacked
from bayescal.dataset.read import SETTINGS, TABLE, measurements_of, read_dataset, read_settings
from bayescal.dataset.table import cells_of, check_columns
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Measurements
from bayescal.errors import BayescalError
from bayescal.storage.reading import content_of, text_of

END = b"\n"


@dataclass(frozen=True)
class Written:
    """What was read of a session: `dataset` with all rows so far, `content` of the lines that have them.

    `fault` is what is wrong with the lines behind, in words, or "". `again` tells that rows that had been
    read before were changed.
    """

    dataset: Dataset
    content: bytes = b""
    fault: str = ""
    again: bool = False


def begun(folder: Path) -> Written:
    """A session of which no row is read yet: its dataset.yaml.

    Raises
    ------
    BayescalError
        If dataset.yaml breaks the format.
    """
    return Written(read_settings(folder / SETTINGS)[0])


def followed(written: Written, folder: Path) -> Written:
    """The same with the rows that were written since; the argument itself if there are none.

    A fault is no error: the person who probes may correct the line.
    """
    path = folder / TABLE
    if not path.exists():
        return written
    content = content_of(path)
    content = content[: content.rfind(END) + 1]
    if content == written.content:
        return replace(written, fault="", again=False) if written.fault else written
    again = not content.startswith(written.content)
    before = begun(folder) if again else written
    try:
        dataset = _with_lines(before, content, folder)
    except BayescalError as error:
        return replace(before, fault=str(error), again=again)
    return Written(dataset, content, again=again) if dataset is not None else replace(before, again=again)


def placed_by_rows(dataset: Dataset) -> bool:
    """Whether all rows together say where targets are, as those of cameras: every row changes the model."""
    return any(KINDS[t.kind].prepared is not None for t in dataset.targets)


def _with_lines(before: Written, content: bytes, folder: Path) -> Dataset | None:
    """The session with the rows of further lines of measurements.csv; None if they have none."""
    d, lines = before.dataset, content.splitlines(keepends=True)
    if placed_by_rows(d):
        return read_dataset(folder)
    done = before.content.count(END)
    new = content[len(before.content) :] if done else b"".join(lines[1:])
    if not new.strip():
        return None
    text = text_of(lines[0] + new, TABLE)
    table = cells_of(text, TABLE, content, lambda h, w: check_columns(h, w, d.robot.units), max(done - 1, 0))
    rows = measurements_of(table, d.robot.units, d.tools, d.targets, d.noise)
    if not len(d.measurements.ids):
        return replace(d, measurements=rows)
    if twice := sorted({*rows.ids} & {*d.measurements.ids}):
        line = table.line[rows.ids.index(twice[0])]
        raise BayescalError(f"id `{twice[0]}` is given twice", f"{TABLE}:{line}", "rename one")
    columns, _ = stacked([d.measurements, rows])
    return replace(d, measurements=Measurements(**columns))
