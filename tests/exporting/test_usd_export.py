"""USD read back by pxr: the chain of the joints' frames, and what the links weigh."""

from dataclasses import replace

import numpy as np
import pytest
from export_arms import calibrated_frames, fake, session_of, with_robot
from scipy.spatial.transform import Rotation

from bayescal.exporting.export import export
from bayescal.exporting.usd import identifiers

pxr = pytest.importorskip("pxr")
from pxr import Usd, UsdGeom, UsdPhysics  # noqa: E402


def opened(text):
    layer = pxr.Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(text)
    return Usd.Stage.Open(layer)


def frame(joint, side):
    """A joint's frame in one of its bodies."""
    quaternion = getattr(joint, f"GetLocalRot{side}Attr")().Get()
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat([*quaternion.GetImaginary(), quaternion.GetReal()]).as_matrix()
    out[:3, 3] = getattr(joint, f"GetLocalPos{side}Attr")().Get()
    return out


def flange(stage, record, readings):
    """Poses of the flange (N, 4, 4) in F0: from the world through every joint, by its bodies."""
    joints = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdPhysics.Joint):
            joint = UsdPhysics.Joint(prim)
            before = joint.GetBody0Rel().GetTargets()
            joints[str(before[0]) if before else ""] = joint
    values = readings @ np.array(record["joint_from_reading"]).T
    number = {name: k for k, name in enumerate(record["joints"].values())}
    out = []
    for row in values:
        pose, body = np.eye(4), ""
        while body in joints:
            joint = joints[body]
            turn = np.eye(4)
            if joint.GetPrim().IsA(UsdPhysics.RevoluteJoint):
                about = "XYZ".index(UsdPhysics.RevoluteJoint(joint).GetAxisAttr().Get())
                vector = np.eye(3)[about] * row[number[joint.GetPrim().GetName()]]
                turn[:3, :3] = Rotation.from_rotvec(vector).as_matrix()
            pose = pose @ frame(joint, 0) @ turn @ np.linalg.inv(frame(joint, 1))
            body = str(joint.GetBody1Rel().GetTargets()[0])
        assert body.endswith("/flange")
        out.append(pose)
    return np.array(out)


@pytest.fixture(scope="module")
def arm():
    return fake(session_of(), ("geometry", "compliance"))


def test_flange_of_the_calibrated_arm(arm):
    out = export(arm, "usd", name="cell 1 <a>")
    stage = opened(out.written.content)
    readings = arm.dataset.measurements.readings
    found, truth = flange(stage, out.written.details, readings), calibrated_frames(arm)[:, -1]
    np.testing.assert_allclose(found[:, :3, 3], truth[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(found[:, :3, :3], truth[:, :3, :3], atol=2e-6)
    assert np.abs(truth[:, :3, 3] - calibrated_frames(arm.valued(0 * arm.values))[:, -1, :3, 3]).max() > 1e-4
    assert [m.effect for m in out.missing] == ["compliance"]


def test_bodies_stand_where_the_joints_put_them(arm):
    """Transforms of the links at zero readings agree with the joints: a viewer shows the same arm."""
    stage = opened(export(arm, "usd").written.content)
    for prim in stage.Traverse():
        if prim.IsA(UsdPhysics.Joint) and UsdPhysics.Joint(prim).GetBody0Rel().GetTargets():
            joint = UsdPhysics.Joint(prim)
            bodies = [joint.GetBody0Rel().GetTargets()[0], joint.GetBody1Rel().GetTargets()[0]]
            shown = [UsdGeom.Xformable(stage.GetPrimAtPath(b)) for b in bodies]
            world = [np.array(body.ComputeLocalToWorldTransform(0)).T for body in shown]
            np.testing.assert_allclose(world[0] @ frame(joint, 0), world[1] @ frame(joint, 1), atol=1e-6)


def test_limits_masses_and_units(arm):
    stage, robot = opened(export(arm, "usd").written.content), arm.dataset.robot
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetDefaultPrim().HasAPI(UsdPhysics.ArticulationRootAPI)
    joints = [UsdPhysics.RevoluteJoint(p) for p in stage.Traverse() if p.IsA(UsdPhysics.RevoluteJoint)]
    limits = [[j.GetLowerLimitAttr().Get(), j.GetUpperLimitAttr().Get()] for j in joints]
    upright = np.diag(robot.link_from_reading) > 0  # J3 of the LR Mate turns against its reading
    expected = np.where(upright[:, None], robot.limits, -robot.limits[:, ::-1])
    np.testing.assert_allclose(limits, np.degrees(expected), rtol=1e-6)
    bodies = [UsdPhysics.MassAPI(p) for p in stage.Traverse() if p.HasAPI(UsdPhysics.MassAPI)]
    np.testing.assert_allclose([body.GetMassAttr().Get() for body in bodies], robot.masses, rtol=1e-6)


def test_inertia_and_senses_of_a_table_top_arm():
    """The first joint of the SO-101 turns against its reading; its links have inertias."""
    session = session_of(robot="robotstudio-so101", payload=0.0)
    arm = fake(session, ("geometry",))
    out, robot = export(arm, "usd"), session.robot
    stage = opened(out.written.content)
    found = flange(stage, out.written.details, session.measurements.readings)
    np.testing.assert_allclose(found[:, :3, 3], calibrated_frames(arm)[:, -1, :3, 3], atol=1e-6)
    bodies = [UsdPhysics.MassAPI(p) for p in stage.Traverse() if p.HasAPI(UsdPhysics.MassAPI)]
    for body, inertia in zip(bodies, robot.inertias, strict=True):
        q = body.GetPrincipalAxesAttr().Get()
        axes = Rotation.from_quat([*q.GetImaginary(), q.GetReal()]).as_matrix()
        found = axes @ np.diag(body.GetDiagonalInertiaAttr().Get()) @ axes.T
        np.testing.assert_allclose(found, inertia, atol=1e-5 * np.abs(inertia).max())


def test_inertias_of_standard_rows_are_about_the_axes_behind_the_row():
    session, square = session_of(), np.random.default_rng(1).normal(size=(6, 3, 3))
    inertias = square @ square.transpose(0, 2, 1)
    rows = replace(session.robot, convention="dh", flange=np.eye(4), inertias=inertias)
    arm = fake(with_robot(session, rows), ("geometry",))
    stage = opened(export(arm.valued(0.0 * arm.values), "usd").written.content)
    bodies = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.MassAPI)]
    link = rows.base[:3, :3]
    for prim, offset, alpha, inertia in zip(bodies, rows.offset, rows.alpha, rows.inertias, strict=True):
        link = link @ Rotation.from_euler("ZX", [offset, alpha]).as_matrix()
        q, body = UsdPhysics.MassAPI(prim).GetPrincipalAxesAttr().Get(), UsdPhysics.MassAPI(prim)
        here = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)).T[:3, :3]
        axes = here @ Rotation.from_quat([*q.GetImaginary(), q.GetReal()]).as_matrix()
        found = axes @ np.diag(body.GetDiagonalInertiaAttr().Get()) @ axes.T
        np.testing.assert_allclose(found, link @ inertia @ link.T, atol=1e-5)


def test_names_of_prims():
    assert identifiers(["joint 1", "joint-1", "1", "joint_1"]) == ["joint_1", "joint_1_2", "_1", "joint_1_3"]
    assert identifiers(["base"], taken=["base"]) == ["base_2"]
