"""Several sessions of one arm as one `Dataset`, so that every later stage fits them together.

The joined sessions share the arm, and tools with equal entries. Targets, certificates, ids, stops and repeats
belong to a session and have its name as a prefix (``A:cube.+x``). Its rows keep the noise that it states. Its
times are shifted to follow those of the session before, so that rows are in the order of time; a drift still
has separate parameters for each session (`effects.common`).

The rows of several sessions, one session after the other.

Whether two sessions are of the same robot, with the same mounting and conventions.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, replace
from hashlib import sha256
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset.table import EMPTY, LABELS
from bayescal.dataset.target_kinds import kinds_of
from bayescal.dataset.types import Certificate, Dataset, Measurements, Noise, Record, Tool
from bayescal.errors import BayescalError
from bayescal.statistics import grouped

PAUSE = 3600.0
"""s between the clocks of two sessions, which is unknown (assumed)."""


def called(session: Dataset, name: str) -> str:
    """The name that something of a session has among those of others."""
    return f"{session.name}:{name}"


def column(m: Measurements, name: str, width: tuple[int, ...] = ()) -> np.ndarray:
    """A copy of an optional column (N, *width), or what stands for a missing one."""
    given = getattr(m, name)
    return np.full((len(m.ids), *width), EMPTY[name]) if given is None else np.array(given)


def _telling(sessions: Sequence[Dataset]) -> list[Dataset]:
    """The sessions whose temperature may drive the arm; where none does, those that record an artefact's."""
    recorded = [s for s in sessions if s.measurements.temperature is not None]
    return [s for s in recorded if s.temperature_of != "artefact"] or recorded


def temperature_of(sessions: Sequence[Dataset]) -> str | None:
    """What the temperatures of the rows joined are of."""
    return next((s.temperature_of for s in _telling(sessions)), None)


def measurements(
    sessions: Sequence[Dataset], u: Sequence[np.ndarray], tool_of: Sequence[np.ndarray]
) -> Measurements:
    """All rows, session after session."""
    before = np.cumsum([0, *(len(s.targets) for s in sessions[:-1])])
    tables = [s.measurements for s in sessions]
    columns, _ = stacked(tables)
    columns |= {
        "ids": tuple(called(s, name) for s in sessions for name in s.measurements.ids),
        "target": np.concatenate([m.target + k for m, k in zip(tables, before, strict=True)]),
        "tool": np.concatenate([index[m.tool] for m, index in zip(tables, tool_of, strict=True)]),
        "u": None if all(np.isnan(values).all() for values in u) else np.concatenate(list(u)),
        "time": _clock(tables),
        "temperature": _temperature(sessions),
    }
    for name in (label for label in LABELS if columns[label] is not None):
        columns[name] = np.concatenate([_labels(s, name) for s in sessions])
    return Measurements(**columns)


