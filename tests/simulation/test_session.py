"""A session as a careful operator would have measured it, and the folder that holds it."""

import json
import re
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import cases, refused, robot_file
from rails import rail_session
from sessions import LITTLE, little
from typer.testing import CliRunner

from bayescal.arm.chain import link_angles, wrenches
from bayescal.arm.transforms import cone, rigid
from bayescal.assess.findings import FAR
from bayescal.cli import app
from bayescal.dataset import read_dataset
from bayescal.effects import EFFECTS
from bayescal.effects.imaging import without_camera
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene
from bayescal.probing.clearance import Clearance, path_free
from bayescal.probing.contacts import PASSES, Sites, inverse
from bayescal.probing.motions import Arm
from bayescal.probing.scene import layout, scene_of
from bayescal.robots import load_robot
from bayescal.simulation import Options, simulate, touch
from bayescal.simulation.record import summary, write
from bayescal.simulation.session import LARGEST_SCALE


def test_counts_and_repeats():
    s = little()
    m = s.dataset.measurements
    assert Counter(m.role) == {"calibrate": 60, "validate": 30 + 12}
    assert Counter(Counter(m.repeat[m.repeat != ""]).values()) == {4: 3}
    assert [t.name for t in s.dataset.targets][:4] == ["cube.+y", "cube.-y", "cube.-x", "cube.+z"]
    expected = dict.fromkeys(range(4), 3) | dict.fromkeys(range(4, 7), 10)
    assert Counter(m.target[m.role == "validate"]) == expected
    assert len(set(m.ids)) == len(m.ids)
    # repeats come one after the other and scatter by the noise
    for group in set(m.repeat) - {""}:
        rows = np.flatnonzero(m.repeat == group)
        assert np.all(np.diff(rows) == 1)
        assert np.ptp(m.readings[rows], axis=0).max() < 1e-3
        assert np.ptp(m.readings[rows], axis=0).max() > 0


def test_positions_are_searched_once_for_an_arm(monkeypatch):
    """Effects and noise do not change them; the seed and the robot do. The session is the same."""
    from bayescal.probing import placement
    from bayescal.simulation import session

    few = LITTLE | {"contacts": 16, "later": 4, "repeats": 0, "spheres": 2, "sphere_contacts": 6}
    fresh = simulate(Options(**few, seed=7)).dataset
    searched = []

    def counted(module, name):
        search = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given: searched.append(name) or search(*given))

    counted(placement, "stream")  # once for each placement
    counted(session, "on_face")
    simulate(Options(**few, seed=7, effects=("geometry",), noise=1e-6))
    again = simulate(Options(**few, seed=7)).dataset
    assert not searched
    np.testing.assert_array_equal(again.measurements.readings, fresh.measurements.readings)
    other = {**few, "contacts": 20}
    simulate(Options(**other, seed=7))
    assert set(searched) == {"on_face"}  # more or fewer contacts, the same spheres
    simulate(Options(**other, seed=8))
    assert searched.count("stream") == 1


def test_the_default_cube_is_that_of_the_paper():
    offsets = [t.values["offset"] for t in little().dataset.targets[:4]]
    assert offsets == pytest.approx([0.1143, 0.1143, -0.3357, 0.2643], abs=1e-12)


def test_time_goes_on_and_the_arm_warms_up():
    m = little().dataset.measurements
    assert np.all(np.diff(m.time) > 0)
    assert m.temperature[-10:].mean() > m.temperature[:10].mean() + 1
    later = (m.role == "validate") & (m.target < 4)
    assert m.time[later].min() > m.time[~later].max() + 1000


def test_poses_and_directions_vary():
    d = little(contacts=100).dataset
    m, scene = d.measurements, Scene(d)
    fitted = m.role == "calibrate"
    positive = np.mean(m.velocity[fitted] > 0, axis=0)
    assert np.all((positive > 0.08) & (positive < 0.92))
    flange = Arm(d.robot, d.tools[0].centre).frames(m.readings)[:, -1, :3, 2]
    for k, target in enumerate(d.targets[:4]):
        at = fitted & (m.target == k)
        lean = np.degrees(np.arccos(-flange[at] @ target.values["normal"]))
        assert lean.max() < 63
        assert np.ptp(lean) > 30
        assert np.all(np.sort(np.ptp(scene.points[at], axis=0))[1:] > 0.15)


