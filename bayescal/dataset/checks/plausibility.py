"""Plausibility: readings within the joint limits, contacts consistent with the nominal geometry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bayescal.arm.robot import Robot
from bayescal.dataset.checks.certified import contradictions
from bayescal.dataset.checks.conventions import explanation
from bayescal.dataset.checks.misfit import OFF, contacts, nominal, seen
from bayescal.dataset.checks.units import suspicion
from bayescal.dataset.contacts import Contacts, residual, settled
from bayescal.dataset.table import Table
from bayescal.dataset.target_kinds import KINDS, angle_sd, place_sd
from bayescal.dataset.types import Dataset, Target
from bayescal.errors import BayescalError
from bayescal.files import Document

BEYOND = np.deg2rad(10)
"""How far beyond its limit a joint is believed."""

MANY = 0.3
"""Share of rows beyond a limit from which on the readings as a whole are wrong."""

LEVER = 0.3
"""m: arm of an angle's uncertainty when a target's place is judged."""

LIKE = "look like"
LOOKS_LIKE = (
    (180 / np.pi, "radians"),
    (np.pi / 180, "degrees converted twice"),
    (1e-3 * 180 / np.pi, "milliradians"),
    (1e3, "m"),
    (1e-3, "µm"),
    (10.0, "cm"),
    (25.4, "inches"),
)
"""Factor by which values must be multiplied to be in deg or mm, and the probable unit."""


def check(dataset: Dataset, table: Table, document: Document) -> None:
    """Refuse the first implausible row or target, with its line; or the one change that explains all rows.

    The uncertainty of a target's pose is that of its prior; the frame of an instrument is unknown.
    """
    for problem in problems(dataset, table, document):
        known = LIKE in problem.what
        raise problem if known else explanation(dataset, document) or problem


def problems(dataset: Dataset, table: Table, document: Document) -> Iterator[BayescalError]:
    """What `check` refuses, with places and remedies; what follows from a problem before is left out."""
    rows = dataset.measurements
    found, many = _beyond_limits(dataset.robot, rows.readings, table)
    if found is not None:
        yield found
    if many:
        return
    if (found := _in_other_units(dataset, table)) is not None:
        yield found
        return
    p = nominal(dataset, rows.readings)
    limit = np.array([max(OFF, 5 * (t.u or 0.0)) for t in dataset.tools])[rows.tool]
    for index, target in enumerate(dataset.targets):
        at = np.flatnonzero(rows.target == index)
        if not len(at):
            continue
        if not KINDS[target.kind].placed:
            away = seen(dataset, p, at)
        else:
            mine = contacts(dataset, index, p, at)
            away = np.linalg.norm(residual(mine)[0], axis=1)
            if (away <= limit[at]).all():
                continue
            if (found := _misplaced(mine, away, document)) is not None:
                yield found
                continue
            away = settled(mine)
        if (found := _impossible(target, away, limit[at], at, table, document)) is not None:
            yield found
    for wrong in contradictions(dataset):
        if wrong.impossible:
            where = document.where(wrong.place)
            yield BayescalError(f"{wrong.what}, as the rows on them are", where, wrong.remedy)


def _beyond_limits(robot: Robot, readings: np.ndarray, table: Table) -> tuple[BayescalError | None, bool]:
    """A reading beyond its limits, and whether many are.

    Limits apply to the row of `link_from_reading`, without the sign of its diagonal.
    """
    sign = np.where(np.diag(robot.link_from_reading) < 0, -1.0, 1.0)
    angle = readings @ robot.link_from_reading.T * sign
    beyond = np.maximum(robot.limits[:, 0] - angle, angle - robot.limits[:, 1])
    bad = (beyond > BEYOND).any(axis=1)
    if not bad.any():
        return None, False
    row = int(np.argmax(bad))
    joint = int(np.argmax(beyond[row]))
    low, high = np.rad2deg(robot.limits[joint])
    what = (
        f"{robot.joint_names[joint]} is at {np.rad2deg(angle[row, joint]):.6g} deg, "
        f"its limits are {low:g} to {high:g} deg"
    )
    many = bool(bad.mean() > MANY)
    often = "many rows are: were degrees converted twice, or signs or coupling changed?"
    return table.error(row, what, often if many else "check the reading, or the robot's limits"), many


def _in_other_units(dataset: Dataset, table: Table) -> BayescalError | None:
    """Readings that are consistent with the session only in another unit than the stated one."""
    found = suspicion(dataset)
    if found is None:
        return None
    unit = "deg" if found.quantities[0].startswith("j") else "mm"
    columns = [f"`{quantity}_{unit}`" for quantity in found.quantities]
    every = len(columns) == dataset.robot.n
    noun = "the joint readings" if every else f"the values of {', '.join(columns)}"
    like = next((word for factor, word in LOOKS_LIKE if np.isclose(factor, found.factor)), "another unit's")
    what = f"{noun} {LIKE} {like}: a row is {1e3 * found.stated:.0f} mm off, and then {1e3 * found.other:.2g}"
    return table.error(0, what, f"these columns hold {unit}: convert them")


def _misplaced(contacts: Contacts, away: np.ndarray, document: Document) -> BayescalError | None:
    """A misplaced target.

    The error of all its contacts is larger than its prior explains, or is small if its values are read in
    another unit.
    """
    target = contacts.target
    u, angle = place_sd(target), angle_sd(target)
    if away.min() <= OFF:
        return None
    remedy = ""
    for factor, unit in ((1e3, "m"), (1e-3, "µm")):
        keep = (KINDS[target.kind].direction, "diameter")
        values = {k: v if k in keep else v * factor for k, v in target.values.items()}
        other = replace(contacts, target=replace(target, values=values))
        if np.median(np.linalg.norm(residual(other)[0], axis=1)) < OFF:
            remedy = f"its values look like {unit}: write them in mm"
    if remedy or away.min() > 5 * (u + angle * LEVER):
        what = f"all contacts of `{target.name}` are nominally {1e3 * away.min():.0f} mm or more off it"
        remedy = remedy or "check its place, its frame (F0) and the units, or state a wider `u_mm`"
        return BayescalError(what, document.where(("targets", target.name)), remedy)
    return None


def _impossible(
    target: Target, away: np.ndarray, limit: np.ndarray, at: np.ndarray, table: Table, document: Document
) -> BayescalError | None:
    """A row that disagrees with most of its target's rows, or a target on which none agree."""
    bad = away > limit
    if not bad.any():
        return None
    noun = "readings" if KINDS[target.kind].noise == "point" else "contacts"
    if bad.mean() > 0.5:
        what = f"most {noun} of `{target.name}` disagree with the arm by {1e3 * np.median(away):.0f} mm"
        remedy = "check the target, the tool and the units"
        return BayescalError(what, document.where(("targets", target.name)), remedy)
    row = int(np.argmax(away))
    which = "reading" if KINDS[target.kind].noise == "point" else "contact"
    others = "point of the other readings" if which == "reading" else "surface fitted to the other contacts"
    what = f"impossible {which}: {1e3 * away[row]:.0f} mm from the {others} on `{target.name}`"
    more = f" ({bad.sum() - 1} more rows are as far off)" if bad.sum() > 1 else ""
    return table.error(at[row], what + more, "check target, tool and joint readings, or leave the row out")
