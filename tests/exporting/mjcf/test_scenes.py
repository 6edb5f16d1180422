"""Scenes as people have them: clashing names, includes, meshes, vehicles, calibrated arms."""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from cases import DATA, refused
from drawn_arms import drawn, off

from analysis.simulators import BASE, differences
from bayescal.exporting.export import export
from bayescal.exporting.mjcf import Joints, replay_table
from bayescal.exporting.mjcf.elastic import CLOSE, Content, spring_of
from bayescal.exporting.mjcf.replay import Replay, Simulated
from bayescal.verifying.simulator import File, limit

SCENE = DATA / "ur5e_scene.xml"
SCENE_TEXT = SCENE.read_text()
ELASTIC = (*BASE, "base-compliance")
EVERY = (*ELASTIC, "hysteresis", "eccentricity", "backlash")
TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def changed(*by: tuple[str, str]) -> str:
    """The scene with replaced parts, each of which it has once."""
    text = SCENE_TEXT
    for old, new in by:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


def fits(path: Path, effects=ELASTIC, tip: str = "", poses: int = 3):
    """The exported arm, after its tool points in MuJoCo were compared with the model."""
    arm, into = drawn("universal-robots-ur5e", effects), Path(f"{path}{tip}")
    found = export(arm, "mjcf", into=str(into), force=True)
    file = File.of(arm, found.written.content, into, found.record(into.name))
    assert np.max(off(arm, poses, file)) < limit(effects)
    return found


def save(folder: Path, text: str, name: str = "scene.xml") -> Path:
    (folder / name).write_text(text, newline="")
    return folder / name


NAMES = (
    ('<geom name="table"',
     '<body name="flange"><body name="tool"><body name="payload"/></body><site name="ball"/></body>'
     '<body name="stand" pos="2 0 0"><joint name="elbow_joint_flex"/>'
     '<joint name="stand_x" axis="1 0 0"/><geom size=".1"/></body><body name="elbow_joint_wave_1_crank"/>'
     '<geom name="table"'),
    ("  <actuator>",
     '  <tendon><fixed name="elbow_joint_gear"><joint joint="elbow_joint_flex" coef="1"/></fixed></tendon>\n'
     '  <sensor><jointpos joint="elbow_joint_flex"/><framepos objtype="site" objname="ball"/></sensor>\n'
     "  <actuator>"),
)  # fmt: skip


def test_names_of_the_scene_are_left_to_it(tmp_path):
    text = changed(*NAMES).replace('qpos="0.6 0.3 0.1 1 0 0 0 ', 'qpos="0.1 0.2 0.6 0.3 0.1 1 0 0 0 ')
    out = fits(save(tmp_path, text), EVERY)
    renamed = out.record("x")["renamed"]
    assert renamed["body"] == {
        "flange": "flange_2", "tool": "tool_2", "payload": "payload_2", "stand": "stand_2",
        "elbow_joint_wave_1_crank": "elbow_joint_wave_1_crank_2",
    }  # fmt: skip
    assert renamed["joint"] == {"elbow_joint_flex": "elbow_joint_flex_2", "stand_x": "stand_x_2"}
    assert renamed["tendon"] == {"elbow_joint_gear": "elbow_joint_gear_2"}
    assert renamed["site"] == {"ball": "ball_2"}
    assert "the file has a site ball: that of the arm is called ball_2" in out.notes
    old, new = ElementTree.fromstring(text), ElementTree.fromstring(out.written.content)
    for kind in ("body", "site", "joint", "fixed"):
        own = {e.get("name"): e for e in new.iter(kind)}
        for e in old.iter(kind):
            if e.get("name") and not e.get("name").endswith("_link"):
                assert own[e.get("name")].attrib == e.attrib
    model = mujoco.MjModel.from_xml_string(out.written.content)
    names = {model.joint(model.wrap_objid[k]).name for k in range(model.nwrap)}
    assert "elbow_joint_flex" in names  # of the user's tendon alone


def test_a_class_of_our_name_is_kept(tmp_path):
    own = '<default class="bayescal"><joint damping="7"/></default>'
    joint = '<joint name="hatch" class="bayescal"/>'
    default = ('<default class="ur5e">', f'{own}<default class="ur5e">')
    text = changed(default, ('<geom name="cube"', f'{joint}<geom name="cube"'))
    text = text.replace('<freejoint name="cube_free"/>', "").replace("0.6 0.3 0.1 1 0 0 0 ", "0 ")
    out = fits(save(tmp_path, text), BASE)
    assert own in out.written.content
    assert joint in out.written.content
    again = fits(save(tmp_path, out.written.content), BASE)
    classes = ['default class="bayescal"', 'default class="bayescal_2"']
    assert re.findall('default class="bayescal.*?"', again.written.content) == classes


