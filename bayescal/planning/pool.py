"""What a plan is made from: the setup of a session, and its candidate contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayescal.dataset import Box, Dataset

__all__ = ["Box", "Pool", "Region", "Setup"]

CONE = np.radians(60.0)
"""rad: working cone of a probe that states none, of its axis about the inward normal (assumed)."""
CLEAR = 5e-3
"""m: smallest clearance of motions where none is stated (assumed: some times what an arm that is not
calibrated is off)."""


@dataclass(frozen=True)
class Region:
    """The part of a target where contacts may be.

    Of a face: a rectangle with `centre` (3,), m, in F0, and half edges `half` (2, 3), m. Of a cylinder: half
    of its axis, `half` (1, 3). Of a sphere, or of a ball bar about its pivot: a cap about `up` (3,), a unit
    vector, to `widest`, rad, from it; `centre` is that of the sphere. Of a seat: its `centre`, which is left
    along `up`.
    """

    centre: np.ndarray
    half: np.ndarray | None = None
    up: np.ndarray | None = None
    widest: float = 0.0


@dataclass(frozen=True)
class Setup:
    """A session before it is measured, or continued.

    Attributes
    ----------
    dataset : Dataset
        Robot, tools, targets, certificates and noise; its rows are those that were measured already.
    regions : mapping of str to Region
        Of every target with a place of its own, by its name: all but instruments.
    volume : Box or None
        Volume of interest, in which distances must be accurate.
    payloads : tuple of float
        Masses, kg, that can be attached in addition to the tool.
    table : float or None
        Height, m, of the table in F0, against gravity; None if none is stated.
    cone : float
        Greatest angle, rad, between the axis of the tool and the inward normal.
    validated : frozenset of str
        Targets that are not calibrated on: spheres of certified distances, which validate.
    clearance : float
        Smallest clearance, m, of motions between contacts.
    poses : np.ndarray, shape (M, n)
        Readings, rad, of poses between which distances must be accurate; M = 0 if none are stated.
    notes : tuple of str
        What the user should know about the setup.
    """

    dataset: Dataset
    regions: Mapping[str, Region]
    volume: Box | None = None
    payloads: tuple[float, ...] = ()
    table: float | None = None
    cone: float = CONE
    validated: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    clearance: float = CLEAR
    poses: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))


@dataclass(frozen=True)
class Pool:
    """Candidate contacts, as rows of a session.

    Attributes
    ----------
    setup : Setup
    session : Dataset
        Its first `measured` rows were measured already. Those that follow are possible: with the role
        calibrate a candidate, with the role validate a contact that locates a sphere of a certified distance
        and belongs to every plan. Readings are those at which the nominal arm touches the nominal target.
        Times are random within the session, so that a drift is not along any other coordinate.
    measured : int
    approach : np.ndarray, shape (N, n)
        Readings, rad, from which the tool moves straight to each contact, and to which it retracts; those
        of the row itself where nothing is touched, or that was measured already.
    dropped : mapping of str to int
        Reasons why contacts were not candidates, with their number.
    warnings : tuple of str
        Targets with few candidates or none, and why.
    """

    setup: Setup
    session: Dataset
    measured: int
    approach: np.ndarray
    dropped: Mapping[str, int]
    warnings: tuple[str, ...] = ()

    @cached_property
    def candidates(self) -> np.ndarray:
        """Rows of the session that are candidates, (C,)."""
        role = self.session.measurements.role
        return np.flatnonzero((role == "calibrate") & (np.arange(len(role)) >= self.measured))

    @cached_property
    def validation(self) -> np.ndarray:
        """Rows of the session that belong to every plan, (V,)."""
        role = self.session.measurements.role
        return np.flatnonzero((role == "validate") & (np.arange(len(role)) >= self.measured))
