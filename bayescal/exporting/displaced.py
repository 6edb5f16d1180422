"""Constant displacements of an arm's frames: what a file of constant geometry can hold of a model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.arm.motion import Term
from bayescal.arm.transforms import AXES
from bayescal.effects import Parameter
from bayescal.effects.tool import TOOL
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