def test_a_fit_of_geometry_changes_poses_alone(tmp_path):
    text = changed(
        ('<option integrator="implicitfast"/>',
         "<option\t integrator = 'RK4'\n   timestep='0.001' />  <!-- a > b -->"),
        ("<!-- the upper arm hangs to the side -->", "<!-- the 'upper' arm &amp; its <tube> -->"),
        ('<body name="wrist_2_link" pos="0 0.127 0">', "<body  pos = '0 0.127 0'\n   name='wrist_2_link'  >"),
        ('model="ur5e scene"', 'model="ur5e &gt; &quot;scene&quot; &#181;"'),
    )  # fmt: skip
    text = text.replace("\n", "\r\n")
    out = fits(save(tmp_path, text), ("geometry",)).written.content

    def rest(t: str) -> str:
        """The text without places of the arm's bodies."""
        for name in re.findall(r"name=.(\w+_link)", text):
            t = re.sub(rf"<body[^>]*name=.{name}.[^>]*>", f"<{name}>", t)
        return t

    added = re.search(r'\r\n {18}<body name="flange".*?</body>(?=\r\n {16}</body>)', out, re.DOTALL)
    assert added
    assert rest(out.replace(added[0], "")) == rest(text)
    assert re.search(r"<body  pos = \"[^\"]*\"\r\n   name='wrist_2_link' quat=\"[^\"]*\"  >", out)


def test_meshes_are_found_from_another_folder(tmp_path):
    (tmp_path / "robots" / "meshes").mkdir(parents=True)
    (tmp_path / "out" / "deep").mkdir(parents=True)
    (tmp_path / "robots" / "meshes" / "t.obj").write_text(TETRAHEDRON)
    mesh = '<mesh name="t" file="{}t.obj"/><material name="linkgray"'
    shown = ('<geom name="table"', '<geom type="mesh" mesh="t" pos="0 0 3"/><geom name="table"')
    arm = drawn("universal-robots-ur5e", ("geometry",))
    for folder, file in (('meshdir="meshes"', ""), ('assetdir="./meshes/"', ""), ("", "meshes/")):
        text = changed(
            ('<material name="linkgray"', mesh.format(file)), shown,
            ('<compiler angle="radian"', f'<compiler {folder} angle="radian"'),
        )  # fmt: skip
        out = export(arm, "mjcf", into=str(save(tmp_path / "robots", text)), force=True)
        assert out.written.placed(tmp_path / "robots") == out.written.content
        for place in (tmp_path / "robots", tmp_path / "out" / "deep"):
            written = out.save(place / "arm.xml")[0]
            assert mujoco.MjModel.from_xml_path(str(written)).nmesh == 1
        assert written.read_text().count("../../robots") == 1
        assert "../" not in (tmp_path / "robots" / "arm.xml").read_text()


def test_nested_includes_are_found_as_by_mujoco(tmp_path):
    """Relative to the scene first, else to the file that includes them."""
    (tmp_path / "parts").mkdir()
    note = "<mujoco><custom><text name='{}' data='x'/></custom></mujoco>"
    save(tmp_path / "parts", '<mujoco><include file="a.xml"/><include file="b.xml"/></mujoco>', "all.xml")
    for folder, name in (("", "a"), ("parts", "a"), ("parts", "b")):
        save(tmp_path / folder, note.format(f"{folder}{name}"), f"{name}.xml")
    compiler = '  <compiler angle="radian"'
    path = save(tmp_path, changed((compiler, f'  <include file="parts/all.xml"/>\n{compiler}')))
    whole = mujoco.MjModel.from_xml_path(str(path))
    model = mujoco.MjModel.from_xml_string(fits(path, ("geometry",)).written.content)
    kind = mujoco.mjtObj.mjOBJ_TEXT
    names = [[mujoco.mj_id2name(m, kind, k) for k in range(m.ntext)] for m in (whole, model)]
    assert names == [["a", "partsb"]] * 2


