"""Errors by when a measurement is taken: drift with time or temperature, and events between two rows."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from bayescal.arm.motion import TURN, Term
from bayescal.effects.common import alone, apart, each, site_and_driver, within
from bayescal.effects.location import ARM, BASE, TOOL, Driver, Site, Size, face, length
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Scan, Where
from bayescal.errors import BayescalError

ZERO_SD = 5e-5  # rad
GROWTH_SD = 5e-5  # m per m
BASE_SD = 2e-5  # m
SHARES = (1 / 8, 1 / 4, 4.0)  # of the session: plausible time constants, the last nearly a straight line
PAUSES = tuple(itertools.product((25, 40, 55, 70), (15, 30, 45), (500, 1500)))
"""Begin and length, % of the session, of a time in which the arm cools, and time constant, s (assumed)."""
FASTEST, SLOWEST = 400.0, 14400.0  # s: an arm has no shorter or longer time constant (assumed)


def _clock(c: Circumstances) -> np.ndarray | None:
    """Times (N,), s, limited to those of the fitted measurements: the drift after them is not known.

    None if none are recorded, or they do not vary.
    """
    time = c.time
    if time is not None and len(c.fitted):
        time = np.clip(time, np.min(time[c.fitted]), np.max(time[c.fitted]))
    return None if time is None or not np.ptp(time) > 0 else time


def _order(c: Circumstances) -> np.ndarray | None:
    """Numbers of the rows (N,), limited to the fitted ones: a session without times is in their order."""
    if not len(c.fitted):
        return None
    return np.clip(np.arange(len(c.q), dtype=float), np.min(c.fitted), np.max(c.fitted))


def course(c: Circumstances) -> tuple[str, np.ndarray] | None:
    """Name of the driver, and its values over the session (N,) from -1 to 1; None if nothing varies."""
    clock = ("row", _order(c)) if c.time is None else ("time", _clock(c))
    for name, values in (("temperature", c.temperature), clock):
        if values is not None and len(values) and np.ptp(values) > 0:
            return name, _scaled(values)
    return None


def _lengths(c: Circumstances, driver: np.ndarray) -> tuple[Term, ...]:
    """Every a and d of the table and every linear scale, growing by its own length times the driver."""
    robot = c.robot
    scales = [(j + 1, c.q[:, j] * driver) for j in np.flatnonzero(robot.slides).tolist()]
    behind = 0 if robot.convention == "mdh" else 1
    along = [(i + 1, "tz", float(d)) for i, d in enumerate(robot.d)]
    across = [(i + behind, "tx", float(a)) for i, a in enumerate(robot.a)]
    lengths = tuple(Term(frame, axis, length * driver) for frame, axis, length in along + across if length)
    return (*lengths, *(Term(frame, "tz", grown) for frame, grown in scales))


def _drifting(c: Circumstances, by: str, driver: np.ndarray) -> Iterator[Parameter]:
    kind = Driver("time" if by == "row" else by)
    if lengths := _lengths(c, driver):
        yield Parameter(f"thermal-drift growth by {by}", "1", lengths, GROWTH_SD, site=ARM, driver=kind)
    for axis in "xyz":
        term = (Term(0, f"t{axis}", driver),)
        yield Parameter(f"thermal-drift base {axis} by {by}", "m", term, BASE_SD, site=BASE, driver=kind)
    for j, name in enumerate(c.robot.joint_names, start=1):
        term, slides = (Term(j, c.robot.axes[j - 1], driver),), c.robot.slides[j - 1]
        unit, sd = ("m", BASE_SD) if slides else ("rad", ZERO_SD)
        yield Parameter(f"thermal-drift {name} by {by}", unit, term, sd, **site_and_driver(j, kind))


def _parameters(c: Circumstances) -> Iterable[Parameter]:
    recorded = course(c)
    return () if recorded is None else _drifting(c, *recorded)


def _scaled(values: np.ndarray) -> np.ndarray:
    """Values (N,) that vary, from -1 to 1."""
    low, high = np.min(values), np.max(values)
    return (2.0 * values - (low + high)) / (high - low)


def _warming(c: Circumstances, constant: float) -> list[Parameter]:
    """The drift of an arm that warms up with a time constant, s, in place of the recorded course."""
    if all(_clock(one) is None for one in each(c)):
        what = "a time constant needs time_s that varies"
        raise BayescalError(what, f"--model thermal-drift@{constant:g}", "say thermal-drift")

    def course(time: np.ndarray) -> np.ndarray:
        grown = 1.0 - np.exp(-(time - np.min(time)) / constant)
        return 2.0 * grown / np.max(grown) - 1.0

    return _by_clock(c, course)


def _by_clock(c: Circumstances, course: Callable[[np.ndarray], np.ndarray]) -> list[Parameter]:
    """The drift of every session by a function of its times (N,), s; none where these do not vary."""

    def one(c: Circumstances) -> Iterable[Parameter]:
        time = _clock(c)
        return () if time is None else _drifting(c, "time", course(time))

    return apart(c, one)


def heated(share: np.ndarray, begin: float, end: float, constant: float) -> np.ndarray:
    """Temperature (N,) of a body heated from 0 on towards 1, and cooling towards 0 from `begin` to `end`.

    Exact for a body of one time constant.

    Parameters
    ----------
    share : np.ndarray, shape (N,)
        Times, in any unit, as are the others.
    """
    first = 1.0 - np.exp(-np.minimum(share, begin) / constant)
    cooled = first * np.exp(-np.clip(share - begin, 0.0, end - begin) / constant)
    return 1.0 + (cooled - 1.0) * np.exp(-np.maximum(share - end, 0.0) / constant)


def _paused(c: Circumstances, begin: float, length: float, constant: float) -> list[Parameter]:
    """The drift of an arm that cools for a while, in place of the recorded course; see `PAUSES`."""

    def course(time: np.ndarray) -> np.ndarray:
        share = (time - np.min(time)) / np.ptp(time)
        start, until = begin / 100.0, (begin + length) / 100.0
        return _scaled(heated(share, start, until, constant / float(np.ptp(time))))

    return _by_clock(c, course)


def _constants(c: Circumstances) -> np.ndarray:
    clocks = [time for one in each(c) if (time := _clock(one)) is not None]
    span = max((float(np.ptp(time)) for time in clocks), default=0.0)
    tried = np.unique(np.clip(span * np.array(SHARES), FASTEST, SLOWEST)) if span > 0 else np.empty(0)
    return np.array([float(f"{constant:.3g}") for constant in tried])  # finer steps are not distinguishable


def _missing(c: Circumstances) -> str:
    lacks = "no temperature_c of the arm or the air, and no time_s, that varies"
    return "" if any(map(course, each(c))) else lacks


THERMAL_DRIFT = Effect(
    "thermal-drift",
    "lengths, base and joint zeros drift with temperature or time",
    lambda c: apart(c, _parameters),
    _missing,
    Scan(
        "time constant of the warm-up, s",
        "",  # its u is not determined: it is in the name of the model alone
        _constants,
        _warming,
    ),
    whole=True,
    sizes={
        "1": Size("half of the change of lengths, relative"),
        "m": Size("half of the shift", length),
        "rad": Size("half of the change of the zero"),
    },
    phrase=("the arm", "has thermal drift"),
    remedy=(
        "Warm up the arm for 40 min with the motion of the task before measuring. Keep air draughts "
        "and sunlight away, measure reference points at intervals, and record the temperature."
    ),
    confusable_with=("step",),
    shown_by="temperature",
    forms=tuple(
        Form(
            f"paused-{begin}-{length}-{constant}",
            f"time constant {constant} s, cooling from {begin} % of the session on, for {length} % of it",
            partial(_paused, begin=begin, length=length, constant=constant),
        )
        for begin, length, constant in PAUSES
    ),
    of_session=True,
)
r"""Thermal drift: the lengths of the arm grow as it warms up, and its joint zeros drift.

