"""Information that is stated before a session: the tool, nominal targets, and their certificates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.arm.robot import Robot
from bayescal.dataset import Certificate, Dataset, Measurements, Noise, Target, Tool
from bayescal.robots import builtin_robots
from bayescal.simulation.options import Options
from bayescal.simulation.scenery import DIAMETER, SIZE, U_ANGLE, U_DISTANCE, U_SPHERE, Cube

RADIUS = 0.003  # m, of the ball
TOOL = Tool("ball", np.array([0.06, 0.0, 0.12]), RADIUS, 0.8, np.array([0.02, 0.0, 0.06]))
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s2
LEAST_NOISE = 1e-6  # m: stated noise where none is simulated


@dataclass(frozen=True)
class Scenery:
    """Nominal objects: the cube, its four faces, sphere centres (placements, spheres, 3), m."""

    cube: Cube
    faces: tuple[str, ...]
    spheres: np.ndarray

    @property
    def targets(self) -> tuple[Target, ...]:
        """The targets as stated in dataset.yaml."""
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


def dataset_of(options: Options, robot: Robot, scenery: Scenery, measurements: Measurements) -> Dataset:
    """The measurements of the session with the content of dataset.yaml."""
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
        source=f"simulated (bayescal simulate, seed {options.seed}); its ground truth is in truth.json",
    )


def _certificates(scenery: Scenery) -> tuple[Certificate, ...]:
    """Certificates of the cube and the spheres; distances between spheres are added with the truth."""
    out = []
    a, opposite, side, top = (f"cube.{face}" for face in scenery.faces)
    out.append(Certificate("parallel", (a, opposite), SIZE, U_DISTANCE, U_ANGLE))
    for pair in ((a, side), (a, top), (side, top)):
        out.append(Certificate("perpendicular", pair, u_angle=U_ANGLE))
    for name in sphere_names(*scenery.spheres.shape[:2]):
        out.append(Certificate("diameter", (name,), u_distance=U_SPHERE))
    return tuple(out)
