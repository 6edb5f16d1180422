"""A calibrated arm as a USD stage: an articulation of UsdPhysics, for Isaac Sim and others.

Each link is a rigid body whose frame is that of its joint, as it is at zero readings. The frame of a joint in
the link before is the constant transform between the two, in its own link the identity; its axis is z. So the
pose of the flange is the product of these transforms and of the turns of the joints. USD holds the frames of
joints in single precision: 0.1 µm at an arm of 1 m.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import chain_of
from bayescal.exporting import geometry
from bayescal.exporting.written import Format, Options, Written
from bayescal.fitted.arm import FittedArm
from bayescal.storage.reading import library


def _write(arm: FittedArm, options: Options) -> Written:
    library("pxr", "usd-core is not installed", "--to usd", "pip install 'bayescal[usd]'")
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    robot = arm.dataset.robot
    delta = geometry.constant_displacements(arm.model, arm.values, options.state)
    at_zero = geometry.zero_frames(robot, delta)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    moving = (f"{name}_link" for name in robot.joint_names)
    top, *links = identifiers([options.name, "base", *moving, "flange"])
    *joints, fixed, mount = identifiers([*robot.joint_names, "fixed_flange", "fixed_base"], taken=links)
    root = UsdGeom.Xform.Define(stage, f"/{top}")
    root.GetPrim().SetDisplayName(options.name)
    stage.SetDefaultPrim(root.GetPrim())
    UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    paths = [f"/{top}/{name}" for name in links]
    for path, pose in zip(paths, [np.eye(4), *at_zero], strict=True):
        body = UsdGeom.Xform.Define(stage, path)
        body.AddTranslateOp().Set(Gf.Vec3d(*pose[:3, 3].tolist()))
        body.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*_wxyz(pose[:3, :3])))
        UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
    for k in range(robot.n) if robot.masses is not None else ():
        _mass(UsdPhysics.MassAPI.Apply(stage.GetPrimAtPath(paths[k + 1])), Gf, arm, delta, k)

    def joined(kind: Any, name: str, before: str, behind: str, place: np.ndarray) -> Any:
        out = kind.Define(stage, f"/{top}/{name}")
        if before:
            out.CreateBody0Rel().SetTargets([before])
        out.CreateBody1Rel().SetTargets([behind])
        out.CreateLocalPos0Attr(Gf.Vec3f(*place[:3, 3].tolist()))
        out.CreateLocalRot0Attr(Gf.Quatf(*_wxyz(place[:3, :3])))
        out.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        out.CreateLocalRot1Attr(Gf.Quatf(1.0))
        return out

    between, sign = geometry.steps(at_zero), np.sign(np.diag(robot.link_from_reading))
    bounds = np.sort(sign[:, None] * robot.limits, axis=1)
    limits = np.where(robot.slides[:, None], bounds, np.degrees(bounds)).tolist()  # m, deg
    for k, name in enumerate(joints):
        kind = UsdPhysics.PrismaticJoint if robot.slides[k] else UsdPhysics.RevoluteJoint
        joint = joined(kind, name, paths[k], paths[k + 1], between[k])
        joint.GetPrim().SetDisplayName(robot.joint_names[k])
        joint.CreateAxisAttr(UsdPhysics.Tokens.z)
        if not robot.unlimited[k]:  # a joint without these turns without end
            joint.CreateLowerLimitAttr(limits[k][0])
            joint.CreateUpperLimitAttr(limits[k][1])
    joined(UsdPhysics.FixedJoint, fixed, paths[-2], paths[-1], between[-1])
    joined(UsdPhysics.FixedJoint, mount, "", paths[0], np.eye(4))
    shapes = "bodies have no shapes: add meshes and colliders to the links"
    notes = [*geometry.coupled(robot.link_from_reading), shapes]
    if robot.masses is None:
        notes.append("the masses of the links are not known: bodies have none")
    elif robot.inertias is None:
        notes.append("the inertias of the links are not known: bodies have masses and centres alone")
    places = [(f"/{top}/{name}", "physics:localPos0, physics:localRot0") for name in (*joints, fixed)]
    names = dict(zip(robot.joint_names, joints, strict=True))
    details = {"joint_from_reading": robot.link_from_reading.tolist(), "joints": names}
    text = stage.GetRootLayer().ExportToString()
    return Written(text, geometry.items(arm, places), notes=notes, details=details)


def _mass(body: Any, gf: Any, arm: FittedArm, delta: np.ndarray, k: int) -> None:
    """Mass, centre and, where known, inertia of link `k` (from 0) in the frame of its joint."""
    robot = arm.dataset.robot
    assert robot.masses is not None
    body.CreateMassAttr(float(robot.masses[k]))
    body.CreateCenterOfMassAttr(gf.Vec3f(*geometry.centre_in_frame(robot, delta, k).tolist()))
    if robot.inertias is None:
        return
    turn = np.eye(3) if robot.convention == "mdh" else chain_of(robot).link[k + 1][:3, :3]
    moments, axes = np.linalg.eigh(turn @ robot.inertias[k] @ turn.T)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    body.CreateDiagonalInertiaAttr(gf.Vec3f(*moments.tolist()))
    body.CreatePrincipalAxesAttr(gf.Quatf(*_wxyz(axes)))


def _wxyz(rotation: np.ndarray) -> list[float]:
    return list(map(float, Rotation.from_matrix(rotation).as_quat(scalar_first=True)))


def identifiers(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Valid names of prims, each different from those before it, and from those that are taken."""
    from pxr import Tf

    used, out = set(taken), []
    for name in names:
        base = Tf.MakeValidIdentifier(f"_{name}" if name[:1].isdigit() else name)
        free, k = base, 2
        while free in used:
            free, k = f"{base}_{k}", k + 1
        used.add(free)
        out.append(free)
    return out


LIMITS = "joints of USD have constant frames and do not yield"
USD = Format(".usda", _write, geometry.holds_constants, LIMITS, prismatic=True)
"""An articulation with the calibrated geometry, for Isaac Sim and whatever reads UsdPhysics."""
