"""A session to simulate: its options, and its plan with targets, order, times and payloads."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Dataset, Measurements, Noise
from bayescal.effects import BASELINE, EFFECTS
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.probing.contacts import Contacts
from bayescal.probing.motions import Arm
from bayescal.probing.placement import among, cube_of, on_face, placement
from bayescal.probing.scene import Scenery, Sizes
from bayescal.robots import builtin_robots
from bayescal.statistics import stream

GROUP = 4  # contacts of a repeat group
FEWEST_ON_SPHERE = 6
LARGEST_SCALE = 4.0
"""Error scale from which on a parameter is usually further from nominal than a fit accepts without a warning
(`assess.findings.FAR` prior standard deviations); contacts on spheres miss them from about 5 on."""

NOT_NEGATIVE = (
    *("seed", "arm_seed", "error_scale", "later", "repeats", "spheres", "placements"),
    *("noise", "joint_noise", "payload"),
)
"""Options of a session that must be finite, and 0 or more."""


@dataclass(frozen=True)
class Options:
    """A session to simulate. Counts are of contacts, except `spheres` of an artefact and its `placements`.

    `arm_seed` is the seed of the true arm, its tool and the artefacts, to simulate another session of the
    same arm; None for the seed of the session. `contacts` are for calibration, including repeats (groups of
    four); `later` are on the same faces, for validation. `error_scale` multiplies every deviation of the true
    arm. `noise` (m) is the noise of a contact, `joint_noise` (rad) that of a reading, `outliers` the fraction
    of gross contacts, `payload` (kg) is attached for half of the plane contacts.
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
        for option in NOT_NEGATIVE:
            value = getattr(self, option)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise BayescalError("a negative value makes no sense", flag(option), "give 0 or more")
        if self.error_scale > LARGEST_SCALE:
            what = "times its tolerances is no error of an arm that a calibration corrects"
            remedy = f"give {LARGEST_SCALE:g} or less"
            raise BayescalError(f"{self.error_scale:g} {what}", "--error-scale", remedy)
        for name in self.effects:
            if (effect := plain(name)) not in EFFECTS:
                what = f"no effect is called `{effect}`"
                raise BayescalError(what, "--effects", f"known: {', '.join(EFFECTS)}")
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
            what = f"{self.spheres} spheres are too many for one artefact"
            raise BayescalError(what, "--spheres", "give 8 or fewer")


def flag(option: str) -> str:
    """Name of an option on the command line."""
    unit = {"noise": "-um", "joint_noise": "-deg"}.get(option, "")
    return f"--{option.replace('_', '-')}{unit}"


GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s2
LEAST_NOISE = 1e-6  # m: stated noise where none is simulated


def dataset_of(options: Options, robot: Robot, scenery: Scenery, measurements: Measurements) -> Dataset:
    """The measurements of the session with the content of dataset.yaml."""
    return Dataset(
        name=options.name,
        folder=Path(),
        robot=robot,
        robot_reference=options.robot if options.robot in builtin_robots() else "robot.yaml",
        readings="encoder",
        gravity=GRAVITY,
        tools=(Sizes.of(robot).tool,),
        noise=Noise(contact=max(options.noise, LEAST_NOISE), joint=options.joint_noise),
        targets=scenery.targets,
        certificates=scenery.certificates,  # distances between spheres are added with the truth
        measurements=measurements,
        temperature_of="arm",
        source=f"simulated (bayescal simulate, seed {options.seed}); its ground truth is in truth.json",
    )


SET_UP, LUNCH = 120.0, 1800.0  # s: before the spheres of a placement, before the later contacts
PACE = 6.0, 14.0  # s per contact
COLD, WARMER, WARMING = 22.0, 4.0, 3000.0  # degC, K, s


@dataclass(frozen=True)
class Visit:
    """Consecutive contacts: indices of their targets (M,), their repeat groups."""

    role: str
    contacts: Contacts
    target: np.ndarray
    repeat: np.ndarray
    pause: float = 0.0  # s, before the first


def plan(options: Options, robot: Robot) -> tuple[Dataset, Scenery]:
    """The planned session: readings at which the nominal arm touches the nominal targets.

    Raises
    ------
    BayescalError
        If too little of the cube or the spheres can be reached.
    """
    arm = Arm(robot, Sizes.of(robot).tool.centre)
    cube, faces = cube_of(arm)
    visits = [_calibrating(arm, options.contacts, options.repeats, options.seed)]
    centres = np.empty((options.placements if options.spheres else 0, options.spheres, 3))
    for p in range(len(centres)):
        centres[p], balls = placement(arm, options.spheres, options.sphere_contacts, options.seed, p)
        for k, ball in enumerate(balls):
            target = np.full(len(ball), len(faces) + p * options.spheres + k)
            visits.append(_visit("validate", ball, target, 0.0 if k else SET_UP))
    visits.append(_later(arm, options.later, options.seed))
    scenery = Scenery(cube, faces, centres, Sizes.of(robot).diameter)
    return dataset_of(options, robot, scenery, _measurements(options, visits, len(faces))), scenery


