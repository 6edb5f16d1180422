"""Orders of probing: interleaved sweeps over all targets, the shortest, random; and the time of travel.

If faces were probed one after the other, a drift would look like a displacement of the faces. By default
every sweep therefore visits all targets, on a short path. Contacts on an artefact with several placements
(``ball.A@1``, ``ball.A@2``) are together, and so are equal payloads in a sweep: in each it changes once.
Contacts that validate are in the middle of the session and at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from bayescal.planning.pool import Pool
from bayescal.probing.clearance import RETRACT
from bayescal.probing.contacts import SPEED
from bayescal.probing.motions import seconds_between
from bayescal.probing.scene import placements

SWEEPS = "sweeps"
"""The default."""
COUNT = 4
"""Sweeps of a session."""
DETOUR = 3.0
"""s: what a motion that collides is taken to be longer by (measured: 1 to 3 s for passing another point)."""
ROUNDS = 12  # of corrections of a path by such motions
BACK = 20e-3  # m/s: velocity of the retract (assumed)
GAIN = 1e-9  # s: a smaller reduction of the time ends the search

Blocked = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""blocked(begin (M,), end (M,)) -> which motions between them collide, (M,)."""
Path = Callable[[np.ndarray, int, Blocked], np.ndarray]
"""path(seconds (M, M), first, blocked) -> order (M,) of visiting, from `first` on."""


def ordered(
    pool: Pool,
    rows: np.ndarray,
    order: str,
    rng: np.random.Generator,
    blocked: Blocked = lambda begin, end: np.zeros(len(begin), bool),
) -> np.ndarray:
    """Positions (M,) that put rows (M,) of the pool's session in an order of `ORDERS`.

    Motions between rows that are `blocked` (`transit.Transits.blocked`) are avoided where that saves time.
    """
    return ORDERS[order](pool, np.asarray(rows, int), rng, blocked)


def sweeps(pool: Pool, rows: np.ndarray, rng: np.random.Generator, blocked: Blocked) -> np.ndarray:
    """Positions (M,) of rows (M,) in interleaved sweeps.

    A row that is given twice is a contact to be repeated: its measurements are in different sweeps.
    """
    return _in_order(pool, rows, COUNT, cleared, rng, blocked)


def shortest(pool: Pool, rows: np.ndarray, rng: np.random.Generator, blocked: Blocked) -> np.ndarray:
    """Positions (M,) of rows (M,) on a short path: nearest neighbour, then exchanges of two connections."""
    return _in_order(pool, rows, 1, cleared, rng, blocked)


def random_order(pool: Pool, rows: np.ndarray, rng: np.random.Generator, blocked: Blocked) -> np.ndarray:
    """Positions (M,) of rows (M,) at random, within each placement of an artefact."""

    def path(seconds: np.ndarray, first: int, blocked: Blocked) -> np.ndarray:
        return rng.permutation(len(seconds))

    return _in_order(pool, rows, 1, path, rng, blocked, loads=False)


ORDERS: Mapping[str, Callable[[Pool, np.ndarray, np.random.Generator, Blocked], np.ndarray]] = {
    SWEEPS: sweeps,
    "shortest": shortest,
    "random": random_order,
}
"""Orders by their name."""


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


def cleared(seconds: np.ndarray, first: int, blocked: Blocked) -> np.ndarray:
    """A short path (M,) as `shorter` finds it, where a motion that is blocked lasts `DETOUR` longer.

    Only motions of paths that are considered are checked: of all between 200 contacts there are 20,000.
    """
    cost, checked = seconds.copy(), np.zeros(seconds.shape, bool)
    path = shorter(cost, first)
    for _ in range(ROUNDS):
        begin, end = path[:-1], path[1:]
        new = ~checked[begin, end]
        begin, end = begin[new], end[new]
        checked[begin, end] = checked[end, begin] = True
        bad = blocked(begin, end)
        if not np.any(bad):
            break
        for a, b in ((begin[bad], end[bad]), (end[bad], begin[bad])):
            cost[a, b] += DETOUR
        path = exchanged(cost, path)
    return path


def shorter(seconds: np.ndarray, first: int) -> np.ndarray:
    """A short path through all of M points: nearest neighbour, then 2-opt.

    Parameters
    ----------
    seconds : np.ndarray, shape (M, M)
        Symmetric times between points.
    first : int
        Where it begins; it may end anywhere.
    """
    return exchanged(seconds, nearest(seconds, first))


def nearest(seconds: np.ndarray, first: int) -> np.ndarray:
    """The path (M,) from each point to the nearest that was not visited."""
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


