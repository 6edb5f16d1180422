"""The session: what is touched, in which order, when, and with what hanging on the flange."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.arm.robot import Robot
from bayescal.dataset import Certificate, Dataset, Measurements, Noise, Target, Tool
from bayescal.errors import BayescalError
from bayescal.robots import builtin_robots
from bayescal.simulate.options import GROUP, Options, stream
from bayescal.simulate.place import place_cube, place_spheres
from bayescal.simulate.probing import Contacts, join, on_face
from bayescal.simulate.reach import Arm
from bayescal.simulate.scenery import DIAMETER, SIZE, U_ANGLE, U_DISTANCE, U_SPHERE, Cube

TOOL = Tool("ball", np.array([0.06, 0.0, 0.12]), 0.003, 0.8, np.array([0.02, 0.0, 0.06]))
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s2
LEAST_NOISE = 1e-6  # m: stated where none is simulated
PAUSE = {"spheres": 120.0, "later": 1800.0}  # s, to set up the artefact, to have lunch
COLD, WARMER, WARMING = 22.0, 4.0, 3000.0  # degC, K, s


@dataclass(frozen=True)
class Scenery:
    """What stands there, nominally: the cube, its four faces, sphere centres (placements, spheres, 3), m."""

    cube: Cube
    faces: tuple[str, ...]
    spheres: np.ndarray

    @property
    def targets(self) -> tuple[Target, ...]:
        """The targets as dataset.yaml knows them."""
        planes = [
            Target(f"cube.{f}", "plane", {"normal": self.cube.normal(f), "offset": self.cube.offset(f)})
            for f in self.faces
        ]
        names = sphere_names(*self.spheres.shape[:2])
        centres = self.spheres.reshape(-1, 3)
        balls = [
            Target(name, "sphere", {"centre": centre, "diameter": DIAMETER})
            for name, centre in zip(names, centres, strict=True)
        ]
        return (*planes, *balls)


def sphere_names(placements: int, spheres: int) -> list[str]:
    """Names of the spheres, placement by placement."""
    return [f"ball.{chr(ord('A') + k)}@{p + 1}" for p in range(placements) for k in range(spheres)]


def plan(options: Options, robot: Robot) -> tuple[Dataset, Scenery]:
    """The session as planned: readings at which the nominal arm touches the nominal targets.

    Raises
    ------
    BayescalError
        If too little of the cube or the spheres can be reached.
    """
    assert TOOL.ball_radius is not None
    arm, radius = Arm(robot, TOOL.centre), TOOL.ball_radius
    cube, faces = place_cube(arm, radius, stream(options.seed, "cube"))
    rng = stream(options.seed, "faces")
    groups, singles = options.repeats, options.contacts - GROUP * options.repeats
    parts, targets, repeat, role = [], [], [], []

    def take(kind: str, contacts: Contacts, target: int | np.ndarray, group: list[str]) -> None:
        parts.append(contacts)
        targets.append(np.broadcast_to(target, len(contacts)))
        repeat.extend(group)
        role.extend([kind] * len(contacts))

    face_of, found = _shuffled(arm, cube, faces, radius, singles + groups, rng)
    times = np.ones(singles + groups, int)
    times[rng.choice(len(times), groups, replace=False)] = GROUP
    rows = np.repeat(np.arange(len(times)), times)
    label = np.where(times > 1, np.cumsum(times > 1), 0)[rows]
    take("calibrate", found[rows], face_of[rows], [f"r{k:02d}" if k else "" for k in label])
    pauses = {}
    centres = np.empty((options.placements if options.spheres else 0, options.spheres, 3))
    for p in range(len(centres)):
        own = stream(options.seed, "spheres", str(p))
        centres[p], balls = place_spheres(arm, cube, options.spheres, radius, options.sphere_contacts, p, own)
        pauses[len(role)] = PAUSE["spheres"]
        for k, ball in enumerate(balls):
            take("validate", ball, len(faces) + p * options.spheres + k, [""] * len(ball))
    pauses[len(role)] = PAUSE["later"]
    face_of, found = _shuffled(arm, cube, faces, radius, options.later, stream(options.seed, "later"))
    take("validate", found, face_of, [""] * len(found))

    contacts, target = join(parts), np.concatenate(targets)
    scenery = Scenery(cube, faces, centres)
    clock = stream(options.seed, "clock")
    time = np.cumsum(clock.uniform(6.0, 14.0, len(target)) + [pauses.get(i, 0.0) for i in range(len(target))])
    warm = COLD + WARMER * (1 - np.exp(-time / WARMING)) + clock.normal(0, 0.03, len(time))
    measurements = Measurements(
        ids=tuple(f"c{i:04d}" for i in range(len(target))),
        role=np.array(role),
        target=target,
        tool=np.zeros(len(target), int),
        readings=contacts.readings,
        line=np.arange(len(target)) + 2,
        velocity=contacts.velocity,
        time=np.round(time, 2),
        temperature=np.round(warm, 2),
        payload=_payload(options, np.array(repeat), target < len(faces)),
        repeat=np.array(repeat),
    )
    return _dataset(options, robot, scenery, measurements), scenery


def _shuffled(
    arm: Arm, cube: Cube, faces: tuple[str, ...], radius: float, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, Contacts]:
    """Contacts on all the faces alike, in random order, with the index of each one's face."""
    target = np.sort(rng.permutation(count) % len(faces))
    parts = []
    for k, face in enumerate(faces):
        wanted, have = int(np.sum(target == k)), 0
        for _ in range(20):
            _, found = on_face(arm, cube, face, radius, 2 * (wanted - have) + 8, rng)
            found = found[: wanted - have]
            parts.append(found)
            have += len(found)
            if have == wanted:
                break
        else:
            raise BayescalError(
                f"face {face} of the cube is hardly reached", arm.robot.name, "check its limits"
            )
    order = rng.permutation(count)
    return target[order], join(parts)[order]


