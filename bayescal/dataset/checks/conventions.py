"""Mistakes of joint columns and tools that explain a session: sign, zero, coupling, exchange, unit.

As for units, all rows are far from their targets at nominal geometry, and near them after one change. No
nominal arm has such an error, and no other change of one joint removes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from bayescal.dataset.checks.misfit import FEWEST, away
from bayescal.dataset.checks.units import FALLS, SUSPECT
from bayescal.dataset.types import Dataset
from bayescal.errors import BayescalError
from bayescal.files import Document

ZEROS = (90.0, -90.0, 180.0)
"""deg: differences of the zero of a joint between conventions."""
TOOL_UNITS = ((1e3, "m"), (25.4, "inches"), (10.0, "cm"), (1e-3, "µm"))
TABLE = "measurements.csv"
ROBOT = "correct `link_from_reading` or `offset_deg` in the robot file, or the column"
LEFT = 0.05
"""m: what an arm in the right convention may leave, with loosely known targets."""


@dataclass(frozen=True)
class _Change:
    """A session as it is after one change: in words, the column or tool that is changed, and the remedy."""

    what: str
    column: str
    tool: str
    remedy: str
    dataset: Dataset


def explanation(dataset: Dataset, document: Document) -> BayescalError | None:
    """The one change that explains all rows, with both misfits, its place and a remedy; or None."""
    rows = dataset.measurements
    if len(rows.ids) < FEWEST:
        return None
    stated = away(dataset, rows.readings)
    found = []
    for change, own in _changes(dataset):
        before = float(np.median(stated[own]))
        if before > SUSPECT:
            after = float(np.median(away(change.dataset, change.dataset.measurements.readings)[own]))
            if after < min(before / FALLS, LEFT):
                found.append((after, before, change))
    if not found:
        return None
    after, before, change = min(found, key=lambda each: each[0])
    what = f"{change.what}: rows are {1e3 * before:.0f} mm off their targets, and then {1e3 * after:.2g} mm"
    where = (
        document.where(("tools", change.tool, "centre_mm")) if change.tool else f"{TABLE}: `{change.column}`"
    )
    return BayescalError(what, where, change.remedy)


def _changes(dataset: Dataset) -> Iterator[tuple[_Change, np.ndarray]]:
    """Each change of a joint, of the coupling of joints 2 and 3, of two columns, of a tool; its rows (N,)."""
    rows, n = dataset.measurements, dataset.robot.n
    every, names = np.ones(len(rows.ids), bool), dataset.robot.joint_names

    def read(what: str, joint: int, readings: np.ndarray, remedy: str = ROBOT) -> tuple[_Change, np.ndarray]:
        other = replace(dataset, measurements=replace(rows, readings=readings))
        return _Change(what, f"j{joint + 1}_deg", "", remedy, other), every

    for k, name in enumerate(names):
        readings = rows.readings.copy()
        readings[:, k] *= -1
        yield read(f"{name} has the opposite sign", k, readings)
        for zero in ZEROS:
            readings = rows.readings.copy()
            readings[:, k] += np.radians(zero)
            yield read(f"the zero of {name} differs by {zero:g} deg", k, readings)
    for sign in (1.0, -1.0) if n > 2 else ():
        readings = rows.readings.copy()
        readings[:, 2] += sign * readings[:, 1]
        yield read("J3 is coupled to J2", 2, readings)
    for a, b in combinations(range(n), 2):
        readings = rows.readings.copy()
        readings[:, [a, b]] = readings[:, [b, a]]
        what = f"the columns `j{a + 1}_deg` and `j{b + 1}_deg` are interchanged"
        yield read(what, a, readings, "exchange their headings")
    for tool, (factor, unit) in product(dataset.tools, TOOL_UNITS):
        tools = tuple(replace(t, centre=t.centre * factor) if t is tool else t for t in dataset.tools)
        own = rows.tool == [t.name for t in dataset.tools].index(tool.name)
        if own.sum() >= FEWEST:
            what = f"`centre_mm` of `{tool.name}` is in {unit}"
            yield _Change(what, "", tool.name, "write it in mm", replace(dataset, tools=tools)), own