def _in_order(
    pool: Pool,
    rows: np.ndarray,
    count: int,
    path: Path,
    rng: np.random.Generator,
    blocked: Blocked,
    loads: bool = True,
) -> np.ndarray:
    """Positions of all rows: sweeps, of which each is divided by payload, with validation between them."""
    m = pool.session.measurements
    fitted = np.flatnonzero(m.role[rows] != "validate")
    visits = []
    stations = _stations(pool, rows, fitted)
    for station in stations:
        visits += _dealt(pool, rows, station, -(-count // len(stations)), rng)
    legs = []
    for k, visit in enumerate(visits):
        parts_of_visit = _by_payload(pool, rows, visit) if loads else [visit]
        legs.append(parts_of_visit[:: -1 if k % 2 else 1])
    half = (len(legs) + 1) // 2
    middle, end = _validating(pool, rows, np.flatnonzero(m.role[rows] == "validate"))
    parts = [part for leg in legs[:half] for part in leg] + middle
    parts += [part for leg in legs[half:] for part in leg] + end
    out: list[int] = []
    for part in parts:
        readings = pool.approach[rows[part]]
        seconds = seconds_between(readings[:, None], readings[None])
        before = pool.approach[rows[out[-1]]] if out else readings[0]
        first = int(np.argmin(np.abs(readings - before).max(axis=1)))
        out += part[path(seconds, first, _of(blocked, rows[part]))].tolist()
    return np.array(out, int)


def _of(blocked: Blocked, rows: np.ndarray) -> Blocked:
    """The same by positions in `rows` (M,)."""
    return lambda begin, end: blocked(rows[begin], rows[end])


def _placements(pool: Pool, rows: np.ndarray) -> np.ndarray:
    """The placement of the target of each row, (M,); "" where it stays."""
    labels = np.array(placements([t.name for t in pool.session.targets]), object)
    return labels[pool.session.measurements.target[rows]]


def _stations(pool: Pool, rows: np.ndarray, some: np.ndarray) -> list[np.ndarray]:
    """Positions `some` by placement, in the order of the targets, and by tool.

    What stays is dealt to all placements. The tool changes only where it has to.
    """
    label, target = _placements(pool, rows)[some], pool.session.measurements.target[rows[some]]
    stays = some[label == ""]
    names = [str(name) for name in dict.fromkeys(label[np.argsort(target, kind="stable")]) if name]
    parts = [np.concatenate([some[label == name], stays[k :: len(names)]]) for k, name in enumerate(names)]
    tool, out = pool.session.measurements.tool, []
    for k, part in enumerate(parts or [stays]):
        by_tool = [part[tool[rows[part]] == t] for t in np.unique(tool[rows[part]])]
        out += by_tool[:: -1 if k % 2 else 1]
    return out


def _dealt(
    pool: Pool, rows: np.ndarray, some: np.ndarray, count: int, rng: np.random.Generator
) -> list[np.ndarray]:
    """Positions `some` in sweeps with equal numbers of each target and payload; repeats are in several."""
    m = pool.session.measurements
    payload = np.zeros(len(m.ids)) if m.payload is None else m.payload
    once = rng.permutation(np.unique(rows[some]))
    once = once[np.lexsort([payload[once], m.target[once]])]
    sweep_of = {int(row): k for k, row in enumerate(once)}
    out: list[list[int]] = [[] for _ in range(count)]
    apart = [*dict.fromkeys((0, count // 2, *range(count)))]
    seen: dict[int, int] = {}
    for position in some:
        row = int(rows[position])
        times = seen[row] = seen.get(row, -1) + 1
        out[(sweep_of[row] + apart[times % count]) % count].append(int(position))
    return [np.array(positions, int) for positions in out if positions]


def _by_payload(pool: Pool, rows: np.ndarray, some: np.ndarray) -> list[np.ndarray]:
    """Positions `some` with each payload, the lightest first."""
    m = pool.session.measurements
    if m.payload is None:
        return [some]
    load = m.payload[rows[some]]
    return [some[load == kg] for kg in np.unique(load)]


def _validating(pool: Pool, rows: np.ndarray, some: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Positions that validate, for the middle and for the end of the session.

    Each placement is in one of them; of targets that stay, every second contact is in each.
    """
    label = _placements(pool, rows)[some]
    names = [name for name in dict.fromkeys(label) if name]
    parts = [some[label == name] for name in names]
    target = pool.session.measurements.target[rows[some]]
    stays = [some[(label == "") & (target == t)] for t in np.unique(target[label == ""])]
    middle, end = parts[: len(parts) // 2], parts[len(parts) // 2 :]
    for k, group in enumerate((middle, end)):
        halves = [one[k::2] for one in stays]
        if halves and len(joined := np.concatenate(halves)):
            group.append(joined)
    return middle, end
