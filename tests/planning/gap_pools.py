"""A small pool of candidates from a simulated session: half of the contacts with an additional payload."""

from functools import cache

import numpy as np

from bayescal.estimate import Estimate, linearise, unit_weights
from bayescal.model import build
from bayescal.model.parts import parts_of
from bayescal.model.scene import Scene
from bayescal.planning.pool import Pool, Setup
from bayescal.robots import load_robot
from bayescal.simulation.options import Options
from bayescal.simulation.session import plan

MODEL = ("geometry", "compliance")


@cache
def pool(contacts: int = 150) -> Pool:
    options = Options(contacts=contacts, payload=2.0, repeats=0, later=0, spheres=0)
    session, _ = plan(options, load_robot(options.robot)[0])
    return Pool(Setup(session, {}), session, 0, session.measurements.readings, {})


@cache
def nominal(without: tuple[str, ...] = ()) -> Estimate:
    """The nominal arm at the pool's contacts, with their stated noise."""
    model = build(Scene(pool().session), MODEL, 1.0, parts_of(without, MODEL))
    z = np.zeros(model.size)
    weights = unit_weights(model, z)
    linear = linearise(model, z, weights)
    return Estimate(model, z, np.eye(model.size), weights, linear, 0, np.empty(0, int), {})
