"""Masses, limits and units in exported files, for arms of both conventions of rows."""

import json
import re
from dataclasses import replace
from functools import cache
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from export_arms import fake, robot_of, session_of, with_robot
from urdf_texts import words

from analysis.benchmarks.reference import points_reference
from bayescal import effects
from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.arm.statics import Stance, gravity_loads
from bayescal.arm.transforms import rigid, rotation, rpy_matrix
from bayescal.dataset import Measurements, Target
from bayescal.effects import Effect, Parameter, Site, Term
from bayescal.estimate import calibrated, estimate
from bayescal.exporting import FORMATS
from bayescal.exporting.export import export
from bayescal.exporting.geometry import constant_displacements
from bayescal.exporting.robot import calibrated_robot
from bayescal.model import ARM, Scene, build
from bayescal.robots import load_robot, robot_from_urdf, robot_to_yaml

HALF = 0.5 * np.pi


def standard(name="universal-robots-ur5e"):
    """A UR5e with rows in standard DH and skew centres of mass."""
    robot = session_of(name).robot
    own = {"alpha": [HALF, 0, 0, HALF, -HALF, 0], "a": [0, -0.425, -0.3922, 0, 0, 0]}
    rows = {key: np.array(values) for key, values in own.items()}
    return replace(
        robot, convention="dh", d=np.array([0.1625, 0, 0, 0.1333, 0.0997, 0.0996]), **rows,
        centres_of_mass=np.random.default_rng(1).uniform(-0.1, 0.1, (6, 3)),
    )  # fmt: skip


def two_tools(name="franka-panda"):
    """A session whose last row is with the second tool, which weighs more and hangs elsewhere."""
    session = session_of(name)
    tool, m = session.tools[0], session.measurements
    heavy = replace(tool, name="heavy", mass=tool.mass + 2.0, centre_of_mass=tool.centre_of_mass + 0.07)
    rows = replace(m, tool=np.arange(len(m.ids)) % 2 ^ len(m.ids) % 2)
    return replace(session, tools=(tool, heavy), measurements=rows)


ARMS = {
    "two tools": lambda: fake(two_tools(), ("geometry",), scale=3.0),
    "mdh, coupled": lambda: fake(session_of("fanuc-lrmate200ic"), ("geometry",), scale=3.0),
    "dh": lambda: fake(with_robot(session_of("universal-robots-ur5e"), standard()), ("geometry",), scale=3.0),
}


def expected(arm, load: bool) -> np.ndarray:
    """Gravity torques (C, n) about the axes of the joints, N m, with the tool or without."""
    data, robot = arm.dataset, arm.dataset.robot
    q = link_angles(robot, data.measurements.readings[:5])
    state = len(data.measurements.ids) - 1
    delta = np.tile(constant_displacements(arm.model, arm.values, state), (5, 1, 1))
    tool = data.tools[int(data.measurements.tool[state])]
    mass = np.full(5, tool.mass if load else 0.0)
    # the mass of a tool is displaced as its tip
    values = dict(zip((p.name for p in arm.model.parameters), arm.values, strict=True))
    centre = np.tile(tool.centre_of_mass + [values[f"{tool.name} {axis}"] for axis in "xyz"], (5, 1))
    loads = gravity_loads(robot, chain_of(robot), q, data.gravity, mass, centre, Stance(delta, 0.0 * delta))
    return loads.moments[:, 1:, 2]


