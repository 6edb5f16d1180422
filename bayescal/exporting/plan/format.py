"""The motions of a plan, and what a format makes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.planning.result import Plan

APPROACH, CONTACT, RETRACT, MEASURE = "approach", "contact", "retract", "measure"
"""Motions: the first three of a contact, the last where nothing is touched."""


@dataclass(frozen=True)
class Motion:
    """A motion of the arm.

    Attributes
    ----------
    row : int
        Of the planned session.
    kind : str
    readings : np.ndarray, shape (n,)
        At its end, rad.
    """

    row: int
    kind: str
    readings: np.ndarray


@dataclass(frozen=True)
class Format:
    """A format of planned motions: its name, the file in the run folder, its text, and what is in it."""

    name: str
    file: str
    text: Callable[[Plan], str]
    summary: str


def motions(plan: Plan) -> Iterator[Motion]:
    """All motions of a plan, in the order of probing."""
    readings = plan.session.measurements.readings
    for row, (away, at) in enumerate(zip(plan.approach, readings, strict=True)):
        if np.array_equal(away, at):
            yield Motion(row, MEASURE, at)
        else:
            yield Motion(row, APPROACH, away)
            yield Motion(row, CONTACT, at)
            yield Motion(row, RETRACT, away)


def payload_of(plan: Plan, row: int) -> float:
    """Payload of a planned contact beyond the tool, kg."""
    payload = plan.session.measurements.payload
    return 0.0 if payload is None else float(payload[row])
