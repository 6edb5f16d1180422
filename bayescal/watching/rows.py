"""The rows of a session that is being measured: those that are complete, as they are written.

A line counts when it ends. Lines that were read are not parsed again, unless they were changed. A line that
breaks the format is stated once, and read again when the file changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from bayescal.dataset import Dataset
from bayescal.dataset.join import stacked
from bayescal.dataset.read import (
    SETTINGS,
    TABLE,
    content_of_table,
    measurements_of,
    read_dataset,
    read_settings,
)
from bayescal.dataset.table import table_of
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Measurements
from bayescal.errors import BayescalError
from bayescal.storage.reading import content_of

END = b"\n"


@dataclass(frozen=True)
class Written:
    """What was read of a session: `dataset` with all rows so far, `content` of the lines that have them.

    `settings` is the content of dataset.yaml. `fault` is what is wrong with the lines behind, in words, or
    "". `again` tells that what had been read before was changed.
    """

    dataset: Dataset
    settings: bytes
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
    dataset, document, _ = read_settings(folder / SETTINGS)
    return Written(dataset, document.content)


def followed(written: Written, folder: Path, ended: bool = False) -> Written:
    """The same with the rows that were written since; the argument itself if there are none.

    A fault is no error: the person who probes may correct the line. `ended`: nothing more is written, and
    the last line counts as it is.
    """
    try:
        settings = content_of(folder / SETTINGS)
        content = content_of_table(folder) if (folder / TABLE).exists() else b""
    except BayescalError as error:
        return replace(written, fault=str(error), again=False)
    if not ended:
        content = content[: content.rfind(END) + 1]
    if (settings, content) == (written.settings, written.content):
        return replace(written, fault="", again=False) if written.fault else written
    again = settings != written.settings or not content.startswith(written.content)
    before = written
    try:
        before = begun(folder) if again else written
        dataset = _with_lines(before, content, folder)
    except BayescalError as error:
        return replace(before, fault=str(error), again=again)
    return replace(before, dataset=dataset, content=content, fault="", again=again)


def placed_by_rows(dataset: Dataset) -> bool:
    """Whether all rows together say where targets are, as those of cameras: every row changes the model."""
    return any(KINDS[t.kind].prepared is not None for t in dataset.targets)


def _with_lines(before: Written, content: bytes, folder: Path) -> Dataset:
    """The session with the rows of further lines of measurements.csv."""
    d, lines = before.dataset, content.splitlines(keepends=True)
    done = before.content.count(END)
    new = content[len(before.content) :] if done else b"".join(lines[1:])
    if not new.strip():
        return d
    if placed_by_rows(d):
        return read_dataset(folder, rows=content)
    table = table_of(lines[0] + new, TABLE, d.robot.units, max(done - 1, 0))
    rows = measurements_of(table, d.robot.units, d.tools, d.targets, d.noise)
    if not len(d.measurements.ids):
        return replace(d, measurements=rows)
    if twice := sorted({*rows.ids} & {*d.measurements.ids}):
        line = table.line[rows.ids.index(twice[0])]
        raise BayescalError(f"id `{twice[0]}` is given twice", f"{TABLE}:{line}", "rename one")
    columns, _ = stacked([d.measurements, rows])
    return replace(d, measurements=Measurements(**columns))
