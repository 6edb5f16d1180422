"""Events: something changes at once, between two rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bayescal.arm.motion import TURN, Term
from bayescal.effects.common import alone, apart, each, within
from bayescal.effects.location import BASE, TOOL, Driver, Site, Size, face, length
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Scan, Where

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


def long_enough(c: Circumstances, one: float, other: float) -> bool:
    """Whether there are as many fitted rows between two steps as there must be before the first of them."""
    between = np.sum((c.fitted + 1 >= min(one, other)) & (c.fitted + 1 < max(one, other)))
    return bool(between >= min(_edge(session.fitted) for session in each(c)))


def _apart(c: Circumstances, one: tuple[Site, float], other: tuple[Site, float]) -> bool:
    """Whether two steps, each a site and a row, are two events; the only instrument is the base."""
    only = [face(name) for name, rows, _ in c.instruments if np.all(rows[c.fitted] > 0.0)]
    one_site = len({BASE if site in only else site for site, _ in (one, other)}) == 1
    return not one_site or long_enough(c, one[1], other[1])


def _at(c: Circumstances, row: float) -> list[Parameter]:
    if not c.sessions:
        return _shift(c, row)
    index = min(int(row), len(c.q)) - 1
    return [within(p, s) for s in c.sessions if s.rows[index] for p in _shift(alone(c, s), row)]


def _shift(c: Circumstances, row: float) -> list[Parameter]:
    since, end = after(c, row), c.chain.n + 1
    out = _displaced("step", BASE, since, {0: (*SHIFTS, *TURNS)})
    indices = reflectors(c)
    tools = [("step tool", TOOL, indices)] if indices else []
    if len(indices) > 1:
        tools += [(f"step tool {c.tool_names[k]}", TOOL.of(c.tool_names[k]), (k,)) for k in indices]
    for name, site, used in tools:
        axes = {end: SHIFTS} | ({TURN: TURNS} if set(used) & set(c.turned_tools) else {})
        out += _displaced(name, site, since * np.isin(c.tool, used), axes)
    for name, rows, place in c.instruments:
        if np.sum(rows[c.fitted]) < len(c.fitted) or np.linalg.norm(place) > NEAR:
            shift = _displaced(f"step {name}", face(name), since * rows, {0: (*SHIFTS, *TURNS)})
            out += [replace(p, terms=_about(p.terms[0], place)) for p in shift]
    return out


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
) -> list[Parameter]:
    """A displacement of some frames along some axes, by a driver (N,)."""
    where: Where = {"site": site, "driver": Driver("event")}
    return [
        Parameter(f"{name} {axis.removeprefix('t')}", unit, (Term(frame, axis, since),), sd, **where)
        for frame, directions in axes.items()
        for axis in directions
        for unit, sd in (SD[axis[0]],)
    ]


STEP = Effect(
    "step",
    "sudden shift of the base, of a tool or of an instrument at row n",
    lambda c: apart(c, lambda one: _shift(one, one.fitted[len(one.fitted) // 2] + 1.0)),
    lambda c: "" if len(c.fitted) > 1 else "a step needs more than one row",
    Scan("first row after it", "from row {:.0f} on", moments, _at, True, EVENTS, beside, _apart),
    sizes={"m": Size("shift", length), "rad": Size("rotation", length)},
    alternatives=True,
    phrase=("the base", "shifted suddenly"),
    remedy=(
        "Look at the log at the row of the event: a collision, a changed tool, a displaced stand, "
        "an emergency stop. Fasten the base, the tool or the instrument, and measure again from "
        "there."
    ),
    confusable_with=("thermal-drift",),
    side="mount",
    of_session=True,
)
r"""Step: a sudden shift of the base, of a tool or of an instrument at a row n.

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
base, as one whose coordinates were aligned with the base, is no other site than the base.
"""