@pytest.mark.parametrize("name", ARMS)
def test_gravity_torques_of_a_urdf(name):
    arm = ARMS[name]()
    out = export(arm, "urdf", force=True)
    model = pin.buildModelFromXML(out.written.content)
    model.gravity.linear = arm.dataset.gravity
    data, record = model.createData(), out.record("a")
    angles = arm.dataset.measurements.readings[:5] @ np.array(record["joint_from_reading"]).T
    joints = [model.joints[model.getJointId(name)] for name in record["joints"].values()]
    found = []
    for turn in angles:
        q = pin.neutral(model)
        q[[joint.idx_q for joint in joints]] = turn
        held = pin.computeGeneralizedGravity(model, data, q)[[joint.idx_v for joint in joints]]
        found.append(-held * np.array(record["signs"]))
    np.testing.assert_allclose(found, expected(arm, False), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_gravity_torques_of_an_sdf(name):
    arm = ARMS[name]()
    model = ET.fromstring(export(arm, "sdf", force=True).written.content).find("model")
    joints = {j.findtext("child"): j for j in model.findall("joint")}
    turns = arm.dataset.measurements.readings[:5] @ arm.dataset.robot.link_from_reading.T
    for turn, wanted in zip(turns, expected(arm, True), strict=True):
        angles = dict(zip(arm.dataset.robot.joint_names, turn, strict=True))
        poses, points = {"": np.eye(4)}, []  # of links; weights with their points and the joints before them
        axes = {}
        for link in model.findall("link"):
            x = np.array(link.findtext("pose").split(), float)
            joint = joints[link.get("name")]
            before = link.find("pose").get("relative_to", "")
            pose = poses[before] @ rigid(rpy_matrix(x[3:]), x[:3])
            above = [*axes.get(before, ())]
            if joint.get("type") == "revolute":
                above.append((joint.get("name"), pose[:3, 2], pose[:3, 3]))
                pose = pose @ rigid(rotation(2, angles[joint.get("name")]))
            poses[link.get("name")], axes[link.get("name")] = pose, above
            if link.findtext("gravity") != "false":
                centre = np.array(link.findtext("inertial/pose").split()[:3], float)
                weight = float(link.findtext("inertial/mass")) * arm.dataset.gravity
                points.append(((pose @ np.append(centre, 1.0))[:3], weight, above))
        found = dict.fromkeys(angles, 0.0)
        for point, weight, above in points:
            for own, axis, at in above:
                found[own] += axis @ np.cross(point - at, weight)
        np.testing.assert_allclose(list(found.values()), wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("to", ["urdf", "sdf"])
def test_inertias_are_those_of_equal_balls(to):
    """Alike about all axes, of one radius of gyration: in a URDF, that of the ball that it states."""
    text = export(ARMS["two tools"](), to, force=True).written.content
    size = []
    for link in ET.fromstring(text).iter("inertial"):
        own = {**link.find("inertia").attrib, **{e.tag: e.text for e in link.find("inertia")}}
        tensor = np.array([[float(own["i" + "".join(sorted(a + b))]) for a in "xyz"] for b in "xyz"])
        mass = link.find("mass")
        gyration = np.sqrt(tensor[0, 0] / float(mass.get("value", mass.text)))
        np.testing.assert_allclose(tensor, tensor[0, 0] * np.eye(3), atol=1e-15)
        size.append(gyration)
    np.testing.assert_allclose(size, size[0], rtol=1e-9)
    assert 0.02 < size[0] < 0.2
    for radius in re.findall(r"ball of ([\d.]+) mm radius", text):
        assert 1e3 * size[0] == pytest.approx(float(radius) * np.sqrt(2 / 5))


FACTORS = {"mm": 1e3, "deg": 180.0 / np.pi, "urad/(N m)": 1e6, "kg": 1.0, "kg mm": 1e3, "1": 1.0}
"""Unit of a sidecar: how many of it are one SI unit."""


def written_values(arm):
    """Values and u of the parameters, in every unit that has a factor, by name."""
    each = zip(arm.model.parameters, arm.values, np.sqrt(np.diag(arm.covariance)), strict=True)
    return {
        p.name: {unit: ((p.nominal + v) * f, own * f) for unit, f in FACTORS.items()} for p, v, own in each
    }


def lengths_without(arm, names):
    """Displacements (C,) of the TCP in the rows of the session, um, by parameters with these names."""
    rows, of = np.arange(len(arm.dataset.measurements.ids)), [p.name for p in arm.model.parameters]
    other = replace(arm, values=np.where(np.isin(of, names), 0.0, arm.values))
    return 1e6 * np.linalg.norm(arm.at_rows(rows).points - other.at_rows(rows).points, axis=1)


UNIT_OF = {"a2": "mm", "alpha2": "deg", "theta2": "deg", "scale J2": "1", "compliance J2": "urad/(N m)"}


OF_THEIR_OWN = {"hand-eye", "lerobot", "lerobot-dynamixel", "pal"}
"""Formats of a session or of a file of their own."""


@cache
def arm_of(robot):
    """An arm with random values of four effects."""
    return fake(session_of(robot), ("geometry", "compliance", "encoder-scale", "payload"), scale=0.4)


@pytest.mark.parametrize("name", sorted(set(FORMATS) - OF_THEIR_OWN))
def test_values_of_a_sidecar_are_in_their_units(name):
    arm = arm_of("universal-robots-ur5e" if name == "ur-yaml" else "fanuc-lrmate200ic")
    record = json.loads(json.dumps(export(arm, name, force=True).record("arm")))
    known, units = written_values(arm), {}
    lost = [n for m in record["not_expressed"] for n in m["parameters"]]
    for m in (*record["not_expressed"], record["remaining"] | {"parameters": lost}):
        size = lengths_without(arm, m["parameters"])
        expected = np.sqrt(np.mean(size**2)), size.max()
        np.testing.assert_allclose([m["rms_um"] or 0.0, m["max_um"] or 0.0], expected, rtol=0.1, atol=1e-6)
    assert record["written"]
    for item in record["written"]:
        value, u = known[item["parameter"]][item["unit"]]
        assert item["value"] == pytest.approx(value, rel=1e-12, abs=1e-15)
        assert item["u"] == pytest.approx(u, rel=1e-12)
        units[item["parameter"]] = item["unit"]
    for parameter, unit in UNIT_OF.items():
        assert units.get(parameter, unit) == unit
    tip = np.array([known[f"{arm.dataset.tools[0].name} {axis}"]["mm"] for axis in "xyz"])
    np.testing.assert_allclose(record["tools"][0]["centre_mm"], tip[:, 0], rtol=1e-12)
    np.testing.assert_allclose(record["tools"][0]["u_mm"], tip[:, 1], rtol=1e-12)


def test_limits_that_the_robot_states(tmp_path):
    """In degrees per second in robot.yaml; in files where it is stated, and nowhere a limit of zero."""
    robot = session_of("universal-robots-ur5e").robot
    robot = replace(
        robot, velocities=np.array([2.0, 3.0, np.nan, 3.2, 3.2, 3.2]),
        torques=np.array([150.0, 150, 150, 28, 28, np.nan]),
    )  # fmt: skip
    (tmp_path / "robot.yaml").write_text(robot_to_yaml(robot))
    assert f"max_velocity_degps: {np.rad2deg(2.0):.14g}" in (tmp_path / "robot.yaml").read_text()
    again = load_robot("robot.yaml", tmp_path)[0]
    np.testing.assert_allclose(again.velocities, robot.velocities, rtol=1e-12)
    np.testing.assert_array_equal(again.torques, robot.torques)
    arm = fake(with_robot(session_of("universal-robots-ur5e"), again), ("geometry",))
    out = export(arm, "urdf", name="arm")
    model = pin.buildModelFromXML(out.written.content)
    low, high = robot.limits.T
    np.testing.assert_allclose(model.lowerPositionLimit, low, rtol=1e-12)
    np.testing.assert_allclose(model.upperPositionLimit, high, rtol=1e-12)
    np.testing.assert_allclose(model.velocityLimit, [2, 3, 1e9, 3.2, 3.2, 3.2], rtol=1e-12)
    np.testing.assert_allclose(model.effortLimit, [150, 150, 150, 28, 28, 1e9], rtol=1e-12)
    assert any("effort and velocity of 1e+09: not stated" in note for note in out.notes)
    (tmp_path / "arm.urdf").write_text(out.written.content)
    found = robot_of("arm.urdf", tmp_path)
    np.testing.assert_allclose(found.velocities, robot.velocities, rtol=1e-12)
    np.testing.assert_array_equal(found.torques, robot.torques)
    sdf = ET.fromstring(export(arm, "sdf", name="arm").written.content)
    limits = {j.get("name"): j.find("axis/limit") for j in sdf.iter("joint") if j.find("axis") is not None}
    assert float(limits["J1"].findtext("velocity")) == pytest.approx(2.0, rel=1e-12)
    assert float(limits["J4"].findtext("effort")) == 28.0
    assert limits["J3"].find("velocity") is None
    assert limits["J6"].find("effort") is None
    ranges = mujoco.MjModel.from_xml_string(export(arm, "mjcf", name="arm").written.content)
    np.testing.assert_allclose([ranges.joint(j).range for j in robot.joint_names], robot.limits, rtol=1e-12)
    assert all(ranges.joint(j).limited[0] for j in robot.joint_names)


def test_limits_of_coupled_and_inverted_joints(tmp_path):
    """Limits of the links, with the sense that the axis has in the file."""
    arm = fake(session_of(), ("geometry",))
    robot = arm.dataset.robot
    sense = np.sign(np.diag(robot.link_from_reading))
    model = mujoco.MjModel.from_xml_string(export(arm, "mjcf", name="arm").written.content)
    for name, own, limits in zip(robot.joint_names, sense, robot.limits, strict=True):
        np.testing.assert_allclose(model.joint(name).range, sorted(own * limits), rtol=1e-12)
    urdf = export(arm, "urdf", name="arm").written.content
    assert not re.search(r'(effort|velocity)="0(\.0)?"', urdf)
    (tmp_path / "arm.urdf").write_text(urdf)
    assert robot_of("arm.urdf", tmp_path).velocities is None


# --- SDF exports: read by the rules of the format and put into MuJoCo: where the tool comes to rest.

STEPS = 12


def pose(text: str) -> np.ndarray:
    x = np.array(text.split(), float)
    return rigid(rpy_matrix(x[3:]), x[:3])


def quat(matrix: np.ndarray) -> str:
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, matrix[:3, :3].ravel())
    return " ".join(map(repr, out.tolist()))


def resting(text: str, angles: dict[str, float], gravity: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the flange in the model's frame, with commanded joints at some angles, rad."""
    model = ET.fromstring(text).find("model")
    links = {link.get("name"): link for link in model.findall("link")}
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(root, "option", integrator="discrete", timestep="1", gravity=words(gravity))
    bodies = {"world": ET.SubElement(root, "worldbody")}
    for joint in model.findall("joint"):
        parent, child = joint.findtext("parent"), joint.findtext("child")
        own = links[child].find("pose")
        assert own.get("relative_to", "world") == parent
        at, axis = pose(own.text), joint.find("axis")
        spring = None if axis is None else axis.findtext("dynamics/spring_stiffness")
        if axis is not None and spring is None:
            assert pose(joint.findtext("pose"))[:3, 3].tolist() == [0, 0, 0]
            assert axis.findtext("xyz").split() == ["0.0", "0.0", "1.0"]
            at = at @ rigid(rotation(2, angles[joint.get("name")]))
        body = ET.SubElement(bodies[parent], "body", name=child, pos=words(at[:3, 3]), quat=quat(at))
        inertial = links[child].find("inertial")
        if links[child].findtext("gravity") == "false":
            body.set("gravcomp", "1")
        ET.SubElement(
            body, "inertial", mass=inertial.findtext("mass"),
            pos=words(pose(inertial.findtext("pose"))[:3, 3]),
            diaginertia=" ".join(inertial.findtext(f"inertia/{k}") for k in ("ixx", "iyy", "izz")),
        )  # fmt: skip
        if spring is not None:
            ET.SubElement(
                body, "joint", type="hinge", axis=axis.findtext("xyz"), stiffness=spring,
                pos=words(pose(joint.findtext("pose"))[:3, 3]), damping=axis.findtext("dynamics/damping"),
                springref=axis.findtext("dynamics/spring_reference"),
            )  # fmt: skip
        bodies[child] = body
    built = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(built)
    for _ in range(STEPS if built.nv else 0):
        mujoco.mj_step(built, data)
    mujoco.mj_forward(built, data)
    k = mujoco.mj_name2id(built, mujoco.mjtObj.mjOBJ_BODY, "flange")
    return rigid(data.xmat[k].reshape(3, 3), data.xpos[k])


ELASTIC = ("compliance",), ("compliance", "bending"), ("compliance", "base-compliance")


def check_rest(arm, limit):
    """The tool of an SDF file rests in MuJoCo where the model has it."""
    out = export(arm, "sdf", name="arm", force=True)
    record = out.record("arm.sdf")
    readings, names = arm.dataset.measurements.readings[:4], arm.dataset.robot.joint_names
    poses = arm.at(readings)
    point = np.linalg.solve(poses.flange[0], np.append(poses.points[0], 1.0))
    for k, reading in enumerate(readings):
        turns = dict(zip(names, np.array(record["joint_from_reading"]) @ reading, strict=True))
        found = resting(out.written.content, turns, arm.dataset.gravity) @ point
        assert np.linalg.norm(found[:3] - poses.points[k]) < limit
    assert not out.missing


@pytest.mark.parametrize("effects", ELASTIC, ids=lambda e: e[-1])
@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "universal-robots-ur5e"])
def test_the_tool_rests_where_the_model_has_it(name, effects):
    # the second order of bending: the same limit as of tests/statics
    limit = 0.6e-6 if "bending" in effects else 0.15e-6
    check_rest(fake(session_of(name), ("geometry", *effects), scale=0.4), limit)


