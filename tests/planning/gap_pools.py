"""A small pool of candidates from a simulated session: half of the contacts with an additional payload."""

from functools import cache

from bayescal.estimate import Estimate
from bayescal.model.block import parts_of
from bayescal.planning.pool import Pool, Setup
from bayescal.planning.projection import nominal as at_nominal
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
    """The nominal arm at the pool's contacts."""
    return at_nominal(pool().session, MODEL, parts_of(without, MODEL))
