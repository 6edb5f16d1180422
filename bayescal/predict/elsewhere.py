"""The arm in other conditions than those of its session: other poses, another tool, another payload."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayescal.arm.motion import Motion, Term
from bayescal.arm.nominal import NominalArm
from bayescal.arm.robot import Robot
from bayescal.dataset import Measurements
from bayescal.effects import Circumstances, Parameter, parameters_of
from bayescal.errors import BayescalError
from bayescal.model import Model

SPEED = np.radians(10.0)
"""rad/s: velocity of every joint, in either direction (assumed)."""


def joint_range(robot: Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    """Readings (count, n), rad, evenly over the ranges of all joints, a turn about its zero at most."""
    low, high = np.clip(robot.limits, -np.pi, np.pi).T
    return NominalArm(robot, np.zeros(3)).readings_of(rng.uniform(low, high, (count, robot.n)))


def elsewhere(
    model: Model,
    rows: np.ndarray,
    readings: np.ndarray,
    payload: np.ndarray | None = None,
    offset: np.ndarray | None = None,
) -> Motion:
    """Motion of a fitted arm in other conditions.

    Parameters
    ----------
    model : Model
    rows : np.ndarray of int, shape (N,)
        Rows of the session: each states the tool, the payload and the temperature.
    readings : np.ndarray, shape (N, n)
        Joint readings, rad.
    payload : np.ndarray, shape (N,), optional
        Masses, kg, in place of those of the rows.
    offset : np.ndarray, shape (3,), optional
        Added to the TCP in the flange frame, m.

    Returns
    -------
    Motion
        By the parameters of the model. Those that act on its session alone (a shift at a time, the form of a
        face) move nothing.
    """
    scene = model.scene
    d, m = scene.dataset, scene.dataset.measurements
    count = len(rows)
    direction = np.where(np.arange(count * d.robot.n).reshape(count, -1) % 2, 1.0, -1.0)

    def of(column: np.ndarray | None) -> np.ndarray | None:
        return None if column is None else column[rows]

    table = Measurements(
        ids=tuple(map(str, range(count))),
        role=np.full(count, "calibrate"),
        target=m.target[rows],
        tool=m.tool[rows],
        readings=readings,
        line=np.arange(count),
        velocity=SPEED * direction,
        time=of(m.time),
        temperature=of(m.temperature),
        xyz=of(m.xyz),
        rpy=of(m.rpy),
        length=of(m.length),
        payload=of(m.payload) if payload is None else payload,
    )
    there = type(scene)(replace(d, measurements=table), compliances=scene.compliances)
    circumstances = there.circumstances(np.arange(count))
    known = {p.name: p for effect in model.effects for p in _possible(effect, circumstances)}
    known |= {p.name: p for p in parameters_of((), circumstances)}
    tools = there.tools if offset is None else there.tools + offset
    terms: list[tuple[int, Term]] = []
    for k, parameter in enumerate(model.parameters):
        if parameter.name in known:
            terms += [(k, t) for t in known[parameter.name].terms if t.frame >= 0]
    return Motion(there.chain, there.q, tools, terms, len(model.parameters))


def _possible(effect: str, circumstances: Circumstances) -> tuple[Parameter, ...]:
    """Parameters of an effect; none where the conditions lack what it needs."""
    try:
        return parameters_of((effect,), circumstances, lenient=True)
    except BayescalError:
        return ()


def point_slopes(model: Model, motion: Motion, values: np.ndarray) -> np.ndarray:
    """Slopes (N, 3, P), m, of the TCP positions of a motion by z of the arm, at deviations (P,), SI."""
    at = motion.points(values)
    columns: Callable[[int], np.ndarray] = lambda k: motion.columns(  # noqa: E731
        values, at, np.repeat(np.eye(3)[k][:, None], at.shape[1], axis=1)
    )
    return np.stack([columns(k).T for k in range(3)], axis=1) * model.sd
