"""Rows from the records of a log: on one clock, without what is corrupt, divided into motions with roles."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import pairwise

import numpy as np

from bayescal.errors import BayescalError, listed
from bayescal.importing.joint_formats import LARGEST, MEASURED, TEXTS, Record, Stream
from bayescal.importing.roles import Rule
from bayescal.preparing import joint_delays

BETWEEN = 1.0
"""s put between records whose clocks begin anew: the true time is not known."""
LOST = 0.05
"""Fraction of rows that may be left out as corrupt; more is another mistake (assumed)."""
MOVING = 0.01
"""rad/s, over 0.1 s: a joint that turns slower is at rest (assumed: above the noise of encoders)."""
LAST = "last:20%"
"""The motions that validate by default."""
RULES = "write last:20%, every:5, motions '7,8' or kind 'pick*'"
"""Rules that are known."""
MOST = 0.4
"""Largest fraction that motions of another kind may be, to validate all."""
SAME = (2e-3, 5e-3)
"""Difference (RMS) of one trajectory repeated: rad, and relative to its range, the larger (assumed)."""
SAMPLES = 400
"""Points at which two trajectories are compared."""


@dataclass(frozen=True)
class Rows:
    """N rows of all motions in SI: `time` (N,) s, increasing; `motion` (N,) from 1; `cells` as of a stream.

    `ids` and `kinds` are those of the motions, and `roles` if a column states them, else ().
    """

    time: np.ndarray
    motion: np.ndarray
    cells: Mapping[str, np.ndarray]
    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    roles: tuple[str, ...] = ()

    def of(self, motion: int) -> np.ndarray:
        """Rows of a motion."""
        return np.flatnonzero(self.motion == motion)


def on_one_clock(record: Record) -> tuple[Stream, tuple[str, ...]]:
    """The rows of a record with the quantities of its other streams; its notes, and what was left out."""
    rows, notes = _clean(record.rows)
    for other in record.others:
        clean, said = _clean(other)
        notes += said
        if not len(clean.time):
            notes.append(f"{other.name} has no values")
            continue
        inside = rows.time >= clean.time[0]
        if not other.held:
            inside &= rows.time <= clean.time[-1]
        if not inside.any():
            what = f"{rows.name} and {other.name} have no time in common"
            raise BayescalError(what, record.name, "are their stamps of one clock?")
        if lost := int((~inside).sum()):
            notes.append(f"{lost} rows of {rows.name} outside the time of {other.name} left out")
        rows = _take(rows, inside)
        more = {k: _at(rows.time, clean, v) for k, v in clean.cells.items()}
        rows = replace(rows, cells={**rows.cells, **more})
    if len(rows.time) < 2:
        raise BayescalError("fewer than two rows", record.name, "check the file")
    return rows, (*record.notes, *notes)


def _at(time: np.ndarray, stream: Stream, values: np.ndarray) -> np.ndarray:
    """Values (N, n) of a stream at other times."""
    if stream.held:
        return values[np.searchsorted(stream.time, time, "right") - 1]
    return np.column_stack([np.interp(time, stream.time, column) for column in values.T])


def _take(stream: Stream, rows: np.ndarray) -> Stream:
    cells = {k: v[rows] for k, v in stream.cells.items()}
    return replace(stream, time=stream.time[rows], cells=cells, line=stream.lines[rows])


def _clean(stream: Stream) -> tuple[Stream, list[str]]:
    """A stream without empty quantities, corrupt or incomplete rows, and stamps that do not increase."""
    notes = []
    numbers = {k: v for k, v in stream.cells.items() if k not in TEXTS}
    still = [k for k, v in numbers.items() if k in MEASURED and not np.nan_to_num(v).any()]
    empty = [k for k, v in numbers.items() if k in still or np.isnan(v).all()]
    if "position" in empty or len(stream.time) == 0:
        raise BayescalError("no joint positions", stream.name, "check the map")
    if empty:
        notes.append(f"{stream.name}: no value of {', '.join(empty)} (none, or only zeros)")
    stream = replace(stream, cells={k: v for k, v in stream.cells.items() if k not in empty})
    bad, why = ~np.isfinite(stream.time), ""
    for key in [k for k in numbers if k not in empty]:
        values = numbers[key]
        wrong = ~(np.abs(values) <= LARGEST[key])
        row = wrong.reshape(len(wrong), -1).any(axis=1)
        if row.any() and not why:
            k = int(np.argmax(row))
            value = np.atleast_1d(values[k])[np.atleast_1d(wrong[k])][0]
            size = f"{value:g}" if np.isfinite(value) else "empty"
            why = f"`{key}` is {size} (line {stream.lines[k]})"
        bad |= row
    why = why or "time is empty"
    _refuse_many(stream, bad, why)
    if bad.any():
        notes.append(f"{int(bad.sum())} rows of {stream.name} left out, first: {why}")
    stream = _take(stream, ~bad)
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], stream.time[:-1]]))
    late = stream.time <= latest
    if late.any():
        k = int(np.argmax(late))
        double = int((stream.time == latest).sum())
        why = f"{double} with the stamp of the row above, {int(late.sum()) - double} with an earlier one"
        why += f" (line {stream.lines[k]})"
        _refuse_many(stream, late, why)
        notes.append(f"{int(late.sum())} rows of {stream.name} left out: {why}")
    return _take(stream, ~late), notes


def _refuse_many(stream: Stream, bad: np.ndarray, why: str) -> None:
    if bad.sum() > max(LOST * len(bad), 1):
        what = f"{int(bad.sum())} of {len(bad)} rows cannot be used: {why}"
        raise BayescalError(what, stream.name, "check the columns; divide a log whose clock begins anew")


def divided(records: Sequence[Record], rule: str) -> tuple[Rows, tuple[str, ...]]:
    """All rows of a log, divided into motions.

    Parameters
    ----------
    records : sequence of Record
    rule : str
        ``files`` (files, bags or episodes, each a motion), ``column``, or ``pause:2 s`` (where no joint moves
        for longer); "" for a column where there is one, else files.

    Returns
    -------
    tuple of Rows and tuple of str
        And in words how they were divided.

    Raises
    ------
    BayescalError
        For an unknown rule, quantities that not all records have, and fewer than two motions.
    """
    clean = [on_one_clock(each) for each in records]
    streams, times = [stream for stream, _ in clean], Counter(note for _, said in clean for note in said)
    notes = [f"{note} (of {k} records)" if k > 1 else note for note, k in times.items()]
    for stream in streams:
        if lost := streams[0].cells.keys() ^ stream.cells.keys():
            what = f"`{min(lost)}` is not in all records"
            raise BayescalError(what, stream.name, "import those with the same columns, or map fewer")
    time = _one_time(streams, records, notes)
    cells = {k: np.concatenate([s.cells[k] for s in streams]) for k in streams[0].cells}
    record = np.repeat(np.arange(len(streams)), [len(s.time) for s in streams])
    name, _, length = (rule or ("column" if "motion" in cells else "files")).partition(":")
    pause = re.fullmatch(r"\s*([\d.]+)\s*s?\s*", length)
    if name == "column" and "motion" in cells and not length:
        motions, kept, words = _named(cells["motion"], time, cells["position"], record)
        cells = {k: v[kept] for k, v in (cells | {"motion": motions}).items()}
        time, record = time[kept], record[kept]
        labels = np.array([f"{r}/{m}" for r, m in zip(record, cells["motion"], strict=True)])
    elif name == "files" and not length:
        labels, words = record.astype(str), "each file, bag or episode is a motion"
    elif name == "pause" and pause and float(pause[1]) > 0:
        least = float(pause[1])
        labels = _pauses(time, cells["position"], record, least)
        words = f"cut where all joints are slower than {MOVING:g} rad/s for {least:g} s or longer"
    else:
        what = "no column holds `motion`" if name == "column" else f"'{rule}' is not a rule for motions"
        raise BayescalError(what, "--motions", "write files, pause:2 s, or column (with `motion` mapped)")
    edge = np.flatnonzero(np.r_[True, labels[1:] != labels[:-1]])
    if len(edge) < 2:
        what = "a single motion: a log needs two or more, one of them to validate"
        remedy = "give a folder of several files, or divide it: `--motions pause:2 s`"
        if name == "pause":
            remedy = "between motions no pause is as long: state a shorter one, or map a column `motion`"
        raise BayescalError(what, records[0].name, remedy)
    motion = np.repeat(np.arange(1, len(edge) + 1), np.diff(np.r_[edge, len(time)]))
    labelled = name == "column" and len(set(cells["motion"][edge])) == len(edge)
    ids = tuple(cells["motion"][edge] if labelled else map(str, range(1, len(edge) + 1)))
    kinds = tuple(cells["kind"][edge]) if "kind" in cells else tuple(records[r].kind for r in record[edge])
    rows = Rows(time, motion, cells, ids, kinds)
    notes.append(f"{len(edge)} motions: {words}")
    return (replace(rows, roles=_stated(rows, cells["role"])) if "role" in cells else rows), tuple(notes)


def _stated(rows: Rows, role: np.ndarray) -> tuple[str, ...]:
    """Roles of the motions by a column; `calibrate` where its cells are empty."""
    out = []
    for k, name in enumerate(rows.ids, 1):
        stated = {r or "calibrate" for r in role[rows.of(k)].tolist()}
        if len(stated) > 1 or not stated <= {"calibrate", "validate"}:
            what = f"motion {name} has the roles {listed(sorted(stated))}"
            remedy = "write calibrate or validate, one for all rows of a motion"
            raise BayescalError(what, "column `role`", remedy)
        out.append(stated.pop())
    return tuple(out)


def _one_time(streams: Sequence[Stream], records: Sequence[Record], notes: list[str]) -> np.ndarray:
    """Times (N,), s, from the first row on, of records one behind the other."""
    session = all(r.clock == "session" for r in records)
    if session and all(after.time[0] > before.time[-1] for before, after in pairwise(streams)):
        return np.concatenate([s.time for s in streams]) - streams[0].time[0]
    if len(streams) > 1:
        notes.append(f"each record has its own clock: {BETWEEN:g} s is put between them (assumed)")
    parts, now = [], 0.0
    for stream in streams:
        parts.append(stream.time - stream.time[0] + now)
        now = parts[-1][-1] + BETWEEN
    return np.concatenate(parts)


def speeds(time: np.ndarray, position: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Velocities (N, n), rad/s, from positions and stamps, averaged over 0.1 s; not across motions."""
    out = np.zeros_like(position)
    for k in np.flatnonzero(np.bincount(motion) > 1):
        rows = motion == k
        out[rows] = joint_delays.speeds(time[rows], position[rows])
    return out


