"""Random places on targets that a TCP can be brought to, by the kind of the target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.arm.transforms import cross
from bayescal.dataset import Target
from bayescal.dataset.types import Box
from bayescal.planning.pool import Region
from bayescal.probing.reach import cone

DOWN = np.radians(100.0)
"""rad from upwards: contacts on a cylinder whose normal is lower are on its underside (assumed)."""


@dataclass(frozen=True)
class Sites:
    """M places to bring the TCP to.

    Attributes
    ----------
    points : np.ndarray, shape (M, 3)
        TCP positions in F0, m.
    normals : np.ndarray, shape (M, 3)
        Outward unit normals, along which the tool leaves; nan where nothing is touched.
    axes : np.ndarray, shape (M, 3)
        Directions of the z axis of the tool: to be had where something is touched, else only a start.
    """

    points: np.ndarray
    normals: np.ndarray
    axes: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, rows: np.ndarray | slice) -> Sites:
        return Sites(self.points[rows], self.normals[rows], self.axes[rows])


def join(parts: list[Sites]) -> Sites:
    """All places, in order."""
    names = ("points", "normals", "axes")
    return Sites(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class Room:
    """What the choice of places depends on beside the target.

    `anywhere` (K, 3), m, are TCP positions of random configurations; `volume` that of interest; `cone`, rad,
    the greatest angle of the tool about the inward normal; `radius`, m, that of the ball.
    """

    anywhere: np.ndarray
    volume: Box | None
    cone: float
    radius: float


def sites_on(
    target: Target, region: Region | None, room: Room, count: int, rng: np.random.Generator
) -> Sites:
    """`count` random places on a target, with random directions of the tool."""
    points, normals = PLACES[target.kind](target, region, room, count, rng)
    return directed(points, normals, room.cone, rng)


def directed(points: np.ndarray, normals: np.ndarray, half_angle: float, rng: np.random.Generator) -> Sites:
    """Places with random directions of the tool, within the cone (rad) about the inward normals."""
    free = cone(np.tile([0.0, 0.0, 1.0], (len(points), 1)), np.pi, rng)
    touched = np.isfinite(normals[:, 0])
    axes = np.where(touched[:, None], cone(np.where(touched[:, None], -normals, free), half_angle, rng), free)
    return Sites(points, normals, axes)


Places = tuple[np.ndarray, np.ndarray]


def _on_plane(
    target: Target, region: Region | None, room: Room, count: int, rng: np.random.Generator
) -> Places:
    assert region is not None
    assert region.half is not None
    normals = np.tile(np.asarray(target.values["normal"], float), (count, 1))
    return region.centre + rng.uniform(-1, 1, (count, 2)) @ region.half + room.radius * normals, normals


def _on_sphere(
    target: Target, region: Region | None, room: Room, count: int, rng: np.random.Generator
) -> Places:
    assert region is not None
    assert region.up is not None
    normals = cone(np.tile(region.up, (count, 1)), region.widest, rng)
    return region.centre + (0.5 * float(target.values["diameter"]) + room.radius) * normals, normals


def _on_cylinder(
    target: Target, region: Region | None, room: Room, count: int, rng: np.random.Generator
) -> Places:
    assert region is not None
    assert region.half is not None
    assert region.up is not None
    axis = np.tile(np.asarray(target.values["axis"], float), (count, 1))
    normals = cross(axis, rng.normal(size=(count, 3)))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    under = normals @ region.up < np.cos(DOWN)
    normals[under] *= -1
    along = rng.uniform(-1, 1, (count, 1)) @ region.half
    return region.centre + along + (0.5 * float(target.values["diameter"]) + room.radius) * normals, normals


def _at_seat(
    target: Target, region: Region | None, room: Room, count: int, rng: np.random.Generator
) -> Places:
    assert region is not None
    assert region.up is not None
    return np.tile(region.centre, (count, 1)), np.tile(region.up, (count, 1))


def _about_pivot(
    target: Target, region: Region | None, room: Room, count: int, rng: np.random.Generator
) -> Places:
    """At the length of the bar from its pivot; a wire has any length."""
    assert region is not None
    assert region.up is not None
    length = float(target.values["length"])
    if np.isnan(length):
        return _in_volume(target, region, room, count, rng)
    out = cone(np.tile(region.up, (count, 1)), region.widest, rng)
    return region.centre + length * out, np.full((count, 3), np.nan)


def _in_volume(
    target: Target, region: Region | None, room: Room, count: int, rng: np.random.Generator
) -> Places:
    """In the volume of interest, or wherever the arm is at random joint angles."""
    if room.volume is None:
        points = room.anywhere[rng.integers(len(room.anywhere), size=count)]
    else:
        points = room.volume.centre + rng.uniform(-0.5, 0.5, (count, 3)) * room.volume.size
    return points, np.full((count, 3), np.nan)


PLACES: dict[str, Callable[[Target, Region | None, Room, int, np.random.Generator], Places]] = {
    "plane": _on_plane,
    "sphere": _on_sphere,
    "cylinder": _on_cylinder,
    "fixed-point": _at_seat,
    "distance": _about_pivot,
    "instrument": _in_volume,
}
"""Of each kind of target: random TCP positions (M, 3), m, and outward normals (M, 3)."""
