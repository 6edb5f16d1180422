"""Conventions of a joint that explain a session better than those of the robot file: sign, zero, coupling.

As for units, all rows are far from their targets at nominal geometry, and near them after one change. No
nominal arm has such an error, and no other change of one joint removes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.checks.misfit import FEWEST, away
from bayescal.dataset.checks.units import FALLS, SUSPECT

ZEROS = (90.0, -90.0, 180.0)
"""deg: differences of the zero of a joint between conventions."""
TOOL_UNITS = ((1e3, "m"), (25.4, "inches"), (10.0, "cm"), (1e-3, "µm"))
LEFT = 0.05
"""m: what an arm in the right convention may leave, with loosely known targets."""


def other_convention(dataset: Dataset) -> tuple[str, str, float, float] | None:
    """The change that explains the session, or None: what, where, misfit before and after, m."""
    rows = dataset.measurements
    if len(rows.ids) < FEWEST:
        return None
    before = float(np.median(away(dataset, rows.readings)))
    if before <= SUSPECT:
        return None
    found = []
    for what, where, other in _changes(dataset):
        after = float(np.median(away(other, other.measurements.readings)))
        if after < min(before / FALLS, LEFT):
            found.append((after, what, where))
    if not found:
        return None
    after, what, where = min(found)
    return what, where, before, after


def _changes(dataset: Dataset) -> Iterator[tuple[str, str, Dataset]]:
    """Each change of one joint, of the coupling of joints 2 and 3, or of the tool: words, key, dataset."""
    rows, n = dataset.measurements, dataset.robot.n

    def read(readings: np.ndarray) -> Dataset:
        return replace(dataset, measurements=replace(rows, readings=readings))

    for k, name in enumerate(dataset.robot.joint_names):
        readings = rows.readings.copy()
        readings[:, k] *= -1
        yield f"{name} has the opposite sign", f"j{k + 1}_deg", read(readings)
        for zero in ZEROS:
            readings = rows.readings.copy()
            readings[:, k] += np.radians(zero)
            yield f"the zero of {name} differs by {zero:g} deg", f"j{k + 1}_deg", read(readings)
    for sign in (1.0, -1.0) if n > 2 else ():
        readings = rows.readings.copy()
        readings[:, 2] += sign * readings[:, 1]
        yield "J3 is coupled to J2", "j3_deg", read(readings)
    for factor, unit in TOOL_UNITS:
        tools = tuple(replace(t, centre=t.centre * factor) for t in dataset.tools)
        yield f"`centre_mm` of the tools is in {unit}", "tools", replace(dataset, tools=tools)
