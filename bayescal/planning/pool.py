"""What a plan is made from: the setup of a session, and its candidate contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.dataset import Dataset


@dataclass(frozen=True)
class Box:
    """A box with edges along the axes of F0: its centre (3,) and its edge lengths (3,), m."""

    centre: np.ndarray
    size: np.ndarray


@dataclass(frozen=True)
class Region:
    """The part of a target where contacts may be.

    Of a face: a rectangle with `centre` (3,), m, in F0, and half edges `half` (2, 3), m. Of a sphere: a cap
    about `up` (3,), a unit vector, to `widest`, rad, from it; `centre` is that of the sphere.
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
        Of every target that can be touched, by its name.
    volume : Box or None
        Volume of interest, in which distances shall be accurate.
    payloads : tuple of float
        Masses, kg, that can be attached in addition to the tool.
    table : float or None
        Height, m, of the table in F0; None if there is none.
    """

    dataset: Dataset
    regions: Mapping[str, Region]
    volume: Box | None = None
    payloads: tuple[float, ...] = ()
    table: float | None = None


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
        of the row itself where nothing is touched.
    dropped : mapping of str to int
        Reasons why contacts were not candidates, with their number.
    """

    setup: Setup
    session: Dataset
    measured: int
    approach: np.ndarray
    dropped: Mapping[str, int]

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
