"""What to log next is something that a person can do."""

import re

import numpy as np
import pytest
from cases import cases

from bayescal.motion.diagnose import TO_DO, to_do
from bayescal.motion.effects import Form, Scale
from bayescal.motion.quantities import UNKNOWN, Ranges, cells
from bayescal.motion.signals import derivative
from bayescal.preparing.next_motions import Bounds, MotionPlan
from bayescal.reporting.motion.fit import plan_record


@pytest.mark.parametrize(("site", "driver", "said"), cases("next_logs"))
def test_each_quantity_has_what_to_do(site, driver, said):
    text = to_do(Form(UNKNOWN, site, driver))
    assert said in text
    assert f"what varies with {driver}" in text
    assert "{" not in text


def test_every_general_function_has_a_line_of_its_own(null_estimate):
    """The last line, of what is in no other, is for directions alone."""
    s, at = null_estimate.parts[0], null_estimate.model
    scale = Scale(null_estimate.rms, abs(at.coulomb), 0.0)
    forms = {form for form, _, _ in cells(s, at, scale, Ranges(null_estimate.parts, at))}
    assert len(forms) > 20
    parts = [part for part, _ in TO_DO[:-1]]
    assert [f.driver for f in forms if not any(re.search(rf"\b{p}\b", f.driver) for p in parts)] == []


@pytest.mark.parametrize("role", ["calibrate", "validate"])
def test_motions_of_one_role_whose_torques_are_all_late_are_no_drift_of_the_clock(null_estimate, role):
    at, scale = null_estimate.model, Scale(null_estimate.rms, abs(null_estimate.model.coulomb), 0.0)
    ranges, share = Ranges(null_estimate.parts, at), []
    for s in (s for s in null_estimate.parts if s.role == role):
        rate = derivative(at.torque(s), s.step)
        by = [x for form, _, x in cells(s, at, scale, ranges) if form.driver == "rate of torque times time"]
        share.append([x[:, 0] / rate[:, 0] for x in by])
    function = np.concatenate(share, axis=1)
    assert np.mean(function, axis=1) == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(function[0]) > 0.2


def test_the_bounds_of_a_plan_are_stated_in_degrees(null_estimate):
    """And torques in N m."""
    bounds = Bounds.of(null_estimate.parts[0].log)
    stated = plan_record(MotionPlan((), (), bounds))["bounds"]
    keys = ("lowest_deg", "highest_deg", "speed_degps", "acceleration_degps2")
    for key, value in zip(keys, (bounds.low, bounds.high, bounds.speed, bounds.acceleration), strict=True):
        assert np.radians(np.array(stated[key], float)) == pytest.approx(value, abs=1e-5), key
    torque = bounds.torque[np.isfinite(bounds.torque)]
    assert [x for x in stated["torque_Nm"] if x] == pytest.approx(torque, abs=1e-3)
