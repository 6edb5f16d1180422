"""A fitted arm at any pose: equal to its model at the rows of the session, with every effect."""

import json
from dataclasses import replace

import numpy as np
import pytest
from export_arms import fake, session_of

from bayescal.effects import EFFECTS
from bayescal.errors import BayescalError
from bayescal.fitted.arm import open_run
from bayescal.fitted.file import write_arm
from bayescal.model import build, standing
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate

MOVING = tuple(
    e for e in ("compliance", "hardening", "bending", "base-compliance", "payload", "eccentricity",
                "second-harmonic", "gear-mesh@50", "backlash", "unsettled", "hysteresis", "encoder-scale",
                "coupling", "thermal-drift", "step")
)  # fmt: skip


@pytest.fixture(scope="module")
def session():
    options = Options(contacts=60, later=6, repeats=2, spheres=0, seed=3, payload=1.0)
    return simulate(options).dataset


@pytest.mark.parametrize("effect", MOVING)
def test_rows_of_the_session_are_where_the_model_has_them(session, effect):
    """Also as new poses: the drivers of a pose are those of the row that it repeats."""
    effects = ("geometry", "compliance", effect) if effect != "compliance" else ("geometry", effect)
    arm = fake(session, effects)
    rows, m = np.arange(0, len(session.measurements.ids), 7), session.measurements
    expected = arm.model.motion(rows).points(arm.values).T
    np.testing.assert_allclose(arm.at_rows(rows).points, expected, rtol=0, atol=1e-12)
    if effect == "unsettled":
        return  # the arm is at rest in a pose
    for row, own in zip(rows, expected, strict=True):
        pose = arm.at(m.readings[[row]], payload_kg=m.payload[row], direction=m.velocity[row], row=int(row))
        np.testing.assert_allclose(pose.points[0], own, rtol=0, atol=1e-12)


def test_the_model_is_in_equilibrium(session):
    arm = fake(session, ("geometry", "compliance", "bending", "base-compliance", "payload"))
    again = standing(arm.model, arm.values)
    np.testing.assert_allclose(again.stance.delta, arm.model.scene.stance.delta, rtol=0, atol=1e-12)


def test_flange_and_slopes(session):
    arm = fake(session, ("geometry", "compliance", "backlash"))
    poses = arm.at(session.measurements.readings[:5], direction=np.ones(6))
    tool = session.tools[0].centre + [arm.values[arm.model.names.index(f"ball {a}")] for a in "xyz"]
    reached = np.einsum("cij,j->ci", poses.flange, np.append(tool, 1.0))[:, :3]
    np.testing.assert_allclose(poses.points, reached, rtol=0, atol=1e-12)
    k = arm.model.names.index("backlash J3")
    step = replace(arm, values=arm.values + 1e-6 * np.eye(len(arm.values))[k])
    moved = step.at(session.measurements.readings[:5], direction=np.ones(6)).points - poses.points
    np.testing.assert_allclose(1e6 * moved, poses.by_parameters[:, :, k], atol=2e-3)
    assert poses.covariance.shape == (5, 3, 3)


def test_play_follows_the_direction_and_the_previous_pose(session):
    arm = fake(session, ("geometry", "backlash"))
    q = session.measurements.readings[:4]
    up, down = (arm.at(q, direction=s * np.ones(6)).points for s in (1, -1))
    np.testing.assert_allclose(arm.at(q, previous=q - 0.1).points, up, rtol=0, atol=1e-15)
    np.testing.assert_allclose(0.5 * (up + down), arm.at(q).points, rtol=0, atol=1e-8)
    assert np.all(np.linalg.norm(up - down, axis=1) > 1e-6)


def test_state_of_a_time_and_of_a_row(session):
    arm = fake(session, ("geometry", "step@30", "thermal-drift"))
    m, q = session.measurements, session.measurements.readings[[0]]
    early, late = arm.at(q, row=0).points, arm.at(q).points
    np.testing.assert_allclose(arm.at(q, time=m.time[0]).points, early, rtol=0, atol=1e-12)
    np.testing.assert_allclose(arm.at(q, row=m.ids[0]).points, early, rtol=0, atol=1e-15)
    assert np.linalg.norm(early - late) > 1e-6
    with pytest.raises(BayescalError, match="there is no row `x`"):
        arm.at(q, row="x")


