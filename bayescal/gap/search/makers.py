"""One generic cell, its parameters by site, and the quantities of a session on which an error may depend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.arm import chain as reference
from bayescal.arm.motion import CONTACT, IMAGE, TURN, Term
from bayescal.arm.statics import gravity_in_f0
from bayescal.effects import Circumstances, Parameter, View, location
from bayescal.effects.common import LINK, READING, added_load, base_terms, by_reading, sense, side_of, turned
from bayescal.effects.imaging import at_view
from bayescal.effects.location import BASE, CAMERA, PROBE, TOOL, Driver, Site, joint
from bayescal.estimate.families import cosines, unit_range
from bayescal.gap.settings import CELLS, RELATIVES
from bayescal.statistics import rms


@dataclass(frozen=True)
class Cell:
    """A site, a coordinate, and its sets of columns: one smooth set, or many local ones.

    With `clusters` it is a random error, drawn anew in each cluster of rows: its only set has one
    parameter, the motion by that error. Without sets they are those of `cells.sets_of`.
    """

    site: Site
    driver: Driver
    sets: tuple[tuple[Parameter, ...], ...]
    of_known_effect: bool = False  # whether a known effect has this same function
    weight: float = 1.0  # number of cells of its kind of site that its prior is worth
    clusters: np.ndarray | None = None  # (N,) int, equal for rows that share a random error


def smooth(x: np.ndarray, fitted: np.ndarray, waves: int = CELLS.waves) -> list[np.ndarray]:
    """Cosines of 1 to `waves` half periods over the range of a coordinate x (N,); of few values, fewer.

    Of two values the second would be a constant.
    """
    return cosines(x, fitted, min(waves, len(np.unique(x[fitted])) - 1))


def along(frame: int, axis: str, driver: np.ndarray, angle: float = CELLS.angle) -> Parameter:
    """A shift, m, along an axis of a frame, or a turn, rad, about it."""
    unit, sd = ("m", CELLS.length) if axis[0] == "t" else ("rad", angle)
    return Parameter("", unit, (Term(frame, axis, driver),), sd)


def tilted(c: Circumstances, axis: np.ndarray, driver: np.ndarray) -> Parameter:
    """A turn of the base about a vector (3,) in F0, rad."""
    return Parameter("", "rad", base_terms(c, "r", axis, driver), CELLS.angle)


def at_joint(c: Circumstances, j: int, drivers: list[np.ndarray], side: str = LINK) -> tuple[Parameter, ...]:
    """Rotations of the link of a joint, or of all links that its reading moves; shifts of a prismatic one."""
    unit, sd = ("m", CELLS.length) if c.robot.slides[j - 1] else ("rad", CELLS.angle)
    return tuple(Parameter("", unit, turned(c.robot, j, d, side), sd) for d in drivers)


def moves(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides of a joint where an error rotates different links: both where its reading moves several links."""
    return (LINK, READING) if np.count_nonzero(c.robot.link_from_reading[:, j - 1]) > 1 else (LINK,)


