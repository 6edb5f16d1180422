"""The arm of a fit, and the true arm of a simulated session, are at rest under gravity."""

import re
import sys

import numpy as np
import pytest

from bayescal.effects import parameters_of
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated, settled
from bayescal.model import Model, build, equilibrium
from bayescal.model.equilibrium import STILL, by_name, moved, tool_points
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate

EVERY = ("geometry", "compliance", "bending", "base-compliance")


@pytest.fixture(scope="module")
def loaded():
    """A session with two kilograms on half of its contacts, of an arm that yields everywhere."""
    options = Options(seed=2, contacts=120, repeats=0, later=0, placements=0, noise=2e-6, payload=2.0)
    return simulate(Options(**{**vars(options), "effects": EVERY}))


def bare(effects):
    """Models of some effects without blocks."""

    def make(scene):
        return Model(
            scene, effects, parameters_of(effects, scene.circumstances(scene.rows("calibrate"))), (), ()
        )

    return make


def test_a_fitted_arm_is_at_rest(loaded):
    """Moments computed again at its pose do not move a TCP; after two fits they moved it by 6 um."""
    found = calibrated(Scene(loaded.dataset), EVERY)
    again = build(settled(found), EVERY)
    values = by_name(again, found.arm, found.model)
    assert moved(tool_points(found.model, found.arm), tool_points(again, values)) < STILL


def test_every_start_comes_to_the_same_rest(loaded):
    """From nominal moments and from those of an arm that yields three times as much."""
    values = loaded.world.deviations

    def soft(model):
        return 3.0 * values(model)

    scene, make = Scene(loaded.dataset), bare(EVERY)
    here = equilibrium(scene, make, values, 1e-13)
    far = equilibrium(scene, make, soft, 1e-13)
    back = equilibrium(far.scene, make, values, 1e-13)
    nominal = make(scene)
    points = [tool_points(m, values(m)) for m in (nominal, here, back)]
    assert moved(points[1], points[2]) < 1e-12
    assert moved(points[0], points[1]) > 5e-5


def test_an_arm_that_falls_is_refused(loaded):
    scene = Scene(loaded.dataset)

    def limp(model):
        return np.array([0.3 if p.name == "compliance J3" else 0.0 for p in model.parameters])

    with pytest.raises(BayescalError, match=re.escape("the arm does not come to rest under gravity")):
        equilibrium(scene, bare(("compliance",)), limp)


def test_fits_that_do_not_come_to_rest_are_refused(loaded, monkeypatch):
    monkeypatch.setattr(sys.modules["bayescal.estimate.estimate"], "FITS", 2)
    with pytest.raises(BayescalError, match="from fit to fit, after 2 fits"):
        calibrated(Scene(loaded.dataset), ("geometry", "compliance"))


def test_fits_that_come_to_rest_slowly_are_not_refused(loaded, monkeypatch):
    """A tenth of the noise is enough after the last fit."""
    found = calibrated(Scene(loaded.dataset), ("geometry", "compliance"))
    for name, value in (("AT_REST", 0.0), ("STILL", 0.0), ("FITS", 4)):
        monkeypatch.setattr(sys.modules["bayescal.estimate.estimate"], name, value)
    last = calibrated(Scene(loaded.dataset), ("geometry", "compliance"))
    assert np.max(np.abs(last.z - found.z) / found.sd) < 0.1