@pytest.mark.parametrize("down", [[9.81, 0.0, 0.0], [0.0, -9.81, 0.0], [4.9, 0.0, -8.5], [0.0, 0.0, 9.81]])
def test_the_tool_rests_there_however_the_arm_hangs_and_whatever_it_carries(down):
    """On a wall the hinge of the stand is behind it: the weight of arm and load has a moment about it."""
    session = session_of()
    tool = replace(session.tools[0], mass=5.0)
    hung = replace(session, gravity=np.array(down), tools=(tool,))
    check_rest(fake(hung, ("geometry", "compliance", "base-compliance"), scale=0.4), 0.15e-6)


def test_names_are_unique_and_other_effects_are_told():
    arm = fake(session_of(), ("geometry", "compliance", "backlash", "hardening"))
    out = export(arm, "sdf", name="arm")
    model = ET.fromstring(out.written.content).find("model")
    for tag in ("link", "joint"):
        each = [element.get("name") for element in model.findall(tag)]
        assert len(set(each)) == len(each)
    assert {m.effect for m in out.missing} == {"backlash", "hardening"}
    springs = {j.get("name"): j.findtext("axis/dynamics/spring_stiffness") for j in model.findall("joint")}
    values = dict(zip(arm.model.names, arm.model.shift * 0 + arm.values, strict=False))
    assert float(springs["J3_flex"]) == pytest.approx(1.0 / values["compliance J3"], rel=1e-9)
    assert springs["J3"] is None


