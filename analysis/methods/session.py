"""Simulated sessions for methods: statements that are exactly true, and one that a tracker reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import frames
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import Certificate, Dataset, Noise, Target
from bayescal.robots import load_robot
from bayescal.simulation import Options, World, touch
from bayescal.simulation.record import draws
from bayescal.simulation.session import plan
from bayescal.statistics import stream

TURN, SHIFT = (2e-3, -1e-3, 1.5e-3), (0.8e-3, -0.5e-3, 0.6e-3)  # rad, m: how the cube was put down
TRACKER = (np.array([2.0, 0.5, 0.3]), np.array([0.1, -0.2, 2.8]))  # m, rad: its frame as stated
TRACKER_OFF = (np.array([2e-3, -1e-3, 1e-3]), np.array([1e-3, 2e-3, -2e-3]))  # m, rad: beside that
VALIDATION = 3  # every third row
LEAST_NOISE = 1e-6  # m: stated where there is none
GROSS = 0.3e-3  # m


@cache
def planned(options: Options) -> Dataset:
    """What is to be touched, and from where: laid out once for many arms."""
    robot, _ = load_robot(options.robot)
    return plan(options, robot)[0]


def touched(
    options: Options, arm: int = 0, noise: float = 0.0, shape_error: float = 0.0, outliers: float = 0.0
) -> Dataset:
    """A session on a cube and spheres made as they are drawn, the cube put down a little wrong.

    Parameters
    ----------
    options : Options
        Of the layout.
    arm : int
        Seed of the true arm, and of all that is drawn here.
    noise : float
        Of a contact, m.
    shape_error : float
        Standard deviation, m, of how far each face of the true cube lies from where it should be on it.
    outliers : float
        Fraction of contacts that are 0.3 mm off.
    """
    before = planned(options)
    before = replace(before, noise=Noise(contact=max(noise, LEAST_NOISE)))
    turn, rng = rpy_matrix(np.array(TURN)), stream(arm, "methods")
    true = []
    for t in before.targets:
        values = dict(t.values)
        if t.kind == "plane":
            normal = turn @ np.asarray(t.values["normal"])
            moved = float(t.values["offset"]) + normal @ np.array(SHIFT) + rng.normal(0, shape_error)
            values = {"normal": normal, "offset": float(moved)}
        true.append(replace(t, values=values))
    count = len(before.measurements.ids)
    shift = noise * rng.normal(size=count)
    shift[rng.choice(count, round(outliers * count), replace=False)] += GROSS
    found = touch(
        World(options.effects, partial(draws, replace(options, seed=arm)), tuple(true)), before, shift
    )
    return replace(found, certificates=(*before.certificates, *_distances(before.targets)))


def _distances(targets: Sequence[Target]) -> tuple[Certificate, ...]:
    balls = [t for t in targets if t.kind == "sphere"]
    place = {t.name: t.name.partition("@")[2] for t in balls}
    pairs = [(a, b) for k, a in enumerate(balls) for b in balls[k + 1 :] if place[a.name] == place[b.name]]
    return tuple(
        Certificate(
            "distance",
            (a.name, b.name),
            float(np.linalg.norm(np.asarray(a.values["centre"]) - np.asarray(b.values["centre"]))),
            1e-6,
        )
        for a, b in pairs
    )


def tracked(options: Options, noise: float = 0.0, poses: bool = False) -> Dataset:
    """Poses of a session's contacts, measured by a tracker whose frame has an error; every third validates.

    `noise` (m) is that of a coordinate; with `poses` orientations are read too, without noise.
    """
    xyz, rpy = TRACKER
    tracker = Target("tracker", "instrument", {"xyz": xyz, "rpy": rpy})
    before = planned(options)
    m = before.measurements
    count = len(m.ids)
    rows = replace(
        m,
        target=np.zeros(count, int),
        role=np.where(np.arange(count) % VALIDATION, "calibrate", "validate"),
        xyz=np.zeros((count, 3)),
        repeat=None,
    )
    read = replace(
        before,
        targets=(tracker,),
        certificates=(),
        measurements=rows,
        noise=Noise(point=max(noise, LEAST_NOISE)),
    )
    world = World(options.effects, partial(draws, options), read.targets)
    model = world.model(read)
    points = model.motion(np.arange(count)).points(world.deviations(model))
    off = TRACKER_OFF
    frame = rigid(rpy_matrix(rpy + off[1]), xyz + off[0])
    seen = (points.T - frame[:3, 3]) @ frame[:3, :3]
    seen = seen + noise * stream(options.seed, "tracker").normal(size=seen.shape)
    read = replace(read, measurements=replace(rows, xyz=seen))
    if not poses:
        return read
    delta = model.motion(np.arange(count)).displacements(world.deviations(model))
    flange = frames(model.scene.chain, model.scene.q, delta)[:, -1, :3, :3]
    rpy = Rotation.from_matrix(frame[:3, :3].T @ flange).as_euler("xyz")
    return replace(read, measurements=replace(read.measurements, rpy=rpy))
