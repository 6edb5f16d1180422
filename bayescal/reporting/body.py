"""The arm and what stands around it as bodies: a record of them, and their outlines from a direction of view.

An outline is a polygon; drawn from far to near, outlines look like the bodies. The arm is the nominal one of
capsules (`probing.scene`), artefacts are the boxes and spheres that the targets of a session state.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from bayescal.arm import chain as reference
from bayescal.arm.shapes import Box, Capsule
from bayescal.effects.location import Site
from bayescal.model.scene import Scene
from bayescal.probing.bodies import arm_capsules
from bayescal.probing.scene import scene_of
from bayescal.reporting.origin import plain
from bayescal.reporting.style import MARKED
from bayescal.reporting.text import MM
from bayescal.storage.reading import Json

ROUND = 12
"""Corners of half a circle."""
COLOURS = {"arm": "#e6ebf0", "tool": "#ccd5dd", "edge": "#8f9ba7"}
"""Of figures; artefacts are grey."""
FACES = np.array([[s if k == axis else 0.0 for k in range(3)] for axis in range(3) for s in (-1.0, 1.0)])
"""Outward normals of a box."""


DRAWN = ("joint", "link", "base", "tool", "probe")
"""Kinds of sites that a drawing without contacts can mark."""


@dataclass(frozen=True)
class View:
    """A direction of view without perspective, by unit vectors in F0: to the right, up, to the viewer."""

    right: np.ndarray
    up: np.ndarray
    toward: np.ndarray

    @classmethod
    def of(cls, azimuth: float, elevation: float) -> Self:
        """The view from an azimuth about z and an elevation above the plane of x and y, rad."""
        (c, low), (s, high) = np.cos([azimuth, elevation]), np.sin([azimuth, elevation])
        toward, right = np.array([low * c, low * s, high]), np.array([-s, c, 0.0])
        return cls(right, np.cross(toward, right), toward)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) as (..., 2), to the right and up, in the same unit."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


@dataclass(frozen=True)
class Outline:
    """A polygon (M, 2), mm, of a body of the `arm`, the `tool` or an `artefact`; `shade` is 0 (dark) to 1."""

    kind: str
    polygon: np.ndarray
    depth: float  # mm towards the viewer
    shade: float = 1.0
    joint: int = -1  # with which it moves, 0 for the base; -1: an artefact


def arm_drawing(scene: Scene) -> dict[str, Any]:
    """``arm`` of fit.json and gap.json: the nominal arm at link angles of zero, and the artefacts; F0.

    `links_mm` are the origins of the base, of the frame of each joint and of the flange, and `axes` the unit
    vectors of the joints. A pose follows by rotations about the axes, from the last joint to the first.
    With prismatic joints `units` are those of the joints' coordinates, deg or mm: they shift along their
    axes. `capsules` are all points within `radius_mm` of a segment; each moves with the joints up to `joint`
    (0: with none). `artefacts` are boxes (half sizes along the rows of `axes`) and spheres.
    """
    dataset, chain = scene.dataset, scene.chain
    frames = reference.frames(chain, np.zeros((1, chain.n)))[0]
    first = int(dataset.measurements.tool[0]) if len(dataset.measurements.tool) else 0
    capsules = [
        {
            "joint": min(c.frame, chain.n),
            "of": "tool" if c.frame > chain.n else "arm",
            "ends_mm": plain(np.round(MM * (np.stack([c.a, c.b]) @ pose[:3, :3].T + pose[:3, 3]), 3)),
            "radius_mm": round(MM * c.radius, 3),
        }
        for c in arm_capsules(dataset.robot, dataset.tools[first])
        for pose in (frames[c.frame],)
    ]
    return {
        "robot": dataset.robot.name,
        "joints": list(dataset.robot.joint_names),
        "links_mm": plain(np.round(MM * frames[:, :3, 3], 3)),
        "axes": plain(np.round(frames[1:-1, :3, 2], 6)),
        **({"units": list(dataset.robot.units)} if dataset.robot.slides.any() else {}),
        "capsules": capsules,
        "artefacts": list(_artefacts(scene)),
    }


def _artefacts(scene: Scene) -> Iterator[dict[str, Any]]:
    for solid in scene_of(scene.dataset, with_table=False).solids:
        shape = solid.shapes[0]
        if isinstance(shape, Box):
            yield {
                "name": solid.name,
                "centre_mm": plain(np.round(MM * shape.pose[:3, 3], 3)),
                "axes": plain(np.round(shape.pose[:3, :3].T, 6)),
                "half_mm": plain(np.round(MM * shape.half, 3)),
            }
        elif isinstance(shape, Capsule) and not shape.length:  # a ball
            centre = plain(np.round(MM * shape.a, 3))
            yield {"name": solid.name, "centre_mm": centre, "radius_mm": round(MM * shape.radius, 3)}


def placed(arm: Json, angles: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation (3, 3) and shift (3,), mm, of what moves with the joints up to each, at link angles (n,), rad.

    Prismatic joints shift by mm. The first moves with none. A product of exponentials (Lynch and Park,
    Modern Robotics, 2017, 4.1).
    """
    links, axes = np.array(arm["links_mm"], float), np.array(arm["axes"], float)
    turn, shift = np.eye(3), np.zeros(3)
    out = [(turn, shift)]
    units = arm.get("units", ["deg"] * len(axes))
    for origin, (x, y, z), angle, unit in zip(links[1:-1], axes, angles, units, strict=True):
        if unit == "mm":
            shift = shift + angle * turn @ [x, y, z]
        else:
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
            turn, shift = turn @ rotation, turn @ (origin - rotation @ origin) + shift
        out.append((turn, shift))
    return out


