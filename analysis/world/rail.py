"""An arm on a rail before a tracker: the true carriage leaves its straight line, and turns on the way.

The rail is what rails are: segments that are bolted together, each bent a little, with kinks where they
meet. Its errors are functions of the position in metres, no polynomials. Positions and torques are
Pinocchio's, as of the arm (`arm`): the rail moves the six coordinates of its base.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from analysis.world import scene, session, tracker, write
from analysis.world.arm import BASE, JOINT, LINK_FROM_READING, SIZE, Arm, draw, nominal

TRAVEL = 3.0  # m, along y of the base's frame
SEGMENT = 1.0  # m
AXES = ("x", "z")  # in which the carriage leaves its line
LATER = 80  # rows that validate
BY_TORQUE = 3  # passes until deflection and torque agree


@dataclass(frozen=True)
class Curve:
    """An error by the position: kinks at the ends of segments, and waves; in m or rad."""

    at: np.ndarray  # (K,) m, ends of the segments
    knots: np.ndarray  # (K,)
    waves: np.ndarray  # (W, 3): amplitude, length (m), phase

    def __call__(self, y: np.ndarray) -> np.ndarray:
        """Return the error (N,) at positions (N,), m."""
        amplitude, length, phase = self.waves.T
        return (
            np.interp(y, self.at, self.knots)
            + np.sin(2 * np.pi * np.asarray(y)[:, None] / length + phase) @ amplitude
        )

    def bent(self, y: np.ndarray) -> np.ndarray:
        """Return the error (N,) at positions (N,), m, without the straight line that fits the travel best."""
        every = np.linspace(0.0, TRAVEL, 3001)
        return self(y) - np.polyval(np.polyfit(every, self(every), 1), y)


def curve(rng: np.random.Generator, size: float) -> Curve:
    """Draw an error of a size, m or rad."""
    at = np.arange(0.0, TRAVEL + SEGMENT / 2, SEGMENT)
    lengths = rng.uniform([2.0, 0.9], [5.0, 2.0])
    waves = np.column_stack([size * rng.uniform(0.3, 0.8, 2), lengths, rng.uniform(0, 6.28, 2)])
    return Curve(at, size * rng.standard_normal(len(at)), waves)


@dataclass(frozen=True)
class Rail:
    """How the carriage of a true rail moves: errors by its position, and what is wrong of all of it."""

    straight: tuple[Curve, Curve]  # along x and z, m
    turns: tuple[Curve, Curve, Curve]  # about x, y and z, rad
    scale: float  # relative error of the position
    lean: np.ndarray  # (2,) rad: direction of the rail in x and z
    mounted: np.ndarray  # (3,) rad: the arm on its carriage

    def coordinates(self, y: np.ndarray) -> np.ndarray:
        """Return the six coordinates (N, 6) of the base at readings (N,), m."""
        y = y * (1 + self.scale)
        x, z = (bend(y) + lean * y for bend, lean in zip(self.straight, self.lean, strict=True))
        turns = [turn(y) + angle for turn, angle in zip(self.turns, self.mounted, strict=True)]
        return np.column_stack([x, y, z, *turns])


def rail(rng: np.random.Generator) -> Rail:
    """Draw a rail that is mounted as rails are: bent by a tenth of a millimetre, turned by 0.1 mrad."""
    return Rail(
        straight=(curve(rng, 8e-5), curve(rng, 8e-5)),
        turns=(curve(rng, 5e-5), curve(rng, 5e-5), curve(rng, 5e-5)),
        scale=5e-5 * rng.standard_normal(),
        lean=1e-3 * rng.standard_normal(2),
        mounted=1e-3 * rng.standard_normal(3),
    )


@dataclass(frozen=True)
class OnRail:
    """A session of an arm on a rail: the true arm, its files by name, and the noise of a coordinate, m."""

    body: Arm
    rail: Rail
    at: tracker.Instrument
    sigma: float
    texts: dict[str, str]

    def reads(self, y: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return what the tracker reads (N, 3), m, without noise, at positions (N,), m, and angles (N, 6)."""
        coordinates = np.zeros((len(y), SIZE))
        coordinates[:, BASE] = self.rail.coordinates(y)
        links = q @ LINK_FROM_READING.T
        coordinates[:, JOINT] = links
        for _ in range(BY_TORQUE):
            coordinates[:, JOINT] = links + self.body.shape.give * self.body.weigh(coordinates)[:, JOINT]
        origin, turn = self.body.place(coordinates)
        return self.at.read(origin + turn @ self.body.shape.tool)


