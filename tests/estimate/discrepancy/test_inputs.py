"""Errors of masses in the stated uncertainty: against fits with other masses, and their second moment."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.assess.agreement import pair
from bayescal.estimate import calibrated
from bayescal.estimate.discrepancy import Inputs, inputs, mixed, stated
from bayescal.model.options import FitOptions
from bayescal.model.scene import Scene

FULL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=7, noise=1e-6).dataset


@pytest.fixture(scope="module")
def found(session):
    return stated(calibrated(Scene(session), FULL, FitOptions(robust=False)))


@pytest.mark.parametrize("name", ["mass of link 3", "centre of link 4 y", "centre of load z"])
def test_an_error_of_a_mass_moves_the_fit_as_stated(session, found, name):
    """A fit with another mass, compared with its bias by a standard uncertainty of it."""
    k = found.inputs.names.index(name)
    robot, (tool,), *where = session.robot, session.tools, *name.split()
    p = next(p for p in inputs(found.plain) if p.name == name)
    if where[0] == "mass":
        masses = robot.masses.copy()
        masses[int(where[3]) - 1] *= 1 + p.sd
        other = replace(session, robot=replace(robot, masses=masses))
    elif where[2] == "link":
        centres = robot.centres_of_mass.copy()
        centres[int(where[3]) - 1, "xyz".index(where[-1])] += p.sd
        other = replace(session, robot=replace(robot, centres_of_mass=centres))
    else:
        shift = p.sd * np.eye(3)["xyz".index(where[-1])]
        other = replace(session, tools=(replace(tool, centre_of_mass=tool.centre_of_mass + shift),))
    moved = (calibrated(Scene(other), FULL, FitOptions(robust=False)).z - found.plain.z) / found.plain.sd
    # the true mass is less than this fit states
    expected = -found.inputs.slopes[:, k] / found.plain.sd
    assert np.max(np.abs(expected)) > 0.3
    np.testing.assert_allclose(moved, expected, atol=0.2 * np.max(np.abs(expected)))


def test_residuals_that_show_an_error_state_it():
    """Second moment of the errors: by the prior where nothing is seen, else by what the residuals say."""
    rng = np.random.default_rng(0)
    h = rng.standard_normal((400, 3)) * [0.0, 1.0, 1.0]
    f = np.array([0.0, 0.0, 0.8])
    seen = Inputs.of("abc", np.eye(3), h, h @ f + 0.02 * rng.standard_normal(400))
    np.testing.assert_allclose(np.sqrt(seen.variances), [1.0, 0.05, 0.8], atol=0.02)
    assert seen.dof == pytest.approx(2.0, abs=0.02)
    # an effect that no model has is no error of masses of ten standard uncertainties
    wild = Inputs.of("abc", np.eye(3), h, 10.0 * h @ f)
    assert np.max(wild.variances) == pytest.approx(6.0, rel=0.02)


def test_stated_compliances_contain_the_uncertainty_of_masses(found):
    """Some 5 % of masses whose torques a compliance is divided by, that no residual shows."""
    names = found.plain.model.names
    more = np.sqrt(np.diag(found.covariance)) / found.plain.sd
    assert more[names.index("compliance J3")] > 2.0
    assert np.median(more) < 1.2
    assert found.parameter_shares["masses"] > 0.02


def test_a_model_without_compliance_has_no_errors_of_masses(session, found):
    assert inputs(calibrated(Scene(session), ("geometry",), FitOptions(robust=False))) == []
    weightless = replace(session, robot=replace(session.robot, masses=None, centres_of_mass=None))
    assert stated(calibrated(Scene(weightless), ("geometry",), FitOptions(robust=False))).inputs.names == ()


def test_mixed_errors_move_as_their_sum(found):
    own = inputs(found.plain)
    mixing = np.random.default_rng(0).standard_normal((len(own), 2))
    one, _ = mixed(own, mixing)
    total = {}
    for weight, p in zip(mixing[:, 0], own, strict=True):
        for t in p.terms:
            total[t.frame, t.axis] = total.get((t.frame, t.axis), 0.0) + weight * p.sd * t.driver
    for t in one.terms:
        np.testing.assert_allclose(t.driver, total[t.frame, t.axis], rtol=1e-9, atol=1e-15)


def test_sessions_of_one_arm_have_its_masses_in_common(found):
    """A difference that only different masses could explain is one, unless the tools differ."""
    k = found.plain.model.names.index("compliance J3")
    off = np.zeros(len(found.plain.z))
    off[k] = 1.5 * np.sqrt(found.inputs.variances[k])
    other = replace(found, plain=replace(found.plain, z=found.plain.z + off))
    names = ("compliance J3",)
    same = pair(("A", "B"), (found, other), names)
    model = found.plain.model
    dataset = model.scene.dataset
    heavier = replace(dataset, tools=(replace(dataset.tools[0], mass=9.0),))
    loaded = replace(model, scene=replace(model.scene, dataset=heavier))
    unequal = replace(other, plain=replace(other.plain, model=loaded))
    assert abs(same.apart[0]) > 1.5 * abs(pair(("A", "B"), (found, unequal), names).apart[0])
