"""The motions of a plan, and what a format makes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.errors import BayescalError
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


BEYOND = 5e-3
"""m beyond the expected surface where a guarded motion ends (assumed)."""
MOST_BEYOND = 50e-3
"""m: more is no search for a surface."""


@dataclass(frozen=True)
class Probe:
    """How a controller notices a contact, and how far it searches.

    Attributes
    ----------
    input : str
        Digital input as the controller names it; "" for the first of the format.
    force : float or None
        N: change of the force at the tool from which on it is a contact, in place of the input.
    beyond : float
        m beyond the expected surface where the guarded motion ends.
    """

    input: str = ""
    force: float | None = None
    beyond: float = BEYOND

    def __post_init__(self) -> None:
        """Refuse what is no threshold and no length."""
        if self.force is not None and not (np.isfinite(self.force) and self.force > 0):
            raise BayescalError(f"a force of {self.force:g} N", "--probe-force-n", "give a positive number")
        if self.force is not None and self.input:
            what = "either the input or the force states a contact"
            raise BayescalError(what, "--probe-force-n", "remove it or --probe-input")
        if not 0 < self.beyond <= MOST_BEYOND:
            what = f"a search {1e3 * self.beyond:g} mm beyond the surface"
            raise BayescalError(what, "--probe-beyond-mm", f"give more than 0, to {1e3 * MOST_BEYOND:g}")


@dataclass(frozen=True)
class Format:
    """A format of planned motions.

    Attributes
    ----------
    name, summary : str
        In options, and what is in it.
    files : callable
        Texts of a plan by the names of their files in the run folder; only programs depend on the probe.
    check : callable
        Refuses a probe that the format cannot use, before a plan is made.
    """

    name: str
    files: Callable[[Plan, Probe], Mapping[str, str]]
    summary: str
    check: Callable[[Probe], None] = lambda probe: None


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
    """Whether no collision-free path to a contact was found from the contact before (`Plan.by_hand`)."""
    return bool(plan.by_hand) and bool(plan.by_hand[row])


def payload_of(plan: Plan, row: int) -> float:
    """Payload of a planned contact beyond the tool, kg."""
    payload = plan.session.measurements.payload
    return 0.0 if payload is None else float(payload[row])
