"""Drift of an arm that cools for a while: its course against an integration in small steps."""

import numpy as np
import pytest

from bayescal.effects import EFFECTS, parameters_of
from bayescal.effects.thermal_drift import PAUSES, heated
from bayescal.model.scene import Scene


def test_a_body_that_is_heated_cools_and_is_heated_again():
    """Newton's law, integrated in 200,000 steps."""
    begin, end, constant = 0.4, 0.7, 0.3
    time = np.linspace(0.0, 1.0, 200_001)
    state, course = 0.0, []
    for t in time:
        course.append(state)
        goal = 0.0 if begin <= t < end else 1.0
        state += (goal - state) / constant * (time[1] - time[0])
    some = slice(None, None, 4000)
    np.testing.assert_allclose(heated(time, begin, end, constant)[some], np.array(course)[some], atol=2e-5)


@pytest.mark.parametrize("pause", PAUSES[::5])
def test_a_paused_drift_covers_the_session(cube, pause):
    scene = Scene(cube(seed=1).dataset)
    c = scene.circumstances(scene.rows("calibrate"))
    name = f"thermal-drift@paused-{pause[0]}-{pause[1]}-{pause[2]}"
    own = [p for p in parameters_of((name,), c) if p.effect == "thermal-drift"]
    assert [(p.name, p.sd) for p in own] == [(p.name, p.sd) for p in EFFECTS["thermal-drift"].at(c, 600.0)]
    base = next(p for p in own if p.name.startswith("thermal-drift base"))
    (term,) = base.terms
    assert (np.min(term.driver), np.max(term.driver)) == (-1.0, 1.0)
    assert np.any(np.diff(term.driver) < 0)
    assert np.any(np.diff(term.driver) > 0)