Formula: $`a_k \to a_k (1 + g f), \; d_k \to d_k (1 + g f), \; \rho_{z,k} = x_k f, \; \delta_0 = b f`$;
f goes from -1 to 1 with temperature or time.

Driver: the temperature, or the time if none is recorded (an artefact's temperature does not count), or the
order of the rows if neither is, scaled to -1 to 1 over the session. One parameter scales all lengths of the
arm by the same factor. Each joint zero has its own drift. The base drifts along three axes; its rotation
about the first axis is that of the first zero. Values are half of the change over the session. An arm may
also warm up with a time constant, which is scanned or given: ``thermal-drift@600`` for ten minutes. Of
several sessions, each has its own drift. An arm that rests or moves slowly for a while cools down meanwhile:
``thermal-drift@paused-40-15-1500`` warms up with 1500 s, but its motors are off from 40 % of the session on,
for 15 % of it. Prior: zeros 0.05 mrad, from drifts of 0.06 to 0.13 mrad over a
session (an ABB IRB 120 measured with a laser tracker); growth 5e-5, as of aluminium (23e-6 1/K) over 4 K, and
the base 0.02 mm (both assumed).
"""

SHIFTS, TURNS = ("tx", "ty", "tz"), ("rx", "ry", "rz")
SD = {"t": ("m", 5e-5), "r": ("rad", 1e-4)}
ROWS = 200
"""Rows that are tried at first; of longer sessions those beside the leading ones follow (cost)."""
EVENTS = 3
"""Steps that a diagnosis looks for (cost)."""
NEAR = 0.5
"""m: within it, turns about an instrument and about the base differ by no more than the prior of a shift."""
EDGE = 0.03  # share of the fitted measurements that must be before, after, and between steps


def after(c: Circumstances, row: float) -> np.ndarray:
    """1 from the given row (counted from 1) on, else 0, (N,)."""
    return (np.arange(len(c.q)) >= row - 1).astype(float)


def moments(c: Circumstances) -> np.ndarray:
    """Numbers (from 1) of rows that may be the first after a step, evenly spread over the fitted ones."""
    out = []
    for one in each(c):
        low, count = _edge(one.fitted), len(one.fitted)
        first = np.unique(np.linspace(low, count - low, ROWS).round().astype(int))
        possible = np.flatnonzero(c.may_change[one.fitted])
        first = possible[np.unique(np.searchsorted(possible, first[first <= possible[-1]]))]
        out.append(one.fitted[first[(first > 0) & (first < count)]] + 1.0)
    return np.concatenate(out)


def _edge(fitted: np.ndarray) -> int:
    return max(1, round(EDGE * len(fitted)))


def beside(c: Circumstances, row: float) -> np.ndarray:
    """Numbers of fitted rows about as near to a row as the next of `moments`."""
    for fitted in (one.fitted for one in each(c)):
        if row - 1 in fitted:
            place, low = int(np.searchsorted(fitted, row - 1)), _edge(fitted)
            near = len(fitted) // ROWS + 1
            some = fitted[max(place - near, low) : min(place + near, len(fitted) - low) + 1]
            return some[c.may_change[some]] + 1.0
    return np.empty(0)


def long_enough(c: Circumstances, one: float, other: float, on: np.ndarray | float = 1.0) -> bool:
    """Whether as many fitted rows of a site, `on` (N,), are between two steps as before the first of them."""
    between = ((c.fitted + 1 >= min(one, other)) & (c.fitted + 1 < max(one, other))).astype(float)
    count = float(np.sum(between * np.broadcast_to(on, len(c.q))[c.fitted]))
    return count >= min(_edge(session.fitted) for session in each(c))


def _apart(c: Circumstances, one: tuple[Site, float], other: tuple[Site, float]) -> bool:
    """Whether two steps, each a site and a row, are two events; the only instrument is the base."""
    only = [face(name) for name, rows, _ in c.instruments if np.all(rows[c.fitted] > 0.0)]
    one_site = len({BASE if site in only else site for site, _ in (one, other)}) == 1
    on = next((rows for name, rows, _ in c.artefacts if face(name) == one[0]), 1.0)
    return not one_site or long_enough(c, one[1], other[1], on)


def _at(c: Circumstances, row: float) -> list[Parameter]:
    if not c.sessions:
        return list(_shift(c, row))
    index = min(int(row), len(c.q)) - 1
    return [within(p, s) for s in c.sessions if s.rows[index] for p in _shift(alone(c, s), row)]


def _shift(c: Circumstances, row: float) -> Iterator[Parameter]:
    since, end = after(c, row), c.chain.n + 1
    yield from _displaced("step", BASE, since, {0: (*SHIFTS, *TURNS)})
    indices = reflectors(c)
    tools = [("step tool", TOOL, indices)] if indices else []
    if len(indices) > 1:
        tools += [(f"step tool {c.tool_names[k]}", TOOL.of(c.tool_names[k]), (k,)) for k in indices]
    for name, site, used in tools:
        axes = {end: SHIFTS} | ({TURN: TURNS} if set(used) & set(c.turned_tools) else {})
        yield from _displaced(name, site, since * np.isin(c.tool, used), axes)
    for k, (name, rows, place) in enumerate((*c.instruments, *c.artefacts)):
        mine, later = rows[c.fitted], since[c.fitted]
        alone_moves = np.sum(mine) < len(mine) or (k < len(c.instruments) and np.linalg.norm(place) > NEAR)
        if alone_moves and min(mine @ later, mine @ (1.0 - later)) >= _edge(c.fitted):
            for p in _displaced(f"step {name}", face(name), since * rows, {0: (*SHIFTS, *TURNS)}):
                yield replace(p, terms=_about(p.terms[0], place))


def _about(term: Term, place: np.ndarray) -> tuple[Term, ...]:
    """Terms of a displacement of the base whose turns are about a place, (3,) m, to first order."""
    if term.axis not in TURNS:
        return (term,)
    back = -np.cross(np.eye(3)[TURNS.index(term.axis)], place)
    return (term, *(Term(0, axis, by * term.driver) for axis, by in zip(SHIFTS, back, strict=True) if by))


def reflectors(c: Circumstances) -> tuple[int, ...]:
    """Tools (numbers) that touch no surface in the fitted measurements: reflectors, balls in a socket."""
    used, touching = c.tool[c.fitted], c.touching[c.fitted]
    return tuple(int(k) for k in np.unique(used) if not np.any(touching[used == k]))


def _displaced(
    name: str, site: Site, since: np.ndarray, axes: Mapping[int, tuple[str, ...]]
) -> Iterator[Parameter]:
    """A displacement of some frames along some axes, by a driver (N,)."""
    where: Where = {"site": site, "driver": Driver("event")}
    for frame, axis in ((frame, axis) for frame, directions in axes.items() for axis in directions):
        unit, sd = SD[axis[0]]
        yield Parameter(f"{name} {axis.removeprefix('t')}", unit, (Term(frame, axis, since),), sd, **where)


STEP = Effect(
    "step",
    "sudden shift of the base, of a tool, of an instrument or of an artefact at row n",
    lambda c: apart(c, lambda one: _shift(one, one.fitted[len(one.fitted) // 2] + 1.0)),
    lambda c: "" if len(c.fitted) > 1 else "a step needs more than one row",
    Scan("first row after it", "from row {:.0f} on", moments, _at, True, EVENTS, beside, _apart),
    sizes={"m": Size("shift", length), "rad": Size("rotation", length)},
    alternatives=True,
    phrase=("the base", "shifted suddenly"),
    remedy=(
        "Look at the log at the row of the event: a collision, a changed tool, a displaced stand, "
        "an emergency stop. Fasten the base, the artefact, the tool or the instrument, and measure "
        "again from there."
    ),
    confusable_with=("thermal-drift",),
    side="mount",
    of_session=True,
)
r"""Step: a sudden shift of the base, of a tool, of an instrument or of an artefact at a row n.

Formula: $`\delta_a(i) = x_a \; \mathrm{if} \; i \ge n, \; \mathrm{else} \; 0`$;
for each of the six axes a of the base, or of another site.

Driver: 0 before a row and 1 from this row on, for each of the six displacements of the base. The model is not
linear in the row. It is given, as ``step@212`` for the 212th row of the session; the default is the middle of
the fitted data, which are in the order of time. A diagnosis scans all rows. Several steps are
``step@40/212 at base and base``. A step ends with its session: of
several sessions, each has a step in its middle, or only the session with the given row has one. Prior:
0.05 mm and 0.1 mrad (assumed: 0.05 mm at half a metre; an operator would notice a larger shift).

Other sites are alternatives to the base. ``step@212 at tool``: a reflector slips in its nest, with the same
prior, and turns where its orientation is read. A stylus that is mounted anew is none: its pre-travel changes
too (assumed). Of several reflectors, all are ``tool``, and each is ``tool of NAME``. ``step@212 at NAME``:
the instrument of that name shifts, and turns about its own place. An instrument that stands far from the base
thereby shifts its points by far more than a base that turns as much. The only instrument within 0.5 m of the
base, as one whose coordinates were aligned with the base, is no other site than the base. ``step@212 at
ball@2``: the second placement of the artefact ``ball`` shifts, and turns about the middle of its contacts.
Targets are one rigid body where certificates or their names tie them. The only body is no other site than the
base. Each site needs as many of its own rows before and after its step as the edges of a session have.
"""
