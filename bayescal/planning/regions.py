"""Where contacts may be: stated regions, faces of boxes, the places that were probed before."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from bayescal.collision.scene import box_of, up_of
from bayescal.collision.shapes import Box as Solid
from bayescal.dataset import Dataset, Patch, Target
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene
from bayescal.planning.pool import Region

EDGE = 0.07
"""Of the size of a face: the distance of contacts from its edges, which are chamfered (assumed)."""
LOWEST = np.radians(88.0)
"""rad: greatest angle from the top of a sphere to a contact; its stem is below."""
ENOUGH = 8
"""Contacts that show where a face can be probed (assumed)."""


def regions_of(dataset: Dataset) -> dict[str, Region]:
    """The region of every target with a place of its own.

    A stated region is taken; else a face is that of a box which the other faces of its artefact determine,
    less a margin at its edges; else the rectangle of the contacts that were made on it.

    Raises
    ------
    BayescalError
        If the extent of a face or a cylinder is not known, or its kind cannot be planned.
    """
    stated = dataset.plan.regions if dataset.plan else {}
    faces = _faces(dataset.targets)
    out = {}
    for target in dataset.targets:
        if target.kind == "instrument":
            continue
        if target.kind not in REGIONS:
            what = f"contacts on a target of kind {target.kind} cannot be planned"
            raise BayescalError(what, target.name, f"kinds: {', '.join([*REGIONS, 'instrument'])}")
        region = REGIONS[target.kind](dataset, target, stated.get(target.name), faces)
        if region is None:
            raise BayescalError(*_unknown_extent(dataset, target))
        out[target.name] = region
    return out


def _unknown_extent(dataset: Dataset, target: Target) -> tuple[str, str, str]:
    size = "[width, height]" if target.kind == "plane" else "[length]"
    line = f"`plan: {{regions: {{{target.name}: {{centre_mm: [x, y, z], size_mm: {size}}}}}}}`"
    others = "; or add the opposite face, or plan `--after` a session on it" if target.kind == "plane" else ""
    what = f"where `{target.name}` can be probed is not known: no size is stated, and no other face gives it"
    return what, "dataset.yaml", f"add {line}{others}"


def edges(normal: np.ndarray, along: np.ndarray | None = None) -> np.ndarray:
    """Directions (2, 3) of the width and the height of a rectangle across a unit normal (3,).

    The width is nearest to `along`, or to the axis of F0 that comes first of those along the face.
    """
    if along is None:
        along = np.eye(3)[1 if np.argmax(np.abs(normal)) == 0 else 0]
    width = along - (along @ normal) * normal
    width = width / np.linalg.norm(width)
    return np.stack([width, np.cross(normal, width)])


def _faces(targets: tuple[Target, ...]) -> dict[str, Region]:
    """Faces of the boxes that planes with a common first part of their names determine."""
    artefacts: dict[str, list[Target]] = {}
    for target in targets:
        if target.kind == "plane":
            artefacts.setdefault(target.name.rpartition(".")[0], []).append(target)
    out: dict[str, Region] = {}
    for faces in artefacts.values():
        if (box := box_of(faces)) is not None:
            out |= {face.name: _face_of(box, np.asarray(face.values["normal"], float)) for face in faces}
    return out


def _face_of(box: Solid, normal: np.ndarray) -> Region:
    """The face of a box in the direction of a unit normal (3,), less its edges."""
    axes, centre = box.pose[:3, :3], box.pose[:3, 3]
    along = axes.T @ normal
    k = int(np.argmax(np.abs(along)))
    half = (1 - 2 * EDGE) * (axes * box.half).T
    return Region(centre + np.sign(along[k]) * box.half[k] * axes[:, k], np.delete(half, k, axis=0))


def _plane(
    dataset: Dataset, target: Target, patch: Patch | None, faces: Mapping[str, Region]
) -> Region | None:
    normal, offset = np.asarray(target.values["normal"], float), float(target.values["offset"])
    if patch is not None:
        centre = patch.centre - (normal @ patch.centre - offset) * normal
        return Region(centre, 0.5 * patch.size[:, None] * edges(normal, patch.along))
    if target.name in faces:
        return faces[target.name]
    points = _probed(dataset, target)
    if len(points) < ENOUGH:
        return None
    across = edges(normal)
    place = points @ across.T
    low, high = place.min(axis=0), place.max(axis=0)
    return Region(0.5 * (low + high) @ across + offset * normal, 0.5 * (high - low)[:, None] * across)


def _cylinder(
    dataset: Dataset, target: Target, patch: Patch | None, faces: Mapping[str, Region]
) -> Region | None:
    axis, point = (np.asarray(target.values[key], float) for key in ("axis", "point"))
    if patch is not None:
        place, half = float((patch.centre - point) @ axis), 0.5 * float(patch.size[0])
    else:
        points = _probed(dataset, target)
        if len(points) < ENOUGH:
            return None
        along = (points - point) @ axis
        place, half = 0.5 * float(along.min() + along.max()), 0.5 * float(np.ptp(along))
    return Region(point + place * axis, half * axis[None], up_of(dataset))


def _cap(dataset: Dataset, target: Target, patch: Patch | None, faces: Mapping[str, Region]) -> Region:
    return Region(np.asarray(target.values["centre"], float), up=up_of(dataset), widest=LOWEST)


def _seat(dataset: Dataset, target: Target, patch: Patch | None, faces: Mapping[str, Region]) -> Region:
    return Region(np.asarray(target.values["centre"], float), up=up_of(dataset))


REGIONS: dict[str, Callable[[Dataset, Target, Patch | None, Mapping[str, Region]], Region | None]] = {
    "plane": _plane,
    "sphere": _cap,
    "cylinder": _cylinder,
    "fixed-point": _seat,
    "distance": _cap,
}
"""Of each kind of target: its region, by the stated one and the faces of boxes; None if it is not known."""


def _probed(dataset: Dataset, target: Target) -> np.ndarray:
    """Nominal TCP positions (M, 3), m, in F0, of the rows of a target."""
    names = np.array([t.name for t in dataset.targets])
    rows = names[dataset.measurements.target] == target.name
    return Scene(dataset).points[rows] if rows.any() else np.empty((0, 3))
