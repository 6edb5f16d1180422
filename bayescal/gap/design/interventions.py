"""Interventions: contacts of a session repeated under other conditions, as rows appended to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayescal.arm.chain import wrenches
from bayescal.dataset import Dataset, Measurements
from bayescal.dataset.append import appended
from bayescal.gap.settings import DESIGN
from bayescal.model.scene import Scene

AGAIN = "the same poses again"


@dataclass(frozen=True)
class Intervention:
    """Candidate contacts: rows of the session with the same poses (C,), their own rows (C,)."""

    what: str
    source: np.ndarray
    rows: np.ndarray


def widened(scene: Scene, rows: np.ndarray) -> tuple[Dataset, list[Intervention]]:
    """The session with candidate contacts appended, by intervention, at the poses of some rows.

    The first intervention, `AGAIN`, repeats the poses without a change. All except those from a cold start
    are at the end of the session. They stay within its times and temperatures, whose range defines drifts.
    Their role is not to calibrate, so that results from the fitted measurements do not change.
    """
    m = scene.dataset.measurements
    late = {k: getattr(m, k)[-1] for k in ("time", "temperature") if getattr(m, k) is not None}
    if m.time is not None:
        late["time"] = m.time.max()
    choices: list[tuple[str, np.ndarray, Mapping[str, Any]]] = [(AGAIN, rows, late)]
    if scene.dataset.robot.masses is not None and scene.measured_torques is None:  # these would not be known
        load = DESIGN.payload + (0.0 if m.payload is None else m.payload[rows])
        choices.append(
            (f"the same poses with {DESIGN.payload:g} kg additional payload", rows, late | {"payload": load})
        )
    if m.velocity is not None:
        ways = turns(scene, rows)
        if ways:
            what = "the same poses, approached with joint motion in both directions about the stylus tip"
            velocity = np.concatenate([m.velocity[rows] + way for way in ways])
            choices.append((what, np.tile(rows, len(ways)), late | {"velocity": velocity}))
        what = f"the same poses at {DESIGN.faster:g} times the speed of contact"
        choices.append((what, rows, late | {"velocity": DESIGN.faster * m.velocity[rows]}))
    if m.time is not None and np.ptp(m.time) > 0:
        time = np.random.default_rng(0).uniform(m.time.min(), m.time.max(), len(rows))
        mixed = {"time": time}
        if m.temperature is not None:
            mixed["temperature"] = np.interp(time, m.time, m.temperature)
        choices.append(("the same poses in random order of the faces, from a cold start", rows, mixed))
    count, rows_of, interventions = len(m.role), [], []
    for what, source, _ in choices:
        rows_of.append(count + np.arange(len(source)))
        interventions.append(Intervention(what, source, rows_of[-1]))
        count += len(source)
    every = np.concatenate([source for _, source, _ in choices])
    columns = {name for _, _, changed in choices for name in changed} | {"payload"}
    changed = {name: np.concatenate([_values(m, name, *c[1:]) for c in choices]) for name in columns}
    ids = [f"possible {k}" for k in np.concatenate(rows_of)]
    return replace(scene.dataset, measurements=appended(m, every, changed, ids)), interventions


def _values(m: Measurements, name: str, source: np.ndarray, changed: Mapping[str, Any]) -> np.ndarray:
    """A column of some rows of a session, with new values where they are given."""
    column = getattr(m, name)
    own = np.zeros(len(source)) if column is None else column[source]
    return np.broadcast_to(changed[name], own.shape) if name in changed else own


def turns(scene: Scene, rows: np.ndarray) -> list[np.ndarray]:
    """Velocities of the readings (C, n), rad/s, that rotate the arm about a resting ball, where possible.

    Two motions, each in both directions: that which reverses most of the recorded velocities, and another.
    A mere reversal of the velocities is not possible: the ball would leave the surface.
    """
    m, robot = scene.dataset.measurements, scene.dataset.robot
    assert m.velocity is not None
    q, tools = scene.q[rows], scene.tools[rows]
    still = np.zeros((len(rows), robot.n + 2, 6))
    along = [np.broadcast_to(u, (len(rows), 3)) for u in np.eye(3)]
    by = [wrenches(scene.chain, q, tools, still, u)[:, 1:-1, 0] @ robot.link_from_reading for u in along]
    jacobian = np.stack(by, axis=1)  # (C, 3, n)
    free = np.eye(robot.n) - np.linalg.pinv(jacobian) @ jacobian
    own = m.velocity[rows]
    size = DESIGN.turning * np.linalg.norm(own, axis=1, keepdims=True)
    out: list[np.ndarray] = []
    for wish in (-np.sign(own), np.random.default_rng(1).standard_normal(own.shape)):
        way = (free @ wish[..., None])[..., 0]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        if np.median(length) < DESIGN.still:
            return []
        way = size * way / np.maximum(length, DESIGN.still)
        out += [way, -way]
    return out