def stacked(tables: Sequence[Measurements]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The columns of several tables, one below the other.

    A column that some of them lack has there what empty cells stand for.

    Returns
    -------
    dict
    tuple of str
        Columns that some of them lack and that have no empty cell: they are left out.
    """
    columns: dict[str, Any] = {"ids": tuple(name for m in tables for name in m.ids)}
    lost = []
    for name in (field.name for field in fields(Measurements) if field.name != "ids"):
        stated = [values for m in tables if (values := getattr(m, name)) is not None]
        columns[name] = None
        if stated and (name in EMPTY or len(stated) == len(tables)):
            columns[name] = np.concatenate([column(m, name, stated[0].shape[1:]) for m in tables])
        elif stated:
            lost.append(name)
    return columns, tuple(lost)


def _labels(session: Dataset, name: str) -> np.ndarray:
    """Stops or repeats (N,), called by their session; "" where there are none."""
    labels = column(session.measurements, name)
    return np.array([called(session, str(label)) if label else "" for label in labels])


def _clock(tables: Sequence[Measurements]) -> np.ndarray | None:
    """Times (N,), s: those of each session after those of the one before; of one without, one moment."""
    if all(m.time is None for m in tables):
        return None
    out: list[np.ndarray] = []
    end = 0.0
    for m in tables:
        time = np.zeros(len(m.ids)) if m.time is None else m.time
        out.append(time + (end + PAUSE - min(0.0, float(time.min())) if out else 0.0))
        end = float(out[-1].max())
    return np.concatenate(out)


def _temperature(sessions: Sequence[Dataset]) -> np.ndarray | None:
    """Temperatures (N,), degC, of arm or air; a session without any stays at the mean of the others."""
    recorded = {s.name: s.measurements.temperature for s in _telling(sessions)}
    if not recorded:
        return None
    mean = float(np.mean(np.concatenate([values for values in recorded.values() if values is not None])))
    return np.concatenate([recorded.get(s.name, np.full(len(s.measurements.ids), mean)) for s in sessions])


RELATIVE, ABSOLUTE = 1e-8, 1e-9
"""How alike two robot files must be, SI: to the digits that files are written with."""
NOT_THE_ARM = ("limits", "reductions", "radii", "priors", "ground")
"""Fields of a robot that may be told otherwise, or not at all, of the same arm."""


def check_alike(first: Dataset, other: Dataset) -> None:
    """Refuse two sessions of different arms, mountings or conventions."""
    if difference := arm_difference(first, other):
        what = f"not the robot of {first.name}: {difference}"
        raise BayescalError(what, str(other.folder), "fit the sessions of each arm apart")
    turns = [s.noise.orientation for s in (first, other) if s.noise.orientation is not None] or [0.0]
    pairs = (
        ("gravity_mps2", first.gravity, other.gravity),
        ("readings", first.readings, other.readings),
        ("torques", first.torques, other.torques),
        ("noise.joint_deg", np.degrees(first.noise.joint), np.degrees(other.noise.joint)),
        ("noise.slide_mm", 1e3 * (first.noise.slide or 0.0), 1e3 * (other.noise.slide or 0.0)),
        ("noise.orientation_deg", np.degrees(turns[0]), np.degrees(turns[-1])),
        ("held", *(_held(d.robot) for d in (first, other))),
    )
    for key, here, there in pairs:
        same = here == there if isinstance(here, str) else bool(np.all(_close(here, there)))
        if not same:
            what = f"`{key}` is {_words(there)}, in {first.name} it is {_words(here)}"
            raise BayescalError(what, str(other.folder), "state what is true of both, or fit them apart")


def arm_difference(first: Dataset, second: Dataset) -> str:
    """The first thing in which two robot files or serial numbers differ, in words; "" if nothing does."""
    one, other = first.robot, second.robot
    here, there = ((d.sessions or (d,))[0].record.serials.get("arm") for d in (first, second))
    if here and there and here != there:
        return f"serial number {there}, not {here}"
    if _stands(one) != _stands(other):
        return "the link that stands still is another one"
    for field in (f.name for f in fields(Robot) if f.name not in NOT_THE_ARM):
        here, there = getattr(one, field), getattr(other, field)
        name = field.replace("_", " ")
        if (here is None) != (there is None):
            return f"{name} given for one of them only"
        if not isinstance(here, np.ndarray):
            if here != there:
                return f"{name} {there}, not {here}"
        elif here.shape != there.shape:
            return f"{len(there)} rows of {name}, not {len(here)}"
        elif not np.all(close := _close(here, there)):
            place = tuple(int(k) for k in np.argwhere(~close)[0])
            of = f" of {one.joint_names[place[0]]}" if len(here) == one.n else ""
            return f"{name}{of} {there[place]:.9g}, not {here[place]:.9g} (SI)"
    return ""


def _stands(robot: Robot) -> int:
    """The joint before the link that stands still; 0 of an arm that stands on F0."""
    return 0 if robot.ground is None else robot.ground.link


def _held(robot: Robot) -> list[float]:
    """Mass and centre of what the first of two arms carries; zeros of one arm."""
    ground = robot.ground
    return [0.0] * 4 if ground is None else [ground.held, *ground.held_centre.tolist()]


def _close(here: Any, there: Any) -> np.ndarray:
    return np.isclose(here, there, rtol=RELATIVE, atol=ABSOLUTE)


def _words(value: Any) -> str:
    return f"{np.round(value, 9)}" if np.ndim(value) else f"{value}"


def joined(sessions: Sequence[Dataset], remounted: bool = False, own_noise: bool = True) -> Dataset:
    """Join sessions of one arm.

    Parameters
    ----------
    sessions : sequence of Dataset
        At least one; a single one is returned as it is.
    remounted : bool
        Give every session tools of its own: they were taken off the flange in between. Otherwise tools of
        one name that state the same are one tool.
    own_noise : bool
        Let every session have a noise scale of its own; otherwise rows of one kind share theirs.

    Returns
    -------
    Dataset
        With the sessions, each under a name of its own, as its `sessions`.

    Raises
    ------
    BayescalError
        Where they are not of one arm, or one of them is given twice.
    """
    if len(sessions) == 1:
        return sessions[0]
    sessions = _named(sessions)
    first = sessions[0]
    for other in sessions[1:]:
        check_alike(first, other)
    tools, tool_of = _tools(sessions, remounted)
    targets = tuple(
        replace(t, name=called(s, t.name), session=s.name, noise=s.name if own_noise else "")
        for s in sessions
        for t in s.targets
    )
    noise, rows = _stated(sessions)
    return replace(
        first, name=" + ".join(s.name for s in sessions), tools=tools, noise=noise, targets=targets,
        certificates=_certificates(sessions), measurements=measurements(sessions, rows, tool_of),
        temperature_of=temperature_of(sessions), source=None, plan=None, record=Record(),
        sha256=sha256(" ".join(s.sha256 for s in sessions).encode()).hexdigest(), sessions=tuple(sessions),
    )  # fmt: skip


def _named(sessions: Sequence[Dataset]) -> list[Dataset]:
    """The sessions with names that differ: their own, else those of their folders, else numbered."""
    given: dict[str, Dataset] = {}
    for s in sessions:
        if s.sha256 and (before := given.setdefault(s.sha256, s)) is not s:
            remedy = "its rows would count twice: name it once"
            raise BayescalError(f"the same session as {before.folder}", str(s.folder), remedy)
    choices = (
        [s.name for s in sessions],
        [s.folder.resolve().name for s in sessions],
        [f"{s.name} {k}" for k, s in enumerate(sessions, start=1)],
    )
    names = next(c for c in choices if len(set(c)) == len(c))
    # a name goes into those of variables, of which a netCDF file allows none with a slash
    return [replace(s, name=name.replace("/", "-")) for s, name in zip(sessions, names, strict=True)]


def _same(one: Tool, other: Tool) -> bool:
    """Whether two tools state the same."""
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(Tool))


def _tools(sessions: Sequence[Dataset], remounted: bool) -> tuple[tuple[Tool, ...], list[np.ndarray]]:
    """All tools, and for each session the index among them of each of its own."""
    stated = grouped((tool.name, tool) for s in sessions for tool in s.tools)
    shared = {n for n, (one, *more) in stated.items() if all(not remounted and _same(one, t) for t in more)}
    out: dict[str, Tool] = {}
    index = []
    for s in sessions:
        names = [t.name if t.name in shared else called(s, t.name) for t in s.tools]
        for tool, name in zip(s.tools, names, strict=True):
            out.setdefault(name, replace(tool, name=name))
        index.append(np.array([list(out).index(name) for name in names]))
    return tuple(out.values()), index


def _fitted(session: Dataset) -> set[str]:
    """Names of the targets with rows to fit."""
    m = session.measurements
    return {session.targets[k].name for k in np.unique(m.target[m.role == "calibrate"])}


def _certificates(sessions: Sequence[Dataset]) -> tuple[Certificate, ...]:
    """All certificates, those of one artefact that several sessions fit with their uncertainty widened.

    The error of a certificate is common to all sessions and does not average out. K constraints with
    uncertainty u sqrt(K) have together the weight of a single constraint with u.
    """
    fitted = [(s, _fitted(s)) for s in sessions]
    copies = Counter(c for s, names in fitted for c in s.certificates if _used(c, names))
    out = []
    for s, touched in fitted:
        for c in s.certificates:
            wide = float(np.sqrt(copies[c])) if _used(c, touched) else 1.0
            names = tuple(called(s, name) for name in c.targets)
            u_distance, u_angle = (None if u is None else u * wide for u in (c.u_distance, c.u_angle))
            points = c.points
            if points is not None:
                covariance = wide**2 * np.array(points.covariance)
                points = replace(points, covariance=tuple(map(tuple, covariance.tolist())))
            out.append(replace(c, targets=names, u_distance=u_distance, u_angle=u_angle, points=points))
    return tuple(out)


def _used(certificate: Certificate, fitted: set[str]) -> bool:
    """Whether a fit of these targets uses a certificate."""
    least = len(certificate.targets) if certificate.points is None else 2
    return not certificate.derived and len(fitted & {*certificate.targets}) >= least


def _stated(sessions: Sequence[Dataset]) -> tuple[Noise, list[np.ndarray]]:
    """The noise that all state, and each session's `u` (N,), m, nan where that holds.

    Where the sessions state different noise, each one's rows carry what theirs states.
    """
    rows = [column(s.measurements, "u") for s in sessions]
    for key in ("contact", "point"):
        values = [getattr(s.noise, key) for s in sessions]
        if len({v for v in values if v is not None}) < 2:
            continue
        for s, u, value in zip(sessions, rows, values, strict=True):
            of_kind = np.array([kind.noise == key for kind in kinds_of(s)])[s.measurements.target]
            u[of_kind & np.isnan(u)] = np.nan if value is None else value
    stated: dict[str, Any] = {}
    for s in sessions:  # the first that states a value
        stated = {key: value for key, value in vars(s.noise).items() if value is not None} | stated
    return Noise(**stated), rows
