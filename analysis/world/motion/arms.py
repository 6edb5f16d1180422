"""The arms, nominal and true: the true parameters are drawn within their uncertainties."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.world.motion.dynamics import Chain, about_origin

U = {"mass": 0.15, "centre_of_mass_m": 0.012, "inertia": 0.15, "armature": 0.15, "friction_transition": 0.3}
"""Standard uncertainties of the nominal parameters; relative, but of the centre."""


@dataclass(frozen=True)
class Arm:
    """Geometry, inertial parameters, drives and friction of an arm; SI, joint side."""

    name: str
    chain: Chain
    mass: np.ndarray  # (n,)
    centre: np.ndarray  # (n, 3)
    inertia: np.ndarray  # about the centre (n, 3, 3)
    gear: np.ndarray
    armature: np.ndarray
    rated: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    transition: float  # rad/s, of Coulomb friction
    home: np.ndarray  # rad, about which the excitation moves
    span: np.ndarray  # rad, of a motion to either side
    load_centre: np.ndarray  # of the payload, in the last link (3,)
    load_gyration: float  # m
    load: float  # kg, the usual payload
    centre_u: float = U["centre_of_mass_m"]

    @property
    def size(self) -> int:
        """Number of joints."""
        return len(self.mass)

    @property
    def parameters(self) -> np.ndarray:
        """Inertial parameters of all links, one after the other (10 n,)."""
        return about_origin(self.mass, self.centre, self.inertia).ravel()

    def friction(self, speed: np.ndarray) -> np.ndarray:
        """Coulomb and viscous friction (rows, n) at speeds (rows, n), rad/s."""
        return self.coulomb * np.tanh(speed / self.transition) + self.viscous * speed

    def payload(
        self, kilos: float, shift: np.ndarray | float = 0.0, gyration: float | None = None
    ) -> np.ndarray:
        """Inertial parameters (10,) that a payload adds to the last link."""
        square = (self.load_gyration if gyration is None else gyration) ** 2
        centre = np.atleast_2d(self.load_centre + shift)
        return about_origin(np.array([kilos]), centre, kilos * square * np.eye(3)[None])[0]


# origin mm, rpy deg, mass kg, centre mm, gyration mm; gear, armature, rated, Coulomb, viscous, home, span deg
_UR = (
    ((0, 0, 152), (0, 0, 0), 5.6, (0, -22, -12), (66, 66, 58), 101, 1.5, 150, 7.0, 9.0, 0, 60),
    ((0, 118, 0), (90, 0, 0), 9.8, (205, 0, 118), (62, 172, 172), 101, 1.5, 150, 9.0, 11.0, -72, 28),
    ((425, 0, 0), (0, 0, 0), 4.1, (168, 0, 18), (50, 138, 138), 101, 0.85, 100, 5.5, 6.0, 82, 35),
    ((392, 0, 0), (0, 0, 0), 1.7, (0, 9, 52), (40, 40, 34), 81, 0.26, 28, 1.7, 1.6, -62, 60),
    ((0, 104, 0), (-90, 0, 0), 1.6, (0, -6, 42), (40, 40, 30), 81, 0.26, 28, 1.6, 1.5, -60, 65),
    ((0, 92, 0), (90, 0, 0), 1.0, (8, 0, 36), (35, 35, 30), 81, 0.21, 28, 1.2, 1.0, 0, 90),
)
_LRMATE = (
    ((0, 0, 330), (0, 0, 0), 8.2, (22, 0, -60), (85, 80, 62), 120, 1.1, 110, 6.0, 7.0, 0, 70),
    ((50, 0, 0), (90, 90, 0), 6.1, (190, 0, 30), (48, 130, 130), 140, 1.6, 120, 6.5, 7.5, 25, 32),
    ((440, 0, 0), (0, 0, 90), 4.8, (30, 42, -8), (62, 55, 60), 110, 0.6, 60, 3.6, 3.2, 8, 30),
    ((35, 420, 0), (-90, 0, 0), 2.6, (0, 0, -150), (70, 70, 36), 80, 0.16, 22, 1.1, 0.9, 0, 75),
    ((0, 0, 0), (90, 0, 0), 1.1, (0, 25, 4), (34, 30, 34), 80, 0.12, 18, 0.9, 0.7, 50, 45),
    ((0, 80, 0), (-90, 0, 0), 0.35, (2, 0, -6), (20, 20, 22), 50, 0.05, 11, 0.5, 0.35, 0, 110),
)
_SMALL = (
    ((0, 0, 110), (0, 0, 0), 1.25, (0, -8, -14), (34, 34, 30), 100, 0.16, 34, 1.6, 1.4, 0, 70),
    ((0, 62, 0), (90, 0, 0), 1.9, (98, 0, 58), (34, 84, 84), 100, 0.16, 34, 1.7, 1.6, -60, 34),
    ((210, 0, 0), (0, 0, 0), 1.2, (84, 0, 10), (28, 72, 72), 100, 0.10, 22, 1.1, 1.0, 75, 40),
    ((190, 0, 0), (0, 0, 0), 0.55, (0, 6, 26), (24, 24, 20), 50, 0.030, 8, 0.40, 0.32, -55, 65),
    ((0, 60, 0), (-90, 0, 0), 0.5, (0, -4, 22), (22, 22, 18), 50, 0.028, 8, 0.38, 0.30, -55, 70),
    ((0, 52, 0), (90, 0, 0), 0.32, (4, 0, 18), (18, 18, 16), 50, 0.022, 8, 0.30, 0.22, 0, 100),
)
_SEVEN = (
    ((0, 0, 335), (0, 0, 0), 4.9, (2, -30, -62), (82, 70, 66), 100, 0.62, 87, 3.2, 3.0, 0, 55),
    ((0, 0, 0), (-90, 0, 0), 4.2, (2, -72, 28), (78, 60, 66), 100, 0.62, 87, 3.2, 3.2, 28, 26),
    ((0, -316, 0), (90, 0, 0), 3.4, (28, 36, -64), (60, 60, 42), 100, 0.48, 87, 2.6, 2.2, 0, 45),
    ((82, 0, 0), (90, 0, 0), 3.5, (-52, 100, 26), (64, 46, 62), 100, 0.46, 87, 2.4, 2.2, -95, 30),
    ((-82, 384, 0), (-90, 0, 0), 2.4, (-10, 38, -108), (76, 72, 34), 60, 0.16, 12, 0.75, 0.6, 0, 60),
    ((0, 0, 0), (90, 0, 0), 1.6, (52, -12, -10), (34, 44, 46), 60, 0.14, 12, 0.7, 0.55, 105, 40),
    ((88, 0, 0), (90, 0, 0), 0.7, (8, -4, 68), (30, 30, 26), 60, 0.10, 12, 0.5, 0.35, 40, 80),
)
SORTS = {
    "ur-like": (_UR, 1.5, 0.9),
    "lrmate-like": (_LRMATE, 2.5, 0.8),
    "small-cobot": (_SMALL, 0.6, 0.6),
    "seven-axis": (_SEVEN, 1.2, 0.8),
}
"""Joints, usual payload (kg), and the offset of the centre of a payload as a share of 70 mm."""


def _round(values: np.ndarray, digits: int = 4) -> np.ndarray:
    """Values to some significant digits, as dataset.yaml has them."""
    return np.array([float(f"{v:.{digits}g}") for v in np.ravel(values)]).reshape(np.shape(values))


def nominal(rng: np.random.Generator, sort: str) -> Arm:
    """Draw a nominal arm of a sort, between .85 and 1.2 of its size."""
    rows, load, out = SORTS[sort]
    scale = rng.uniform(0.85, 1.2)
    origin, rpy, mass, centre, gyration, *drive = (np.array(c, dtype=float) for c in zip(*rows, strict=True))
    gear, armature, rated, coulomb, viscous, home, span = drive
    mass = _round(mass * scale**2 * np.exp(0.05 * rng.standard_normal(len(mass))))
    square = _round((1e-3 * scale * gyration) ** 2 * mass[:, None])
    inertia = square[:, :, None] * np.eye(3)
    torque = scale**3

    def mm(values: np.ndarray | float) -> np.ndarray:
        return 1e-3 * np.round(values * scale, 1)

    return Arm(
        name=sort,
        chain=Chain(mm(origin), np.radians(rpy)),
        mass=mass,
        centre=mm(centre),
        inertia=inertia,
        gear=gear,
        armature=_round(armature * scale**4),
        rated=_round(rated * torque),
        coulomb=_round(coulomb * torque),
        viscous=_round(viscous * torque),
        transition=float(np.radians(np.round(np.degrees(rng.uniform(0.02, 0.045)), 3))),
        home=np.radians(home),
        span=np.radians(span),
        load_centre=mm(np.array([0.0, 20.0, 70.0]) * out),
        load_gyration=float(mm(40.0)),
        load=float(np.round(load * scale**2, 2)),
        centre_u=float(mm(12.0)),
    )


def true(rng: np.random.Generator, drawn: Arm) -> Arm:
    """Draw the true arm: normal within two standard uncertainties; friction is another by up to a half."""
    n = drawn.size

    def normal(*shape: int) -> np.ndarray:
        return np.clip(rng.standard_normal(shape), -2, 2)

    mass = drawn.mass * (1 + U["mass"] * normal(n))
    bend = normal(n, 3, 3)
    stretch = np.eye(3) + 0.25 * U["inertia"] * (bend + bend.transpose(0, 2, 1))
    trace = np.trace(drawn.inertia, axis1=1, axis2=2)[:, None, None]
    spread = stretch @ (trace / 2 * np.eye(3) - drawn.inertia) @ stretch.transpose(0, 2, 1)
    spread *= (mass / drawn.mass)[:, None, None]
    inertia = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
    return replace(
        drawn,
        mass=mass,
        centre=drawn.centre + drawn.centre_u * normal(n, 3),
        inertia=inertia,
        armature=drawn.armature * (1 + U["armature"] * normal(n)),
        coulomb=drawn.coulomb * np.exp(0.25 * normal(n)),
        viscous=drawn.viscous * np.exp(0.25 * normal(n)),
        transition=drawn.transition * float(np.exp(U["friction_transition"] * normal(1)[0])),
    )
