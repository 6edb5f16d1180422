"""A robot as its drawing says it is: nominal kinematics, masses and coupling of its axes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Convention = Literal["mdh", "dh"]
Coupling = Literal["display", "mechanical"]


@dataclass(frozen=True)
class Robot:
    """Nominal serial arm of n revolute joints, in SI units.

    Rows follow `convention`: in modified DH (``mdh``, Craig) ``alpha`` and ``a`` of row i stand
    before joint i, ``Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d)``; in standard DH (``dh``) after it,
    ``Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)``. ``theta = link_from_reading @ reading + offset``.
    Behind modified rows the flange may stand anywhere (`flange`); standard ones end at it.

    `coupling` says what couples the axes of `link_from_reading`. ``display``: the controller computes what
    it shows; every motor, gear and encoder sits at its own joint, between two links. ``mechanical``: linkages
    or gear trains do; motors and encoders turn by the readings, each moving all links of its column.
    """

    name: str
    convention: Convention
    joint_names: tuple[str, ...]
    alpha: np.ndarray  # (n,) rad
    a: np.ndarray  # (n,) m
    d: np.ndarray  # (n,) m
    offset: np.ndarray  # (n,) rad
    beta: np.ndarray  # (n,) rad, Hayati's angle of near-parallel axes; zero on a drawing
    limits: np.ndarray  # (n, 2) rad, of the link side (row of link_from_reading times its sign)
    link_from_reading: np.ndarray  # (n, n)
    base: np.ndarray = field(default_factory=lambda: np.eye(4))  # first row's frame in F0
    masses: np.ndarray | None = None  # (n,) kg, of the link that each joint moves
    centres_of_mass: np.ndarray | None = None  # (n, 3) m, each in its link frame
    compliance: np.ndarray | None = None  # (n,) rad/(N m), where already known
    reductions: np.ndarray | None = None  # (n,) motor turns a joint turn
    flange: np.ndarray = field(default_factory=lambda: np.eye(4))  # in the last row's frame; mdh only
    coupling: Coupling = "display"
    radii: np.ndarray | None = None  # (n,) m, of capsules around the links; nan where assumed
    velocities: np.ndarray | None = None  # (n,) rad/s, largest of the joints; nan where not stated
    torques: np.ndarray | None = None  # (n,) N m, largest of the joints; nan where not stated

    def __post_init__(self) -> None:
        assert self.convention == "mdh" or np.array_equal(self.flange, np.eye(4)), "standard rows end at it"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)
