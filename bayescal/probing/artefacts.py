"""Nominal artefacts, a granite cube and a plate with spheres, and the tool that touches them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.shapes import Box
from bayescal.arm.transforms import rigid
from bayescal.dataset.types import Certificate, Target, Tool
from bayescal.probing.scene import Solid

RADIUS = 0.003  # m, of the ball
U_DISTANCE, U_ANGLE = 3e-6, 1.2e-5  # m, rad: of the cube's certificate
U_SPHERE = 1e-6  # m: of a sphere's diameter, and of a distance between spheres
LONGEST = 0.3  # m, between spheres of the artefact
SMALL_ARM = 0.45
"""m: lengths of the rows of an arm, added up, below which its artefacts are the small ones."""


@dataclass(frozen=True)
class Sizes:
    """The tool, the edge of the cube and the diameter of the spheres, m, that suit an arm."""

    tool: Tool
    edge: float
    diameter: float

    @classmethod
    def of(cls, robot: Robot) -> Sizes:
        """Those for a robot: a table-top arm can neither carry nor reach those of an industrial one."""
        return SMALL if float(np.hypot(robot.a, robot.d).sum()) < SMALL_ARM else LARGE


LARGE = Sizes(
    Tool("ball", np.array([0.06, 0.0, 0.12]), RADIUS, 0.8, np.array([0.02, 0.0, 0.06])), 0.2286, 0.0508
)
"""A probe of 0.8 kg, a cube of 9 inches and spheres of 2 inches."""
SMALL = Sizes(
    Tool("ball", np.array([0.02, 0.0, 0.1]), RADIUS, 0.05, np.array([0.01, 0.0, 0.05])), 0.0508, 0.0254
)
"""A stylus of 50 g, a cube of 2 inches and spheres of 1 inch."""

FACES = {"+x": (0, 1.0), "-x": (0, -1.0), "+y": (1, 1.0), "-y": (1, -1.0), "+z": (2, 1.0)}
"""Axis and sign of the faces that can be touched: the cube stands on the sixth."""


@dataclass(frozen=True)
class Cube:
    """A cube: centre (3,) and edge, m, and the directions of its edges, columns of `axes` (3, 3), in F0."""

    centre: np.ndarray
    axes: np.ndarray
    edge: float

    def normal(self, face: str) -> np.ndarray:
        """Outward unit normal (3,) of a face."""
        axis, sign = FACES[face]
        return sign * self.axes[:, axis]

    def offset(self, face: str) -> float:
        """Distance of a face from the origin of F0 along its normal, m."""
        return float(self.normal(face) @ self.centre) + self.edge / 2

    def on(self, face: str, count: int, rng: np.random.Generator) -> np.ndarray:
        """Points (count, 3), m, distributed over a face, away from its edges."""
        axis, _ = FACES[face]
        flat = rng.uniform(-0.43, 0.43, (count, 3)) * self.edge
        flat[:, axis] = 0.0
        return self.centre + flat @ self.axes.T + 0.5 * self.edge * self.normal(face)

    @property
    def solid(self) -> Solid:
        """The cube as an obstacle."""
        return Solid("cube", (Box(rigid(self.axes, self.centre), np.full(3, self.edge / 2)),))

    def inside(self, points: np.ndarray, margin: float) -> np.ndarray:
        """Which of points (..., 3) are in the cube, or nearer to it than the margin, m."""
        return np.all(np.abs((points - self.centre) @ self.axes) < self.edge / 2 + margin, axis=-1)


def layout(spheres: int, longest: float) -> np.ndarray:
    """Sphere centres (spheres, 3), m, on the artefact: two at its ends, the others beside them."""
    between = np.arange(1, max(spheres - 1, 1))
    x = np.concatenate([[-0.5, 0.5], between / max(spheres - 1, 1) - 0.5])
    y = np.concatenate([[0.0, 0.0], 0.225 * (-1.0) ** (between - 1)])
    return longest * np.stack([x, y, 0 * x], axis=1)[:spheres]


@dataclass(frozen=True)
class Scenery:
    """Nominal objects: the cube, its four faces, sphere centres (placements, spheres, 3) and diameter, m."""

    cube: Cube
    faces: tuple[str, ...]
    spheres: np.ndarray
    diameter: float

    @property
    def targets(self) -> tuple[Target, ...]:
        """The targets as stated in dataset.yaml."""
        planes = [
            Target(f"cube.{f}", "plane", {"normal": self.cube.normal(f), "offset": self.cube.offset(f)})
            for f in self.faces
        ]
        names = sphere_names(*self.spheres.shape[:2])
        centres = self.spheres.reshape(-1, 3)
        balls = [
            Target(name, "sphere", {"centre": centre, "diameter": self.diameter})
            for name, centre in zip(names, centres, strict=True)
        ]
        return (*planes, *balls)

    @property
    def certificates(self) -> tuple[Certificate, ...]:
        """An edge of the cube and the right angles of three faces; the diameter of every sphere."""
        diameters = [
            Certificate("diameter", (name,), u_distance=U_SPHERE)
            for name in sphere_names(*self.spheres.shape[:2])
        ]
        if not self.faces:
            return tuple(diameters)
        one, opposite, *others = (f"cube.{face}" for face in self.faces)
        parallel = Certificate("parallel", (one, opposite), self.cube.edge, U_DISTANCE, U_ANGLE)
        pairs = combinations((one, *others), 2)
        square = [Certificate("perpendicular", pair, u_angle=U_ANGLE) for pair in pairs]
        return (parallel, *square, *diameters)


def sphere_names(placements: int, spheres: int) -> list[str]:
    """Names of the spheres, placement by placement."""
    return [f"ball.{chr(ord('A') + k)}@{p + 1}" for p in range(placements) for k in range(spheres)]
