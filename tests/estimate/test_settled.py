"""Weights pull where an arm stands: a fit that is told so leaves less, and finds the arm."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.statics import Stance
from bayescal.estimate import calibrated, estimate, settled
from bayescal.model import ARM, build, standing
from bayescal.model.scene import POSED, UNPOSED, Scene
from bayescal.simulation import Options, simulate

BOTH = ("geometry", "compliance")


@pytest.fixture(scope="module")
def loaded():
    """A session of exact statics, with two kilograms on half of its contacts."""
    return simulate(Options(seed=2, contacts=160, repeats=0, later=0, placements=0, noise=2e-6, payload=2.0))


def pulls(found, simulated):
    """How far off the truth the compliances are, in posterior standard deviations."""
    true = {p["name"]: 1e-6 * p["value_urad_per_nm"] for p in simulated.truth["parameters"]
            if p["effect"] == "compliance"}  # fmt: skip
    at = [k for k, p in enumerate(found.model.parameters) if p.effect == "compliance"]
    off = [(found.model.physical(found.z)[k] - true[found.model.names[k]]) / found.model.sd[k] for k in at]
    return np.array(off) / found.sd[at]


def test_settled_moments_leave_less(loaded):
    as_drawn = estimate(build(Scene(loaded.dataset), BOTH))
    stands = estimate(build(settled(as_drawn), BOTH), start=as_drawn.z)
    assert as_drawn.weights.scale["contact"] > 1.5  # of 2 um
    assert stands.weights.scale["contact"] < 1.15
    assert np.max(np.abs(pulls(as_drawn, loaded))) > 8
    assert np.max(np.abs(pulls(stands, loaded))) < 4


def test_moments_stand_where_the_true_arm_does(loaded):
    """Where the fitted arm stands they are nearly the true one's; on the drawing they are not."""
    true = loaded.world.model(loaded.dataset).scene.moments
    as_drawn = estimate(build(Scene(loaded.dataset), BOTH))
    off, left = as_drawn.model.scene.moments - true, settled(as_drawn).moments - true
    assert np.max(np.abs(off)) > 0.02
    assert np.max(np.abs(left)) < 0.2 * np.max(np.abs(off))


def test_known_sag_is_sag(cube):
    """Whether the robot file knows a compliance or a fit has found it, the arm stands at the same place."""
    dataset = cube(seed=1).dataset
    known = np.array([0.0, 3e-5, 2e-4, 1e-3, 2e-3, 3e-3])
    drawn = Scene(replace(dataset, robot=replace(dataset.robot, compliance=known)))
    found = build(Scene(dataset), BOTH)
    values = found.deviations(np.zeros(found.size)[found.slices[ARM]])
    for k, p in enumerate(found.parameters):
        if p.effect == "compliance":
            values[k] = known[dataset.robot.joint_names.index(p.name.split()[1])]
    as_known = build(drawn, ("geometry",))
    nothing = np.zeros(len(as_known.parameters))
    moments = standing(found, values).moments
    np.testing.assert_allclose(standing(as_known, nothing).moments, moments, atol=1e-12)
    assert np.max(np.abs(moments - Scene(dataset).moments)) > 1e-3


@pytest.mark.parametrize(("effects", "fits"), [(("joint",), 1), (("geometry",), 1), (BOTH, 3)])
def test_only_a_model_that_gravity_acts_on_is_fitted_again(cube, monkeypatch, effects, fits):
    """The single fit has the settled scene and agrees with a second fit there."""
    count = []

    def counted(*args, **kwargs):
        count.append(args)
        return estimate(*args, **kwargs)

    module = sys.modules["bayescal.estimate.estimate"]  # the package has a function of this name
    monkeypatch.setattr(module, "estimate", counted)
    found = calibrated(Scene(cube().dataset), effects)
    assert len(count) == fits
    assert found.model.scene.stance is not None
    again = estimate(build(found.model.scene, effects), start=found.z)
    assert np.array_equal(again.rejected, found.rejected)
    assert np.allclose(again.z, found.z, atol=2e-3 if fits == 1 else 0.05)


@pytest.mark.parametrize("sag", [0.0, 1e-5])
def test_scenes_of_several_poses_share_only_what_is_equal(cube, sag):
    """Against a scene made afresh, also where the robot file's compliances bend the nominal arm."""
    dataset = cube(seed=1, count=20).dataset
    dataset = replace(dataset, robot=replace(dataset.robot, compliance=np.full(6, sag)))
    scene, rows = Scene(dataset, oriented=True), np.arange(20)
    for name in UNPOSED | POSED:
        getattr(scene, name)
    stance = Stance(*1e-2 * np.random.default_rng(0).standard_normal((2, 20, 8, 6)))
    moved, fresh = scene.posed_at(stance, {"compliance J2": 1e-6}), Scene(dataset, stance, True)
    for name in UNPOSED | POSED:
        a, b = getattr(moved, name), getattr(fresh, name)
        np.testing.assert_equal(*(vars(x) if name in ("chain", "loads") else x for x in (a, b)), name)
    a, b = moved.circumstances(rows), fresh.circumstances(rows)
    np.testing.assert_array_equal(a.moments, b.moments)
    np.testing.assert_array_equal(a.q, b.q)
    np.testing.assert_array_equal(a.approach, b.approach)
    assert not np.array_equal(a.moments, scene.circumstances(rows).moments)
    assert np.array_equal(a.q, scene.q) == (sag == 0.0)
    assert (moved.points is scene.points) == (sag == 0.0)
    assert a.stance is stance
    assert a.compliances == {"compliance J2": 1e-6}
