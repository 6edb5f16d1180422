"""What stands around an arm: artefacts as solids, spheres on stems, and the table below them.

A target states a surface, not a body. What is added here is assumed, and on the safe side for an arm that
approaches from outside: artefacts are boxes that reach down behind their faces, spheres stand on stems.

Nominal artefacts, a granite cube and a plate with spheres, and the tool that touches them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.shapes import Box, Capsule, Cylinder, HalfSpace, Hull, Shape
from bayescal.arm.transforms import rigid
from bayescal.dataset.regions import Region, Session
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Certificate, Dataset, Target, Tool

LYING = np.radians(20.0)
"""rad from the horizontal, up to which a board lies on a table (assumed)."""
SQUARE = 0.02  # rad: faces of a box are perpendicular and parallel to within this


@dataclass(frozen=True)
class Solid:
    """A body in F0. A contact with it is on its first shape; the others carry it.

    Solids with different `placement` are not in the workspace at the same time; "" is always there. `carries`
    marks the table on which the arm itself stands: links that are always below its height (the shoulder of an
    arm whose artefact stands higher) are not compared with it.
    """

    name: str
    shapes: tuple[Shape, ...]
    placement: str = ""
    carries: bool = False


@dataclass(frozen=True)
class Scene:
    """Solids of a session; `of` gives the index of the solid on which a target is, by its name."""

    solids: tuple[Solid, ...]
    of: dict[str, int]

    def touched(self, names: list[str]) -> np.ndarray:
        """Indices (M,) of the solids of targets; -1 for a target without a solid."""
        return np.array([self.of.get(name, -1) for name in names], int)


def on_table(solids: Sequence[Solid], up: np.ndarray, height: float | None = None) -> tuple[Solid, ...]:
    """The solids with the table on which they stand; boxes above it stand on a pedestal of their own size.

    Parameters
    ----------
    solids : sequence of Solid
    up : np.ndarray, shape (3,)
        Unit vector.
    height : float, optional
        Of the table along `up`, m; that of the lowest point of all solids if not given.
    """
    if height is None:
        height = min(shape.lowest(up) for solid in solids for shape in solid.shapes)
    out = [replace(s, shapes=(*s.shapes, *_pedestal(s.shapes[0], up, height))) for s in solids]
    return (*out, Solid("table", (HalfSpace(up, height),), carries=True))


def _pedestal(shape: Shape, up: np.ndarray, height: float) -> tuple[Shape, ...]:
    """The box below an upright box down to `height`, m; other shapes have stems, or lean."""
    if not isinstance(shape, Box):
        return ()
    axis = int(np.argmax(np.abs(shape.pose[:3, :3].T @ up)))
    bottom = shape.lowest(up)
    if abs(shape.pose[:3, axis] @ up) < np.cos(SQUARE) or bottom <= height:
        return ()
    pose, half = shape.pose.copy(), shape.half.copy()
    half[axis] = 0.5 * (bottom - height)
    pose[:3, 3] -= (shape.half[axis] + half[axis]) * up
    return (Box(pose, half),)


def own_solids(dataset: Dataset) -> tuple[Solid, ...]:
    """The solids that a session states (`solids:` in dataset.yaml)."""
    out = []
    for stated in dataset.solids:
        turn, centre = stated.pose[:3, :3], stated.pose[:3, 3]
        shape: Shape
        if stated.kind == "box":
            shape = Box(stated.pose, 0.5 * stated.size)
        elif stated.kind == "cylinder":
            shape = Cylinder(centre, turn[:, 2], 0.5 * float(stated.size[1]), 0.5 * float(stated.size[0]))
        else:
            shape = Hull(stated.points @ turn.T + centre)
        out.append(Solid(stated.name, (shape,), stated.placement))
    return tuple(out)


def up_of(dataset: Dataset) -> np.ndarray:
    """The unit vector (3,) against gravity; z of F0 where gravity is not modelled."""
    length = float(np.linalg.norm(dataset.gravity))
    return -dataset.gravity / length if length else np.array([0.0, 0.0, 1.0])


def placements(names: Sequence[str]) -> list[str]:
    """Placement of the artefact of each target, by its name (``ball.A@1``: ``1``).

    "" where the target stays; a single placement stays.
    """
    labels = [name.partition("@")[2] for name in names]
    return labels if len({*labels} - {""}) > 1 else [""] * len(labels)


def scene_of(
    dataset: Dataset,
    regions: Mapping[str, Region] | None = None,
    table: float | None = None,
    with_table: bool = True,
) -> Scene:
    """The solids that the targets of a session state.

    Planes of a name with a common part before the dot (``cube.+x``) are faces of a box, if they include a
    parallel pair and three perpendicular directions. Along a direction with a single face the box is as deep
    as the smallest parallel pair. Spheres stand on stems. Other targets have no extent without their regions.

    Parameters
    ----------
    dataset : Dataset
    regions : mapping of str to Region, optional
        By the names of targets: walls, cylinders and posts of seats are added, and the session's own solids,
        which do not stand on anything.
    table : float, optional
        Height of the table, m, against gravity; below the lowest solid if not given.
    with_table : bool
        Add the table below all solids, on which boxes stand by pedestals.
    """
    up, names = up_of(dataset), [t.name for t in dataset.targets]
    labels = [name.partition("@")[2] for name in names] if regions is None else placements(names)
    label = dict(zip(names, labels, strict=True))
    solids, of, boards = list[Solid](), dict[str, int](), list[Solid]()

    def add(name: str, shapes: tuple[Shape, ...], on: Sequence[str]) -> None:
        """Add the solid on which some targets are."""
        of.update(dict.fromkeys(on, len(solids)))
        solids.append(Solid(name, shapes, label[on[-1]]))

    for target in dataset.targets:
        kind, planned = KINDS[target.kind], KINDS[target.kind].probing
        if kind.touched and kind.centred and planned.region and planned.obstacle:
            region = planned.region(target, Session(up))
            if region is not None:
                add(target.name, planned.obstacle(target, region), [target.name])
    for artefact, faces in artefacts(dataset.targets).items():
        if (box := box_of(faces)) is not None:
            add(artefact, (box,), [t.name for t in faces])
    for target in dataset.targets:
        obstacle = KINDS[target.kind].probing.obstacle
        if regions and target.name in regions and target.name not in of and obstacle:
            shapes = obstacle(target, regions[target.name])
            if KINDS[target.kind].posed:  # nothing touches it
                boards.append(Solid(target.name, shapes, label[target.name]))
            else:
                add(target.name, shapes, [target.name])
    solids += [board for board in boards if _lies(board.shapes[0], up)]
    if with_table and (solids or table is not None):
        solids = list(on_table(solids, up, table))
    solids += [board for board in boards if not _lies(board.shapes[0], up)]  # what carries it is unknown
    if regions is not None:
        moved = set(label.values())  # a single placement is there all the time
        stated = own_solids(dataset)
        solids += [replace(s, placement=s.placement if s.placement in moved else "") for s in stated]
    return Scene(tuple(solids), of)


def _lies(shape: Shape, up: np.ndarray) -> bool:
    """Whether a flat box lies, within `LYING`."""
    if not isinstance(shape, Box):
        return False
    thin = int(np.argmin(shape.half))
    return bool(abs(shape.pose[:3, thin] @ up) > np.cos(LYING))


def artefacts(targets: Sequence[Target]) -> dict[str, list[Target]]:
    """Planes with a common first part of their names, by that part."""
    out: dict[str, list[Target]] = {}
    for target in targets:
        if KINDS[target.kind].flat:
            out.setdefault(target.name.rpartition(".")[0], []).append(target)
    return out


def table_height(scene: Scene) -> float | None:
    """Height of the table, m, against gravity; None where there is none."""
    shapes = [solid.shapes[0] for solid in scene.solids if solid.carries]
    return next((shape.offset for shape in shapes if isinstance(shape, HalfSpace)), None)


def box_of(faces: list[Target]) -> Box | None:
    """The box whose faces are planes, or None if the planes do not determine one."""
    normals = np.array([t.values["normal"] for t in faces], float)
    offsets = np.array([t.values["offset"] for t in faces], float)
    axes: list[np.ndarray] = []
    for normal in normals:
        if all(abs(normal @ axis) < SQUARE for axis in axes):
            axes.append(normal)
        elif max(abs(normal @ axis) for axis in axes) < np.cos(SQUARE):
            return None  # oblique faces
    if len(axes) < 3:
        return None
    high, low = np.full(3, np.inf), np.full(3, -np.inf)  # along each axis
    for normal, offset in zip(normals, offsets, strict=True):
        along = [float(normal @ axis) for axis in axes]
        k = int(np.argmax(np.abs(along)))
        if along[k] > 0:
            high[k] = min(high[k], offset)
        else:
            low[k] = max(low[k], -offset)
    size = high - low
    if not np.any(np.isfinite(size)) or np.any(size <= 0):
        return None
    depth = size[np.isfinite(size)].min()
    low = np.where(np.isfinite(low), low, high - depth)  # the first face of an axis gave its direction
    square = np.linalg.qr(np.array(axes).T)[0]
    square = square * np.sign(np.sum(square * np.array(axes).T, axis=0))
    pose = np.eye(4)
    pose[:3, :3] = square
    pose[:3, 3] = np.linalg.solve(np.array(axes), 0.5 * (high + low))
    return Box(pose, 0.5 * (high - low))


def held_by(dataset: Dataset, tool: int) -> tuple[Capsule, ...]:
    """What a tool of a session holds beside itself, of the targets that it measures or may measure."""
    m = dataset.measurements
    out = list[Capsule]()
    for k, target in enumerate(dataset.targets):
        used = np.unique(m.tool[m.target == k])
        if tool in used if len(used) else dataset.tools[tool].ball_radius is None:
            out += KINDS[target.kind].probing.held(target)
    return tuple(out)


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
