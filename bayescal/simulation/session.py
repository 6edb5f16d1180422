"""The plan of a session: targets, order, times and payloads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Dataset, Measurements
from bayescal.errors import BayescalError
from bayescal.probing.arm import Arm
from bayescal.probing.artefacts import TOOL, Scenery
from bayescal.probing.contacts import Contacts
from bayescal.probing.placement import among, cube_of, on_face, placement
from bayescal.simulation.options import GROUP, Options, dataset_of
from bayescal.statistics import stream

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
    arm = Arm(robot, TOOL.centre)
    cube, faces = cube_of(arm)
    visits = [_calibrating(arm, options.contacts, options.repeats, options.seed)]
    centres = np.empty((options.placements if options.spheres else 0, options.spheres, 3))
    for p in range(len(centres)):
        centres[p], balls = placement(arm, options.spheres, options.sphere_contacts, options.seed, p)
        for k, ball in enumerate(balls):
            target = np.full(len(ball), len(faces) + p * options.spheres + k)
            visits.append(_visit("validate", ball, target, 0.0 if k else SET_UP))
    visits.append(_later(arm, options.later, options.seed))
    scenery = Scenery(cube, faces, centres)
    return dataset_of(options, robot, scenery, _measurements(options, visits, len(faces))), scenery


def _visit(role: str, contacts: Contacts, target: np.ndarray, pause: float) -> Visit:
    return Visit(role, contacts, target, np.full(len(contacts), ""), pause)


@lru_cache(maxsize=64)
def _calibrating(arm: Arm, count: int, repeats: int, seed: int) -> Visit:
    """Contacts on all faces in random order, of which `repeats` are made `GROUP` times in a row."""
    rng = stream(seed, "faces")
    different = count - (GROUP - 1) * repeats
    target, contacts = _shuffled(arm, different, rng)
    times = np.ones(different, int)
    times[rng.choice(different, repeats, replace=False)] = GROUP
    names = np.array([f"r{k:02d}" if k else "" for k in np.where(times > 1, np.cumsum(times > 1), 0)])
    rows = np.repeat(np.arange(different), times)
    return Visit("calibrate", contacts[rows], target[rows], names[rows])


@lru_cache(maxsize=64)
def _later(arm: Arm, count: int, seed: int) -> Visit:
    """The later contacts on the faces, for validation."""
    target, contacts = _shuffled(arm, count, stream(seed, "later"))
    return _visit("validate", contacts, target, LUNCH)


def _shuffled(arm: Arm, count: int, rng: np.random.Generator) -> tuple[np.ndarray, Contacts]:
    """Equally many contacts on all faces, in random order, with the index of the face of each."""
    cube, faces = cube_of(arm)
    clearance = among(arm, cube)
    target = np.sort(rng.permutation(count) % len(faces))
    parts = []
    for k, face in enumerate(faces):
        wanted, have = int(np.sum(target == k)), 0
        for _ in range(20):
            parts.append(on_face(arm, clearance, cube, face, 2 * (wanted - have) + 8, rng)[: wanted - have])
            have += len(parts[-1])
            if have == wanted:
                break
        else:
            raise BayescalError(
                f"too few contacts on face {face} of the cube are within reach and clear of collisions",
                arm.robot.name,
                "check its limits",
            )
    order = rng.permutation(count)
    return target[order], Contacts.join(parts)[order]


def _measurements(options: Options, visits: list[Visit], faces: int) -> Measurements:
    """The table of all visits; targets before `faces` are planes."""
    contacts = Contacts.join([v.contacts for v in visits])
    target, repeat = (np.concatenate([getattr(v, name) for v in visits]) for name in ("target", "repeat"))
    clock = stream(options.seed, "clock")
    steps = clock.uniform(*PACE, len(target))
    begins = np.cumsum([0] + [len(v.target) for v in visits[:-1]])
    for at, visit in zip(begins, visits, strict=True):
        steps[at : at + 1] += visit.pause
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
