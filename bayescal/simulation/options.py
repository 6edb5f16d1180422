"""Options of a simulated session.

Information that is stated before a session: the tool, nominal targets, and their certificates.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Certificate, Dataset, Measurements, Noise, Target, Tool
from bayescal.effects import BASELINE, EFFECTS
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.probing.approach import DIAMETER, SIZE, U_ANGLE, U_DISTANCE, U_SPHERE, Cube
from bayescal.robots import builtin_robots

GROUP = 4  # contacts of a repeat group
FEWEST_ON_SPHERE = 6
LARGEST_SCALE = 4.0
"""Error scale from which on a parameter is usually further from nominal than a fit accepts without a warning
(`assess.findings.FAR` prior standard deviations); contacts on spheres miss them from about 5 on."""


@dataclass(frozen=True)
class Options:
    """A session to simulate. Counts are of contacts, except `spheres` of an artefact and its `placements`.

    `arm_seed` is the seed of the true arm and its tool, to simulate another session of the same arm; None
    for the seed of the session. `contacts` are for calibration, including repeats (groups of four); `later`
    are on the same faces, for validation. `error_scale` multiplies every deviation of the true arm.
    `noise` (m) is the noise of a contact, `joint_noise` (rad) that of a reading, `outliers` the fraction of
    gross contacts, `payload` (kg) is attached for half of the plane contacts.
    """

    robot: str = "fanuc-lrmate200ic"
    effects: tuple[str, ...] = BASELINE
    name: str = "simulated"
    seed: int = 0
    error_scale: float = 1.0
    contacts: int = 500
    later: int = 60
    repeats: int = 15
    spheres: int = 3
    placements: int = 4
    sphere_contacts: int = 11
    noise: float = 5e-6
    joint_noise: float = 0.0
    outliers: float = 0.0
    payload: float = 0.0
    arm_seed: int | None = None

    @property
    def seed_of_arm(self) -> int:
        """Seed of the true arm."""
        return self.seed if self.arm_seed is None else self.arm_seed

    def check(self) -> None:
        """Raise an error for invalid options.

        Raises
        ------
        BayescalError
            With the option.
        """
        for option in (
            "seed",
            "error_scale",
            "later",
            "repeats",
            "spheres",
            "placements",
            "noise",
            "joint_noise",
            "payload",
        ):
            value = getattr(self, option)
            if not (np.isfinite(value) and value >= 0):
                raise BayescalError("a negative value makes no sense", flag(option), "give 0 or more")
        if self.error_scale > LARGEST_SCALE:
            what = (
                f"{self.error_scale:g} times its tolerances is no error of an arm that a calibration corrects"
            )
            raise BayescalError(what, "--error-scale", f"give {LARGEST_SCALE:g} or less")
        for name in self.effects:
            if (effect := plain(name)) not in EFFECTS:
                what = f"no effect is called `{effect}`"
                raise BayescalError(what, "--effects", f"known: {', '.join(EFFECTS)}")
        if self.seed_of_arm < 0:
            raise BayescalError("a negative value makes no sense", "--arm-seed", "give 0 or more")
        if not 0 <= self.outliers < 0.5:
            raise BayescalError(f"{self.outliers:g} is no fraction of contacts", "--outliers", "0 to 0.5")
        if self.contacts < 16:
            raise BayescalError(f"{self.contacts} contacts are too few", "--contacts", "give 16 or more")
        if GROUP * self.repeats > self.contacts:
            what = f"{self.repeats} groups of {GROUP} are more than the {self.contacts} contacts"
            raise BayescalError(what, "--repeats", "give fewer repeats or more contacts")
        if self.spheres and self.placements and self.sphere_contacts < FEWEST_ON_SPHERE:
            what = f"{self.sphere_contacts} contacts cannot locate a sphere"
            raise BayescalError(what, "--sphere-contacts", f"give {FEWEST_ON_SPHERE} or more")
        if self.spheres > 8:
            raise BayescalError(
                f"{self.spheres} spheres are too many for one artefact", "--spheres", "give 8 or fewer"
            )


def flag(option: str) -> str:
    """Name of an option on the command line."""
    unit = {"noise": "-um", "joint_noise": "-deg"}.get(option, "")
    return f"--{option.replace('_', '-')}{unit}"


def stream(seed: int, *names: str) -> np.random.Generator:
    """An independent generator for each name, so that draws of one part do not change those of another."""
    words = [int.from_bytes(name.encode(), "little") for name in names]
    return np.random.default_rng(np.random.SeedSequence([seed, *words]))


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