def passes(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides of a joint with different motions: both where several readings move its link."""
    return (LINK, READING) if np.count_nonzero(c.robot.link_from_reading[j - 1]) > 1 else (LINK,)


def sides_of(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides on which a joint moves, or its error rotates, differently."""
    return max(moves(c, j), passes(c, j), key=len)


def at_contact(on: np.ndarray, drivers: Iterable[np.ndarray]) -> tuple[Parameter, ...]:
    """Displacements of contacts along their normals, at the rows (N,) where `on` is 1."""
    return tuple(Parameter("", "m", (Term(CONTACT, "normal", on * d),), CELLS.length) for d in drivers)


Mover = Callable[[np.ndarray], list[Parameter]]
SHIFTS, TURNS = ("tx", "ty", "tz"), ("rx", "ry", "rz")


def displaced(axes: Mapping[int, tuple[str, ...]], rows: np.ndarray | float = 1.0) -> Mover:
    """Displacements of frames along axes, in the rows (N,) where it is 1."""

    def move(d: np.ndarray) -> list[Parameter]:
        driver = d * rows  # one array for all axes
        return [along(f, axis, driver, CELLS.angle / 2) for f, of in axes.items() for axis in of]

    return move


def bodies(c: Circumstances) -> dict[Site, tuple[Mover, ...]]:
    """Instruments and rigid bodies of targets that may shift alone, beside others, as `movers`."""
    every = ((name, rows) for name, rows, _ in (*c.instruments, *c.artefacts))
    return {
        location.face(name): (displaced({0: (*SHIFTS, *TURNS)}, rows),)
        for name, rows in every
        if np.sum(rows[c.fitted]) < len(c.fitted)
    }


def movers(c: Circumstances) -> dict[Site, tuple[Mover, ...]]:
    """Sites that may drift with time or shift suddenly, and their parameters for a driver (N,).

    Of several tools, all may move together, or each alone; a tool whose orientation is read also turns.
    """

    def turn(j: int) -> Mover:
        return lambda d: list(at_joint(c, j, [d], side_of(c.robot)))

    def contact(rows: np.ndarray) -> Mover:
        return lambda d: list(at_contact(rows, [d]))

    out: dict[Site, tuple[Mover, ...]] = {BASE: (displaced({0: (*SHIFTS, *TURNS)}),)}
    out |= {joint(j): (turn(j),) for j in range(1, c.robot.n + 1)}
    of_tool = {c.chain.n + 1: SHIFTS} | ({TURN: TURNS} if c.turned_tools else {})
    single = [(c.tool == k).astype(float) for k in c.fitted_tools] if len(c.fitted_tools) > 1 else []
    out[TOOL] = tuple(displaced(of_tool, rows) for rows in (1.0, *single))
    if np.any(c.touching):
        out[PROBE] = (contact(c.touching.astype(float)),)
    out |= {location.face(face.name): (contact(face.rows),) for face in c.faces}
    out |= {at_view(v, CAMERA): (_lens(v),) for v in c.views}
    return out


def _lens(v: View) -> Mover:
    """Errors of the focal lengths and the optical axis of a view."""
    every = [(e, k) for e in (v.focal, v.centre) for k in range(e.by.shape[2])]

    def move(d: np.ndarray) -> list[Parameter]:
        return [Parameter("", e.unit, shifts(e.by[:, :, k] * d[:, None]), CELLS.pixels) for e, k in every]

    return move


def shifts(lengths: np.ndarray) -> tuple[Term, ...]:
    """Terms that move corners in the image by lengths (N, 2), m."""
    return tuple(Term(IMAGE, way, lengths[:, k]) for k, way in enumerate("uv") if lengths[:, k].any())


def measured(c: Circumstances) -> np.ndarray:
    """Rows (N,) in the order of measurement: of time if recorded, else of the file."""
    return np.arange(len(c.q)) if c.time is None else np.argsort(c.time, kind="stable")


def repeated(c: Circumstances, readings: np.ndarray, anew: bool = False) -> np.ndarray:
    """Numbers (N,), equal for rows with equal readings (N, ...) and for repetitions of one contact.

    With `anew` each repetition has a number of its own.
    """
    out = np.unique(np.round(readings, 8), axis=0, return_inverse=True)[1].ravel()
    if c.repeat is not None:
        labels = c.repeat.astype(str)
        has = np.flatnonzero(labels != "")
        out[has] = len(out) + (has if anew else np.unique(labels[has], return_inverse=True)[1])
    return np.unique(out, return_inverse=True)[1]


def fading(angle: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Direction of the travel to each of successive angles (..., N), forgotten over a travel.

    After a travel d the state is sign(d) + (state - sign(d)) exp(-|d| / length), from 0: (..., L, N) in
    -1 to 1, for L lengths.
    """
    step = np.diff(angle, prepend=angle[..., :1])[..., None, :]
    keep, sign = np.exp(-np.abs(step) / lengths[:, None]), np.sign(step)
    out, state = np.empty(keep.shape), np.zeros(keep.shape[:-1])
    for k in range(keep.shape[-1]):
        state = sign[..., k] + (state - sign[..., k]) * keep[..., k]
        out[..., k] = state
    return out


def slack(angle: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Position within lost motion of L widths, along successive angles (..., N): (..., L, N) in -1 to 1.

    The state persists from contact to contact: a travel d moves it by 2 d / width, at most to its end. It
    begins at 0.
    """
    step = 2.0 * np.diff(angle, prepend=angle[..., :1])[..., None, :] / widths[:, None]
    out, state = np.empty(step.shape), np.zeros(step.shape[:-1])
    for k in range(step.shape[-1]):
        state = np.minimum(np.maximum(state + step[..., k], -1.0), 1.0)
        out[..., k] = state
    return out


def seats(course: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Which of two places is taken along successive values (..., N): (..., L, N), -1 or 1, 0 before any.

    It is taken once the value is beyond one of L thresholds in its direction, until the value is beyond this
    threshold in the other direction.
    """
    there = course[..., None, :]
    taken = np.where(np.abs(there) > thresholds[:, None], np.sign(there), 0.0)
    last = np.maximum.accumulate(np.where(taken != 0.0, np.arange(course.shape[-1]), 0), axis=-1)
    return np.take_along_axis(taken, last, axis=-1)


def points(c: Circumstances) -> np.ndarray:
    """TCP positions (N, 3) at nominal geometry, in F0, m."""
    return reference.points(c.chain, c.q, c.tool_centres[c.tool])


@dataclass(frozen=True)
class Argument:
    """A quantity of the session, with functions of it."""

    driver: Driver
    functions: np.ndarray  # (N, k) smooth ones, which modulate a prediction
    factors: np.ndarray  # (N, m) positive ones, in proportion to which an error may be


def arguments(c: Circumstances) -> tuple[Argument, ...]:
    """All quantities of a session on which an error may depend, those that vary over its fitted rows."""
    return tuple(
        Argument(driver, np.column_stack(values), np.column_stack([np.empty((len(c.q), 0)), *factors]))
        for driver, values, factors in _functions(c)
        if values
    )


def at_tool(c: Circumstances) -> np.ndarray:
    """Direction of gravity in the frame of the flange, (N, 3); 0 without gravity."""
    pose = reference.frames(c.chain, c.q)
    down = gravity_in_f0(c.chain, pose, c.gravity / max(float(np.linalg.norm(c.gravity)), 1e-300))
    return np.asarray((pose[:, -1, :3, :3].swapaxes(1, 2) @ down[..., None])[..., 0])


def _functions(c: Circumstances) -> Iterator[tuple[Driver, list[np.ndarray], list[np.ndarray]]]:
    fitted, waves = c.fitted, RELATIVES.waves
    for j in range(1, c.robot.n + 1):
        angle = c.readings[:, j - 1]
        yield by_reading(c.robot, j), cosines(angle, fitted, waves), _ends(angle, fitted)
        if c.torques is not None and np.ptp(c.torques[fitted, j - 1]) > 1e-3:
            load = c.torques[:, j - 1] / rms(c.torques[fitted, j - 1])
            yield Driver("torque", j), cosines(load, fitted, waves), [np.abs(load), *_ends(load, fitted)]
        if c.velocity is not None and np.any(c.velocity[fitted, j - 1]):
            speed, way = np.abs(c.velocity[:, j - 1]), sense(c.velocity[:, j - 1])
            yield Driver("direction", j), [way], [(1.0 + way) / 2, (1.0 - way) / 2]
            yield Driver("joint speed", j), cosines(speed, fitted, 2), [speed / rms(speed[fitted])]
    clock = np.arange(len(c.q), dtype=float) if c.time is None else c.time
    yield Driver("time"), cosines(clock, fitted, waves), _ends(clock, fitted)
    if c.temperature is not None:
        yield Driver("temperature"), cosines(c.temperature, fitted, 2), _ends(c.temperature, fitted)
    load = added_load(c)
    yield Driver("load"), smooth(load, fitted, 2), _ends(load, fitted)
    place = points(c)
    ends = [f for x in place.T for f in _ends(x, fitted)]
    yield Driver("workspace"), [f for x in place.T for f in cosines(x, fitted, 1)], ends
    if np.any(c.touching):
        normal = list(np.where(c.touching[:, None], c.approach, 0.0).T)
        yield Driver("contact direction"), normal, [f for x in normal for f in _ends(x, fitted)]


def _ends(x: np.ndarray, fitted: np.ndarray) -> list[np.ndarray]:
    """Straight lines from 0 at one end of the range of a coordinate x (N,) to 1 at the other, both ways."""
    u = unit_range(x, fitted)
    return [] if u is None else [u, 1.0 - u]