# --- The calibrated robot as DH rows moves exactly as the displaced chain does.


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_rows_move_as_the_model(cube, convention, tied):
    session = cube(seed=1, count=60).dataset
    if convention == "dh":  # any rows will do: the same numbers read the other way
        session = replace(session, robot=replace(session.robot, convention="dh"))
    if tied:
        targets = tuple(replace(t, u=1e-3, u_angle=1e-3) for t in session.targets)
        session = replace(session, targets=targets, tools=tuple(replace(t, u=1e-3) for t in session.tools))
    scene = Scene(session)
    model = build(scene, ("geometry",))
    found = estimate(build(Scene(cube(seed=1, count=60).dataset), ("geometry",)))
    fake = replace(found, model=model, z=2.0 * np.random.default_rng(0).standard_normal(model.size))
    robot = calibrated_robot(fake.model, fake.arm)
    values = model.deviations(fake.z[model.slices[ARM]])
    tool = scene.tools[0].copy()
    for value, p in zip(values, model.parameters, strict=True):
        if p.effect == "tool":
            tool["xyz".index(p.name[-1])] += value
    expected = points_reference(model.motion(np.arange(len(scene.q))), values).T
    q = link_angles(robot, session.measurements.readings)
    np.testing.assert_allclose(points(chain_of(robot), q, tool), expected, atol=1e-12)


