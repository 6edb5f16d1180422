"""Artefacts that a set-up can start from: nominal targets within reach, and their certificates.

JSON schemas of dataset.yaml and robot.yaml, with which editors complete and check these files.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import chain, combinations
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rpy_matrix, rpy_of
from bayescal.dataset import Certificate, Patch, Target
from bayescal.dataset.schema import file_model
from bayescal.dataset.session import ArtefactFile
from bayescal.errors import BayescalError
from bayescal.probing.motions import Arm
from bayescal.probing.placement import cube_of, placement
from bayescal.probing.scene import LARGE, U_SPHERE, Cube, Scenery, Sizes
from bayescal.robots.schema import RobotFile
from bayescal.storage.files import Keys, stem_of
from bayescal.storage.reading import table_beside

SPHERES, PLACEMENTS, ON_SPHERE = 3, 4, 11
"""Spheres of the artefact, its placements, and contacts on each sphere."""
TILTS = ((0.0, 0.0), (0.0, -45.0), (40.0, 0.0), (-40.0, 0.0))
"""deg: roll and pitch of each placement of the plate."""
PLATE, SEATS, BAR = 0.25, 0.2, 0.3
"""m: edge of the plate, distance of neighbouring seats, length of the bar (examples)."""
U_SEAT, U_FORM = 5e-6, 3e-6  # m: examples
PIVOTS = (-0.3, 0.0, 0.3)
"""Of the reach: positions of the pivot of the bar, across."""
AWAY = (3.0, 0.0, 0.5)
"""m: the instrument, seen from the base."""


@dataclass(frozen=True)
class Room:
    """Where artefacts can be: the arm, and the cube that it reaches with its four faces."""

    arm: Arm
    cube: Cube
    faces: tuple[str, ...]

    @classmethod
    def of(cls, robot: Robot) -> Room:
        """The room of a robot with the example tool.

        Raises
        ------
        BayescalError
            If the arm is too small to reach anything.
        """
        arm = Arm(robot, Sizes.of(robot).tool.centre)
        return cls(arm, *cube_of(arm))

    @property
    def diameter(self) -> float:
        """Of spheres, m."""
        return Sizes.of(self.arm.robot).diameter

    @property
    def scale(self) -> float:
        """Size of artefacts relative to those of an industrial arm."""
        return Sizes.of(self.arm.robot).edge / LARGE.edge


@dataclass(frozen=True)
class Outline:
    """Targets at nominal places, certificates with example values, regions where contacts may be."""

    targets: tuple[Target, ...]
    certificates: tuple[Certificate, ...] = ()
    regions: Mapping[str, Patch] = field(default_factory=dict)


@dataclass(frozen=True)
class Artefact:
    """An artefact: what it is, its outline in a room, and the tool.

    What to measure on it is in `templates/measure`. `certified` are keys of its targets that a certificate
    states; `columns` those of measurements.csv that its rows need beyond the joints.
    """

    name: str
    summary: str
    outline: Callable[[Room], Outline]
    tool: str = "probe"
    certified: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()


def _cube(room: Room) -> Outline:
    scenery = Scenery(room.cube, room.faces, np.empty((0, 0, 3)), room.diameter)
    return Outline(scenery.targets, scenery.certificates)


def _spheres(room: Room) -> Outline:
    centres = np.empty((PLACEMENTS, SPHERES, 3))
    for turn in range(PLACEMENTS):
        centres[turn], _ = placement(room.arm, SPHERES, ON_SPHERE, 0, turn)
    scenery = Scenery(room.cube, (), centres, room.diameter)
    balls = scenery.targets
    placements = [balls[k : k + SPHERES] for k in range(0, len(balls), SPHERES)]
    pairs = chain.from_iterable(combinations(placed, 2) for placed in placements)
    return Outline(balls, (*scenery.certificates, *(_apart(a, b, U_SPHERE) for a, b in pairs)))


def _plate(room: Room) -> Outline:
    """One plate in several orientations: planes at different angles."""
    targets, regions = [], {}
    for k, tilt in enumerate(TILTS):
        normal = room.cube.axes @ rpy_matrix(np.radians([*tilt, 0.0]))[:, 2]
        name, offset = f"plate@{k + 1}", float(normal @ room.cube.centre)
        targets.append(Target(name, "plane", {"normal": normal, "offset": offset}))
        regions[name] = Patch(room.cube.centre, np.full(2, room.scale * PLATE))
    flat = tuple(Certificate("flat", (t.name,), u_form=U_FORM) for t in targets)
    return Outline(tuple(targets), flat, regions)


def _seats(room: Room) -> Outline:
    corners = 0.5 * room.scale * SEATS * np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]])
    seats = zip("ABCD", room.cube.centre + corners @ room.cube.axes.T, strict=True)
    targets = [Target(f"seat.{letter}", "fixed-point", {"centre": centre}) for letter, centre in seats]
    return Outline(tuple(targets), tuple(_apart(a, b, U_SEAT) for a, b in combinations(targets, 2)))


def _bar(room: Room) -> Outline:
    low, reach = -0.5 * room.cube.edge, room.arm.reach
    centres = [np.round(room.cube.centre + room.cube.axes @ [0.0, y * reach, low], 3) for y in PIVOTS]
    places = [{"centre": centre, "length": room.scale * BAR} for centre in centres]
    return Outline(tuple(Target(f"bar@{k}", "distance", place) for k, place in enumerate(places, 1)))


def _tracker(room: Room) -> Outline:
    base = room.arm.mount
    frame = base[:3, :3] @ np.diag([-1.0, -1.0, 1.0])  # it looks at the arm
    place = {"xyz": base[:3, 3] + base[:3, :3] @ np.array(AWAY), "rpy": rpy_of(frame)}
    return Outline((Target("tracker", "instrument", place),))


def _apart(one: Target, other: Target, u: float) -> Certificate:
    length = np.linalg.norm(np.asarray(one.values["centre"]) - np.asarray(other.values["centre"]))
    return Certificate("distance", (one.name, other.name), round(float(length), 6), u)


TABLE = table_beside(__file__, "artefacts.toml")
OUTLINES = {
    "cube": _cube, "spheres": _spheres, "plate": _plate, "socket": _seats, "bar": _bar, "tracker": _tracker,
}  # fmt: skip
ARTEFACTS = {name: Artefact(name, outline=OUTLINES[name], **of) for name, of in TABLE["artefacts"].items()}
"""Artefacts by name. Example values of certificates are marked to be filled in."""

JOINTS = 6
"""Joints of a robot.yaml that is to be filled in: most arms have as many."""

DIALECT = "https://json-schema.org/draft/2020-12/schema"
UNITS = TABLE["units"]
"""Units of keys that are not written as in the key."""

MODELS: dict[str, Callable[[], type[Keys]]] = {
    "dataset": file_model,
    "robot": lambda: RobotFile,
    "artefact": lambda: ArtefactFile,
}
"""Models of the files, by name."""


def schema_of(name: str) -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a file that users write, from the models that read it.

    Parameters
    ----------
    name : str
        Of `MODELS`.

    Raises
    ------
    BayescalError
        If there is no such file.
    """
    if name not in MODELS:
        raise BayescalError(f"there is no schema `{name}`", "schema", f"known: {', '.join(MODELS)}")
    schema = MODELS[name]().model_json_schema(by_alias=True)
    for part in (schema, *schema.get("$defs", {}).values()):
        for key, entry in part.get("properties", {}).items():
            entry.pop("title", None)
            if (unit := stem_of(key)[1]) and "description" in entry:
                entry["description"] += f" Unit: {UNITS.get(unit, unit)}."
    return {"$schema": DIALECT, **schema, "title": f"{name}.yaml of bayescal"}


def schema_text(name: str) -> str:
    """The schema of `schema_of` as text."""
    return json.dumps(schema_of(name), indent=1, ensure_ascii=False) + "\n"