def joints_of(record: Json) -> np.ndarray:
    """Coordinates of the joints, (N, n), of the rows of a record: deg, or as ``arm.units`` states."""
    rows = record["rows"]
    return np.array(rows.get("angle_deg", rows.get("joint")), float)


def of_units(arm: Json, shown: np.ndarray) -> np.ndarray:
    """Coordinates of joints (n,) of the rows of a record as `placed` takes them: rad and mm."""
    return np.where(np.array(arm.get("units", "deg")) == "mm", shown, np.radians(shown))


def typical(angles: np.ndarray) -> int:
    """The row of angles (N, n) that is nearest to the median of all, by the spread of each joint."""
    scale = np.maximum(np.std(angles, axis=0), 1e-6)
    return int(np.argmin(np.sum(((angles - np.median(angles, axis=0)) / scale) ** 2, axis=1)))


def posed(arm: Json, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Base, joints and flange (n + 2, 3), mm, and axes of joints (n, 3) in F0, at link angles (n,), rad."""
    links, axes = np.array(arm["links_mm"], float), np.array(arm["axes"], float)
    moved = placed(arm, angles)
    carried = [moved[0], *moved]  # a joint turns what follows it
    points = [turn @ origin + shift for (turn, shift), origin in zip(carried, links, strict=True)]
    return np.array(points), np.array([turn @ axis for (turn, _), axis in zip(moved, axes, strict=False)])


def outlines(arm: Json, angles: np.ndarray, view: View) -> list[Outline]:
    """Outlines of arm, tool and artefacts at link angles (n,), rad, from far to near."""
    moved = placed(arm, angles)
    out = []
    for c in arm["capsules"]:
        turn, shift = moved[c["joint"]]
        ends = np.array(c["ends_mm"], float) @ turn.T + shift
        depth = float(np.mean(ends @ view.toward))
        first, last = view.seen(ends)
        out.append(Outline(c["of"], stadium(first, last, c["radius_mm"]), depth, joint=c["joint"]))
    for body in arm["artefacts"]:
        centre = np.array(body["centre_mm"], float)
        depth = float(centre @ view.toward)
        if "radius_mm" in body:
            middle = view.seen(centre)
            out.append(Outline("artefact", stadium(middle, middle, body["radius_mm"]), depth))
            continue
        axes, half = np.array(body["axes"], float), np.array(body["half_mm"], float)
        for normal in FACES:
            lit = float(normal @ axes @ view.toward)
            if lit > 1e-6:
                out.append(Outline("artefact", view.seen(centre + _face(normal, half) @ axes), depth, lit))
    return sorted(out, key=lambda o: o.depth)


def _face(normal: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Corners (4, 3) of a face of a box about its centre, along its own axes."""
    u, v = (np.eye(3)[k] for k in range(3) if not normal[k])
    return np.array([normal + a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * half


def stadium(a: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    """The outline (M, 2) of all points within a radius of the segment from `a` to `b` (2,)."""
    along = b - a
    half = np.arctan2(along[1], along[0]) - 0.5 * np.pi + np.linspace(0.0, np.pi, ROUND)
    circle = radius * np.stack([np.cos(half), np.sin(half)], axis=1)
    return np.vstack([b + circle, a - circle])


def marks_of(sites: Sequence[Site]) -> dict[str, Any]:
    """What sites mark on the arm: numbers, from 1, of joints and links, and whether the base and the tip."""
    numbers = {f"{kind}s": [s.number for s in sites if s.kind == kind] for kind in ("joint", "link")}
    kinds = {s.kind for s in sites}
    return {**numbers, "base": "base" in kinds, "tip": bool(kinds & {"tool", "probe"})}


def is_marked(o: Outline, marks: Json) -> bool:
    """Whether marks are on the body of an outline."""
    if o.kind == "tool":
        return bool(marks["tip"])
    return o.kind == "arm" and (o.joint in marks["links"] or (o.joint == 0 and marks["base"]))


def fill(axes: Any, some: Iterable[Outline], marks: Json | None = None) -> None:
    """Draw outlines, from far to near, into axes of matplotlib."""
    for o in some:
        colour: Any = COLOURS.get(o.kind, str(round(0.72 + 0.22 * o.shade, 3)))
        if marks and is_marked(o, marks):
            colour = MARKED, 0.55
        axes.fill(*o.polygon.T, facecolor=colour, edgecolor=COLOURS["edge"], lw=0.5, zorder=0.5)
