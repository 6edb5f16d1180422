"""Rows that share a cause are no outliers of a diagnosis: it has to explain them."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.transforms import rpy_matrix
from bayescal.effects.location import TOOL
from bayescal.estimate import calibrated
from bayescal.gap.examine import examine
from bayescal.gap.linear.problem import Slopes
from bayescal.gap.linear.state import fit_state
from bayescal.model.scene import Scene

BASELINE = ("geometry", "compliance")
COUNT, FIRST, OFF = 120, 90, np.array([0.0, 4e-4, 0.0])


@pytest.fixture(scope="module")
def slipped(tracker):
    """A reflector that slips on the flange before the last quarter of the rows."""
    d = replace(tracker(seed=5, count=COUNT).dataset)
    d = replace(d, robot=replace(d.robot, reductions=np.full(6, 100.0)))
    moved = replace(d, tools=(replace(d.tools[0], centre=d.tools[0].centre + OFF),))
    change = (Scene(moved).points - Scene(d).points) @ rpy_matrix(np.asarray(d.targets[0].values["rpy"]))
    change[:FIRST] = 0.0
    return replace(d, measurements=replace(d.measurements, xyz=d.measurements.xyz + change))


def test_a_slipped_reflector_is_found_with_its_row_and_not_deleted(slipped):
    found = examine(Scene(slipped), BASELINE, True, 1.0)
    assert "tool ball from row c90 on" in {cause.label for cause in found.causes}
    assert len(np.intersect1d(found.fitted.rejected, np.arange(FIRST, COUNT))) == 0
    for h in found.search.hypotheses.values():
        used = h.state.weight[: found.problem.count] > 0
        assert np.all(used[np.isin(found.problem.rows[found.problem.contact], found.causes[0].rows)])
    (member,) = found.decision.members
    assert (found.decision.kind, member.effect, member.variant.sites) == ("named", "step", (TOOL,))
    assert abs(member.variant.setting - (FIRST + 1)) <= 2  # a scan of 48 rows


def test_contacts_that_share_a_cause_are_outliers_of_no_hypothesis(tracker):
    """Five rows are gross. Of these, the one that shares a cause is kept."""
    d = tracker(seed=5, count=COUNT).dataset
    slopes = Slopes.of(calibrated(Scene(d), BASELINE, 1.0, False, ()))
    p = slopes.problem(np.zeros(slopes.jacobian.shape[1]), (), ())
    gross = np.array([3, 20, 50, 77, 101])
    p = replace(p, residual=p.residual + 40.0 * np.isin(p.contact, gross))
    sharing = np.arange(COUNT) == 50
    for one, left in ((p, gross), (replace(p, sharing=sharing), np.setdiff1d(gross, 50))):
        weight = fit_state(one, (), ()).weight[: p.count]
        assert set(p.contact[weight == 0]) == set(left.tolist())
