"""An arm on a rail, from files to corrected readings, against a true arm of the independent simulator."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from cases import refused
from rails import folder_of

import bayescal as bc
from analysis.straightness import curves_of
from analysis.world import rail
from analysis.world.arm import Arm, nominal
from bayescal.arm.chain import chain_of, frames, link_angles, points
from bayescal.compensating import compensate_file
from bayescal.dataset import read_dataset, write_dataset
from bayescal.errors import BayescalError
from bayescal.exporting.export import export
from bayescal.exporting.geometry import constant_displacements
from bayescal.fitted.arm import of_fit

EFFECTS = "geometry,compliance,encoder-scale,straightness,angular-motion"
STILL = rail.Curve(np.array([0.0, 3.0]), np.zeros(2), np.zeros((0, 3)))


@pytest.fixture(scope="module")
def made():
    return rail.make(3, 200)


@pytest.fixture(scope="module")
def folder(made, tmp_path_factory):
    return folder_of(made, tmp_path_factory.mktemp("rail"))


@pytest.fixture(scope="module")
def result(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.calibration.levels_of", lambda effects: (effects,))
        return bc.fit(folder, model=EFFECTS, samples=0)


@pytest.fixture(scope="module")
def arm(result):
    return of_fit(result.data)


def test_the_nominal_arm_on_a_straight_rail(made, folder):
    """The nominal arm of the simulator, on a rail without errors, is where the robot file says."""
    body = Arm(nominal())
    level = rail.Rail((STILL,) * 2, (STILL,) * 3, 0.0, np.zeros(2), np.zeros(3))
    dataset = read_dataset(folder)
    readings = dataset.measurements.readings[:20]
    read = replace(made, body=body, rail=level).reads(readings[:, 0], readings[:, 1:])
    ours = points(chain_of(dataset.robot), link_angles(dataset.robot, readings), dataset.tools[0].centre)
    np.testing.assert_allclose(made.at.read(ours), read, atol=1e-12)


def test_a_session_is_written_as_it_was_read(folder, tmp_path):
    dataset = read_dataset(folder)
    write_dataset(dataset, tmp_path / "again")
    assert ",j1_mm,j2_deg," in (tmp_path / "again" / "measurements.csv").read_text().splitlines()[0]
    again = read_dataset(tmp_path / "again")
    np.testing.assert_allclose(again.measurements.readings, dataset.measurements.readings, atol=1e-12)
    np.testing.assert_array_equal(again.robot.slides, dataset.robot.slides)


WRONG = (
    ("j1_mm", "j1_deg", "column `j1_deg`, but joint 1 is prismatic; write `j1_mm`"),
    ("j2_deg", "j2_mm", "column `j2_mm`, but joint 2 is revolute; write `j2_deg`"),
    ("j2_deg", "j02_deg", "unknown column `j02_deg`; is it `j2_deg`?"),
    ("j1_mm", "j0_mm", "unknown column `j0_mm`"),
    ("j1_mm", "j1_m", "`j1_m` has a wrong unit; write `j1_mm`"),
)


@pytest.mark.parametrize(("old", "new", "words"), WRONG)
def test_columns_of_another_unit(made, tmp_path, old, new, words):
    folder_of(made, tmp_path)
    table = tmp_path / "measurements.csv"
    table.write_text(table.read_text().replace(old, new, 1))
    refused(re.escape(words), lambda: read_dataset(tmp_path))


def test_positions_in_metres(made, tmp_path):
    folder_of(made, tmp_path)
    table = tmp_path / "measurements.csv"
    header, *rows = table.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    lines = [",".join([*c[:3], f"{float(c[3]) / 1e3:.9f}", *c[4:]]) for c in cells]
    table.write_text("\n".join([header, *lines, ""]))
    refused(r"the values of `j1_mm` look like m: .* these columns hold mm", lambda: read_dataset(tmp_path))


def test_corrected_readings_bring_the_true_arm_to_its_targets(made, arm, tmp_path):
    """Poses in the frame of the tracker: there the true reflector is read, within the stated u."""
    m = arm.dataset.measurements
    rows = np.random.default_rng(0).choice(len(m.ids), 30, replace=False)
    nominal_ = replace(
        made, body=Arm(nominal()), rail=rail.Rail((STILL,) * 2, (STILL,) * 3, 0, np.zeros(2), np.zeros(3))
    )
    wanted = m.readings[rows] + np.random.default_rng(1).uniform(-0.02, 0.02, (30, 7))
    cells = [",".join(f"{x:.7f}" for x in arm.dataset.robot.shown(r)) for r in wanted]
    table = tmp_path / "targets.csv"
    table.write_text("\n".join(["j1_mm," + ",".join(f"j{k}_deg" for k in range(2, 8)), *cells, ""]))
    out = compensate_file(arm, table)
    readings = np.array([t.readings for t in out.corrected])
    goals = nominal_.reads(wanted[:, 0], wanted[:, 1:])
    found = made.reads(readings[:, 0], readings[:, 1:])
    before = made.reads(wanted[:, 0], wanted[:, 1:])

    def off(read):
        """Errors of distances: where the frame of the base is, no session says."""
        one, other = np.triu_indices(len(read), 1)
        seen, meant = (np.linalg.norm(x[one] - x[other], axis=1) for x in (read, goals))
        return seen - meant

    u = float(np.median([t.u for t in out.corrected]))
    assert np.sqrt(np.mean(off(before) ** 2)) > 5e-4
    assert np.sqrt(np.mean(off(found) ** 2)) < 2.0 * u
    header, first, *_ = out.text.decode().splitlines()
    assert header.startswith("j1_nominal_mm,")
    assert ",j1_mm,j2_deg," in header
    assert float(first.split(",")[7]) == pytest.approx(1e3 * readings[0, 0], abs=1e-6)


def slides_first(path):
    """The model of a file whose first joint is the carriage."""
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    np.testing.assert_allclose(model.jnt_range[0], [0, 3], atol=1e-12)
    return model


def test_a_urdf_in_mujoco_and_pinocchio(arm, tmp_path):
    """Its flange is that of the fitted geometry at any readings."""
    out = export(arm, "urdf")
    out.save(tmp_path / "arm.urdf")
    compiler = '<mujoco><compiler fusestatic="false"/></mujoco></robot>'
    (tmp_path / "static.urdf").write_text(out.written.content.replace("</robot>", compiler))
    model = slides_first(tmp_path / "static.urdf")
    data = mujoco.MjData(model)
    other = pin.buildModelFromXML(out.written.content)
    other_data = other.createData()
    robot, delta = arm.dataset.robot, constant_displacements(arm.model, arm.values, 0)
    for readings in arm.dataset.measurements.readings[:5]:
        q = link_angles(robot, readings[None])
        wanted = frames(chain_of(robot), q, delta[None])[0, -1, :3, 3]
        data.qpos[:] = np.array(out.written.details["joint_from_reading"]) @ readings
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.xpos[model.body("flange").id], wanted, atol=1e-9)
        pin.framesForwardKinematics(other, other_data, data.qpos)
        np.testing.assert_allclose(other_data.oMf[other.getFrameId("flange")].translation, wanted, atol=1e-9)


def test_a_mjcf_file_rests_where_the_fitted_arm_does(result, arm, tmp_path):
    """Springs and the scale of the rail too; its curve is stated as missing."""
    result.save(tmp_path / "run", pictures=False)
    out = export(arm, "mjcf")
    out.save(tmp_path / "arm.xml")
    slides_first(tmp_path / "arm.xml")
    assert {m.effect for m in out.missing} == {"straightness", "angular-motion"}
    found = bc.verify(tmp_path / "run", tmp_path / "arm.xml")
    assert found.passed
    assert max(found.record["max_difference_um"].values()) < 0.1


def test_straightness_is_found_within_its_u(made, arm):
    at = np.linspace(0.0, rail.TRAVEL, 61)
    estimated, u = curves_of(arm, at)
    true = np.stack([curve.bent(at) for curve in made.rail.straight])
    assert np.sqrt(np.mean(true**2)) > 4e-5
    assert np.sqrt(np.mean((estimated - true) ** 2)) < 1.2 * np.sqrt(np.mean(u**2)) < 1e-5


def test_other_files_hold_prismatic_joints_or_refuse(arm):
    assert '<joint name="RAIL" type="prismatic">' in export(arm, "sdf").written.content
    assert "{name: RAIL, type: prismatic, " in export(arm, "robot.yaml").written.content
    stage = export(arm, "usd").written.content
    assert "PhysicsPrismaticJoint" in stage
    assert "upperLimit = 3\n" in stage
    for name in ("ur-yaml", "dh-csv", "joint-zeros", "ros2-control", "lerobot"):
        with pytest.raises(BayescalError, match="RAIL is prismatic"):
            export(arm, name)
    refused("RAIL is prismatic: replay scripts", lambda: export(arm, "mjcf", readings="script"))


def test_a_robot_program_is_refused(folder, arm, tmp_path):
    (tmp_path / "a.script").write_text("movej([0,0,0,0,0,0])\n")
    refused("RAIL is prismatic: robot programs", lambda: compensate_file(arm, tmp_path / "a.script"))


def test_a_diagnosis_names_a_rail_that_is_not_straight(tmp_path):
    found = bc.diagnose(folder_of(rail.make(3, 60), tmp_path))
    assert {"straightness", "angular-motion"} == {n.effect for n in found.data.verdict.named}