def _named(
    names: np.ndarray, time: np.ndarray, position: np.ndarray, record: np.ndarray
) -> tuple[np.ndarray, np.ndarray, str]:
    """Names (N,) of motions, rows (N,) of them, and how: a name that returns is another motion.

    A name that returns and under which no joint ever moves, as `rest`, is none.
    """
    words = "a motion for each value of the column"
    run = np.cumsum(np.r_[0, (names[1:] != names[:-1]) | (np.diff(record) > 0)])
    first = np.flatnonzero(np.r_[True, np.diff(run) > 0])
    each = names[first]
    in_records = Counter(zip(record[first].tolist(), each.tolist(), strict=True))
    again = {name for (_, name), count in in_records.items() if count > 1}
    if not again:
        return names, np.ones(len(names), bool), words
    moves = (np.abs(speeds(time, position, run)) > MOVING).any(axis=1)
    still = [n for n in sorted(again) if not moves[names == n].any()]
    kept = ~np.isin(names, still)
    times = [1 + int((each[:i] == n).sum()) for i, n in enumerate(each)]
    numbered = [f"{n}-{k}" if k > 1 else str(n) for n, k in zip(each, times, strict=True)]
    words += ", and for each time that it returns"
    words += f"; {(~kept).sum()} rows of {listed(still)}, in which no joint moves, left out" if still else ""
    return np.array(numbered)[run], kept, words


