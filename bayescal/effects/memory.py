"""States that depend on earlier rows: what follows a quantity late, from contact to contact."""

from __future__ import annotations

import numpy as np

from bayescal.effects.vocabulary import Circumstances


def successions(c: Circumstances) -> list[np.ndarray]:
    """Rows of each session in the order of measurement: of time if recorded, else of the file."""
    own = [np.flatnonzero(s.rows) for s in c.sessions] or [np.arange(len(c.q))]
    return own if c.time is None else [rows[np.argsort(c.time[rows], kind="stable")] for rows in own]


def lagging(c: Circumstances, goal: np.ndarray, path: np.ndarray, length: float) -> np.ndarray:
    """A state (N,) that follows a goal (N,) along a path (N,), and starts at it.

    After a step of the path by d, the distance from the new goal is exp(-abs(d) / length) times that of the
    state before it.
    """
    out = np.empty(len(goal))
    for rows in successions(c):
        keep = np.exp(-np.abs(np.diff(path[rows], prepend=path[rows[:1]])) / length)
        state = 0.0
        for k, row in enumerate(rows):
            state = goal[row] + (state - goal[row]) * keep[k] if k else goal[row]
            out[row] = state
    return out
