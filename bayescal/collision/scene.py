"""What stands around an arm: solids of artefacts, spheres on stems, and the table below them.

A target states a surface, not a body. What is added here is assumed, and on the safe side for an arm that
approaches from outside: artefacts are boxes that reach down behind their faces, spheres stand on stems.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.collision.shapes import FIXED, Ball, Box, Capsule, Cylinder, HalfSpace, Hull, Shape
from bayescal.dataset.types import Dataset, Target

STEM = 0.1
"""m, assumed: length of the stem below the centre of a sphere."""

STEM_RADIUS = 0.2
"""Radius of a stem, assumed, of the diameter of its sphere."""

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
    """Solids of a session, the solid of each target, and targets whose extent is not known.

    `of` gives the index of the solid on which a target is, by the name of the target. `unknown` are names of
    targets that state a surface without its extent: nothing is avoided there.
    """

    solids: tuple[Solid, ...]
    of: dict[str, int]
    unknown: tuple[str, ...] = ()

    def touched(self, names: list[str]) -> np.ndarray:
        """Indices (M,) of the solids of targets; -1 for a target without a solid."""
        return np.array([self.of.get(name, -1) for name in names], int)


def sphere(name: str, centre: np.ndarray, diameter: float, up: np.ndarray, placement: str = "") -> Solid:
    """A sphere on a stem: centre (3,) and diameter in m, `up` (3,) the unit vector opposite to the stem."""
    stem = Capsule(FIXED, centre, centre - STEM * up, STEM_RADIUS * diameter)
    return Solid(name, (Ball(centre, 0.5 * diameter), stem), placement)


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
    for own in dataset.solids:
        turn, centre = own.pose[:3, :3], own.pose[:3, 3]
        shape: Shape
        if own.kind == "box":
            shape = Box(own.pose, 0.5 * own.size)
        elif own.kind == "cylinder":
            shape = Cylinder(centre, turn[:, 2], 0.5 * float(own.size[1]), 0.5 * float(own.size[0]))
        else:
            shape = Hull(own.points @ turn.T + centre)
        out.append(Solid(own.name, (shape,), own.placement))
    return tuple(out)


def up_of(dataset: Dataset) -> np.ndarray:
    """The unit vector (3,) against gravity; z of F0 where gravity is not modelled."""
    length = float(np.linalg.norm(dataset.gravity))
    return -dataset.gravity / length if length else np.array([0.0, 0.0, 1.0])


def scene_of(dataset: Dataset, with_table: bool = True) -> Scene:
    """The solids that the targets of a session state.

    Planes of a name with a common part before the dot (``cube.+x``) are faces of a box, if they include a
    parallel pair and three perpendicular directions. Along a direction with a single face the box is as deep
    as the smallest parallel pair. Spheres stand on stems; of ``ball.A@1`` the placement is ``1``. Other
    targets have no extent (`Scene.unknown`): no solid.

    Parameters
    ----------
    dataset : Dataset
    with_table : bool
        Add a table below all solids.
    """
    up = up_of(dataset)
    solids: list[Solid] = []
    of: dict[str, int] = {}
    faces: dict[str, list[Target]] = {}
    for target in dataset.targets:
        if target.kind == "plane":
            faces.setdefault(target.name.rpartition(".")[0], []).append(target)
        elif target.kind == "sphere":
            placement = target.name.partition("@")[2]
            centre, diameter = np.asarray(target.values["centre"], float), float(target.values["diameter"])
            of[target.name] = len(solids)
            solids.append(sphere(target.name, centre, diameter, up, placement))
    for artefact, group in faces.items():
        shape = box_of(group)
        if shape is not None:
            of |= dict.fromkeys((t.name for t in group), len(solids))
            solids.append(Solid(artefact, (shape,), group[0].name.partition("@")[2]))
    unknown = tuple(t.name for t in dataset.targets if t.kind != "instrument" and t.name not in of)
    return Scene(on_table(solids, up) if with_table and solids else tuple(solids), of, unknown)


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
