"""Rows of two files side by side: in their order, by id, or by time; several reflectors at a standstill."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.dataset import Target
from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns, first
from bayescal.importing.joint_formats import QUANTITIES
from bayescal.importing.units import quantity
from bayescal.statistics import grouped

MEASURED_REFLECTORS = ("x", "y", "z", "length")
"""Quantities of which a file with one holds measurements, not conditions."""

OWN = ("tool", "target")
"""Texts by which several rows of points with one id differ."""


def distinct(columns: Columns) -> Columns:
    """The rows with ids of their own: those of one id get the name of their tool, or target, or a number."""
    if "id" in columns.cells:
        ids = columns.cells["id"].tolist()
    elif len(np.unique(columns.line)) < columns.count:
        ids = [f"r{line}" for line in columns.line]
    else:
        return columns
    for key in OWN:
        often = Counter(ids)
        if key in columns.cells and max(often.values()) > 1:
            names = columns.cells[key].tolist()
            ids = [f"{i}.{name}" if often[i] > 1 else i for i, name in zip(ids, names, strict=True)]
    return replace(columns, cells=columns.cells | {"id": np.array(ids)})


def stacked(parts: Sequence[Columns]) -> Columns:
    """Rows of several tools or instruments that were measured at the rows of one log, in its order.

    Raises
    ------
    BayescalError
        If the parts do not have the same quantities, or none says which tool or target it is.
    """
    one = parts[0]
    for other in parts[1:]:
        if differ := one.cells.keys() ^ other.cells.keys():
            what = f"`{min(differ)}` is not in all files of points"
            raise BayescalError(what, other.name, "map the same quantities in each")
    if not any(key in one.cells for key in OWN):
        what = "several files hold points"
        raise BayescalError(what, one.name, "map `tool` (a reflector) or `target` (an instrument) in each")
    line = np.concatenate([p.line for p in parts])
    order = np.argsort(line, kind="stable")
    cells = {k: np.concatenate([p.cells[k] for p in parts])[order] for k in one.cells}
    return distinct(replace(one, line=line[order], cells=cells))


def unfolded(columns: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Points of several reflectors in one row (``x@A``, ``x@B``) as a row for each.

    Returns
    -------
    tuple of Columns and tuple of str
        And a note on reflectors that were not measured in some rows.
    """
    keys = [key for key in (*columns.cells, *columns.said) if "@" in key]
    tools = list(dict.fromkeys(key.partition("@")[2] for key in keys))
    if not tools:
        return columns, ()
    if clash := next((k for k in ("tool", "x") if k in columns.cells), None):
        what = f"`{clash}` and `{keys[0]}` are both mapped"
        raise BayescalError(what, columns.name, "keep those of the reflectors alone")
    parts, missing = [], 0
    for tool in tools:
        points = {k.partition("@")[0]: v for k, v in columns.cells.items() if k.endswith(f"@{tool}")}
        common = {k: v for k, v in columns.cells.items() if "@" not in k}
        said = {k.partition("@")[0]: c for k, c in columns.said.items() if k.partition("@")[2] in ("", tool)}
        cells = common | points | {"tool": np.full(columns.count, tool)}
        seen = np.zeros(columns.count, bool)
        for key in points.keys() & set(MEASURED_REFLECTORS):
            seen |= np.isfinite(points[key])
        missing += int((~seen).sum())
        parts.append(replace(columns, cells=cells, said=said).take(seen))
    note = f"{missing} points of {len(tools)} reflectors excluded: not measured"
    return stacked(parts), (note,) if missing else ()


def with_points(columns: Columns, targets: Sequence[Target]) -> tuple[Columns, tuple[str, ...]]:
    """The rows without those of an instrument that saw nothing, and a note on these.

    Motion capture and trackers write such rows for what was hidden. Without targets all are instruments.
    """
    point = [columns.cells[key] for key in "xyz" if key in columns.cells]
    others = [t.name for t in targets if t.kind != "instrument"]
    if len(point) < 3 or (others and "target" not in columns.cells):
        return columns, ()
    none = np.isnan(np.array(point))
    if others:
        none &= ~np.isin(columns.cells["target"], others)
    hidden = none.all(axis=0)
    first(columns, none.any(axis=0) & ~hidden, lambda row: "a part of a point", "give x, y and z, or none")
    note = f"{int(hidden.sum())} rows without a point excluded: not measured"
    return columns.take(~hidden), (note,) if hidden.any() else ()


