"""A session that is planned once, and measured by many true arms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.write import appended, taken, write_files
from bayescal.estimate import Estimate, calibrated
from bayescal.model import Scene
from bayescal.planning.candidates import candidates
from bayescal.planning.exchange import select
from bayescal.planning.goals import Goal, goals
from bayescal.planning.pool import Linearised, Pool, linearised
from bayescal.planning.result import Random, u_of
from bayescal.planning.setup import read_setup
from bayescal.predict.errors import centre_distances, lengths
from bayescal.predict.targets import prepared
from bayescal.probing.scene import Scenery
from bayescal.robots import load_robot
from bayescal.simulation import Options, World, touch
from bayescal.simulation.record import distance_certificates, draws, true_targets
from bayescal.simulation.session import plan
from bayescal.statistics import rms, stream

MODEL = ("geometry", "compliance")
CHOSEN, RANDOM = "chosen", "random"
PLACEMENTS = 4
"""Of the artefact with spheres."""


@dataclass(frozen=True)
class Ground:
    """What all sessions of the study share: the layout, the candidates, the model linearised, the goals."""

    options: Options
    scenery: Scenery
    pool: Pool
    linear: Linearised
    goals: tuple[Goal, Goal]  # certified distances, region of the contacts

    def selection(self, how: str, count: int, seed: int = 0) -> np.ndarray:
        """Chosen or random candidates, (count,)."""
        if how == CHOSEN:
            return select(self.linear, self.goals, count, np.random.default_rng(seed))
        return Random(self.pool, seed).selections(count, 1)[0]

    def u(self, chosen: np.ndarray) -> list[float]:
        """Expected standard uncertainty, m, of the distances of each goal."""
        return [u_of(self.linear, goal, chosen) for goal in self.goals]


@cache
def ground(number: int, seed: int = 0) -> Ground:
    """A LR Mate at a cube, with `PLACEMENTS` of three spheres, and `number` candidates."""
    options = Options(seed=seed, contacts=16, later=0, repeats=0, placements=PLACEMENTS)
    dataset, scenery = plan(options, load_robot(options.robot)[0])
    certificates = distance_certificates(options, scenery, scenery.targets)
    with TemporaryDirectory() as folder:
        write_files(replace(dataset, certificates=(*dataset.certificates, *certificates)), Path(folder))
        pool = candidates(read_setup(folder), number, seed)
    linear = linearised(pool, MODEL)
    certified, region = goals(pool, linear)
    return Ground(options, scenery, pool, linear, (certified, region))


def measured(on: Ground, chosen: np.ndarray, seed: int) -> tuple[float, float]:
    """Root mean square errors, m, of both goals, as one true arm measures a selection and is calibrated.

    The arm, the places of the targets, the certified values and the noise are drawn with the seed.
    """
    options = replace(on.options, seed=seed)
    targets = true_targets(options, on.scenery)
    planned = _planned(on, chosen)
    stated = [c for c in planned.certificates if c.kind != "distance"]
    planned = replace(planned, certificates=(*stated, *distance_certificates(options, on.scenery, targets)))
    world = World(options.effects, partial(draws, options), targets)
    count = len(planned.measurements.ids)
    noise = options.noise * stream(seed, "noise").normal(size=count)
    session, rows = _with_goal(touch(world, planned, noise), on.goals[1])
    found = calibrated(Scene(session), MODEL)
    distances = centre_distances(found.model.scene, prepared(found).located, np.zeros((len(found.arm), 0)))
    errors = _lengths(found, rows, on.goals[1]) - _true_lengths(world, session, rows, on.goals[1])
    return rms(distances.error), rms(errors)


def _planned(on: Ground, chosen: np.ndarray) -> Dataset:
    """The chosen candidates and the validation contacts, as a session that is to be touched."""
    m = on.pool.session.measurements
    rows = np.concatenate([on.pool.candidates[chosen], on.pool.validation])
    if m.time is not None:
        rows = rows[np.argsort(m.time[rows])]
    return replace(on.pool.session, measurements=taken(m, rows))


def _with_goal(session: Dataset, goal: Goal) -> tuple[Dataset, np.ndarray]:
    """The session with the poses of a goal as rows that touch nothing, and their numbers."""
    assert goal.readings is not None
    m, count = session.measurements, len(goal.readings)
    source = np.full(count, np.flatnonzero(m.role == "calibrate")[0])
    changed = {"readings": goal.readings, "velocity": 0.0, "payload": 0.0}
    rows = appended(m, source, changed, [f"goal {k}" for k in range(count)])
    return replace(session, measurements=rows), len(m.ids) + np.arange(count)


def _lengths(found: Estimate, rows: np.ndarray, goal: Goal) -> np.ndarray:
    assert goal.pairs is not None
    return lengths(found.model.motion(rows).points(found.arm), goal.pairs)


def _true_lengths(world: World, session: Dataset, rows: np.ndarray, goal: Goal) -> np.ndarray:
    assert goal.pairs is not None
    model = world.model(session)
    return lengths(model.motion(rows).points(world.deviations(model)), goal.pairs)
