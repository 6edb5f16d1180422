"""Orders of probing, the time of travel, and the motions between contacts.

If faces were probed one after the other, a drift would look like a displacement of the faces. By default
every sweep therefore visits all targets, on a short path. Contacts on an artefact with several placements
(``ball.A@1``, ``ball.A@2``) are together, and so are equal payloads in a sweep: in each it changes once.
Contacts that validate are in the middle of the session and at its end.

Controllers move between approaches by joint angles, all joints at the same time. Such a motion from one face
of an artefact to another usually passes through it: it is checked, and passes other points where it must.
Where a tool, the placement of an artefact or the payload is changed, the arm first goes to a raised pose, far
from all solids, and waits there.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Measurements
from bayescal.dataset.write import taken
from bayescal.planning.pool import Pool
from bayescal.planning.result import Way, Ways
from bayescal.probing.clearance import RETRACT
from bayescal.probing.contacts import EVERY, SPEED
from bayescal.probing.motions import RAISED, TOLERANCE, Place, seconds_between
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
    pool: Pool, rows: np.ndarray, order: str, rng: np.random.Generator, blocked: Blocked
) -> np.ndarray:
    """Positions (M,) that put rows (M,) of the pool's session in an order of `ORDERS`.

    Sweeps visit all targets. A row that is given twice is a contact to be repeated: its measurements are in
    different sweeps. A sweep is divided by payload, and each part is a short path: nearest neighbour, then
    exchanges of two connections. The random order keeps the placements of an artefact apart, no more.

    Motions between rows that are `blocked` (`Transits.blocked`) are avoided where that saves time.
    """
    rows = np.asarray(rows, int)
    m, approach = taken(pool.session.measurements, rows), pool.approach[rows]
    label = np.array(placements([t.name for t in pool.session.targets]), object)[m.target]
    stations = _stations(m, label, np.flatnonzero(m.role != "validate"))
    sweeps = -(-ORDERS[order] // max(len(stations), 1))
    mass = np.zeros(len(rows)) if m.payload is None else m.payload  # the lightest comes first
    visits = [visit for station in stations for visit in _dealt(rows, m, station, sweeps, rng)]
    legs = []
    for k, visit in enumerate(visits):
        loads = [visit] if order == RANDOM else [visit[mass[visit] == kg] for kg in np.unique(mass[visit])]
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


def travel(pool: Pool, rows: np.ndarray, *passed: Sequence[Way]) -> float:
    """Time, s, of the motion between contacts in the given order, with approach and retract.

    `passed` (each M of (K, n)), rad, are the readings that are passed before each row one after the other
    (`leave` and `via` of `Ways`).
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
    by_placement = [some[label[some] == name] for name in names]
    parts = [np.concatenate([part, stays[k :: len(names)]]) for k, part in enumerate(by_placement)]
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


WAITING = 60  # raised poses that are tried where the arm waits, those of the shortest way first
HARD = 6  # of them to which a way past other configurations is searched