def test_compliance_goes_along(cube):
    found = estimate(build(Scene(cube(seed=1, count=120).dataset), ("geometry", "compliance")))
    robot = calibrated_robot(found.model, found.arm)
    named = {p.name: v for p, v in zip(found.model.parameters, found.model.physical(found.z), strict=False)}
    assert robot.compliance is not None
    assert robot.compliance[1] == pytest.approx(named["compliance J2"], rel=1e-12)
    assert robot.name.endswith("-calibrated")


@pytest.mark.parametrize("effect", ["encoder-scale", "encoder-scale@link", "encoder-scale@reading", "joint"])
@pytest.mark.parametrize("coupling", ["display", "mechanical"])
def test_scales_go_along(cube, effect, coupling):
    """On whichever side of the coupled axes the encoders sit."""
    session = cube(seed=1, count=60).dataset
    session = replace(session, robot=replace(session.robot, coupling=coupling))
    scene = Scene(session)
    model = build(scene, (effect,))
    rng = np.random.default_rng(0)
    for j in range(1, 7):  # one at a time: scales of two joints multiply, which the model does not know
        z = np.zeros(model.size)
        own = [k for k, p in enumerate(model.parameters) if p.name == f"encoder-scale J{j}"]
        z[own] = 3.0 * rng.standard_normal()
        robot = calibrated_robot(model, model.deviations(z[model.slices[ARM]]))
        motion = model.motion(np.arange(len(scene.q)))
        expected = points_reference(motion, model.deviations(z[model.slices[ARM]])).T
        q = link_angles(robot, session.measurements.readings)
        np.testing.assert_allclose(points(chain_of(robot), q, scene.tools), expected, atol=1e-12)
        assert np.max(np.abs(expected - scene.points)) > 1e-6
        assert robot.coupling == coupling


