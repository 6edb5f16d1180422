"""What stands around an arm: solids of artefacts, spheres on stems, and the table below them.

A target states a surface, not a body. What is added here is assumed, and on the safe side for an arm that
approaches from outside: artefacts are boxes that reach down behind their faces, spheres stand on stems.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.shapes import Box, Capsule, Cylinder, HalfSpace, Hull, Shape
from bayescal.dataset.regions import Region, Session
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Dataset, Target

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