def test_levels_add_one_effect_each(session):
    arm = fake(session, ("geometry", "compliance", "backlash"))
    assert arm.levels == ("nominal", "geometry", "+ compliance", "+ backlash")
    q = session.measurements.readings[:3]
    last = arm.at_level("+ backlash", q, direction=np.ones(6)).points
    np.testing.assert_allclose(last, arm.at(q, direction=np.ones(6)).points, rtol=0, atol=1e-12)
    nominal = arm.at_level("nominal", q).points
    np.testing.assert_allclose(nominal, arm.model.scene.points[:3], rtol=0, atol=1e-12)
    scene = Scene(session)
    model = build(scene, ("geometry",))
    own = [arm.values[arm.model.names.index(p.name)] for p in model.parameters]
    rigid = model.motion(np.arange(3)).points(np.array(own)).T
    np.testing.assert_allclose(arm.at_level("geometry", q).points, rigid, rtol=0, atol=1e-12)


def test_every_moving_effect_is_tested():
    """A new effect joins the list, or moves no frame of the arm."""
    resting = {"lobing", "latency", "plane-form", "artefact", "ball-radius"}
    assert {e.partition("@")[0] for e in MOVING} | resting | {"geometry"} == set(EFFECTS)


def test_round_trip_of_the_run_folder(session, tmp_path):
    arm = fake(session, ("geometry", "compliance", "payload", "hysteresis@0.02", "step@30"))
    assert write_arm(arm, tmp_path) == ("arm.json", "dataset")
    again = open_run(tmp_path)
    q = session.measurements.readings[::9]
    np.testing.assert_allclose(again.at(q, row=3).points, arm.at(q, row=3).points, rtol=0, atol=2e-9)
    np.testing.assert_array_equal(again.covariance, arm.covariance)
    assert [p.name for p in again.model.parameters] == [p.name for p in arm.model.parameters]
    assert json.loads((tmp_path / "arm.json").read_text())["schema"] == "bayescal-arm/1"


def test_an_arm_without_equilibrium_is_refused(session):
    arm = fake(session, ("geometry", "compliance"))
    soft = [1.0 if p.name == "compliance J2" else 0.0 for p in arm.model.parameters]
    with pytest.raises(BayescalError, match="does not come to rest under gravity"):
        arm.valued(np.array(soft))


@pytest.mark.parametrize("folder", ["../run/dataset", "/elsewhere", "dataset/../..", "dataset/x"])
def test_only_copies_in_the_run_folder_are_read(session, tmp_path, folder):
    (tmp_path / "run").mkdir()
    path = tmp_path / "run" / "arm.json"
    write_arm(fake(session, ("geometry",)), path.parent)
    record = json.loads(path.read_text())
    record["dataset"]["folders"] = [folder]
    path.write_text(json.dumps(record))
    with pytest.raises(BayescalError, match=r"arm\.json: `.*` is not a copy of the dataset") as refusal:
        open_run(path.parent)
    assert "\n" not in str(refusal.value)


def test_a_folder_without_arm_is_refused(tmp_path):
    with pytest.raises(BayescalError, match=r"there is no arm\.json"):
        open_run(tmp_path)


def test_a_torque_that_only_the_fitted_arm_has(tmp_path):
    """The last joint of a UR that points straight down carries no torque, unless the arm leans."""
    session = session_of("universal-robots-ur5e", payload=0.0)
    readings = np.tile(np.radians([0.0, -90.0, 90.0, -90.0, -90.0, 0.0]), (len(session.measurements.ids), 1))
    readings[:, 0] = session.measurements.readings[:, 0]
    tools = tuple(replace(t, centre_of_mass=np.array([0.0, 0.0, 0.06])) for t in session.tools)
    session = replace(
        session, tools=tools, measurements=replace(session.measurements, readings=readings, payload=None)
    )
    leaning = fake(session, ("geometry",))
    nominal = {p.name for p in build(leaning.model.scene, ("compliance",)).parameters}
    assert "compliance J6" in nominal
    assert "compliance J6" not in {p.name for p in build(Scene(session), ("compliance",)).parameters}
    model = build(leaning.model.scene, ("geometry", "compliance"))
    values = dict(zip((p.name for p in leaning.model.parameters), leaning.values, strict=True))
    arm = replace(leaning, model=model, effects=("geometry", "compliance"))
    arm = replace(arm, covariance=np.eye(len(model.parameters)), states={})
    arm = arm.valued(np.array([values.get(p.name, 1e-3) for p in model.parameters]))
    write_arm(arm, tmp_path)
    again = open_run(tmp_path)
    assert [p.name for p in again.model.parameters] == [p.name for p in arm.model.parameters]
    q = readings[:3]
    np.testing.assert_allclose(again.at(q).points, arm.at(q).points, rtol=0, atol=2e-9)
    np.testing.assert_allclose(
        arm.at_level("nominal", q).points, arm.at_level("nominal", q, row=0).points, atol=1e-12
    )