def _pauses(time: np.ndarray, position: np.ndarray, record: np.ndarray, pause: float) -> np.ndarray:
    """Labels (N,) of motions: a record is cut in the middle of each longer time of rest that ends in it."""
    at_rest = (np.abs(speeds(time, position, record)) < MOVING).all(axis=1)
    label = np.zeros(len(time), int)
    for k in np.unique(record):
        rows = np.flatnonzero(record == k)
        edges = np.flatnonzero(np.diff(np.r_[0, at_rest[rows].astype(int), 0]))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            first, last = time[rows[begin]], time[rows[end - 1]]
            if last - first > pause and begin > 0 and end < len(rows):
                # by time: rows may lack in the middle of it
                label[rows[np.searchsorted(time[rows], 0.5 * (first + last))] :] += 1
        label[rows[-1] + 1 :] += 1
    return label.astype(str)


def roles(rows: Rows, rule: str) -> tuple[tuple[str, ...], str]:
    """Roles of the motions, and in words by which rule.

    Parameters
    ----------
    rows : Rows
    rule : str
        ``last:20%``, ``every:5``, ``motions '7,8'`` or ``kind 'pick*'``; "" for those of the last kind, where
        kinds are known and these are at most `MOST` of all, else the last `LAST`.

    Raises
    ------
    BayescalError
        For an unknown rule, one beside a column `role`, and one that selects none or all.
    """
    ids, kinds = np.array(rows.ids), np.array(rows.kinds)
    count = len(ids)
    if rows.roles and rule:
        what = "a column states the role of each motion already"
        raise BayescalError(what, "--validate", "remove one of the two")
    if rows.roles:
        chosen, words = np.array(rows.roles) == "validate", "as the column `role` states"
    elif rule:
        chosen, words = _chosen(ids, kinds, rule)
    elif kinds[-1] and (of_last := kinds == kinds[-1]).sum() <= MOST * count:
        chosen, words = of_last, f"by default those of the last kind, `{kinds[-1]}`"
    else:
        chosen, words = _chosen(ids, kinds, LAST)[0], "by default the last 20 %"
    if not 0 < chosen.sum() < count:
        what = f"{'all' if chosen.all() else 'none'} of the {count} motions would validate"
        raise BayescalError(what, "--validate", RULES)
    names = listed(ids[chosen], 12)
    return tuple(np.where(chosen, "validate", "calibrate").tolist()), f"validation motions: {names} ({words})"


