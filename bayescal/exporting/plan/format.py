"""The motions of a plan, and what a format makes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.planning.result import Plan

PASS, STOP, APPROACH, CONTACT, RETRACT, MEASURE = "pass", "stop", "approach", "contact", "retract", "measure"
"""Motions: past an obstacle; to a raised pose, where the arm waits until `Plan.changes` of the row is done;
three of a contact; the last where nothing is touched."""


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
    """All motions of a plan, in the order of probing.

    Of each row: those of `Plan.leave` (the last is a `STOP`), those of `Plan.via`, and those of its contact.
    The first row begins with a `STOP` even if nothing is to be changed: the session begins there, and the arm
    is brought there by hand.
    """
    readings = plan.session.measurements.readings
    for row, (away, at) in enumerate(zip(plan.approach, readings, strict=True)):
        leave = plan.leave[row] if plan.leave else None
        if leave is not None and len(leave):
            for point in leave[:-1]:
                yield Motion(row, PASS, point)
            yield Motion(row, STOP, leave[-1])
        way = plan.via[row] if plan.via else None
        for point in () if way is None else way:
            yield Motion(row, PASS, point)
        if np.array_equal(away, at):
            yield Motion(row, MEASURE, at)
        else:
            yield Motion(row, APPROACH, away)
            yield Motion(row, CONTACT, at)
            yield Motion(row, RETRACT, away)


def closed(plan: Plan, row: int) -> bool:
    """Whether no way free of collisions to a contact was found from the contact before (`Plan.by_hand`)."""
    return bool(plan.by_hand) and bool(plan.by_hand[row])


def payload_of(plan: Plan, row: int) -> float:
    """Payload of a planned contact beyond the tool, kg."""
    payload = plan.session.measurements.payload
    return 0.0 if payload is None else float(payload[row])
