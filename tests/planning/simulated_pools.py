"""Pools of candidate contacts: sessions as they are planned for simulation, whose rows are the candidates."""

from dataclasses import replace
from functools import cache

import numpy as np

from bayescal.dataset import Target
from bayescal.estimate import Estimate
from bayescal.model import Scene
from bayescal.model.options import parts_of
from bayescal.planning.pool import Linearised, Pool, Setup, linearised
from bayescal.planning.projection import nominal as at_nominal
from bayescal.robots import load_robot
from bayescal.simulation import Options, distance_certificates, plan

MODEL = ("geometry", "compliance")


def pool_of(dataset, measured: int = 0) -> Pool:
    """The session as a pool; its first `measured` rows were measured already."""
    return Pool(Setup(dataset, {}), dataset, measured, dataset.measurements.readings, {})


@cache
def pool() -> Pool:
    """A pool of the nominal LR Mate on a nominal cube, with three spheres that are validated."""
    options = Options(contacts=600, later=0, repeats=0, placements=1, seed=2)
    dataset, scenery = plan(options, load_robot(options.robot)[0])
    certificates = distance_certificates(options, scenery, scenery.targets)
    return pool_of(replace(dataset, certificates=(*dataset.certificates, *certificates)))


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
    target = np.where(tracked, len(dataset.targets), m.target)
    rows = replace(m, target=target, xyz=np.where(tracked[:, None], seen, np.nan))
    noise = replace(dataset.noise, point=20e-6)
    return pool_of(replace(dataset, targets=(*dataset.targets, tracker), noise=noise, measurements=rows))


# --- A small pool of candidates from a simulated session: half of the contacts with an additional payload.


@cache
def gap_pool(contacts: int = 150) -> Pool:
    options = Options(contacts=contacts, payload=2.0, repeats=0, later=0, spheres=0)
    session, _ = plan(options, load_robot(options.robot)[0])
    return Pool(Setup(session, {}), session, 0, session.measurements.readings, {})


@cache
def nominal(without: tuple[str, ...] = ()) -> Estimate:
    """The nominal arm at the pool's contacts."""
    return at_nominal(gap_pool().session, MODEL, parts_of(without, MODEL))
