"""What a file of constant geometry can hold of a fitted arm: frames of the joints at zero readings.

Constant displacements of an arm's frames: what a file of constant geometry can hold of a model.

Numbers as text, with all their digits.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from bayescal.arm.chain import Chain, Robot, chain_of, displaced, frames
from bayescal.arm.motion import Term
from bayescal.arm.transforms import AXES
from bayescal.effects import Parameter
from bayescal.effects.tool import TOOL
from bayescal.exporting.written import Item, item
from bayescal.fitted.arm import FittedArm
from bayescal.model import Model

STATE = ("time", "temperature", "event")
"""Drivers whose value at one row of the session is a constant of the file."""


def changes(p: Parameter) -> bool:
    """Whether a constant parameter has another value in other rows: in time, or in other sessions."""
    return any(np.ndim(t.driver) for t in p.terms)


def constant(p: Parameter) -> bool:
    """Whether a parameter displaces frames of the arm by constants, at least in one state of the session."""
    if p.effect == TOOL.name or any(t.frame < 0 for t in p.terms):
        return False
    # of several sessions, each has a base of its own: its driver is 1 in the rows of its session
    own = p.driver.kind == "constant" and all(np.all(np.isin(t.driver, (0.0, 1.0))) for t in p.terms)
    return own or p.driver.kind in STATE or not changes(p)


def at_state(p: Parameter, state: int) -> Parameter:
    """A constant parameter with its drivers as they are in one row of the session."""

    def fixed(t: Term) -> Term:
        return t if np.ndim(t.driver) == 0 else replace(t, driver=float(np.asarray(t.driver)[state]))

    return replace(p, terms=tuple(map(fixed, p.terms)))


def constant_displacements(model: Model, values: np.ndarray, state: int | None = None) -> np.ndarray:
    """Constant displacements of the frames, (n + 2, 6), rad and m; the last, of the tool, are zero.

    Parameters
    ----------
    model : Model
    values : np.ndarray, shape (P,)
        Deviations of its parameters, SI.
    state : int, optional
        Row of the session whose state holds; without it, what changes during the session is left out.
    """
    n = model.scene.chain.n
    out = np.zeros((n + 2, 6))
    for value, p in zip(values, model.parameters, strict=True):
        if not constant(p) or (state is None and changes(p)):
            continue
        for t in p.terms if state is None else at_state(p, state).terms:
            if t.frame <= n:
                out[t.frame, AXES.index(t.axis)] += value * float(t.driver)
    return out


def zero_frames(robot: Robot, delta: np.ndarray | None = None) -> np.ndarray:
    """Frames 1 to n and the flange (n + 1, 4, 4) in F0, at zero readings, with displacements (n + 2, 6).

    Frame k turns about its z axis with joint k; it is behind the joint's offset and d, and carries the link.
    """
    moved = None if delta is None else delta[None]
    return frames(chain_of(robot), robot.offset[None], moved)[0, 1:]


def geometry_of(arm: FittedArm, state: int) -> np.ndarray:
    """Frames 1 to n and the flange of an arm (n + 1, 4, 4) in F0, at zero readings, in a state."""
    delta = constant_displacements(arm.model, arm.values, state)
    return zero_frames(arm.dataset.robot, delta)


def steps(frames_: np.ndarray) -> np.ndarray:
    """Transforms (n + 1, 4, 4) from F0 to frame 1, from each frame to the next, and to the flange."""
    before = np.concatenate([np.eye(4)[None], frames_[:-1]])
    return np.linalg.inv(before) @ frames_


def carries(t: Term) -> int:
    """Number (from 0) of the step that a displacement acts in: a frame's tilts are behind its joint."""
    behind = t.axis not in ("rz", "tz") or t.frame == 0
    return t.frame if behind else t.frame - 1


def items(arm: FittedArm, places: list[tuple[str, str]]) -> list[Item]:
    """All constant parameters that act in a step with a place (element, attribute) in the file."""
    out = []
    for k, p in enumerate(arm.model.parameters):
        if constant(p):
            for step in dict.fromkeys(carries(t) for t in p.terms):
                if step < len(places):
                    out.append(item(arm, k, *places[step]))
    return out


def joint_angles(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Angles of the joints from zero readings, (C, n), rad, by the nominal coupling."""
    return readings @ robot.link_from_reading.T


def at_zero_poses(frames_: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Flange (C, 4, 4) in F0 of joints that turn frames (n + 1, 4, 4) about their z axes by (C, n), rad."""
    out = np.tile(np.eye(4), (len(turns), 1, 1))
    for step, turn in zip(steps(frames_), np.append(turns, np.zeros((len(turns), 1)), axis=1).T, strict=True):
        spin = np.tile(np.eye(4), (len(turns), 1, 1))
        spin[:, 0, 0] = spin[:, 1, 1] = np.cos(turn)
        spin[:, 1, 0] = np.sin(turn)
        spin[:, 0, 1] = -np.sin(turn)
        out = out @ step @ spin
    return out


def centre_in_frame(robot: Robot, chain: Chain, delta: np.ndarray, k: int) -> np.ndarray:
    """Centre of mass of link `k` (from 0) in the frame of its joint, (3,), m; see `zero_frames`.

    In standard DH it is stated behind the whole row, with the displacements (n + 2, 6) of the joint's frame.
    """
    assert robot.centres_of_mass is not None
    centre = robot.centres_of_mass[k]
    if robot.convention == "mdh":
        return centre
    behind = chain.link[k + 1]
    centre = behind[:3, :3] @ centre + behind[:3, 3]
    return displaced(centre, np.where(np.arange(6) < 2, 0.0, delta[k + 1]))


def coupled(joint_from_reading: np.ndarray) -> list[str]:
    """A note where the joint values (n,) of a file are not the readings, but a matrix (n, n) times these."""
    if np.array_equal(joint_from_reading, np.eye(len(joint_from_reading))):
        return []
    return [
        "joint values of the file are joint_from_reading times the controller's readings (see the sidecar)"
    ]


def number(value: float) -> str:
    """A number with all its digits; no minus zero."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float] | np.ndarray) -> str:
    """Numbers with all their digits, separated by blanks."""
    return " ".join(map(number, np.asarray(values, float).tolist()))
