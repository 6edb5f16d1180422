"""Measured joint torques in place of computed ones: an oracle of a load that the masses do not state."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.statics import torques_on_links
from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.join import joined
from bayescal.effects.masses import masses
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.gap.design.candidate_contacts import widened
from bayescal.gap.search.cells import cells
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate
from bayescal.simulation.touch import touch

BOTH = ("geometry", "compliance")
NOISE = 2e-6  # m


@pytest.fixture(scope="module")
def pulled():
    """A session with up to three kilograms on the flange that its table does not state; torques measured."""
    s = simulate(Options(seed=2, contacts=160, repeats=0, later=0, placements=0, noise=NOISE))
    count = len(s.exact.measurements.ids)
    hidden = np.random.default_rng(0).uniform(0.0, 3.0, count)
    heavier = replace(s.exact, measurements=replace(s.exact.measurements, payload=hidden))
    exact = touch(s.world, heavier, s.shift)
    on_links = s.world.model(exact).scene.moments[:, 1:, 2]
    signs = np.sign(np.diag(exact.robot.link_from_reading))
    table = replace(exact.measurements, payload=None, torque=on_links * signs)
    return replace(exact, measurements=table, torques="measured")


def scale(dataset):
    """Noise of contacts, as a multiple of the stated one."""
    return calibrated(Scene(dataset), BOTH, robust=False).weights.scale["contact"]


def circumstances(dataset):
    scene = Scene(dataset)
    return scene.circumstances(scene.rows("calibrate"))


def test_a_load_that_only_the_torques_show(pulled):
    assert scale(pulled) < 1.15
    assert scale(replace(pulled, torques="computed")) > 10


def test_no_masses_are_needed(pulled):
    robot = replace(pulled.robot, masses=None, centres_of_mass=None)
    assert scale(replace(pulled, robot=robot)) < 1.15


def test_torques_drive_effects_and_cells(pulled):
    c = circumstances(pulled)
    np.testing.assert_array_equal(c.torques, torques_on_links(pulled.robot, pulled.measurements.torque))
    assert not np.allclose(c.torques, c.moments[:, 1:, 2], atol=1.0)
    without = circumstances(replace(pulled, robot=replace(pulled.robot, masses=None, centres_of_mass=None)))
    wanted = {str(cell.driver) for cell in cells(without) if cell.driver.kind == "torque"}
    assert {"torque 3", "past torque 3", "torque 3, by its angle"} <= wanted


def test_masses_do_not_act_twice(pulled):
    """Measured torques contain every mass: no error of a mass turns a joint; no payload is a candidate."""
    c = circumstances(pulled)
    assert not masses(c)
    assert masses(circumstances(replace(pulled, torques="computed")))
    scene = Scene(pulled)
    _, choices = widened(scene, scene.rows("calibrate")[:5])
    assert not any("payload" in choice.what for choice in choices)


def test_torques_of_coupled_axes(pulled):
    """By the power: a linkage adds the torque of the forearm to J2, a display does not."""
    robot = pulled.robot
    torque, rate = np.random.default_rng(1).standard_normal((2, 5, robot.n))
    linked = torques_on_links(replace(robot, coupling="mechanical"), torque)
    np.testing.assert_allclose(
        np.sum(linked * (rate @ robot.link_from_reading.T), axis=1), np.sum(torque * rate, axis=1)
    )
    shown = torques_on_links(replace(robot, coupling="display"), torque)
    np.testing.assert_array_equal(np.abs(shown), np.abs(torque))


def test_files_state_them(pulled, tmp_path):
    write_dataset(pulled, tmp_path / "session")
    back = read_dataset(tmp_path / "session")
    assert back.torques == "measured"
    np.testing.assert_allclose(back.measurements.torque, pulled.measurements.torque, atol=1e-6)
    with pytest.raises(BayescalError, match=r"`torques` is computed, .* it is measured"):
        joined([pulled, replace(pulled, name="other", torques="computed")])


@pytest.mark.parametrize(
    ("torque", "words"),
    [(lambda t: None, "no columns `j1_nm`"), (lambda t: -t, "`j2_nm`.*: opposite in sign")],
)
def test_torques_that_are_missing_or_opposed(pulled, torque, words, tmp_path):
    table = replace(pulled.measurements, torque=torque(pulled.measurements.torque))
    write_dataset(replace(pulled, measurements=table), tmp_path / "session")
    with pytest.raises(BayescalError, match=words) as caught:
        read_dataset(tmp_path / "session")
    assert "dataset.yaml" in str(caught.value)