@dataclass(frozen=True)
class Transits:
    """Motions between the approaches of rows of a pool."""

    pool: Pool

    @cached_property
    def _labels(self) -> np.ndarray:
        """Placement of each row, (N,)."""
        session = self.pool.session
        labels = np.array(placements([t.name for t in session.targets]), object)
        return labels[session.measurements.target]

    def blocked(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Which straight motions between the approaches of rows (M,) collide, (M,).

        None where tool or artefact is changed on the way: the arm stops there.
        """
        out, approach = np.zeros(len(begin), bool), self.pool.approach
        tool = self.pool.session.measurements.tool
        a, b = self._labels[begin], self._labels[end]
        label = np.where(b == "", a, b)
        moved = (tool[begin] == tool[end]) & ((a == "") | (b == "") | (a == b))
        places = zip(tool[end[moved]].tolist(), map(str, label[moved]), strict=True)
        for k, name in sorted(set(places)):
            some = moved & (tool[end] == k) & (label == name)
            out[some] = ~self.pool.setup.hands[k].place(name).free(approach[begin[some]], approach[end[some]])
        return out

    def ways(self, rows: np.ndarray) -> Ways:
        """The motions to rows (M,) in the order of probing, with the stops where something is changed."""
        approach, labels = self.pool.approach[rows], self._placed(rows)
        tool = self.pool.session.measurements.tool[rows]
        changes = self._changes(rows, labels)
        stops = np.array([k == 0 or bool(text) for k, text in enumerate(changes)])
        none = np.empty((0, approach.shape[1]))
        leave: list[Way] = [none] * len(rows)
        via: list[Way] = [none] * len(rows)
        places = [self.pool.setup.hands[t].place(str(n)) for t, n in zip(tool, labels, strict=True)]
        for k in np.flatnonzero(stops):
            before = None if k == 0 else (places[k - 1], approach[k - 1])
            leave[k], via[k] = stopped(before, (places[k], approach[k]))
        for place in dict.fromkeys(places):
            some = np.array([k for k, one in enumerate(places) if one is place and not stops[k]], int)
            for k, way in zip(some, place.ways(approach[some - 1], approach[some]), strict=True):
                via[k] = way
        for row in [k for k, way in enumerate(via) if way is None and not stops[k]]:
            # among more solids, where a way to each contact is known
            every = self.pool.setup.hands[tool[row]].place(EVERY)
            via[row] = every.ways(approach[[row - 1]], approach[[row]])[0]
        robot = self.pool.session.robot
        ends = zip(approach, via, strict=True)
        words = tuple(by_hand(end, robot) if way is None else "" for end, way in ends)
        clear = self._clearance(rows, places, leave, via)
        return Ways(leave=tuple(leave), via=tuple(via), changes=changes, by_hand=words, clearance=clear)

    def _clearance(
        self, rows: np.ndarray, places: Sequence[Place], leave: Sequence[Way], via: Sequence[Way]
    ) -> np.ndarray:
        """Smallest clearance (M,), m, of all motions of each row; nan where a part is by hand."""
        approach, m = self.pool.approach[rows], self.pool.session.measurements
        motions: dict[Place, list[tuple[int, np.ndarray, np.ndarray]]] = {place: [] for place in places}
        out, closed = np.full(len(rows), np.inf), []
        for k, (up, down) in enumerate(zip(leave, via, strict=True)):
            if up is None or down is None:
                closed.append(k)
                continue
            if k and len(up):
                motions[places[k - 1]] += [(k, a, b) for a, b in pairwise([approach[k - 1], *up])]
            begin = up[-1:] if len(up) else approach[max(k - 1, 0)][None]
            motions[places[k]] += [(k, a, b) for a, b in pairwise([*begin, *down, approach[k]])]
        for place, some in motions.items():
            if some:
                of, a, b = (np.array(part) for part in zip(*some, strict=True))
                np.minimum.at(out, of, place.clearance.closest(a, b, TOLERANCE))
            rows_here = np.array([k for k, one in enumerate(places) if one is place])
            hand = self.pool.setup.hands[m.tool[rows[rows_here[0]]]]
            names = [self.pool.session.targets[t].name for t in m.target[rows[rows_here]]]
            touched = self.pool.setup.scene.touched(names)
            for a, b, slack in hand.line(m.readings[rows[rows_here]], approach[rows_here]):
                np.minimum.at(out, rows_here, place.clearance.closest(a, b, TOLERANCE, touched, slack))
        out[closed] = np.nan
        return out

    def _placed(self, rows: np.ndarray) -> np.ndarray:
        """Placement of the artefact while each of rows (M,) is probed, (M,).

        It stays where it is until a row needs another, and is there from the beginning.
        """
        out = self._labels[rows]
        labelled = np.flatnonzero(out != "")
        if len(labelled):
            before = np.searchsorted(labelled, np.arange(len(rows)), side="right") - 1
            out = out[labelled[np.maximum(before, 0)]]
        return out

    def _changes(self, rows: np.ndarray, labels: np.ndarray) -> tuple[str, ...]:
        """What the person has to do before each of rows (M,), or ""."""
        session = self.pool.session
        m = session.measurements
        payload = np.zeros(len(rows)) if m.payload is None else m.payload[rows]
        names = [session.tools[k].name for k in m.tool[rows]]
        several = {"tool": len(set(names)) > 1, "placement": len(set(labels)) > 1}
        out = []
        for k, (name, label, load) in enumerate(zip(names, labels, payload, strict=True)):
            parts = []
            if several["tool"] and (k == 0 or name != names[k - 1]):
                parts.append(f"mount tool {name}")
            if several["placement"] and (k == 0 or label != labels[k - 1]):
                parts.append(f"move the artefact to placement {label}")
            if load != (payload[k - 1] if k else 0.0):
                parts.append(f"attach {load:g} kg to the tool" if load else "remove the payload")
            out.append("; ".join(parts))
        return tuple(out)


def stopped(before: tuple[Place, np.ndarray] | None, after: tuple[Place, np.ndarray]) -> tuple[Way, Way]:
    """Ways (K, n) from an approach (n,) to a raised pose where the arm waits, and from there to another.

    The last of the first is where it waits. At the start of a session (`before` is None) it is the only. None
    for both if there is no such way.
    """
    place, end = after
    raised = place.hubs
    if before is not None and before[0] is not place:
        away = np.minimum(before[0].away(raised), RAISED)
        raised = raised[away >= 0.5 * away.max(initial=0.0)]
    begin = end if before is None else before[1]
    order = np.argsort(seconds_between(begin, raised) + seconds_between(raised, end), kind="stable")
    best = raised[order[:WAITING]]
    direct = place.free(best, np.broadcast_to(end, best.shape))
    if before is not None:
        direct[direct] = before[0].free(np.broadcast_to(begin, best[direct].shape), best[direct])
    for wait in [*best[direct][:1], *best[:HARD]]:
        down = place.ways(wait[None], end[None])[0]
        up = wait[None][:0] if before is None else before[0].ways(begin[None], wait[None])[0]
        if down is not None and up is not None:
            return np.concatenate([up, wait[None]]), down
    return None, None


def by_hand(end: np.ndarray, robot: Robot) -> str:
    """How the arm is jogged manually to readings (n,), rad, to which no free way is known."""
    joints = [f"J{k} {angle:.1f}" for k, angle in enumerate(robot.shown(end), 1)]
    if robot.slides.any():
        each = ", ".join(f"{joint} {unit}" for joint, unit in zip(joints, robot.units, strict=True))
        return f"jog manually: first raise the tool above all that stands there; then to {each}"
    first, *others = joints
    return (
        "jog manually from where the arm stands: first raise the tool above all that stands there (J2, J3); "
        f"then {first} deg; then the wrist, {', '.join(others[2:]) or first} deg; at last lower the arm to "
        f"{', '.join(others[:2]) or first} deg"
    )
