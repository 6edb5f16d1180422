"""Generic cells of joints with a memory of earlier contacts, and of random errors of their readings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.effects import Circumstances
from bayescal.effects.joints import motion
from bayescal.effects.location import Driver, joint
from bayescal.gap.search.cell import Cell, at_joint, sides_of
from bayescal.gap.settings import CELLS


def measured(c: Circumstances) -> np.ndarray:
    """Rows (N,) in the order of measurement: of time if recorded, else of the file."""
    return np.arange(len(c.q)) if c.time is None else np.argsort(c.time, kind="stable")


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


def travel(c: Circumstances) -> Iterator[Cell]:
    """Errors of a joint by its travel since earlier contacts."""
    order = measured(c)
    at = [(j, side) for j in range(1, c.robot.n + 1) for side in sides_of(c, j)]
    angles = np.stack([motion(c.robot, j, c.readings, side)[order] for j, side in at])
    lengths, widths = np.radians(CELLS.forgotten), np.radians(CELLS.slack)
    states = np.empty((len(at), len(lengths) + len(widths), len(order)))
    states[..., order] = np.concatenate([fading(angles, lengths), slack(angles, widths)], axis=1)
    for j in range(1, c.robot.n + 1):
        sets = [
            at_joint(c, j, [s], side)
            for (joint_of, side), own in zip(at, states, strict=True)
            if joint_of == j
            for s in own
            if np.ptp(s[c.fitted]) > 0
        ]
        yield Cell(joint(j), Driver("travel", j), tuple(sets))


def scatter(c: Circumstances) -> Iterator[Cell]:
    """Readings of a joint with an error drawn anew at every reading, which repeated contacts do not show."""
    for j in range(1, c.robot.n + 1):
        clusters = np.unique(np.round(c.readings[:, j - 1], 8), return_inverse=True)[1]
        yield Cell(joint(j), Driver("reading", j), (at_joint(c, j, [np.ones(len(c.q))]),), clusters=clusters)


MAKERS = (travel, scatter)
"""Functions that list the cells of a session."""