STILL = np.radians(0.01)
"""rad, m: readings that change by more than this within the tolerance of time: the arm was moving."""

CLOCKS = QUANTITIES["clocks"]


def pair(rule: str, log: Columns, points: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Pair the rows of two files.

    Parameters
    ----------
    rule : str
        ``row``: the i-th with the i-th; ``id``; or ``time:0.5 s``, the nearest in time within a tolerance.
    log, points : Columns
        Of which `points` are measurements or conditions (a temperature).

    Returns
    -------
    tuple of Columns and tuple of str
        The rows with the quantities of both, and notes on what has no partner.

    Raises
    ------
    BayescalError
        For counts that differ, ids given twice, clocks that differ, and rows that pair twice.
    """
    match = re.fullmatch(r"(row|id|time)(?:[:\s]\s*(.+))?", rule.strip())
    if match is None or bool(match[2]) != (match[1] == "time"):
        raise BayescalError(f"`{rule}` is not known", "--pair", "must be row, id or time:0.5 s")
    if match[1] == "time":
        return _by_time(log, points, quantity(match[2], "time", 1, "--pair")[0])
    if match[1] == "id":
        return _by_id(log, points)
    if log.count != points.count:
        what = f"{log.count} rows in {log.name}, {points.count} in {points.name}"
        raise BayescalError(what, "--pair row", "map `id` in both files and pair them by id")
    return _joined(log, points), ()


def rows_words(count: int) -> str:
    """A number of rows in words."""
    return f"{count} row{'s' * (count > 1)}"


def is_measured(columns: Columns) -> bool:
    """Whether a file holds measurements, not conditions alone."""
    return any(key.partition("@")[0] in MEASURED_REFLECTORS for key in columns.cells)


def check_ids(columns: Columns, besides: Sequence[str] = ()) -> None:
    """Refuse a file without ids, or with one twice for the same of `besides`."""
    if "id" not in columns.cells:
        raise BayescalError("no column holds `id`", columns.name, "map it (`id=Name`), or pair by row")
    twice = _repeated(_keys(columns, ("id", *besides)))
    ids = columns.cells["id"]
    remedy = "keep a single row, or rename the id"
    first(columns, twice, lambda row: f"id `{ids[row]}` is given twice", remedy)


def _repeated(keys: Sequence[tuple[object, ...]]) -> np.ndarray:
    """Which of the keys (N,), bool, are not the only ones."""
    counts = Counter(keys)
    return np.array([counts[key] > 1 for key in keys])


def _keys(columns: Columns, names: Sequence[str]) -> list[tuple[str, ...]]:
    return list(zip(*(columns.cells[name].tolist() for name in names), strict=True))


def _by_id(log: Columns, points: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Rows of one id side by side, in the log's order; points of several tools or targets may share an id."""
    names = [key for key in OWN if key in points.cells]
    shared = [key for key in names if key in log.cells]
    check_ids(log, shared)
    check_ids(points, names)
    places = grouped((key, row) for row, key in enumerate(_keys(points, ("id", *shared))))
    pairs = [(i, j) for i, key in enumerate(_keys(log, ("id", *shared))) for j in places.get(key, ())]
    if not pairs:
        what = f"no id of {log.name} is in {points.name}"
        examples = f"`{log.cells['id'][0]}` and `{points.cells['id'][0]}` are the first ids"
        raise BayescalError(what, "--pair id", f"{examples}; map the right columns, or pair by row")
    mine, theirs = np.array(pairs).T
    lost = log.count - len(np.unique(mine)), points.count - len(np.unique(theirs))
    of = zip(lost, (log.name, points.name), strict=True)
    excluded = [f"{rows_words(count)} of {name} without a partner" for count, name in of if count]
    both = _joined(log.take(mine), points.take(theirs).without(shared))
    return distinct(both), (f"excluded: {' and '.join(excluded)}",) if excluded else ()


def _by_time(log: Columns, points: Columns, tolerance: float) -> tuple[Columns, tuple[str, ...]]:
    """The nearest in time: each measurement takes a row of the log, each row of the log its conditions."""
    for columns in (log, points):
        if "time" not in columns.cells:
            raise BayescalError("no column holds `time`", columns.name, "map it, `time=T s`")
        time = columns.cells["time"]
        first(columns, np.isnan(time), lambda row: "`time` is empty", "fill in the cell")
    if log.clock != points.clock and not {log.clock, points.clock} <= {"", "counter"}:
        clocks = f"{CLOCKS[log.clock]} in {log.name}, {CLOCKS[points.clock]} in {points.name}"
        raise BayescalError(f"the times do not have the same origin: {clocks}", "--pair", "pair by id or row")
    forward = is_measured(points)
    of, among = (points, log) if forward else (log, points)
    nearest, apart = _nearest(of.cells["time"], among.cells["time"])
    near = apart <= tolerance
    if not near.any():
        what = f"no rows of {log.name} and {points.name} are within {tolerance:g} s: the nearest differ by "
        raise BayescalError(f"{what}{apart.min():.6g} s", "--pair", "check the clocks, or pair by id or row")
    mine, theirs = np.flatnonzero(near), nearest[near]
    sizes = f"{np.median(apart[near]):.3g} s (median), {apart[near].max():.3g} s (maximum)"
    notes = [f"paired by time: differences of {sizes}"]
    if count := int((~near).sum()):
        partner = f"a row of {among.name} within {tolerance:g} s"
        notes.append(f"excluded: {rows_words(count)} of {of.name} without {partner}")
    if forward:
        _check_single(points.take(mine), theirs)
        notes += _motion(log, points.cells["time"][mine], tolerance)
        order = np.argsort(theirs, kind="stable")
        mine, theirs = theirs[order], mine[order]
        notes.append(f"{len(np.unique(mine))} of {log.count} rows of {log.name} are used")
    dropped = ("time",) if forward else ("time", "id")
    return distinct(_joined(log.take(mine), points.take(theirs).without(dropped))), tuple(notes)


def _nearest(of: np.ndarray, among: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index (N,) of the nearest of `among` to each `of`, and how far it is."""
    order = np.argsort(among, kind="stable")
    after = np.clip(np.searchsorted(among[order], of), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(among[order[before]] - of) <= np.abs(among[order[after]] - of)
    index = order[np.where(closer, before, after)]
    return index, np.abs(among[index] - of)


def _check_single(points: Columns, theirs: np.ndarray) -> None:
    """Refuse two measurements of the same tool and target that pair with the same row."""
    names = [key for key in OWN if key in points.cells]
    keys = list(zip(theirs.tolist(), *(points.cells[k].tolist() for k in names), strict=True))
    remedy = "pair by id, give a smaller tolerance, or map `tool`"
    first(points, _repeated(keys), lambda row: "two rows have the same nearest row of the log", remedy)


def _motion(log: Columns, times: np.ndarray, tolerance: float) -> list[str]:
    """A note on measurements during which the arm moved."""
    names = [k for k in log.cells if re.fullmatch(r"j\d+", k)]
    joints = [log.cells[k] for k in names]
    if not joints:
        return []
    order = np.argsort(log.cells["time"], kind="stable")
    readings, clock = np.column_stack(joints)[order], log.cells["time"][order]
    low = np.searchsorted(clock, times - tolerance)
    high = np.searchsorted(clock, times + tolerance, side="right")
    still = np.zeros(len(joints))
    windows = zip(low, high, strict=True)
    spread = np.array([np.ptp(readings[a:b], axis=0) if b > a else still for a, b in windows])
    moved = int((spread > STILL).any(axis=1).sum())
    if not moved:
        return []
    column = log.said.get(names[int(np.argmax(spread.max(axis=0)))])
    slides = column is not None and column.dimension == "length"
    size = f"{1e3 * spread.max():.2g} mm" if slides else f"{np.degrees(spread.max()):.2g} deg"
    what = f"the arm moved by up to {size} within {tolerance:g} s of {moved} of {len(times)} measurements"
    return [f"{what}: check the clocks"]


def _joined(log: Columns, points: Columns) -> Columns:
    """All columns; the log's own id, if any, is kept."""
    if both := log.cells.keys() & points.cells.keys() - {"id"}:
        what = f"`{min(both)}` is in {log.name} and in {points.name}"
        raise BayescalError(what, points.name, "map it in one of them")
    cells, said = points.cells | log.cells, points.said | log.said
    return replace(log, cells=cells, said=said, clock=log.clock or points.clock)