def test_included_files_stand_in_the_patched_file(tmp_path):
    body = re.search(r"  <worldbody>.*</actuator>\n", SCENE_TEXT, re.DOTALL)[0]
    (tmp_path / "parts").mkdir()
    save(tmp_path / "parts", f"<mujocoinclude>\n<!-- the arm -->\n{body}</mujocoinclude>\n", "arm.xml")
    light = '<worldbody><light pos="0 0 4"/></worldbody>'
    out = fits(save(tmp_path, changed((body, f'  <include file="parts/arm.xml"/>\n  {light}\n'))))
    assert "<!-- the arm -->" in out.written.content
    assert "<include" not in out.written.content
    assert "arm.xml stands in place of its <include>" in out.notes
    assert mujoco.MjModel.from_xml_string(out.written.content).nlight == 2


BASE_TAG = '<body name="base" quat="0 0 0 -1" childclass="ur5e">'
VEHICLE = (
    '<body name="vehicle" pos="1 2 0.5" quat="0.8 0 0 0.6"><freejoint name="drive"/>'
    '<geom size=".3 .2 .1" type="box" mass="80"/>\n    ' + BASE_TAG
)
ENDS = "      </body>\n    </body>\n  </worldbody>"


def on_a_vehicle() -> str:
    """The scene with its arm on a vehicle."""
    text = changed((BASE_TAG, VEHICLE), (ENDS, "      </body>\n    </body></body>\n  </worldbody>"))
    return text.replace('qpos="0.6 0.3 0.1 1 0 0 0 ', 'qpos="0.6 0.3 0.1 1 0 0 0 1 2 0.5 0.8 0 0 0.6 ')


@pytest.mark.parametrize("effects", [("geometry",), EVERY], ids=["geometry", "elastic"])
def test_an_arm_on_a_vehicle(tmp_path, effects):
    model = mujoco.MjModel.from_xml_string(fits(save(tmp_path, on_a_vehicle()), effects).written.content)
    assert model.joint("drive").type == mujoco.mjtJoint.mjJNT_FREE
    assert model.body("vehicle").mass == 80
    if effects == EVERY:
        assert model.body(model.body("stand").parentid[0]).name == "base"


def test_places_of_parameters_are_those_of_the_scene(tmp_path):
    """Where the sidecar says that a parameter is: bodies and joints of the scene."""
    record = fits(save(tmp_path, SCENE_TEXT), ELASTIC).record("scene.xml")
    at = {item["parameter"]: (item["element"], item["attribute"]) for item in record["written"]}
    assert at["a2"] == ("body forearm_link", "pos, quat")  # row 3 of modified DH is before joint 3
    assert at["theta2"] == ("body upper_arm_link", "pos, quat")
    assert at["compliance J3"][0].startswith("joint elbow_joint_flex")
    assert at["ball x"] == ("site ball", "pos")
    new = export(drawn("universal-robots-ur5e", ELASTIC), "mjcf", force=True).record("arm.xml")
    at = {item["parameter"]: item["element"] for item in new["written"]}
    assert (at["a2"], at["theta2"]) == ("body link3", "body link2")


def test_masses_of_geoms_stay(tmp_path):
    inertial = '<freejoint name="cube_free"/><inertial mass="7" pos="1 0 0" diaginertia="1 1 1"/>'
    text = changed(
        ('autolimits="true"', 'autolimits="true" inertiafromgeom="true"'),
        ('<freejoint name="cube_free"/>', inertial),
    )  # fmt: skip
    path = save(tmp_path, text)
    out = fits(path)
    before = mujoco.MjModel.from_xml_path(str(path))
    after = mujoco.MjModel.from_xml_string(out.written.content)
    assert after.body("cube").mass == before.body("cube").mass != 7
    assert after.body("cube").ipos.tolist() == before.body("cube").ipos.tolist()
    assert after.body("upper_arm_link").mass == 8.058
    assert any("inertiafromgeom is auto" in note for note in out.notes)
    assert 'inertiafromgeom="true"' in fits(path, ("geometry",)).written.content


def test_the_mass_of_a_gripper_is_told(tmp_path):
    gripper = '<body name="gripper"><inertial mass="2" pos="0 0 .1" diaginertia="1 1 1"/></body>'
    site = '<site name="attachment_site"'
    arm = drawn("universal-robots-ur5e", ELASTIC)
    path = save(tmp_path, changed((site, f"{gripper}{site}")))
    out = export(arm, "mjcf", into=f"{path}", force=True)
    assert out.record("a")["carried_kg"] == pytest.approx(2.0)
    assert "the file has 2 kg on the last body, in addition to the tool of the session" in out.notes