def _payload(options: Options, repeat: np.ndarray, on_plane: np.ndarray) -> np.ndarray | None:
    """Payloads (N,), kg, on half of the plane contacts, alike within a repeat group; None without."""
    if not options.payload:
        return None
    rng = stream(options.seed, "payload")
    loaded = rng.random(len(repeat)) < 0.5
    for group in np.unique(repeat[repeat != ""]):
        loaded[repeat == group] = rng.random() < 0.5
    return np.where(loaded & on_plane, options.payload, 0.0)


def _dataset(options: Options, robot: Robot, scenery: Scenery, measurements: Measurements) -> Dataset:
    return Dataset(
        name=options.name,
        folder=Path(),
        robot=robot,
        robot_reference=options.robot if options.robot in builtin_robots() else "robot.yaml",
        readings="encoder",
        gravity=GRAVITY,
        tools=(TOOL,),
        noise=Noise(contact=max(options.noise, LEAST_NOISE), joint=options.joint_noise),
        targets=scenery.targets,
        certificates=_certificates(scenery),
        measurements=measurements,
        temperature_of="arm",
        source=f"simulated (bayescal simulate, seed {options.seed}); its truth is in truth.json",
    )


def _certificates(scenery: Scenery) -> tuple[Certificate, ...]:
    """What the papers say of the cube and the spheres; distances between spheres are added with the truth."""
    out = []
    a, opposite, side, top = (f"cube.{face}" for face in scenery.faces)
    out.append(Certificate("parallel", (a, opposite), SIZE, U_DISTANCE, U_ANGLE))
    for pair in ((a, side), (a, top), (side, top)):
        out.append(Certificate("perpendicular", pair, u_angle=U_ANGLE))
    for name in sphere_names(*scenery.spheres.shape[:2]):
        out.append(Certificate("diameter", (name,), u_distance=U_SPHERE))
    return tuple(out)
