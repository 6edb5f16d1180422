"""Two arms that touch: the session of a simulator of its own through fit, exports, and back."""

import numpy as np
import pytest
from cases import refused, without_draws

import bayescal as bc
from analysis.world import two_arms
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.target_kinds import plannable
from bayescal.robots import load_robot

CHAIN = "left_flange..right_flange"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("two")
    for name, text in two_arms.make(7, 70, 10, seats=True)[0].items():
        (path / name).write_text(text)
    return path


@pytest.fixture(scope="module")
def run(folder):
    fitted = bc.fit(folder, samples=0)
    with without_draws():
        fitted.save(folder.parent / "run", pictures=False)
    return fitted, folder.parent / "run"


def test_geometry_and_compliance_of_both_arms_explain_the_contacts(run):
    fitted, _ = run
    assert all(0.7 < scale < 1.4 for scale in fitted.record["noise"]["scale"].values())
    planes = fitted.record["validation"]["planes"]
    assert sum(f["count"] * f["inside95_fraction"] for f in planes) >= sum(f["count"] for f in planes) - 2
    assert max(f["calibrated_rms_um"] for f in planes) < 20 < min(f["nominal_rms_um"] for f in planes)


@pytest.mark.parametrize(("to", "into"), [("mjcf", ""), ("urdf", f"#{CHAIN}")])
def test_a_simulator_has_the_arms_of_a_file(run, folder, tmp_path, to, into):
    _, path = run
    written = tmp_path / f"arms.{to}"
    bc.export(path, to, into=f"{folder / 'cell.urdf'}{into}" if into else "").save(written)
    assert bc.verify(path, written).passed


def test_a_new_urdf_reads_back(run, tmp_path):
    fitted, path = run
    robot, rng = fitted.data.dataset.robot, np.random.default_rng(0)
    bc.export(path, "urdf").save(tmp_path / "arms.urdf")
    bc.export(path, "robot.yaml").save(tmp_path / "arms.yaml")
    files = [load_robot(name, tmp_path)[0] for name in ("arms.urdf#in_f0..flange", "arms.yaml")]
    q = rng.uniform(-1, 1, (4, 12))
    np.testing.assert_allclose(*[frames(chain_of(r), link_angles(r, q))[:, -1] for r in files], atol=1e-9)
    for read in files:
        assert read.ground.link == robot.ground.link
        assert read.ground.mass == pytest.approx(robot.ground.mass)
        np.testing.assert_allclose(read.masses, robot.masses, atol=1e-9)
        assert read.ground.held == 0.0  # what a session carries is no part of the arms
    down = [frames(chain_of(r), link_angles(r, q))[:, 6, :3, :3] @ r.ground.place[:3, 2] for r in files]
    np.testing.assert_allclose(*down, atol=1e-9)


def test_a_dataset_of_two_arms_is_written_and_read(folder, tmp_path):
    dataset = read_dataset(folder)
    assert dataset.robot.ground.held == two_arms.CUBE_MASS
    write_dataset(dataset, tmp_path / "again")
    again = read_dataset(tmp_path / "again").robot.ground
    np.testing.assert_allclose(again.held_centre, two_arms.CENTRE)
    assert (again.link, again.held) == (6, two_arms.CUBE_MASS)
    np.testing.assert_allclose(again.place, dataset.robot.ground.place, atol=1e-12)


@pytest.mark.parametrize("to", ["sdf", "usd", "dh-csv", "ur-yaml"])
def test_formats_of_one_arm_refuse_two(run, to):
    refused("know one arm only", lambda: bc.export(run[1], to))


def test_what_moves_one_arm_refuses_two(folder, run, tmp_path):
    for of, command in {
        "plans and simulated sessions": lambda: bc.plan(folder, 10),
        "set-ups of init": lambda: bc.init(tmp_path / "new", robot=f"{folder / 'cell.urdf'}#{CHAIN}"),
        "simulated sessions": lambda: bc.simulate(robot=f"{folder / 'cell.urdf'}#{CHAIN}"),
    }.items():
        refused(f"{of} know one arm only", command)
    (tmp_path / "targets.csv").write_text("id," + ",".join(f"j{k}_deg" for k in range(1, 13)) + "\n")
    refused("corrected targets know one arm only", lambda: bc.compensate(run[1], tmp_path / "targets.csv"))


def test_one_arm_holds_nothing_in_f0(folder, tmp_path):
    for name in ("cell.urdf", "measurements.csv"):
        (tmp_path / name).write_text((folder / name).read_text())
    text = (folder / "dataset.yaml").read_text().replace(CHAIN, "right_flange")
    (tmp_path / "dataset.yaml").write_text(text)
    refused("`held` is of two arms", lambda: read_dataset(tmp_path))


def test_the_joints_of_both_arms_are_said(folder):
    assert "joints 1 to 6 (left_j6 to left_j1) carry what is measured" in str(bc.check(folder))


def test_no_command_advises_a_plan_that_is_refused(folder, tmp_path):
    assert not plannable(read_dataset(folder))
    lines = (folder / "measurements.csv").read_text().splitlines(keepends=True)
    for name in ("cell.urdf", "dataset.yaml"):
        (tmp_path / name).write_text((folder / name).read_text())
    (tmp_path / "measurements.csv").write_text("".join(lines[:40]))
    said = " ".join(str(bc.check(tmp_path)).split())
    assert "rows or more in place of 39" in said
    assert "bayescal plan" not in said


def test_the_ground_is_stated_with_rows_whose_link_frames_are_behind_their_joints(run, tmp_path):
    bc.export(run[1], "robot.yaml").save(tmp_path / "arms.yaml")
    lines = (tmp_path / "arms.yaml").read_text().replace("convention: mdh", "convention: dh").splitlines()
    (tmp_path / "arms.yaml").write_text("\n".join(x for x in lines if not x.startswith("flange")))
    refused("two arms has mdh rows", lambda: load_robot("arms.yaml", tmp_path))
