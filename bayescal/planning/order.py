"""Orders of probing: interleaved sweeps over all targets, the shortest, random; and the time of travel.

If faces were probed one after the other, a drift would look like a displacement of the faces. By default
every sweep therefore visits all targets, on a short path. Contacts on an artefact with several placements
(``ball.A@1``, ``ball.A@2``) are together, and so are equal payloads in a sweep: in each it changes once.
Contacts that validate are in the middle of the session and at its end.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from bayescal.dataset import Measurements
from bayescal.dataset.append import taken
from bayescal.planning.pool import Pool
from bayescal.probing.clearance import RETRACT
from bayescal.probing.contacts import SPEED
from bayescal.probing.motions import seconds_between
from bayescal.probing.scene import placements

SWEEPS, SHORTEST, RANDOM = "sweeps", "shortest", "random"
COUNT = 4
"""Sweeps of a session."""
ORDERS: Mapping[str, int] = {SWEEPS: COUNT, SHORTEST: 1, RANDOM: 1}
"""Orders by their name, the first by default, with the number of sweeps."""
DETOUR = 3.0
"""s: what a motion that collides is taken to be longer by (measured: 1 to 3 s for passing another point)."""
ROUNDS = 12  # of corrections of a path by such motions
BACK = 20e-3  # m/s: velocity of the retract (assumed)
GAIN = 1e-9  # s: a smaller reduction of the time ends the search

Blocked = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""blocked(begin (M,), end (M,)) -> which motions between them collide, (M,)."""