def _visit(role: str, contacts: Contacts, target: np.ndarray, pause: float) -> Visit:
    return Visit(role, contacts, target, np.full(len(contacts), ""), pause)


@lru_cache(maxsize=64)
def _calibrating(arm: Arm, count: int, repeats: int, seed: int) -> Visit:
    """Contacts on all faces in random order, of which `repeats` are made `GROUP` times in a row."""
    rng = stream(seed, "faces")
    different = count - (GROUP - 1) * repeats
    target, contacts = _shuffled(arm, different, rng)
    rows, groups = grouped(different, repeats, rng)
    return Visit("calibrate", contacts[rows], target[rows], groups)


def grouped(different: int, repeats: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (N,) of contacts, some made `GROUP` times in a row, and the names of their groups, or ""."""
    times = np.ones(different, int)
    times[rng.choice(different, repeats, replace=False)] = GROUP
    names = np.array([f"r{k:02d}" if k else "" for k in np.where(times > 1, np.cumsum(times > 1), 0)])
    rows = np.repeat(np.arange(different), times)
    return rows, names[rows]


@lru_cache(maxsize=64)
def _later(arm: Arm, count: int, seed: int) -> Visit:
    """The later contacts on the faces, for validation."""
    target, contacts = _shuffled(arm, count, stream(seed, "later"))
    return _visit("validate", contacts, target, LUNCH)


def _shuffled(arm: Arm, count: int, rng: np.random.Generator) -> tuple[np.ndarray, Contacts]:
    """Equally many contacts on all faces, in random order, with the index of the face of each."""
    cube, faces = cube_of(arm)
    hand = among(arm, cube)
    target = np.sort(rng.permutation(count) % len(faces))
    parts = []
    for k, face in enumerate(faces):
        wanted, have = int(np.sum(target == k)), 0
        for _ in range(20):
            parts.append(on_face(hand, cube, face, 2 * (wanted - have) + 8, rng)[: wanted - have])
            have += len(parts[-1])
            if have == wanted:
                break
        else:
            what = f"too few contacts on face {face} of the cube are within reach and clear of collisions"
            raise BayescalError(what, arm.robot.name, "check its limits")
    order = rng.permutation(count)
    return target[order], Contacts.join(parts)[order]


def _measurements(options: Options, visits: list[Visit], faces: int) -> Measurements:
    """The table of all visits; targets before `faces` are planes."""
    contacts = Contacts.join([v.contacts for v in visits])
    target, repeat = (np.concatenate([getattr(v, name) for v in visits]) for name in ("target", "repeat"))
    clock = stream(options.seed, "clock")
    steps = clock.uniform(*PACE, len(target))
    begins = np.cumsum([0] + [len(v.target) for v in visits[:-1]])
    for first, visit in zip(begins, visits, strict=True):
        steps[first : first + 1] += visit.pause
    time = np.cumsum(steps)
    warm = COLD + WARMER * (1 - np.exp(-time / WARMING)) + clock.normal(0, 0.03, len(time))
    return Measurements(
        ids=tuple(f"c{i:04d}" for i in range(len(target))),
        role=np.concatenate([np.full(len(v.target), v.role) for v in visits]),
        target=target,
        tool=np.zeros(len(target), int),
        readings=contacts.readings,
        line=np.arange(len(target)) + 2,
        velocity=contacts.velocity,
        time=np.round(time, 2),
        temperature=np.round(warm, 2),
        payload=_payload(options, repeat, target < faces),
        repeat=repeat,
    )


def _payload(options: Options, repeat: np.ndarray, on_plane: np.ndarray) -> np.ndarray | None:
    """Payloads (N,), kg, for half of the plane contacts, equal within a repeat group; None without."""
    if not options.payload:
        return None
    rng = stream(options.seed, "payload")
    loaded = rng.random(len(repeat)) < 0.5
    for group in np.unique(repeat[repeat != ""]):
        loaded[repeat == group] = rng.random() < 0.5
    return np.where(loaded & on_plane, options.payload, 0.0)