def test_frames_around_bodies(tmp_path):
    frame = '<frame pos="0 0 .1" euler="0 0 1.2">'
    body = '<body name="shoulder_link" pos="0 0 0.063" axisangle="0 0 1 -1.2">'
    head, tail = changed(('<body name="shoulder_link" pos="0 0 0.163">', frame + body)).split(ENDS)
    out = fits(save(tmp_path, f"{head}      </body></frame>\n    </body>\n  </worldbody>{tail}"))
    assert frame in out.written.content


@pytest.mark.parametrize(
    "first", [("geometry",), (*ELASTIC, "eccentricity", "backlash")], ids=["geometry", "elastic"]
)
def test_an_exported_file_is_patched_again(tmp_path, first):
    """The second calibration replaces the first: no part of it is left."""
    arm, other = drawn("universal-robots-ur5e", EVERY), drawn("universal-robots-ur5e", first, 1)
    fresh = export(arm, "mjcf", into=str(save(tmp_path, SCENE_TEXT, "new.xml")), force=True).written.content
    earlier = export(other, "mjcf", into=str(tmp_path / "new.xml"), force=True).written.content
    again = fits(save(tmp_path, earlier), EVERY)
    assert any("calibrated already" in note for note in again.notes)
    one, two = (mujoco.MjModel.from_xml_string(t) for t in (fresh, again.written.content))
    assert one.names == two.names
    assert one.nq == two.nq
    assert np.abs(one.body_pos - two.body_pos).max() < 2e-3  # frames stay where they are along the axes
    assert np.abs(np.abs(np.sum(one.body_quat * two.body_quat, axis=1)) - 1.0).max() < 1e-5
    np.testing.assert_allclose(one.key_qpos, two.key_qpos, atol=1e-9)
    np.testing.assert_allclose(one.jnt_stiffness, two.jnt_stiffness, rtol=1e-9)


def test_gravity_acts_on_links_that_a_scene_compensates(tmp_path):
    text = changed(('<body name="forearm_link" ', '<body name="forearm_link" gravcomp="1" '))
    out = fits(save(tmp_path, text), BASE)
    assert "gravity acts on forearm_link: springs of the arm carry them" in out.notes
    once = out.written.content
    twice = fits(save(tmp_path, once), BASE).written.content
    one, two = (mujoco.MjModel.from_xml_string(t) for t in (once, twice))
    assert one.names == two.names


def test_of_two_arms_the_last_body_says_which(tmp_path):
    arm = re.search(rf"    {re.escape(BASE_TAG)}.*?\n    </body>\n", SCENE_TEXT, re.DOTALL)[0]
    second = re.sub(r'(name="\w+)(?=")', r"\1_b", arm)
    second = second.replace('quat="0 0 0 -1"', 'pos="2 0 0" quat="0 0 0 -1"')
    path = save(tmp_path, changed((arm, arm + second)).replace("wrist_3_link_b", "far_link"))
    refused(r"several arms .*wrist_3_link, far_link", lambda: fits(path))
    assert fits(path, tip="#far_link").record("x")["tip"] == "far_link"


def test_the_script_beside_a_scene(tmp_path):
    """On a vehicle, beyond the limits of a scene that has a site and a body of our names; with a payload."""
    taken = '<body name="payload" pos="3 0 0"><site name="ball"/><geom size=".1" mass="1"/></body>'
    taken += '<geom name="table"'
    text = on_a_vehicle().replace('<geom name="table"', taken)
    text = text.replace('range="-6.28319 6.28319"', 'range="-.01 .01"')
    arm = drawn("universal-robots-ur5e", (*ELASTIC, "coupling"))
    out = export(arm, "mjcf", into=str(save(tmp_path, text)), readings="script", force=True)
    out.save(tmp_path / "arm.xml")
    replay = Replay(json.loads((tmp_path / "arm-replay.json").read_text()))
    simulated = Simulated(tmp_path / "arm.xml", replay)
    world, readings = np.array(out.record("x")["root_in_f0"]), arm.dataset.measurements.readings[:2]
    for payload in (0.0, 1.5):
        own = np.array([simulated.stand(reading, payload=payload) for reading in readings])
        model = arm.at(readings, payload_kg=payload).points
        np.testing.assert_allclose(own @ world[:3, :3].T + world[:3, 3], model, rtol=0, atol=2e-7)