def ordered(
    pool: Pool,
    rows: np.ndarray,
    order: str,
    rng: np.random.Generator,
    blocked: Blocked = lambda begin, end: np.zeros(len(begin), bool),
) -> np.ndarray:
    """Positions (M,) that put rows (M,) of the pool's session in an order of `ORDERS`.

    Sweeps visit all targets. A row that is given twice is a contact to be repeated: its measurements are in
    different sweeps. A sweep is divided by payload, and each part is a short path: nearest neighbour, then
    exchanges of two connections. The random order keeps the placements of an artefact apart, no more.

    Motions between rows that are `blocked` (`transit.Transits.blocked`) are avoided where that saves time.
    """
    rows = np.asarray(rows, int)
    m, approach = taken(pool.session.measurements, rows), pool.approach[rows]
    label = np.array(placements([t.name for t in pool.session.targets]), object)[m.target]
    stations = _stations(m, label, np.flatnonzero(m.role != "validate"))
    sweeps = -(-ORDERS[order] // max(len(stations), 1))
    visits = [visit for station in stations for visit in _dealt(rows, m, station, sweeps, rng)]
    legs = []
    for k, visit in enumerate(visits):
        loads = [visit] if order == RANDOM else _by_payload(m, visit)
        legs.append(loads[:: -1 if k % 2 else 1])
    half = (len(legs) + 1) // 2
    middle, end = _validating(m, label, np.flatnonzero(m.role == "validate"))
    parts = [part for leg in legs[:half] for part in leg] + middle
    parts += [part for leg in legs[half:] for part in leg] + end
    out: list[int] = []
    for part in parts:
        if order == RANDOM:
            out += part[rng.permutation(len(part))].tolist()
            continue
        before = approach[out[-1]] if out else approach[part[0]]
        first = int(np.argmin(np.abs(approach[part] - before).max(axis=1)))
        out += part[_cleared(approach[part], first, rows[part], blocked)].tolist()
    return np.array(out, int)


def travel(pool: Pool, rows: np.ndarray, *passed: Sequence[np.ndarray | None]) -> float:
    """Time, s, of the motion between contacts in the given order, with approach and retract.

    `passed` (each M of (K, n)), rad, are the readings that are passed before each row one after the other
    (`leave` and `via` of `transit.Ways`).
    """
    approach, m = pool.approach[rows], pool.session.measurements
    points = []
    for *ways, readings in zip(*passed, approach, strict=True):
        points += [p for way in ways if way is not None for p in way] + [readings]
    moves = seconds_between(np.array(points[:-1]), np.array(points[1:])) if len(points) > 1 else 0.0
    touched = np.any(approach != m.readings[rows], axis=1)
    return float(np.sum(moves) + np.sum(touched) * (RETRACT / SPEED + RETRACT / BACK))


def _cleared(readings: np.ndarray, first: int, rows: np.ndarray, blocked: Blocked) -> np.ndarray:
    """A short path (M,) through readings (M, n), from `first` on; a motion that is blocked lasts longer.

    Nearest neighbour, then 2-opt. It may end anywhere.

    Only motions of paths that are considered are checked: of all between 200 contacts there are 20,000.
    """
    cost = seconds_between(readings[:, None], readings[None])
    checked = np.zeros(cost.shape, bool)
    path = exchanged(cost, nearest(cost, first))
    for _ in range(ROUNDS):
        begin, end = path[:-1], path[1:]
        new = ~checked[begin, end]
        begin, end = begin[new], end[new]
        checked[begin, end] = checked[end, begin] = True
        bad = blocked(rows[begin], rows[end])
        if not np.any(bad):
            break
        for a, b in ((begin[bad], end[bad]), (end[bad], begin[bad])):
            cost[a, b] += DETOUR
        path = exchanged(cost, path)
    return path


def nearest(seconds: np.ndarray, first: int) -> np.ndarray:
    """The path (M,) from each point to the nearest that was not visited, by symmetric times (M, M)."""
    unvisited = np.ones(len(seconds), bool)
    out = [first]
    for _ in range(len(seconds) - 1):
        unvisited[out[-1]] = False
        out.append(int(np.argmin(np.where(unvisited, seconds[out[-1]], np.inf))))
    return np.array(out[: len(seconds)], int)


def exchanged(seconds: np.ndarray, path: np.ndarray) -> np.ndarray:
    """The path (M,) with parts of it reversed until no reversal makes it shorter; its beginning stays."""
    path, better = path.copy(), True
    while better:
        better = False
        for i in range(len(path) - 2):
            here, behind = path[i], path[i + 1 :]
            gain = seconds[here, behind[0]] - seconds[here, behind]
            gain[:-1] += seconds[behind[:-1], behind[1:]] - seconds[behind[0], behind[1:]]
            j = int(np.argmax(gain))
            if gain[j] > GAIN:
                path[i + 1 : i + 2 + j] = behind[: j + 1][::-1].copy()
                better = True
    return path


def _stations(m: Measurements, label: np.ndarray, some: np.ndarray) -> list[np.ndarray]:
    """Positions `some` by placement (`label`), in the order of the targets, and by tool.

    What stays is dealt to all placements. The tool changes only where it has to.
    """
    stays = some[label[some] == ""]
    by_target = some[np.argsort(m.target[some], kind="stable")]
    names = [str(name) for name in dict.fromkeys(label[by_target]) if name]
    own = [some[label[some] == name] for name in names]
    parts = [np.concatenate([part, stays[k :: len(names)]]) for k, part in enumerate(own)]
    out = []
    for k, part in enumerate(parts or [stays]):
        by_tool = [part[m.tool[part] == tool] for tool in np.unique(m.tool[part])]
        out += by_tool[:: -1 if k % 2 else 1]
    return out


def _dealt(
    rows: np.ndarray, m: Measurements, some: np.ndarray, count: int, rng: np.random.Generator
) -> list[np.ndarray]:
    """Positions `some` in sweeps with equal numbers of each target and payload; repeats are in several."""
    once = rng.permutation(some[np.unique(rows[some], return_index=True)[1]])
    payload = np.zeros(len(rows)) if m.payload is None else m.payload
    once = once[np.lexsort([payload[once], m.target[once]])]
    sweep_of = {int(row): k for k, row in enumerate(rows[once])}
    out: list[list[int]] = [[] for _ in range(count)]
    apart = [*dict.fromkeys((0, count // 2, *range(count)))]
    seen: Counter[int] = Counter()
    for position in some:
        row = int(rows[position])
        out[(sweep_of[row] + apart[seen[row] % count]) % count].append(int(position))
        seen[row] += 1
    return [np.array(positions, int) for positions in out if positions]


def _by_payload(m: Measurements, some: np.ndarray) -> list[np.ndarray]:
    """Positions `some` with each payload, the lightest first."""
    if m.payload is None:
        return [some]
    return [some[m.payload[some] == kg] for kg in np.unique(m.payload[some])]


def _validating(
    m: Measurements, label: np.ndarray, some: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Positions that validate, for the middle and for the end of the session.

    Each placement is in one of them; of targets that stay, every second contact is in each.
    """
    parts = [some[label[some] == name] for name in dict.fromkeys(label[some]) if name]
    still = some[label[some] == ""]
    stays = [still[m.target[still] == t] for t in np.unique(m.target[still])]
    middle, end = parts[: len(parts) // 2], parts[len(parts) // 2 :]
    for k, group in enumerate((middle, end)):
        halves = [one[k::2] for one in stays]
        if halves and len(joined := np.concatenate(halves)):
            group.append(joined)
    return middle, end