def test_velocities_close_the_contacts_at_the_probing_speed():
    d = little().dataset
    m, scene = d.measurements, Scene(d)
    q = link_angles(d.robot, m.readings)
    still = np.zeros((len(q), d.robot.n + 2, 6))
    v = np.empty((len(q), 3))
    for axis in range(3):
        u = np.tile(np.eye(3)[axis], (len(q), 1))
        by = wrenches(scene.chain, q, scene.tools, still, u)[:, 1:-1, 0] @ d.robot.link_from_reading
        v[:, axis] = np.sum(by * m.velocity, axis=1)
    assert np.allclose(np.linalg.norm(v, axis=1), 5e-3, rtol=0.05)
    for k in range(4):
        inward = -v[m.target == k] @ d.targets[k].values["normal"] / 5e-3
        assert inward.min() > np.cos(np.radians(28))


@pytest.mark.parametrize(("robot", "seed"), [("fanuc-lrmate200ic", 4), ("universal-robots-ur5", 0)])
def test_no_contact_and_no_retract_collides(robot, seed):
    """Of the UR5 two fifths of the contacts did, before they were checked."""
    exact = {"effects": ("geometry",), "error_scale": 0.0, "noise": 0.0}
    d = simulate(Options(robot=robot, seed=seed, **exact, **LITTLE)).dataset
    m, scene = d.measurements, scene_of(d, with_table=False)
    touched = scene.touched([d.targets[i].name for i in m.target])
    clearance = Clearance.of(d.robot, d.tools[0], scene.solids)
    ball = clearance.arm.ball(clearance.arm.frames(m.readings))
    away = ball - [d.targets[i].values.get("centre", np.zeros(3)) for i in m.target]
    away /= np.linalg.norm(away, axis=1)[:, None]
    normals = [d.targets[i].values.get("normal", r) for i, r in zip(m.target, away, strict=True)]
    assert not clearance.collides(m.readings, touched).any()
    assert not path_free(clearance, m.readings, np.array(normals), touched).any()


def test_the_payload_hangs_on_half_of_the_plane_contacts():
    m = little(payload=2.0).dataset.measurements
    assert set(m.payload) == {0.0, 2.0}
    assert 0.3 < np.mean(m.payload[m.target < 4] > 0) < 0.7
    assert np.all(m.payload[m.target >= 4] == 0)
    for group in set(m.repeat) - {""}:
        assert len(set(m.payload[m.repeat == group])) == 1
    assert little().dataset.measurements.payload is None


def test_one_seed_one_session_to_the_byte(tmp_path):
    write(little(), tmp_path / "a")
    write(simulate(Options(**LITTLE, seed=4)), tmp_path / "b")
    files = sorted(p.name for p in (tmp_path / "a").glob("[!.]*"))
    assert files == ["dataset.yaml", "measurements.csv", "truth.json"]
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_the_folder_reads_back(tmp_path):
    s = little(outliers=0.05, payload=1.0)
    write(s, tmp_path / "out")
    back = read_dataset(tmp_path / "out")
    assert np.allclose(back.measurements.readings, s.dataset.measurements.readings, atol=1e-12, rtol=0)
    assert np.array_equal(back.measurements.payload, s.dataset.measurements.payload)
    assert [c.targets for c in back.certificates] == [c.targets for c in s.dataset.certificates]
    said = [[c.distance for c in d.certificates if c.kind == "distance"] for d in (back, s.dataset)]
    assert said[0] == pytest.approx(said[1], abs=1e-12)
    assert json.loads((tmp_path / "out" / "truth.json").read_text())["schema"] == "bayescal-truth/1"
    assert not [p for p in tmp_path.iterdir() if p.name != "out"]


ON_RAILS = ("straightness", "angular-motion", "positioning", "axis-bending")


OF_CONTACTS = {name for name, effect in EFFECTS.items() if effect.missing is not without_camera}
SIMULATED = {
    "usual": ("fanuc-lrmate200ic", OF_CONTACTS - {*ON_RAILS, "gear-mesh"}),
    "gears": (robot_file("standard"), {"gear-mesh"}),
    "rail": ("fanuc-lrmate200ic", {*ON_RAILS}),
}
"""Robots, and the effects that are simulated of them."""


@pytest.mark.parametrize("case", SIMULATED)
def test_every_effect_can_be_simulated(case):
    robot, effects = SIMULATED[case]
    arm = rail_session().robot if case == "rail" else None
    chosen = ("geometry", "compliance", *sorted(effects - {"geometry", "compliance"}))
    few = {"contacts": 24, "later": 4, "repeats": 1, "placements": 0}
    s = simulate(Options(effects=chosen, robot=robot, payload=1.0, **few), arm)
    assert {p["effect"] for p in s.truth["parameters"]} >= {*effects, "tool"}
    assert np.abs(s.world.distances(s.world.model(s.exact)) - s.shift).max() < 2e-12


@pytest.mark.parametrize(("options", "words"), cases("simulation_refusals"))
def test_what_cannot_be_is_refused_in_one_line(options, words, tmp_path):
    if options.get("robot") in ("seven", "small"):
        options = {**options, "robot": robot_file(options["robot"])}
    refused(re.escape(words), lambda: simulate(replace(Options(**LITTLE), **options)))