def _chosen(ids: np.ndarray, kinds: np.ndarray, text: str) -> tuple[np.ndarray, str]:
    rule = Rule.read(text)
    if (chosen := rule.by_number(np.arange(len(ids)))) is not None:
        return chosen, f"one of every {rule.value}" if rule.name == "every" else f"the last {rule.value}"
    if rule.name in ("motions", "kind") and rule.patterns:
        of = (ids if rule.name == "motions" else kinds).tolist()
        alike = [any(fnmatchcase(each, p) for p in rule.patterns) for each in of]
        return np.array(alike), f"{rule.name} {', '.join(rule.patterns)}"
    raise BayescalError(f"'{text}' is not a rule for validation motions", "--validate", RULES)


def repeats(rows: Rows) -> tuple[int, ...]:
    """Of each motion the number (from 1) of the first one with the same trajectory: commands, else positions.

    Two trajectories are the same where they last equally long, from the first to the last row that moves, and
    differ by at most `SAME` (RMS over all joints, after a shift in time of a few samples).
    """
    values = rows.cells.get("command", rows.cells["position"])
    velocity = speeds(rows.time, values, rows.motion)
    curves: list[Curve | None] = []
    for k in range(1, len(rows.ids) + 1):
        indices = rows.of(k)
        moving = np.flatnonzero((np.abs(velocity[indices]) > MOVING).any(axis=1))
        if len(moving) < 2:
            curves.append(None)
            continue
        indices = indices[moving[0] : moving[-1] + 1]
        grid = np.linspace(rows.time[indices[0]], rows.time[indices[-1]], SAMPLES)
        step = float(np.median(np.diff(rows.time[indices])))
        curve = np.column_stack([np.interp(grid, rows.time[indices], column) for column in values[indices].T])
        curves.append((float(grid[-1] - grid[0]), step, curve))
    first: list[int] = []
    for k, other in enumerate(curves):
        same = (i for i in range(k) if first[i] == i + 1 and _same(curves[i], other))
        first.append(next(same, k) + 1)
    return tuple(first)


Curve = tuple[float, float, np.ndarray]
"""Length and step, s, and `SAMPLES` points of a trajectory."""


def _same(one: Curve | None, other: Curve | None) -> bool:
    if one is None or other is None:
        return False
    (long, step, a), (wide, _, b) = one, other
    if abs(long - wide) > max(10 * step, 0.01 * long):
        return False
    slope, difference = np.gradient(a, long / (SAMPLES - 1), axis=0), b - a
    shift = np.sum(slope * difference) / max(float(np.sum(slope**2)), 1e-30)
    limit = max(SAME[0], SAME[1] * float(np.ptp(a, axis=0).max()))
    return abs(shift) <= 10 * step and float(np.sqrt(np.mean((difference - shift * slope) ** 2))) <= limit
