"""Files whose columns are known without a map: a format is an entry of a table.

What is relied on is written down, with its source, in ``docs/importing.md``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns, columns_of
from bayescal.importing.log import Log
from bayescal.importing.mapping import Column, Map
from bayescal.importing.units import UNITS, is_number, unit_of


@dataclass(frozen=True)
class Format:
    """What a file of a manufacturer holds: the map of its columns, and what it is in words."""

    words: str
    map: str = ""


LISTED = "id=id, j*=J* deg"
"""The map of the joint positions that `read_listing` returns."""

FORMATS = {
    "csv": Format("a table; --map states its columns"),
    "robodk": Format("a calibration table of RoboDK: joints, measured point or pose, tool"),
    "ur-rtde": Format(
        "a record of the RTDE client of Universal Robots",
        "time?=timestamp counter_s, j*=actual_q_*0 rad, j*_command?=target_q_*0 rad",
    ),
    "probing": Format("what a probing program of bayescal plan logs", LISTED),
    "fanuc-ls": Format("positions P[n] of a FANUC program as text (LS)", LISTED),
    "fanuc-va": Format("position registers of a FANUC controller (POSREG.VA)", LISTED),
    "kuka-dat": Format("joint positions of a KUKA data list (DAT) or program", LISTED),
    "abb-mod": Format("jointtargets of an ABB RAPID module", LISTED),
}
"""By name. Joint velocities of a record are not read: at rest their signs are noise, not a direction."""

UNSEEN = 1e-6
"""m: RoboDK writes zeros for a point that was not measured; its own scripts require more than 1 µm."""

SAME_TOOL = 1e-6
"""m: TCP positions this close are one."""


def robodk(log: Log, n: int) -> tuple[Columns, dict[str, np.ndarray]]:
    """Rows of a RoboDK table of an arm with `n` joints, and its TCP positions by name.

    Degrees and millimetres: the joints; where measured, x, y, z (and three angles, which are not
    taken); the TCP (and three angles). A row measured at 0, 0, 0 is left out.

    Returns
    -------
    tuple of Columns and dict
        Quantities j1 ... jn, x, y, z if measured, tool; TCP positions (3,) m in the flange frame.
    """
    layouts = {n + 3: (None, n), n + 6: (n, n + 3), n + 12: (n, n + 6)}
    width = log.width
    if width not in layouts:
        what = f"{width} columns do not match a RoboDK table of {n} joints"
        known = ", ".join(map(str, layouts))
        raise BayescalError(what, log.name, f"it has {known} columns (joints, measured, tool); or give --map")
    measured, tool = layouts[width]
    map_ = {f"j{i + 1}": Column(f"#{i + 1}", UNITS["deg"]) for i in range(n)} | _xyz("tool_", tool)
    if measured is not None:
        map_ |= _xyz("", measured)
    columns = columns_of(log, map_)
    if measured is not None:
        xyz = np.column_stack([columns.numbers[k] for k in "xyz"])
        columns = columns.take(np.abs(xyz).sum(axis=1) >= UNSEEN)
        if not columns.count:
            raise BayescalError("no measured row: all points are 0, 0, 0", log.name, "export the table again")
    centres = np.column_stack([columns.numbers.pop(f"tool_{k}") for k in "xyz"])
    names, tools = _tools(centres)
    return replace(columns, texts={"tool": names}), tools


def _xyz(prefix: str, before: int) -> dict[str, Column]:
    return {f"{prefix}{k}": Column(f"#{before + i + 1}", UNITS["mm"]) for i, k in enumerate("xyz")}


def _tools(centres: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Names (N,) of TCP positions (N, 3), and the points: tcp1, tcp2, ... as they first come."""
    tools: dict[str, np.ndarray] = {}
    names = []
    for centre in centres:
        same = [name for name, c in tools.items() if np.linalg.norm(c - centre) < SAME_TOOL]
        names.append(same[0] if same else f"tcp{len(tools) + 1}")
        tools.setdefault(names[-1], centre)
    return np.array(names), tools


def points_map(log: Log, unit: str) -> Map:
    """The map of a file whose rows are ``x y z``, or names and then ``x y z``.

    Of names with several parts (collection, group, target) the last part counts. A file is refused if it
    is not clear which columns are x, y, z.
    """
    width = log.width
    texts = [i for i in range(width) if not all(is_number(row[i]) for row in log.rows)]
    start = width - 3
    if start < 0 or any(i >= start for i in texts) or (start > 1 and start - 1 not in texts):
        what = f"it is not clear which of the {width} columns are x, y, z"
        remedy = "state it in --points-map: `id=#1, x=#2 mm, y=#3 mm, z=#4 mm`"
        raise BayescalError(what, log.name, remedy)
    length = unit_of(unit, "length", "--points-map")
    map_ = {k: Column(f"#{start + i + 1}", length) for i, k in enumerate("xyz")}
    return map_ | ({"id": Column(f"#{start}")} if start else {})