def make(seed: int, count: int = 400, sigma: float = 1.5e-5) -> OnRail:
    """Make a session of `count` rows that calibrate."""
    rng = np.random.default_rng([seed, 7])
    body, true = Arm(draw(rng)), rail(rng)
    n = count + LATER
    q, _ = session.poses(rng, scene.draw(rng), np.full(n, scene.INSTRUMENT))
    y = rng.uniform(0.0, TRAVEL, n)
    out = OnRail(body, true, tracker.draw(rng), sigma, {})
    read = out.reads(y, q) + sigma * rng.standard_normal((n, 3))
    roles = np.repeat(["calibrate", "validate"], [count, LATER])
    texts = {
        "dataset.yaml": _settings(out.at, sigma),
        "robot.yaml": robot_text(),
        "measurements.csv": _rows(roles, y, q, read),
    }
    return replace(out, texts=texts)


def robot_text() -> str:
    """Return robot.yaml of the nominal arm on its rail, which is along y of F0."""
    head, row, rest = write.robot_text().partition("  - {name: J1, alpha_deg: 0,")
    carriage = "  - {name: RAIL, type: prismatic, alpha_deg: -90, a_mm: 0, d_mm: 0, offset_deg: 0, "
    carriage += f"limits_mm: [0, {1e3 * TRAVEL:g}]}}\n"
    head = head.replace("fanuc-lrmate200ic", "lrmate-on-rail")
    coupling = np.eye(7)
    coupling[1:, 1:] = LINK_FROM_READING
    before, _, links = rest.partition("link_from_reading:\n")
    links = "".join(links.partition("links:\n")[1:]).partition("reductions")[0]
    matrix = "".join(f"  - {write._list(r)}\n" for r in coupling)
    links = links.replace("links:\n", "links:\n  - {mass_kg: 80, centre_of_mass_mm: [0, 60, 0]}\n")
    return (
        head
        + carriage
        + row.replace("alpha_deg: 0", "alpha_deg: 90")
        + before
        + "link_from_reading:\n"
        + matrix
        + links
    )


def _settings(at: tracker.Instrument, stated: float) -> str:
    s = nominal()
    turn = Rotation.from_matrix(at.stated_turn).as_euler("xyz", degrees=True)
    place = f"xyz_mm: {write._list(1e3 * at.stated_origin, '{:.3f}')}, rpy_deg: {write._list(turn, '{:.4f}')}"
    mass = f"mass_kg: {s.tool_mass:g}, centre_of_mass_mm: {write._list(1e3 * s.tool_com)}"
    return f"""schema: bayescal-dataset/1
name: rail
robot: robot.yaml
readings: encoder
gravity_mps2: [0, 0, -9.81]
tools:
  reflector: {{centre_mm: {write._list(1e3 * s.tool)}, {mass}}}
noise:
  point_mm: {1e3 * stated:.6f}
targets:
  tracker: {{kind: instrument, {place}}}
"""


def _rows(roles: np.ndarray, y: np.ndarray, q: np.ndarray, read: np.ndarray) -> str:
    lines = ["id,role,target,j1_mm," + ",".join(f"j{k}_deg" for k in range(2, 8)) + ",x_mm,y_mm,z_mm"]
    for k, role in enumerate(roles):
        cells = [f"p{k:04d}", role, "tracker", f"{1e3 * y[k]:.6f}"]
        cells += [f"{v:.7f}" for v in np.degrees(q[k])] + [f"{1e3 * v:.5f}" for v in read[k]]
        lines.append(",".join(cells))
    return "\n".join([*lines, ""])
