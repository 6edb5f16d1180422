"""What stands around the arm: the solids of the targets, and the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayescal.collision import FIXED, Box, Capsule, HalfSpace, Scene, Shape, Solid, on_table, scene_of
from bayescal.collision.scene import STEM, own_solids, up_of
from bayescal.dataset import Target
from bayescal.planning.pool import Region, Setup

THICK = 0.01
"""m: half of the thickness of a wall, of which only the probed face is known (assumed)."""
POST, CLEAR = 0.01, 0.015
"""m: radius of the post of a seat, and its distance below the centre of the ball (assumed)."""


def placements(names: Sequence[str]) -> list[str]:
    """Placement of the artefact of each target, by its name (``ball.A@1``: ``1``).

    "" where the target stays; a single placement stays.
    """
    own = [name.partition("@")[2] for name in names]
    return own if len({*own} - {""}) > 1 else [""] * len(own)


def scene(setup: Setup) -> Scene:
    """The solids of a setup: boxes and spheres (`scene_of`), walls, cylinders, posts of seats, the table.

    Without a stated table it is below the lowest solid; boxes stand on it by pedestals. A single placement
    of spheres is there all the time. Own solids of the session do not stand on anything.
    """
    dataset, up = setup.dataset, up_of(setup.dataset)
    known = scene_of(dataset, with_table=False)
    solids, of = list(known.solids), dict(known.of)
    for target in dataset.targets:
        if target.name in known.unknown:
            of[target.name] = len(solids)
            shape = _SOLIDS[target.kind](target, setup.regions[target.name])
            solids.append(Solid(target.name, (shape,)))
    of_target = dict(
        zip((t.name for t in dataset.targets), placements([t.name for t in dataset.targets]), strict=True)
    )
    of_solid = {solid: of_target[name] for name, solid in of.items()}
    solids = [replace(solid, placement=of_solid.get(k, "")) for k, solid in enumerate(solids)]
    if solids or setup.table is not None:
        solids = list(on_table(solids, up, setup.table))
    used = set(of_target.values())  # a single placement is there all the time
    own = [replace(s, placement=s.placement if s.placement in used else "") for s in own_solids(dataset)]
    return Scene((*solids, *own), of)


def table_height(around: Scene) -> float | None:
    """Height of the table, m, against gravity; None where there is none."""
    shapes = [solid.shapes[0] for solid in around.solids if solid.carries]
    return next((shape.offset for shape in shapes if isinstance(shape, HalfSpace)), None)


def _wall(target: Target, region: Region) -> Box:
    assert region.half is not None
    normal, half = np.asarray(target.values["normal"], float), np.linalg.norm(region.half, axis=1)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([*(region.half / half[:, None]), normal])
    pose[:3, 0] *= np.sign(np.linalg.det(pose[:3, :3]))
    pose[:3, 3] = region.centre - THICK * normal
    return Box(pose, np.append(half, THICK))


def _pin(target: Target, region: Region) -> Capsule:
    assert region.half is not None
    radius = 0.5 * float(target.values["diameter"])
    return Capsule(FIXED, region.centre - region.half[0], region.centre + region.half[0], radius, target.name)


def _post(target: Target, region: Region) -> Capsule:
    """Below a seat, or the pivot of a ball bar."""
    assert region.up is not None
    below = region.centre - (CLEAR + POST) * region.up
    return Capsule(FIXED, below, below - STEM * region.up, POST, target.name)


_SOLIDS: dict[str, Callable[[Target, Region], Shape]] = {
    "plane": _wall,
    "cylinder": _pin,
    "fixed-point": _post,
    "distance": _post,
}
