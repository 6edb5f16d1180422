"""What stands around the arm: the solids of the targets, and the table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayescal.collision import FIXED, Box, Capsule, HalfSpace, Scene, Shape, Solid, scene_of
from bayescal.dataset import Target
from bayescal.planning.pool import Region, Setup
from bayescal.planning.regions import up_of

THICK = 0.01
"""m: half of the thickness of a wall, of which only the probed face is known (assumed)."""


def scene(setup: Setup) -> Scene:
    """The solids of a setup: boxes and spheres (`scene_of`), walls behind other faces, cylinders, the table.

    Without a stated table it is below the lowest solid. A single placement of spheres is there all the time.
    """
    dataset = setup.dataset
    known = scene_of(dataset, with_table=setup.table is None)
    solids, of = list(known.solids), dict(known.of)
    for target in dataset.targets:
        if target.name in known.unknown and target.kind in _SOLIDS:
            of[target.name] = len(solids)
            shape = _SOLIDS[target.kind](target, setup.regions[target.name])
            solids.append(Solid(target.name, (shape,), target.name.partition("@")[2]))
    if len({solid.placement for solid in solids} - {""}) == 1:
        solids = [replace(solid, placement="") for solid in solids]
    if setup.table is not None:
        solids.append(Solid("table", (HalfSpace(up_of(dataset), setup.table),), carries=True))
    return Scene(tuple(solids), of)


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


_SOLIDS: dict[str, Callable[[Target, Region], Shape]] = {"plane": _wall, "cylinder": _pin}
