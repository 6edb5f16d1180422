"""Readings before standstill are named `unsettled`, not backlash; backlash stays backlash."""

from dataclasses import replace

import numpy as np
import pytest
from gap_problems import Bench

from bayescal.dataset import read_dataset, write_dataset
from bayescal.effects import EFFECTS
from bayescal.effects.unsettled import remaining
from bayescal.gap.diagnose import diagnose
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate

STRONG = 300.0


def circumstances(dataset):
    scene = Scene(dataset)
    return scene.circumstances(scene.rows("calibrate"))


def moving(dataset, seed=0):
    """The session with commands ahead of the readings, by a random part of 30 ms of the motion."""
    m = dataset.measurements
    left = np.random.default_rng(seed).uniform(0.0, 0.03, (len(m.ids), 1)) * m.velocity
    return replace(dataset, measurements=replace(m, command=m.readings + left))


@pytest.fixture(scope="module", params=["commands", "speeds"])
def bench(request, cube):
    dataset = cube(seed=5, count=160).dataset
    return Bench.of(moving(dataset) if request.param == "commands" else dataset)


@pytest.mark.parametrize("effect", ["unsettled", "backlash"])
def test_each_is_named_as_what_it_is(bench, effect):
    decision, _ = bench.decided(bench.made_up(1, bench.of_effect(effect, STRONG, seed=1)))
    assert [m.effect for m in decision.members] == [effect]


def test_what_remains_of_the_motion(cube):
    """Commands where they differ from the readings, else the speeds; nothing of a session at rest."""
    dataset = cube(seed=1, count=24).dataset
    c = circumstances(dataset)
    assert remaining(c) is None  # commands that equal the readings
    assert {p.unit for p in EFFECTS["unsettled"].at(c)} == {"s"}
    c = circumstances(moving(dataset))
    left = c.command - c.readings
    first = EFFECTS["unsettled"].at(c)[0]
    assert first.unit == "1"
    (term,) = first.terms
    np.testing.assert_allclose(term.driver, left[:, 0])
    assert str(first.driver) == "remaining motion 1"
    assert first.driver.coordinate(first.site, c).name == "remaining motion of joint 1"
    at_rest = replace(dataset, measurements=replace(dataset.measurements, velocity=None, command=None))
    assert "j1_command_deg" in EFFECTS["unsettled"].missing(circumstances(at_rest))


def test_a_session(tmp_path):
    """From the file to the name; `test_play_is_named_and_removed` is the same of backlash."""
    effects = ("geometry", "compliance", "unsettled")
    session = simulate(Options(contacts=120, later=40, repeats=6, spheres=0, seed=3, effects=effects)).dataset
    write_dataset(session, tmp_path / "session")
    gap = diagnose(read_dataset(tmp_path / "session"))
    assert gap.verdict.kind == "named"
    assert [n.effect for n in gap.verdict.named] == ["unsettled"]
