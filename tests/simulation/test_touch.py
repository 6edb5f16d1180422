"""Contacts of simulated sessions are closed, or refused as soon as it is clear that one will not close."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.errors import BayescalError
from bayescal.simulation.touch import touch


class Ball:
    """A world in which each row passes a ball of radius 1 at some distance from its centre."""

    def __init__(self, dataset, aside, start):
        self.start, self.aside, self.passes = dataset.measurements.readings, aside, 0
        self.velocity, self.ahead = dataset.measurements.velocity, start

    def model(self, dataset, near=None):
        return SimpleNamespace(scene=dataset)

    def distances(self, model):
        """Distance from the ball's surface (N,), after the seconds that moved the readings."""
        self.passes += 1
        moved = (model.scene.measurements.readings - self.start)[:, 0] / self.velocity[:, 0]
        return np.hypot(self.ahead - moved, self.aside) - 1.0


@pytest.mark.parametrize("start", [1.5, 12.0])
def test_contacts_that_meet_their_target_are_closed(cube, start):
    d = cube(seed=1, count=60).dataset
    world = Ball(d, np.linspace(0, 0.95, 60), start)
    closed = touch(world, d, np.zeros(60))
    assert np.max(np.abs(world.distances(world.model(closed)))) < 1e-12


def test_a_contact_that_misses_its_target_is_refused_early(cube):
    d = cube(seed=1, count=60).dataset
    world = Ball(d, np.where(np.arange(60) == 7, 1.2, 0.5), 2.0)
    with pytest.raises(BayescalError, match=f"does not touch {d.targets[d.measurements.target[7]].name}"):
        touch(world, d, np.zeros(60))
    assert world.passes < 16
