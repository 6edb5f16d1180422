"""Candidate contacts as rows of a session, behind those that were measured already."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import count
from typing import Any

import numpy as np

from bayescal.arm.chain import link_angles
from bayescal.arm.transforms import rpy_matrix, rpy_of
from bayescal.dataset import Dataset, Measurements
from bayescal.dataset.target_kinds import KINDS
from bayescal.model.orientations import tool_frames
from bayescal.model.scene import Scene

SESSION = 3600.0
"""s: the time over which candidates are distributed (assumed: 200 contacts at 18 s)."""
SETTLING = 6
"""Corrections of readings for compliances in the robot file; each reduces the error more than tenfold."""
BLANK: Mapping[str, float | str] = {
    "xyz": np.nan, "rpy": np.nan, "length": np.nan, "u": np.nan, "payload": 0.0, "stop": "", "repeat": ""
}  # fmt: skip
"""Of the columns that rows may leave empty: their empty cell."""


@dataclass(frozen=True)
class Possible:
    """M contacts: role, target, tool (M,); readings and velocities (M, n), rad, rad/s; payload (M,), kg."""

    role: np.ndarray
    target: np.ndarray
    tool: np.ndarray
    readings: np.ndarray
    velocity: np.ndarray
    payload: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> Possible:
        return Possible(*(getattr(self, f.name)[rows] for f in fields(Possible)))


def session_of(dataset: Dataset, possible: Possible, rng: np.random.Generator) -> Dataset:
    """The session with the contacts behind its rows.

    Measured columns are continued: the time over an hour, the temperature at random from those measured.
    Columns that every measured row needs (velocities, times) are not added to a session that lacks them.
    Torques are those computed, because none are measured yet.
    """
    m, before, new = dataset.measurements, len(dataset.measurements.ids), len(possible.target)
    prefix = next(f"p{k}." for k in count(1) if not any(i.startswith(f"p{k}.") for i in m.ids))
    start = 0.0 if m.time is None or not before else float(np.max(m.time))
    own: dict[str, np.ndarray] = {
        "role": possible.role,
        "target": possible.target,
        "tool": possible.tool,
        "readings": possible.readings,
        "line": np.zeros(new, int),
        "command": possible.readings,
        "time": rng.uniform(start, start + SESSION, new),
    }
    if m.velocity is not None or possible.velocity.any():
        own["velocity"] = possible.velocity
    if possible.payload.any():
        own["payload"] = possible.payload
    if m.temperature is not None:
        own["temperature"] = rng.choice(m.temperature, new)
    columns: dict[str, Any] = {
        f.name: _continued(m, f.name, own.get(f.name), new) for f in fields(Measurements)
    }
    columns |= {"ids": (*m.ids, *(f"{prefix}{k:05d}" for k in range(new))), "torque": None}
    if not before:
        columns["command"] = None
    session = replace(dataset, measurements=Measurements(**columns), torques="computed")
    return _read(_settled(session, before), before)


def _continued(m: Measurements, name: str, own: np.ndarray | None, new: int) -> np.ndarray | None:
    """A measured column with the cells of the new rows behind it; None if it cannot be continued."""
    if name == "ids":
        return None
    old = getattr(m, name)
    if not m.ids:
        return own
    if old is None:
        if own is None or name not in BLANK:
            return None
        old = np.full((len(m.ids), *own.shape[1:]), BLANK[name])
    if own is None:
        own = np.full((new, *old.shape[1:]), BLANK[name])
    return np.concatenate([old, own])


def _settled(session: Dataset, before: int) -> Dataset:
    """Readings of the new rows that bring the nominal arm there with the compliances of its file."""
    robot = session.robot
    if robot.compliance is None or not np.any(robot.compliance):
        return session
    m = session.measurements
    wanted = link_angles(robot, m.readings)
    back = np.linalg.inv(robot.link_from_reading).T
    readings = m.readings
    for _ in range(SETTLING):
        scene = Scene(replace(session, measurements=replace(m, readings=readings)))
        off = (wanted - scene.q) @ back
        off[:before] = 0.0
        readings = readings + off
    return replace(session, measurements=replace(m, readings=readings))


def _read(session: Dataset, before: int) -> Dataset:
    """The session with what instruments and wires read of the nominal arm in the new rows."""
    m, scene = session.measurements, Scene(session)
    columns: dict[str, Any] = {}

    def column(name: str, width: tuple[int, ...]) -> np.ndarray:
        old = getattr(m, name)
        empty = np.full((len(m.ids), *width), np.nan)
        return np.asarray(columns.setdefault(name, empty if old is None else old.copy()))

    for t, target in enumerate(session.targets):
        rows = np.flatnonzero(m.target == t)
        rows = rows[rows >= before]
        if not len(rows):
            continue
        if KINDS[target.kind].reads == "length":
            if np.isnan(float(target.values["length"])):
                away = scene.points[rows] - np.asarray(target.values["centre"])
                column("length", ())[rows] = np.linalg.norm(away, axis=1)
        elif KINDS[target.kind].reads == "xyz":
            frame = rpy_matrix(np.asarray(target.values["rpy"], float))
            column("xyz", (3,))[rows] = (scene.points[rows] - np.asarray(target.values["xyz"])) @ frame
            if m.rpy is not None or session.noise.orientation is not None:
                tools = tool_frames(session, scene.flange)[m.tool[rows]]
                turned = frame.T @ scene.flange[rows] @ tools
                column("rpy", (3,))[rows] = [rpy_of(one) for one in turned]
    return replace(session, measurements=replace(m, **columns)) if columns else session