def test_the_largest_error_scale_is_that_from_which_on_a_fit_warns():
    replace(Options(), error_scale=LARGEST_SCALE).check()
    assert LARGEST_SCALE == FAR


def test_command_replaces_only_what_it_has_written(tmp_path):
    out = tmp_path / "made"
    short = ["--contacts", "20", "--repeats", "0", "--later", "4", "--placements", "0"]
    run = CliRunner().invoke
    first = run(app, ["simulate", "--out", str(out), *short])
    assert first.exit_code == 0, first.output
    assert "cube.+y: 5 contacts to calibrate, 1 to validate" in first.output
    before = (out / "measurements.csv").read_bytes()
    assert run(app, ["simulate", "--out", str(out), *short, "--seed", "1"]).exit_code == 0
    assert (out / "measurements.csv").read_bytes() != before
    assert read_dataset(out).name == "made"
    other = tmp_path / "other"
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    assert isinstance(run(app, ["simulate", "--out", str(other), *short]).exception, BayescalError)
    assert [p.name for p in other.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("options", [{"later": 0}, {"spheres": 0}, {"spheres": 1}, {"repeats": 15}])
def test_parts_may_be_left_out(options, tmp_path):
    s = little(**options)
    write(s, tmp_path / "out")
    assert len(read_dataset(tmp_path / "out").measurements.ids) == len(s.shift)
    assert summary(s).startswith("simulated: fanuc-lrmate200ic, geometry, compliance\n  cube.+y: ")


# ---

TOOL = np.array([0.06, 0.0, 0.12])


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "standard", "seven", "four"])
def test_inverse_reaches_what_it_says_within_the_limits(name, tmp_path):
    robot, _ = load_robot(name if name.startswith("fanuc") else robot_file(name))
    arm, rng = Arm(robot, TOOL), np.random.default_rng(1)
    pose = arm.frames(arm.anywhere(300, rng))
    centres, axes = arm.ball(pose), pose[:, -1, :3, 2]
    sites = Sites.of(centres, -axes, axes, np.full(300, -1))
    readings, found = inverse(arm, arm.anywhere(300, rng), sites, PASSES)
    assert found.mean() > 0.2
    there = arm.frames(readings[found])
    assert np.abs(arm.ball(there) - centres[found]).max() < 1e-7
    if robot.n >= 5:
        assert np.sum(there[:, -1, :3, 2] * axes[found], axis=1).min() > 1 - 1e-9
    sign = np.sign(np.diag(robot.link_from_reading))
    limited = readings @ robot.link_from_reading.T * sign  # of the FANUC's third joint, J2 + J3
    assert np.all(limited > robot.limits[:, 0])
    assert np.all(limited < robot.limits[:, 1])


def test_arms_of_equal_content_are_equal():
    """Whatever they are called by: one number of another arm makes it another one."""
    robot, _ = load_robot("fanuc-lrmate200ic")
    arm, same = Arm(robot, TOOL), Arm(load_robot("fanuc-lrmate200ic")[0], TOOL.copy())
    assert arm == same
    assert hash(arm) == hash(same)
    for other in (
        Arm(replace(robot, limits=robot.limits * 0.9), TOOL),
        Arm(replace(robot, base=rigid(None, np.array([0.0, 0.0, 1.0]))), TOOL),
        Arm(robot, TOOL + 1e-9),
    ):
        assert arm != other


def test_cone_is_filled():
    axis = np.tile([0.0, 0.6, 0.8], (4000, 1))
    angle = np.arccos(np.sum(axis * cone(axis, 1.0, np.random.default_rng(0)), axis=1))
    assert angle.max() < 1.0
    assert np.mean(angle < 0.5) == pytest.approx((1 - np.cos(0.5)) / (1 - np.cos(1.0)), abs=0.03)


def test_layout_has_its_length_and_no_two_spheres_touch():
    for count in range(2, 9):
        centres = layout(count, 0.3)
        away = np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(count, 1)]
        assert len(centres) == count
        assert away.max() == pytest.approx(0.3)
        assert away.min() > 0.0508


# --- Contacts of simulated sessions are closed, or refused as soon as it is clear that one will not close.


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
    assert np.max(np.abs(world.distances(world.model(touch(world, d, np.zeros(60)))))) < 1e-12


def test_a_contact_that_misses_its_target_is_refused_early(cube):
    d = cube(seed=1, count=60).dataset
    world = Ball(d, np.where(np.arange(60) == 7, 1.2, 0.5), 2.0)
    name = d.targets[d.measurements.target[7]].name
    refused(rf"does not touch {name}.*give a smaller --error-scale", lambda: touch(world, d, np.zeros(60)))
    assert world.passes < 16
