"""Sessions of any number of contacts: those of a small simulated session, repeated at other poses.

The search for poses that an arm can reach without a collision takes far longer than a fit. Here every
contact of a face is repeated with readings some degrees away, and then closed on the true face again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.types import Measurements
from bayescal.simulation import READING, Options, simulate, touch

SEED_CONTACTS = 100
"""Different contacts on faces of the small session."""
AWAY = np.radians(2.0)
"""Standard deviation of the readings of a contact from those that it repeats, rad."""


def session(contacts: int, seed: int = 0, validated: float = 0.1) -> Dataset:
    """A session with `contacts` on faces for calibration, and a share `validated` of as many for validation.

    The arm has errors of geometry; there are no spheres.
    """
    count = contacts + round(validated * contacts)
    options = Options(
        effects=("geometry",), seed=seed, contacts=SEED_CONTACTS, later=0, repeats=0, placements=0
    )
    small = simulate(options)
    m, rng = small.exact.measurements, np.random.default_rng(seed)
    at = np.arange(count) % len(m.ids)
    assert m.velocity is not None
    assert m.temperature is not None
    many = Measurements(
        ids=tuple(f"c{k:06d}" for k in range(count)),
        role=np.where(np.arange(count) < contacts, "calibrate", "validate"),
        target=m.target[at],
        tool=m.tool[at],
        readings=m.readings[at] + AWAY * rng.standard_normal((count, m.readings.shape[1])),
        line=np.arange(count) + 2,
        velocity=m.velocity[at],
        time=10.0 * np.arange(count),
        temperature=m.temperature[at],
    )
    planned = replace(small.exact, measurements=many)
    closed = touch(small.world, planned, options.noise * rng.standard_normal(count)).measurements
    read = np.radians(np.round(np.degrees(closed.readings), READING))
    return replace(small.dataset, measurements=replace(closed, readings=read))
