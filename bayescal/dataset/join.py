"""Several sessions of one arm as one `Dataset`, so that every later stage fits them together.

The joined sessions share the arm, and tools with equal entries. Targets, certificates, ids, stops and repeats
belong to a session and have its name as a prefix (``A:cube.+x``). Its rows keep the noise that it states. Its
times are shifted to follow those of the session before, so that rows are in the order of time; a drift still
has separate parameters for each session (`effects.sessions`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from hashlib import sha256

import numpy as np

from bayescal.dataset.checks.same_robot import check_alike
from bayescal.dataset.join_rows import called, column, measurements, temperature_of
from bayescal.dataset.target_kinds import kinds_of
from bayescal.dataset.types import Certificate, Dataset, Noise, Record, Target, Tool
from bayescal.errors import BayescalError


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
    targets = tuple(_target(t, s, own_noise) for s in sessions for t in s.targets)
    noise, rows = _stated(sessions)
    return replace(
        first,
        name=" + ".join(s.name for s in sessions),
        tools=tools,
        noise=noise,
        targets=targets,
        certificates=_certificates(sessions),
        measurements=measurements(sessions, rows, tool_of),
        temperature_of=temperature_of(sessions),
        source=None,
        plan=None,
        record=Record(),
        sha256=sha256(" ".join(s.sha256 for s in sessions).encode()).hexdigest(),
        sessions=tuple(sessions),
    )


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
    return all(
        np.array_equal(np.asarray(getattr(one, f.name)), np.asarray(getattr(other, f.name)))
        for f in fields(Tool)
    )


def _tools(sessions: Sequence[Dataset], remounted: bool) -> tuple[tuple[Tool, ...], list[np.ndarray]]:
    """All tools, and for each session the index among them of each of its own."""
    stated: dict[str, list[Tool]] = {}
    for tool in (t for s in sessions for t in s.tools):
        stated.setdefault(tool.name, []).append(tool)
    shared = {
        name
        for name, tools in stated.items()
        if len(tools) == 1 or (not remounted and all(_same(tools[0], t) for t in tools[1:]))
    }
    out: dict[str, Tool] = {}
    index = []
    for s in sessions:
        names = [t.name if t.name in shared else called(s, t.name) for t in s.tools]
        for tool, name in zip(s.tools, names, strict=True):
            out.setdefault(name, replace(tool, name=name))
        index.append(np.array([list(out).index(name) for name in names]))
    return tuple(out.values()), index


def _target(target: Target, session: Dataset, own_noise: bool) -> Target:
    return replace(
        target,
        name=called(session, target.name),
        session=session.name,
        noise=session.name if own_noise else "",
    )


def _fitted(session: Dataset) -> set[str]:
    """Names of the targets with rows to fit."""
    m = session.measurements
    return {session.targets[k].name for k in np.unique(m.target[m.role == "calibrate"])}


def _certificates(sessions: Sequence[Dataset]) -> tuple[Certificate, ...]:
    """All certificates, those of one artefact that several sessions fit with their uncertainty widened.

    The error of a certificate is common to all sessions and does not average out. K constraints with
    uncertainty u sqrt(K) have together the weight of a single constraint with u.
    """
    fitted = [_fitted(s) for s in sessions]
    copies = Counter(
        c for s, names in zip(sessions, fitted, strict=True) for c in s.certificates if _used(c, names)
    )
    out = []
    for s, touched in zip(sessions, fitted, strict=True):
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
    rows = [column(s, "u") for s in sessions]
    for key in ("contact", "point"):
        values = [getattr(s.noise, key) for s in sessions]
        if len({v for v in values if v is not None}) < 2:
            continue
        for s, u, value in zip(sessions, rows, values, strict=True):
            of_kind = np.array([kind.noise == key for kind in kinds_of(s)])[s.measurements.target]
            u[of_kind & np.isnan(u)] = np.nan if value is None else value
    common = Noise(
        _first(s.noise.contact for s in sessions),
        _first(s.noise.point for s in sessions),
        sessions[0].noise.joint,
        _first(s.noise.orientation for s in sessions),
    )
    return common, rows


def _first(values: Iterable[float | None]) -> float | None:
    """The first value that there is."""
    return next((value for value in values if value is not None), None)