def test_a_registered_effect_of_a_similar_name_is_no_scale(cube):
    """Its parameter displaces the base; the ratios of the encoders stay nominal."""
    shift = Parameter("encoder-scale-drift x", "m", (Term(0, "tx"),), 1e-3, site=Site("joint", 1))
    effects.register(Effect("encoder-scale-drift", "the base shifts", lambda c: [shift]))
    try:
        scene = Scene(cube(seed=1, count=60).dataset)
        model = build(scene, ("encoder-scale-drift",))
        z = np.zeros(model.size)
        z[0] = 2.0
        robot = calibrated_robot(model, model.deviations(z[model.slices[ARM]]))
    finally:
        effects.unregister("encoder-scale-drift")
    np.testing.assert_array_equal(robot.link_from_reading, scene.dataset.robot.link_from_reading)
    np.testing.assert_allclose(robot.base[:3, 3], scene.dataset.robot.base[:3, 3] + [2e-3, 0, 0], atol=1e-12)


# --- An exported arm as the robot of the next session: the fit finds nothing to correct.

COUNT = 120


def measured(arm, robot, by_reading):
    """A session of the arm under an exact laser tracker; its readings are as the exported robot has them."""
    rng = np.random.default_rng(4)
    low, high = np.quantile(arm.dataset.measurements.readings, [0.0, 1.0], axis=0)
    readings = rng.uniform(low, high, (COUNT, len(low)))
    points = arm.at(readings).points
    tool = replace(arm.dataset.tools[0], u=1e-3)
    shift = [arm.values[arm.model.names.index(f"{tool.name} {axis}")] for axis in "xyz"]
    tracker = Target("tracker", "instrument", {"xyz": np.zeros(3), "rpy": np.zeros(3)}, u=0.0, u_angle=0.0)
    rows = Measurements(
        tuple(f"p{k}" for k in range(COUNT)), np.full(COUNT, "calibrate"), np.zeros(COUNT, int),
        np.zeros(COUNT, int), readings @ by_reading.T, np.arange(COUNT) + 2, xyz=points,
    )  # fmt: skip
    return replace(
        arm.dataset, name="next", robot=robot, robot_reference="arm", targets=(tracker,), certificates=(),
        tools=(replace(tool, centre=tool.centre + shift, centre_of_mass=tool.centre_of_mass + shift),),
        measurements=rows, temperature_of=None, source=None,
        noise=replace(arm.dataset.noise, point=10e-6),
    )  # fmt: skip


