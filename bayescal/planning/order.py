"""Orders of probing: interleaved sweeps over all targets, the shortest, random; and the time of travel.

If faces were probed one after the other, a drift would look like a displacement of the faces. By default
every sweep therefore visits all targets, on a short path. Contacts on an artefact with several placements
(``ball.A@1``, ``ball.A@2``) are together, and so are equal payloads in a sweep: in each it changes once.
Contacts that validate are in the middle of the session and at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from bayescal.planning.hand import RETRACT
from bayescal.planning.pool import Pool
from bayescal.simulation.probing import SPEED

SWEEPS = "sweeps"
"""The default."""
COUNT = 4
"""Sweeps of a session."""
RATE = np.radians(45.0)
"""rad/s: mean velocity of a joint between contacts (assumed: a quarter of that of a small arm)."""
BACK = 20e-3  # m/s: velocity of the retract (assumed)
GAIN = 1e-9  # s: a smaller reduction of the time ends the search

Path = Callable[[np.ndarray, int], np.ndarray]
"""path(seconds (M, M), first) -> order (M,) of visiting, from `first` on."""


def ordered(pool: Pool, rows: np.ndarray, order: str, rng: np.random.Generator) -> np.ndarray:
    """Positions (M,) that put rows (M,) of the pool's session in an order of `ORDERS`."""
    return ORDERS[order](pool, np.asarray(rows, int), rng)


def sweeps(pool: Pool, rows: np.ndarray, rng: np.random.Generator, count: int = COUNT) -> np.ndarray:
    """Positions (M,) of rows (M,) in interleaved sweeps.

    A row that is given twice is a contact to be repeated: its measurements are in different sweeps.
    """
    return _in_order(pool, rows, count, shorter, rng)


def shortest(pool: Pool, rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Positions (M,) of rows (M,) on a short path: nearest neighbour, then exchanges of two connections."""
    return _in_order(pool, rows, 1, shorter, rng)


def random_order(pool: Pool, rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Positions (M,) of rows (M,) at random, within each placement of an artefact."""
    return _in_order(pool, rows, 1, lambda seconds, first: rng.permutation(len(seconds)), rng, loads=False)


ORDERS: Mapping[str, Callable[[Pool, np.ndarray, np.random.Generator], np.ndarray]] = {
    SWEEPS: sweeps,
    "shortest": shortest,
    "random": random_order,
}
"""Orders by their name."""


def travel(pool: Pool, rows: np.ndarray) -> float:
    """Time, s, of the motion between contacts in the given order, with approach and retract."""
    approach, m = pool.approach[rows], pool.session.measurements
    moves = np.abs(np.diff(approach, axis=0)).max(axis=1, initial=0.0) / RATE
    touched = np.any(approach != m.readings[rows], axis=1)
    return float(np.sum(moves) + np.sum(touched) * (RETRACT / SPEED + RETRACT / BACK))


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
    left = np.ones(len(seconds), bool)
    out = [first]
    for _ in range(len(seconds) - 1):
        left[out[-1]] = False
        out.append(int(np.argmin(np.where(left, seconds[out[-1]], np.inf))))
    return np.array(out[: len(seconds)], int)


def exchanged(seconds: np.ndarray, path: np.ndarray) -> np.ndarray:
    """The path (M,) with parts of it reversed until no reversal makes it shorter; its beginning stays."""
    path, better = path.copy(), True
    while better:
        better = False
        for i in range(len(path) - 2):
            here, rest = path[i], path[i + 1 :]
            gain = seconds[here, rest[0]] - seconds[here, rest]
            gain[:-1] += seconds[rest[:-1], rest[1:]] - seconds[rest[0], rest[1:]]
            j = int(np.argmax(gain))
            if gain[j] > GAIN:
                path[i + 1 : i + 2 + j] = rest[: j + 1][::-1].copy()
                better = True
    return path


def _in_order(
    pool: Pool, rows: np.ndarray, count: int, path: Path, rng: np.random.Generator, loads: bool = True
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
        own = _by_payload(pool, rows, visit) if loads else [visit]
        legs.append(own[:: -1 if k % 2 else 1])
    half = (len(legs) + 1) // 2
    middle, end = _validating(pool, rows, np.flatnonzero(m.role[rows] == "validate"))
    parts = [part for leg in legs[:half] for part in leg] + middle
    parts += [part for leg in legs[half:] for part in leg] + end
    out: list[int] = []
    for part in parts:
        at = pool.approach[rows[part]]
        seconds = np.abs(at[:, None] - at[None]).max(axis=2) / RATE
        before = pool.approach[rows[out[-1]]] if out else at[0]
        first = int(np.argmin(np.abs(at - before).max(axis=1)))
        out += part[path(seconds, first)].tolist()
    return np.array(out, int)


def _placements(pool: Pool, rows: np.ndarray) -> np.ndarray:
    """The placement of the target of each row, (M,); "" where it stays, or there is a single placement."""
    names = [t.name.partition("@")[2] for t in pool.session.targets]
    single = len({*names} - {""}) < 2
    return np.array([("" if single else names[t]) for t in pool.session.measurements.target[rows]], object)


def _stations(pool: Pool, rows: np.ndarray, some: np.ndarray) -> list[np.ndarray]:
    """Positions `some` by placement, in the order of the targets; what stays is dealt to all of them."""
    label, target = _placements(pool, rows)[some], pool.session.measurements.target[rows[some]]
    stays = some[label == ""]
    names = [str(name) for name in dict.fromkeys(label[np.argsort(target, kind="stable")]) if name]
    if not names:
        return [stays] if len(stays) else []
    return [np.concatenate([some[label == name], stays[k :: len(names)]]) for k, name in enumerate(names)]


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
    return [np.array(own, int) for own in out if own]


def _by_payload(pool: Pool, rows: np.ndarray, some: np.ndarray) -> list[np.ndarray]:
    """Positions `some` with each payload, the lightest first."""
    m = pool.session.measurements
    if m.payload is None:
        return [some]
    own = m.payload[rows[some]]
    return [some[own == kg] for kg in np.unique(own)]


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
        own = [one[k::2] for one in stays]
        if own and len(joined := np.concatenate(own)):
            group.append(joined)
    return middle, end
