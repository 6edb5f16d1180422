"""Fits at the pose where the fitted arm stands: compliances of the next fit, and parameters of its model."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sessions import tracker

from bayescal.dataset import Noise
from bayescal.effects import BASELINE
from bayescal.estimate.estimate import Secants, calibrated, estimate
from bayescal.model import Scene, build


def taken(matrix, shift, starts, scale=(1.0, 1.0)):
    """What is taken after fits that found `matrix @ taken + shift` (2,), in units of `scale`."""
    secants, known = Secants(), {}
    for start in starts:
        found = dict(zip("ab", ((matrix @ start + shift) / scale).tolist(), strict=True))
        scene = SimpleNamespace(compliances=found, stance="", posed_at=lambda _, mixed: known.update(mixed))
        _, secants = secants.next(scene, dict(zip("ab", (start / np.array(scale)).tolist(), strict=True)))
    return np.array([known["a"], known["b"]]) * scale


@pytest.mark.parametrize("scale", [(1.0, 1.0), (1e-6, 1.0), (1.0, 1e-9)])
def test_three_fits_that_find_linear_functions_tell_the_fixed_point(scale):
    matrix, shift = np.array([[0.4, 0.2], [-0.1, 0.3]]), np.array([1.0, 2.0])
    starts = [np.array(x) for x in ([0.0, 0.0], [1.0, 0.5], [0.3, 2.0])]
    fixed = np.linalg.solve(np.eye(2) - matrix, shift)
    assert taken(matrix, shift, starts, scale) == pytest.approx(fixed)


def test_units_have_no_part_in_what_two_fits_tell():
    """Two fits do not tell two numbers: what is left over is small relative to their sizes."""
    matrix, shift = np.array([[0.4, 0.2], [-0.1, 0.3]]), np.array([1.0, 2.0])
    starts = [np.array([0.0, 0.0]), np.array([1.0, 0.5])]
    plain = taken(matrix, shift, starts)
    assert taken(matrix, shift, starts, (1e-6, 10.0)) == pytest.approx(plain)


def test_a_moment_that_is_zero_at_the_nominal_pose_has_a_compliance_where_the_arm_stands():
    """With so much noise no fit after the first moves the arm: its model has a parameter less."""
    session = tracker(seed=1, count=60).dataset
    on_axis = np.array(session.robot.centres_of_mass)
    on_axis[-1, :2] = 0.0
    robot = replace(session.robot, centres_of_mass=on_axis)
    tools = tuple(replace(t, centre_of_mass=np.array([0.0, 0.0, 0.06])) for t in session.tools)
    session = replace(session, robot=robot, tools=tools, noise=Noise(point=0.3))
    assert "compliance J6" not in estimate(build(Scene(session), BASELINE)).model.names
    assert "compliance J6" in calibrated(Scene(session), BASELINE).model.names