def corrections(dataset, effects):
    """Estimates of the arm's parameters, in prior standard deviations, by name."""
    found = calibrated(Scene(dataset), effects)
    return dict(zip(found.model.names, found.z[found.model.slices[ARM]], strict=False)), found


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "universal-robots-ur5e"])
def test_robot_yaml(name, tmp_path):
    arm = fake(session_of(name), ("geometry", "compliance"))
    (tmp_path / "arm.yaml").write_text(export(arm, "robot.yaml").written.content)
    robot = robot_of("arm.yaml", tmp_path)
    z, _ = corrections(measured(arm, robot, np.eye(6)), ("geometry", "compliance"))
    assert max(abs(value) for value in z.values()) < 0.1
    known = {p.name: v for p, v in zip(arm.model.parameters, arm.values, strict=True)}
    assert robot.compliance[2] == pytest.approx(known["compliance J3"], rel=1e-12)
    # What it cannot hold, the compliance, is found again; the geometry needs no correction
    out = export(arm, "urdf", name="arm")
    (tmp_path / "arm.urdf").write_text(out.written.content)
    by_reading = np.array(out.record("arm.urdf")["joint_from_reading"])
    robot = robot_of("arm.urdf", tmp_path)
    z, found = corrections(measured(arm, robot, by_reading), ("geometry", "compliance"))
    assert max(abs(value) for key, value in z.items() if not key.startswith("compliance")) < 0.1
    fitted = dict(zip((p.name for p in found.model.parameters), found.arm, strict=True))
    known = dict(zip((p.name for p in arm.model.parameters), arm.values, strict=True))
    u = dict(zip((p.name for p in found.model.parameters), found.sd * found.model.sd, strict=False))
    for name in ("compliance J2", "compliance J3"):
        assert abs(fitted[name] - known[name]) < 0.1 * u[name]


def test_a_joint_that_turns_without_end_has_no_limits_in_the_files(tmp_path):
    """Nor in the robot.yaml between fit and export; its limits remain those of plans."""
    session = session_of("franka-panda")
    endless = np.arange(session.robot.n) == 4
    name = session.robot.joint_names[4]
    arm = fake(with_robot(session, replace(session.robot, endless=endless)), ("geometry", "compliance"))
    (tmp_path / "robot.yaml").write_text(robot_to_yaml(arm.dataset.robot))
    again = load_robot(str(tmp_path / "robot.yaml"))[0]
    assert again.unlimited.tolist() == endless.tolist()
    assert again.limits == pytest.approx(arm.dataset.robot.limits)
    texts = {to: export(arm, to, force=True).written.content for to in ("urdf", "sdf", "mjcf")}
    for to in ("urdf", "sdf"):
        (joint,) = (j for j in ET.fromstring(texts[to]).iter("joint") if j.get("type") == "continuous")
        assert joint.get("name") == name
        assert "lower" not in ET.tostring(joint, "unicode")
    assert robot_from_urdf(texts["urdf"].encode(), "arm.urdf").unlimited.tolist() == endless.tolist()
    model = mujoco.MjModel.from_xml_string(texts["mjcf"])
    limited = [bool(model.jnt_limited[model.joint(n).id]) for n in session.robot.joint_names]
    assert limited == (~endless).tolist()