# --- A light model with a script: the same TCP positions, as a user runs it, without this package.

EFFECTS = (*BASE, "encoder-scale", "coupling", "eccentricity", "gear-mesh@100", "backlash")


@pytest.mark.parametrize(
    ("robot", "into"), [("fanuc-lrmate200ic", ""), ("universal-robots-ur5e", str(SCENE))]
)
def test_script_gives_the_points_of_the_model(robot, into, tmp_path):
    arm = drawn(robot, EFFECTS)
    found = export(arm, "mjcf", into=into, readings="script", force=True)
    record = found.record("arm.xml")
    away, size = differences(arm, 8, File.of(arm, found.written.content, tmp_path / "arm.xml", record))
    assert np.max(away) < 2e-8
    assert size > 2e-6
    written = found.save(tmp_path / "arm.xml")
    assert {p.name for p in written} == {
        "arm.xml", "arm-replay.py", "arm-replay.json", "arm.xml.bayescal.json"
    }  # fmt: skip

    m, some = arm.dataset.measurements, [3, 40]
    with (tmp_path / "readings.csv").open("w", newline="") as file:
        write = csv.writer(file)
        n = range(1, m.readings.shape[1] + 1)
        write.writerow([*(f"j{k}_deg" for k in n), *(f"j{k}_degps" for k in n)])
        for row in some:
            write.writerow([*np.degrees(m.readings[row]).tolist(), *np.degrees(m.velocity[row]).tolist()])
    command = [sys.executable, "-I", str(tmp_path / "arm-replay.py"), str(tmp_path / "readings.csv")]
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=env, cwd=tmp_path)
    points = np.array([[float(x) for x in row] for row in list(csv.reader(done.stdout.splitlines()))[1:]])
    world = np.array(record["root_in_f0"]) if into else np.eye(4)
    model = arm.at(m.readings[some], direction=1e3 * m.velocity[some]).points
    assert np.allclose(1e-3 * points @ world[:3, :3].T + world[:3, 3], model, atol=2e-7)


def test_contact_errors_are_those_of_the_model():
    arm = drawn("universal-robots-ur5e", (*BASE, "lobing", "latency", "ball-radius"))
    table = replay_table(Content(arm, 3), Joints.of(arm.dataset.robot.joint_names), True, {})
    replay, scene = Replay(table), arm.model.scene
    c = scene.circumstances(scene.rows("calibrate"))
    for block in arm.model.blocks:
        expected = block.at_contact(arm.values)
        found = [replay.contact_error(c.approach[row], c.speed[row]) for row in block.rows]
        assert np.allclose(found, expected, atol=1e-12)
        assert np.max(np.abs(expected)) > 1e-6


# --- Springs of MuJoCo against the characteristics that they stand for.

TORQUE = 40.0 * np.linspace(0.0, 1.0, 1501)[1:] ** 2
FINE = np.linspace(-40.0, 40.0, 4001)
CHARACTERISTICS = {
    "softer under load": lambda t: 3e-5 * t + 3e-7 * t * np.abs(t),
    "stiffer under load": lambda t: 6e-5 * t - 3e-7 * t * np.abs(t),
    "knee": lambda t: 3e-5 * t + 1e-4 * np.tanh(t / 9.0),
    "hysteresis": lambda t: 3e-5 * t + 5e-5 * np.tanh(t / 0.6),
}


@pytest.mark.parametrize("name", CHARACTERISTICS)
def test_spring_has_the_characteristic(name):
    deflection = CHARACTERISTICS[name]
    spring = spring_of(TORQUE, deflection(TORQUE))
    off = (spring.torque(deflection(FINE)) - FINE) * np.gradient(deflection(FINE), FINE)
    assert np.max(np.abs(off)) < 1.5 * CLOSE
    assert all(b.stiffness > 0 for b in spring.bands)  # else the integrator leaves a part of it explicit
    assert spring.stiffness >= 0
    assert spring.slope == pytest.approx(1.0 / (deflection(1e-3) / 1e-3), rel=0.05)


def test_compliance_is_one_linear_spring():
    spring = spring_of(TORQUE, 2e-4 * TORQUE)
    assert spring.stiffness == pytest.approx(5e3, rel=1e-12)
    assert not spring.bands
