"""Pools of candidate contacts, made of simulated sessions: their rows to calibrate are the candidates."""

from dataclasses import replace
from functools import cache

import numpy as np

from bayescal.dataset import Target
from bayescal.model import Scene
from bayescal.planning.information import Linearised, linearised
from bayescal.planning.pool import Pool, Setup
from bayescal.simulation import Options, simulate

MODEL = ("geometry", "compliance")


def pool_of(dataset, measured: int = 0) -> Pool:
    """The session as a pool; its first `measured` rows were measured already."""
    return Pool(Setup(dataset, {}), dataset, measured, dataset.measurements.readings, {})


@cache
def pool() -> Pool:
    """A pool of the LR Mate on a cube, with spheres that are validated."""
    options = Options(contacts=600, later=0, repeats=0, placements=1, seed=3)
    return pool_of(simulate(options).dataset)


@cache
def linear() -> Linearised:
    """That pool, linearised."""
    return linearised(pool(), MODEL)


def every(found: Linearised) -> np.ndarray:
    """All candidates."""
    return np.arange(found.count)


@cache
def mixed() -> Pool:
    """A pool of contacts on the cube, and of points that a laser tracker reads: one and three residuals."""
    dataset = pool().session
    m = dataset.measurements
    tracked = (m.role == "calibrate") & (np.arange(len(m.role)) % 3 == 0)
    tracker = Target("tracker", "instrument", {"xyz": np.array([2.0, 0.0, 0.5]), "rpy": np.zeros(3)})
    seen = Scene(dataset).points - tracker.values["xyz"]
    rows = replace(
        m,
        target=np.where(tracked, len(dataset.targets), m.target),
        xyz=np.where(tracked[:, None], seen, np.nan),
    )
    noise = replace(dataset.noise, point=20e-6)
    return pool_of(replace(dataset, targets=(*dataset.targets, tracker), noise=noise, measurements=rows))
