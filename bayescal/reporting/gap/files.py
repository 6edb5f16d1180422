"""The run folder of a diagnosis."""

from __future__ import annotations

from pathlib import Path

from bayescal.exporting import of_gap, write_arm
from bayescal.folders import whole
from bayescal.gap.result import Gap
from bayescal.indented import indented
from bayescal.reporting.figures.process import begun
from bayescal.reporting.gap.contacts import table_of_contacts
from bayescal.reporting.gap.record import gap_record
from bayescal.reporting.page.build import write_page

GAP = "gap.json"
NEXT = "next.csv"
"""Contacts to be measured next; only where some are advised."""


def write_gap(gap: Gap, folder: Path, pictures: bool = True) -> tuple[str, ...]:
    """Write gap.json, gap.html, arm.json with the dataset, next.csv and the figures atomically.

    Parameters
    ----------
    gap : Gap
    folder : Path
        Where they are written; an earlier diagnosis there is replaced.
    pictures : bool
        Draw the figures too.

    Returns
    -------
    tuple of str
        File names.
    """
    contents = gap_record(gap)
    record = indented(contents) + "\n"
    names = [GAP]
    arm = None if gap.arm is None else of_gap(gap)
    with whole(folder, GAP) as stage:
        drawn = begun(contents) if pictures else dict
        (stage / GAP).write_text(record, encoding="utf-8")
        if arm is not None:
            names += write_arm(arm, stage)
        if any(a.contacts for a in gap.advice):
            (stage / NEXT).write_text(table_of_contacts(gap), encoding="utf-8")
            names.append(NEXT)
        for name, content in drawn().items():
            (stage / name).write_bytes(content)
            names.append(name)
        names.insert(1, write_page(stage, folder))
    return tuple(names)
