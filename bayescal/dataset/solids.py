"""Solids of the user's own around the arm (`solids:` in dataset.yaml): fixtures, tables, fences."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.errors import BayescalError
from bayescal.storage.files import Document, Keys, Name, Positive, Vector
from bayescal.storage.reading import check_inside

LARGEST = 20_000_000
"""Bytes of a mesh file."""
FLAT = 1e-6  # m: points of a mesh that are nearer to a common plane have no hull


class BoxEntry(Keys):
    """A box."""

    kind: Literal["box"]
    centre_mm: Vector
    """Its centre in F0."""
    size_mm: tuple[Positive, Positive, Positive]
    """Lengths of its edges along x, y, z."""
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    """Its roll, pitch, yaw in F0: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    placement: str = ""
    """Placement of the artefact with which it is there; always if not given."""


class CylinderEntry(Keys):
    """A cylinder about its z axis."""

    kind: Literal["cylinder"]
    centre_mm: Vector
    """Its centre in F0."""
    diameter_mm: Positive
    """Its diameter."""
    length_mm: Positive
    """Its length."""
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    """Its roll, pitch, yaw in F0: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    placement: str = ""
    """Placement of the artefact with which it is there; always if not given."""


class MeshEntry(Keys):
    """The convex hull of a mesh."""

    kind: Literal["mesh"]
    file: Name
    """STL or OBJ file in the dataset folder, in mm."""
    xyz_mm: Vector = (0.0, 0.0, 0.0)
    """Origin of the file's coordinates in F0."""
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    """Its roll, pitch, yaw in F0: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    placement: str = ""
    """Placement of the artefact with which it is there; always if not given."""


SolidEntry = Annotated[BoxEntry | CylinderEntry | MeshEntry, Field(discriminator="kind")]


@dataclass(frozen=True)
class OwnSolid:
    """A solid by its kind (box, cylinder or mesh), pose (4, 4) in F0 and sizes, m.

    `size`: edges of a box (3,); diameter and length of a cylinder about z (2,). `points` (K, 3) of a mesh are
    in its own coordinates, from `file`. `placement`: that of the artefact with which it is there, "" always.
    """

    name: str
    kind: str
    pose: np.ndarray
    size: np.ndarray = field(default_factory=lambda: np.empty(0))
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    placement: str = ""
    file: str = ""


def solids_of(
    document: Document, stated: dict[str, SolidEntry], folder: Path, targets: Sequence[str]
) -> tuple[OwnSolid, ...]:
    """The solids that a dataset.yaml states, beside targets with these names.

    Raises
    ------
    BayescalError
        If a mesh is missing, outside the folder, or no mesh, or no target has the placement of a solid.
    """
    out = []
    placements = {name.partition("@")[2] for name in targets} | {""}
    for name, entry in stated.items():
        if entry.placement not in placements:
            where = document.where(("solids", name, "placement"))
            some = ", ".join(sorted(placements - {""})) or "none"
            raise BayescalError(f"no target has the placement `{entry.placement}`", where, f"known: {some}")
        turn = rpy_matrix(np.radians(entry.rpy_deg))
        if isinstance(entry, MeshEntry):
            where = document.where(("solids", name, "file"))
            points = mesh_points(folder / entry.file, folder, where)
            file = (folder / entry.file).resolve().relative_to(folder.resolve()).with_suffix(".stl")
            pose = rigid(turn, 1e-3 * np.array(entry.xyz_mm))
            out.append(OwnSolid(name, "mesh", pose, np.empty(0), points, entry.placement, file.as_posix()))
            continue
        size = entry.size_mm if isinstance(entry, BoxEntry) else (entry.diameter_mm, entry.length_mm)
        pose = rigid(turn, 1e-3 * np.array(entry.centre_mm))
        out.append(OwnSolid(name, entry.kind, pose, 1e-3 * np.array(size), placement=entry.placement))
    return tuple(out)


def mesh_points(path: Path, folder: Path, where: str) -> np.ndarray:
    """Corners (K, 3), m, of a mesh in mm: binary or text STL, or OBJ; each once."""
    check_inside(path, folder, "the mesh")
    if not path.is_file():
        raise BayescalError(f"there is no file {path.name}", where, "put the mesh into the dataset folder")
    if path.stat().st_size > LARGEST:
        remedy = f"give a mesh of at most {LARGEST // 10**6} MB"
        raise BayescalError(f"{path.name} is too large", where, remedy)
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little")
    if len(content) == 84 + 50 * count and count:
        rows = np.frombuffer(content, np.uint8, offset=84).reshape(count, 50)
        points = rows[:, 12:48].copy().view("<f4").reshape(-1, 3).astype(float)
    else:
        lines = re.findall(rb"^\s*v(?:ertex)?\s+(\S+)\s+(\S+)\s+(\S+)", content, re.MULTILINE)
        try:
            points = np.array([[float(x) for x in line] for line in lines]).reshape(-1, 3)
        except ValueError:
            points = np.empty((0, 3))
    points = np.unique(1e-3 * points[np.isfinite(points).all(axis=1)], axis=0)
    thin = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] if len(points) > 3 else 0.0
    if thin < FLAT:
        raise BayescalError(f"{path.name} has no body", where, "give a closed mesh as STL or OBJ, in mm")
    return points


def hull_stl(points: np.ndarray) -> bytes:
    """The convex hull of points (K, 3), m, as a binary STL file in mm."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    rows = np.zeros((len(hull.simplices), 50), np.uint8)
    corners = 1e3 * points[hull.simplices]
    normals = hull.equations[:, None, :3]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(turned * normals[:, 0], axis=1) < 0
    corners[inward] = corners[inward, ::-1]
    rows[:, :48] = np.concatenate([normals, corners], axis=1).astype("<f4").reshape(-1, 12).view(np.uint8)
    return bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes()


def solid_values(solid: OwnSolid) -> Iterator[tuple[str, np.ndarray | str]]:
    """Keys of a solid in dataset.yaml with their values in SI."""
    yield "kind", solid.kind
    if solid.kind == "mesh":
        yield "file", solid.file
    yield "xyz_mm" if solid.kind == "mesh" else "centre_mm", solid.pose[:3, 3]
    if solid.kind == "box":
        yield "size_mm", solid.size
    elif solid.kind == "cylinder":
        yield "diameter_mm", solid.size[0]
        yield "length_mm", solid.size[1]
    yield "rpy_deg", rpy_of(solid.pose[:3, :3])
    if solid.placement:
        yield "placement", solid.placement
