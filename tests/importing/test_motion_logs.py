"""Joint logs of other programs come back as the session they were written from; assumptions are noted."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cases import cases, refused
from motion_logs import (
    CONSTANTS,
    FRANKA,
    JTC,
    STATE,
    UR,
    bag,
    controller_states,
    header,
    joint_states,
    lerobot,
    of_joints,
    rtde,
    sage,
    session,
    write_csv,
)

from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write
from bayescal.importing.joint_formats import joint_order
from bayescal.importing.joint_rows import Rows, repeats
from bayescal.importing.joint_torques import contradiction, misread
from bayescal.logs import read_log
from bayescal.motion.dynamics import regressor

ARM = "universal-robots-ur10e"
MAP = "time=t s, j*=q*0 rad, j*_velocity=dq*0 radps, j*_torque=tau*0 Nm"


@pytest.fixture(scope="module")
def s():
    return session()


@pytest.fixture(scope="module")
def once(s, tmp_path_factory):
    """A plain table of the session."""
    columns = {"t": s.time} | of_joints("q", s.position) | of_joints("dq", s.velocity)
    return write_csv(tmp_path_factory.mktemp("log") / "log.csv", columns | of_joints("tau", s.torque))


@pytest.fixture
def table(once, tmp_path):
    """A copy of the table, for a test to change."""
    return Path(shutil.copy(once, tmp_path))


def imported(request, tmp_path):
    """The log that an import writes, and its draft."""
    draft = convert(request)
    write(draft, tmp_path / "out")
    return read_log(tmp_path / "out"), draft


def joined(log, name):
    return np.concatenate([getattr(m, name) for m in log.motions])


def noted(draft, words):
    assert any(words in note for note in draft.notes), draft.notes


def fails(words, **options):
    with pytest.raises(BayescalError) as error:
        convert(Request(robot=options.pop("robot", ARM), **options))
    assert words in str(error.value), str(error.value)
    assert str(error.value).count("\n") == 0


def test_a_table_comes_back_divided_at_pauses(s, table, tmp_path):
    log, draft = imported(Request(table, MAP, robot=ARM, motions="pause:0.5 s"), tmp_path)
    np.testing.assert_allclose(joined(log, "position"), s.position, atol=1e-8)
    np.testing.assert_allclose(joined(log, "velocity"), s.velocity, atol=1e-8)
    np.testing.assert_allclose(joined(log, "torque"), s.torque, atol=1e-6)
    np.testing.assert_allclose(joined(log, "time"), s.time - s.time[0], atol=1e-6)
    assert [m.role for m in log.motions] == ["calibrate"] * 4 + ["validate"]
    assert [m.same_as for m in log.motions] == ["1", "1", "3", "4", "5"]
    rows = [len(m.time) for m in log.motions]  # 200 of each, 80 of each pause, cut in the middle
    np.testing.assert_allclose(rows, [80 + 200 + 40, 280, 280, 280, 40 + 200 + 80], atol=12)
    noted(draft, "validation motions: 5 (by default the last 20 %)")
    noted(draft, "repeats of one trajectory: 1, 2")
    noted(draft, "(assumed")
    assert (tmp_path / "out/dataset.yaml").read_text().startswith("# imported from log.csv\n# ")


def test_a_column_divides_names_and_gives_roles(s, table, tmp_path):
    head, *rows = table.read_text().splitlines()
    ends = [f"{'abcdef'[m]},{'validate' if m == 2 else ''}" for m in s.motion]
    more = [f"{row},{end}" for row, end in zip(rows, ends, strict=True)]
    table.write_text("\n".join([f"{head},name,role", *more]))
    said = f"{MAP}, motion=name, role=role, temperature=31 C, payload=2 kg"
    log, _ = imported(Request(table, said, robot=ARM, motions="column"), tmp_path)
    assert [m.name for m in log.motions] == list("abcdef")
    assert [m.role for m in log.motions] == ["calibrate"] * 2 + ["validate"] + ["calibrate"] * 3
    assert all(m.loaded and m.temperature[0] == 31 for m in log.motions)


def test_a_name_that_returns_is_another_motion_and_rest_is_none(s, table, tmp_path):
    head, *rows = table.read_text().splitlines()
    moves = np.abs(s.velocity).max(axis=1) > 1e-3
    number = np.cumsum(moves & np.r_[True, ~moves[:-1]]) * moves
    ends = [("rest", "wave", "wave", "c", "d", "e")[k] for k in number]
    table.write_text("\n".join([f"{head},name", *(f"{r},{e}" for r, e in zip(rows, ends, strict=True))]))
    draft = convert(Request(table, f"{MAP}, motion=name", robot=ARM, motions="column"))
    assert [m["id"] for m in draft.settings["motions"]] == ["wave", "wave-2", "c", "d", "e"]
    noted(draft, "rows of rest, in which no joint moves, left out")
    assert len(draft.columns["t_s"]) == moves.sum()


@pytest.mark.parametrize(("name", "factor", "unit"), [
    ("ns", 1e9, "epoch_ns"), ("us", 1e6, "us"), ("us", 1e6, "µs"), ("s", 1.0, "s"), ("ms", 1e3, "ms"),
])  # fmt: skip
def test_stamps_in_each_unit_and_columns_by_the_names_of_the_joints(s, tmp_path, name, factor, unit):
    start = 1763650000.0 if unit.startswith("epoch") else 0.0
    columns = {name: np.char.mod("%d", np.round((start + s.time) * factor).astype("int64"))}
    columns = columns if factor > 1 else {name: s.time}
    columns |= {f"/joint_states/{n}/position": v for n, v in zip(UR, s.position.T, strict=True)}
    rpm = s.velocity / (np.pi / 30)
    columns |= {f"/joint_states/{n}/velocity": v for n, v in zip(UR, rpm.T, strict=True)}
    path = write_csv(tmp_path / "log.csv", columns)
    said = f"time={name} {unit}, j*={{/joint_states/*name/position}} rad"
    said += ", j*_velocity={/joint_states/*name/velocity} rpm"
    draft = convert(Request(path, said, robot=ARM, motions="pause:0.5 s", joints=",".join(UR)))
    np.testing.assert_allclose(draft.columns["t_s"], s.time - s.time[0], atol=1e-6)
    np.testing.assert_allclose(draft.columns["q3_deg"], np.degrees(s.position[:, 2]), atol=1e-6)
    np.testing.assert_allclose(draft.columns["dq3_degps"], np.degrees(s.velocity[:, 2]), atol=1e-5)
    assert not draft.wrong


def test_seconds_and_nanoseconds_in_two_columns(s, tmp_path):
    time = np.round((s.time + 1763650000.2) * 1e3).astype("int64")
    columns = {"stamp.sec": time // 1000, "stamp.nanosec": time % 1000 * 10**6} | of_joints("q", s.position)
    path = write_csv(tmp_path / "log.csv", {k: v.astype(str) if "st" in k else v for k, v in columns.items()})
    said = "time=stamp.sec + stamp.nanosec/1e9 epoch_s, j*=q*0 rad"
    draft = convert(Request(path, said, robot=ARM, motions="pause:0.5 s"))
    np.testing.assert_allclose(draft.columns["t_s"], s.time - s.time[0], atol=1e-6)
    (tmp_path / "README.txt").write_text("of the recordings")
    write_csv(tmp_path / "other.csv", {k: v.astype(str) if "st" in k else v for k, v in columns.items()})
    assert len(convert(Request(tmp_path, said, robot=ARM)).settings["motions"]) == 2


def test_per_cent_of_the_rated_torque_is_refused_with_the_expression(table):
    said = MAP.replace("tau*0 Nm", "tau*0 %")
    fails("for 150 N m write `j1_torque={tau0} * 1.5 Nm`", log=table, map=said, motions="pause:0.5 s")


def test_stamps_since_1970_in_an_expression_are_refused_with_what_works(table):
    said = MAP.replace("t s", "t + 1763650000 s")
    fails("map the column alone, as one of epoch_s", log=table, map=said, motions="pause:0.5 s")


def test_files_are_motions_and_the_last_kind_validates(s, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    for k, name in ((1, "sweep_1"), (2, "sweep_2"), (3, "sweep_3"), (4, "zpick_1"), (5, "zpick_2")):
        rows = s.motion == k
        columns = {"t": s.time[rows] - s.time[rows][0]} | of_joints("q", s.position[rows])
        write_csv(folder / f"{name}.csv", columns)
    log, draft = imported(Request(folder, "time=t s, j*=q*0 rad", robot=ARM), tmp_path)
    assert [m.role for m in log.motions] == ["calibrate"] * 3 + ["validate"] * 2
    assert [m.kind for m in log.motions] == ["sweep"] * 3 + ["zpick"] * 2
    noted(draft, "those of the last kind, `zpick`")
    noted(draft, "each record has its own clock: 1 s is put between them")
    noted(draft, "no torques and no commands: the log cannot be diagnosed")
    assert np.all(np.diff(joined(log, "time")) > 0)
    assert log.torque_kind == ""
    assert log.controller.kind == "position"


@pytest.mark.parametrize(("rule", "validated"), [
    ("last:40%", "45"), ("every:2", "24"), ("motions '1,3'", "13"), ("kind 'log'", ""),
])  # fmt: skip
def test_roles_by_a_rule(table, rule, validated):
    request = Request(table, MAP, robot=ARM, motions="pause:0.5 s", validate=rule)
    if not validated:
        refused("all of the 5 motions would validate", lambda: convert(request))
        return
    motions = convert(request).settings["motions"]
    assert "".join(m["id"] for m in motions if m["role"] == "validate") == validated


def test_a_record_of_rtde_gives_torque_constants_at_rest(s, tmp_path):
    request = Request(rtde(tmp_path / "r.csv", s), format="ur-rtde", robot=ARM, motions="pause:0.5 s")
    log, draft = imported(request, tmp_path)
    constants = np.array(draft.settings["torque"]["constant_Nm_per_A"])
    np.testing.assert_allclose(constants[1:5], CONSTANTS[1:5], rtol=1e-3)  # they bear gravity at rest
    np.testing.assert_allclose(constants[[0, 5]], CONSTANTS[[0, 5]], rtol=0.01)
    noted(draft, "of J1, J6, which bear no torque at rest, in motion beside friction")
    noted(draft, "the temperature is the mean")
    np.testing.assert_allclose(joined(log, "torque"), s.current * constants, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(joined(log, "command"), s.position, atol=1e-8)
    assert log.torque_kind == "current"
    assert log.u_constant == 0.1


def test_torques_of_a_record_of_rtde_and_currents_that_are_none(s, tmp_path):
    path = rtde(tmp_path / "a.csv", s, **of_joints("actual_current_as_torque_", s.torque))
    draft = convert(Request(path, format="ur-rtde", robot=ARM, motions="pause:0.5 s"))
    assert draft.settings["torque"]["kind"] == "motor"
    np.testing.assert_allclose(draft.columns["torque2_Nm"], s.torque[:, 1], rtol=1e-6)
    bare = rtde(tmp_path / "b.csv", s)
    usual = {"format": "ur-rtde", "motions": "pause:0.5 s"}
    fails("the log has currents, A, and no torques of a motor", log=bare, torque="motor", **usual)


def test_constants_that_a_record_does_not_give_are_asked_for(s, tmp_path):
    path = rtde(tmp_path / "r.csv", replace(s, torque=np.where(np.arange(6) == 5, 0.0, s.torque)))
    usual = {"log": path, "format": "ur-rtde", "motions": "pause:0.5 s"}
    fails("does not give the torque constants of J6", **usual)
    fails("is not 6 positive numbers", torque="current: 12 12 10", **usual)
    draft = convert(Request(robot=ARM, torque="current: 12 12 10 5 5 5", **usual))
    assert draft.settings["torque"]["constant_Nm_per_A"] == [12, 12, 10, 5, 5, 5]


@pytest.mark.parametrize("mcap", [False, True])
def test_a_bag_in_another_order_of_joints_with_commands_of_another_topic(s, tmp_path, mcap):
    path = bag(tmp_path / "bag", [joint_states(s, sorted(UR)), controller_states(s, first=10)], mcap)
    draft = convert(Request(path, robot=ARM, motions="pause:0.5 s", torque="current: 12 12 10 5 5 5"))
    write(draft, tmp_path / "out")
    log = read_log(tmp_path / "out")
    rows = slice(10, len(s.time) - 1)  # those before and behind have no command
    np.testing.assert_allclose(joined(log, "position"), s.position[rows], atol=1e-8)
    np.testing.assert_allclose(joined(log, "torque"), (s.current * CONSTANTS)[rows], rtol=1e-6, atol=1e-6)
    ahead = s.position[np.minimum(np.arange(len(s.time)) + 2, len(s.time) - 1)]
    np.testing.assert_allclose(joined(log, "command")[::2][:-2], ahead[rows][::2][:-2], atol=1e-8)
    noted(draft, "joints from the base on: shoulder_pan_joint, shoulder_lift_joint")
    noted(draft, "received 2 ms later")
    noted(draft, "11 rows of /joint_states outside the time of /controller/state left out")
    noted(draft, f"command of /controller/state ({JTC}), interpolated")
    assert log.u_alignment == pytest.approx(0.01)


def test_fingers_are_no_joints_of_the_arm():
    arm = [f"panda_joint{k}" for k in (3, 1, 2, 4, 5, 6, 7)]
    names = ["panda_finger_joint1", *arm, "panda_finger_joint2"]
    order, how = joint_order(names, [f"J{k + 1}" for k in range(7)], "", "log")
    assert [names[k] for k in order] == sorted(arm)
    assert how.startswith("joints by number")
    refused("do not match those of the robot", lambda: joint_order(names, ["J1", "J2", "J3"], "", "log"))


def test_efforts_of_a_ur_need_constants(s, tmp_path):
    path = bag(tmp_path / "bag", [joint_states(s)])
    fails("efforts of this arm are currents, A", log=path, motions="pause:0.5 s")
    draft = convert(Request(path, robot=ARM, motions="pause:0.5 s", torque="motor"))
    assert draft.settings["torque"] == {"kind": "motor", "referred_to": "joint", "sign": "joint"}


def test_efforts_of_a_franka_are_those_of_sensors_and_zeros_are_none(s, tmp_path):
    seven = [f"fr3_joint{k}" for k in range(1, 8)]
    middle = np.column_stack([s.position, s.position[:, 0]]) - 0.5
    middle[:, [3, 5]] += [-1.0, 1.8]

    def states(factor):
        def make(types, k):
            torque = factor * np.arange(-3.0, 4)
            return types[STATE](header(types, s.time[k]), seven, middle[k], 0.0 * torque, torque)

        path = bag(tmp_path / str(factor), [("/joint_states", STATE, make, s.time)])
        return convert(Request(path, robot="franka-panda", motions="pause:0.5 s"))

    draft = states(1)
    assert draft.settings["torque"]["kind"] == "sensor"
    assert draft.settings["position"] == {"side": "joint"}
    noted(draft, "no value of velocity (none, or only zeros)")
    assert states(0).settings["torque"] == {}


def test_messages_without_stamps_have_the_time_of_reception(s, tmp_path):
    path = bag(tmp_path / "bag", [joint_states(s, unstamped=True, late=0.5)])
    draft = convert(Request(path, robot=ARM, motions="pause:0.5 s", torque="motor"))
    noted(draft, "times are those of reception")
    np.testing.assert_allclose(draft.columns["t_s"], s.time - s.time[0], atol=1e-6)


def test_stamps_of_reception_may_scatter(s, tmp_path):
    """Messages in bursts: neither pauses nor a velocity that is right are lost."""
    topic, kind, _, times = joint_states(s, unstamped=True)
    rng = np.random.default_rng(2)
    rested = s.position + rng.normal(0, 2e-5, s.position.shape)
    late = np.maximum.accumulate(times + np.where(rng.random(len(times)) < 0.05, 0.03, 0.0))
    late += 1e-4 * np.arange(len(late)) % 5e-4
    noisy = joint_states(replace(s, position=rested), unstamped=True)[2]
    path = bag(tmp_path / "b", [(topic, kind, noisy, late)])
    draft = convert(Request(path, robot=ARM, motions="pause:0.5 s", torque="motor"))
    assert len(draft.settings["motions"]) == 5
    assert not draft.wrong


def test_a_gripper_may_be_the_first_to_publish(s, tmp_path):
    topic, kind, make, times = joint_states(s)

    def gripper_first(types, k):
        own = [np.zeros(1)] * 3
        return make(types, k) if k >= 5 else types[kind](header(types, s.time[k]), ["finger_joint"], *own)

    path = bag(tmp_path / "bag", [(topic, kind, gripper_first, times)])
    draft = convert(Request(path, robot=ARM, motions="pause:0.5 s", torque="motor"))
    noted(draft, "5 messages without all joints left out")
    assert len(draft.columns["t_s"]) == len(s.time) - 5


@pytest.mark.parametrize(("late", "empty"), [(0, True), (8, False)])
def test_a_second_publisher_of_the_same_joints_is_left_out(s, tmp_path, late, empty):
    """Its positions are late or its efforts are missing; rows of both were one log of torques and jumps."""
    topic, kind, make, times = joint_states(s, names=sorted(UR))
    other = joint_states(s, names=UR)[2]

    def both(types, k):
        row, second = divmod(k, 2)
        if not second or row % 2:
            return make(types, row)
        message = other(types, max(row - late, 0))
        message.header = header(types, s.time[row] + 0.003)
        message.effort = np.zeros(0) if empty else 0.0 * message.effort
        return message

    stamps = np.column_stack([times, times + 0.003]).ravel()
    keep = np.ones(len(stamps), bool)
    keep[3::4] = False  # of every second row the second publisher has none
    rows = np.flatnonzero(keep)
    messages = (topic, kind, lambda types, k: both(types, int(rows[k])), stamps[keep])
    path = bag(tmp_path / "bag", [messages])
    draft = convert(Request(path, robot=ARM, motions="pause:0.5 s", torque="motor"))
    others = (len(s.time) + 1) // 2
    noted(draft, f"{others} of {len(rows)} messages of /joint_states left out")
    np.testing.assert_allclose(draft.columns["q1_deg"], np.degrees(s.position[:, 0]), atol=1e-9)
    np.testing.assert_allclose(draft.columns["torque1_Nm"], s.current[:, 0], atol=1e-9)


def test_names_of_other_descriptions_of_an_arm():
    so101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    names = ("Jaw", "Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll")
    assert joint_order(names, so101, "", "")[0] == [1, 2, 3, 4, 5]
    assert joint_order(("joint_1", "joint_0", "gripper"), ("a", "b"), "", "")[0] == [1, 0]
    with pytest.raises(BayescalError, match="`gripper` is no joint of an arm"):
        joint_order(("pan.pos", "gripper.pos"), ("pan", "gripper"), "", "")


def test_joint_states_of_a_topic_of_commands_are_commands(s, tmp_path):
    ahead = replace(s, position=s.position + 0.01)
    topics = [joint_states(ahead, topic="/isaac_joint_commands"), joint_states(s, topic="/arm_states")]
    usual = {"robot": ARM, "motions": "pause:0.5 s", "torque": "motor"}
    path = bag(tmp_path / "bag", topics)
    draft = convert(Request(path, **usual))
    np.testing.assert_allclose(draft.columns["q2_deg"], np.degrees(s.position[:, 1]), atol=1e-9)
    np.testing.assert_allclose(draft.columns["command2_deg"], np.degrees(ahead.position[:, 1]), atol=1e-9)
    notes = convert(Request(path, topic="/isaac_joint_commands", **usual)).notes
    assert "rows of /isaac_joint_commands" in notes[0]


def test_publishers_of_parts_of_the_arm_are_told_from_a_wrong_name(s, tmp_path):
    topic, kind, _, times = joint_states(s)

    def halves(types, k):
        row, part = k // 2, slice(0, 3) if k % 2 else slice(3, 6)
        values = (s.position[row, part], s.velocity[row, part], s.current[row, part])
        return types[kind](header(types, s.time[row]), list(UR[part]), *values)

    path = bag(tmp_path / "bag", [(topic, kind, halves, np.repeat(times, 2))])
    fails("several publishers have parts of the 6 joints", log=path, motions="pause:0.5 s")


def test_several_topics_are_chosen_from(s, tmp_path):
    path = bag(tmp_path / "bag", [joint_states(s, topic="/a"), joint_states(s, topic="/b")])
    usual = {"log": path, "motions": "pause:0.5 s", "torque": "motor"}
    fails("joint positions on several topics: /a, /b", **usual)
    fails("no joint positions on `/c`", topic="/c", **usual)
    assert "rows of /b" in convert(Request(robot=ARM, topic="/b", **usual)).notes[0]


def test_franka_states_are_those_of_torque_sensors(s, tmp_path):
    middle = s.position - s.position.mean(axis=0)
    seven = np.column_stack([middle, middle[:, 0]]) + np.array([0, 0, 0, -1.5, 0, 1.8, 0])

    def make(types, k):
        still, torque = np.zeros(7), np.arange(7.0) - 3
        values = {"q": seven[k], "q_d": seven[k], "dq": still + 1, "tau_J": torque}
        return types[FRANKA](header=header(types, s.time[k]), **values)

    path = bag(tmp_path / "bag", [("/franka/state", FRANKA, make, s.time)], mcap=True)
    draft = convert(Request(path, robot="franka-panda", motions="pause:0.5 s"))
    assert draft.settings["torque"]["kind"] == "sensor"
    assert draft.settings["position"] == {"side": "joint"}
    assert draft.columns["torque7_Nm"][0] == 3
    assert "times that of its positions" in draft.wrong


def test_a_damaged_bag_and_a_missing_topic(s, tmp_path):
    path = bag(tmp_path / "bag", [joint_states(s, UR[:4])])
    fails("no joint positions of the 6 joints", log=path)
    file = tmp_path / "broken.mcap"
    file.write_bytes(b"\x89MCAP0\r\n" + bytes(range(100)))
    fails("the bag cannot be read", log=file)
    fails("is not an option of joint logs (rosbag)", log=path, map=MAP)


def test_without_the_package_a_bag_is_refused_with_the_remedy(monkeypatch, tmp_path):
    import sys

    (tmp_path / "log.mcap").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    words = "this log needs the package rosbags; install it: `pip install bayescal[logs]`"
    fails(words, log=tmp_path / "log.mcap")


SO101 = """<robot name="so101"><link name="base"/>{}</robot>"""
NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


@pytest.fixture
def five(tmp_path):
    """A URDF of five joints from -90 to 90 deg, each link with a mass."""
    inertia = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
    parts = [
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>'
        f'<origin xyz="0 0 0.1" rpy="{1.5707963 * (k % 2)} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-1.5707963" upper="1.5707963" effort="3" velocity="5"/></joint>'
        f'<link name="l{k}"><inertial><origin xyz="0 0 0.05"/><mass value="0.2"/>{inertia}</inertial></link>'
        for k, (name, parent) in enumerate(zip(NAMES, ("base", "l0", "l1", "l2", "l3"), strict=True))
    ]
    path = tmp_path / "so101.urdf"
    path.write_text(SO101.format("".join(parts)))
    return path


def test_a_joint_that_turns_without_end_has_no_limits(s, five, tmp_path):
    """Three turns of the first joint; the others are limited."""
    five.write_text(five.read_text().replace("revolute", "continuous", 1))
    position = s.position[:, :5] - s.position[:, :5].mean(axis=0)
    position[:, 0] += 6 * np.pi
    columns = {"t": s.time} | of_joints("q", position)
    request = {"map": "time=t s, j*=q*0 rad", "robot": str(five), "motions": "pause:0.5 s"}
    log, draft = imported(Request(write_csv(tmp_path / "log.csv", columns), **request), tmp_path)
    assert not draft.wrong
    bounds = np.tile([-np.pi / 2, np.pi / 2], (5, 1))
    bounds[0] = np.nan
    np.testing.assert_allclose(log.mechanism.limits, bounds, atol=1e-6)
    columns["q1"] = columns["q1"] + 6 * np.pi
    assert "J2 moves from" in convert(Request(write_csv(tmp_path / "log.csv", columns), **request)).wrong


@pytest.mark.parametrize(("unit", "of_rad", "words"), [
    ("deg", np.degrees, "are in deg, as stated"),
    ("rad", np.asarray, "are in rad, as stated"),
    ("normalised", lambda q: q / (np.pi / 2) * 100, "-100 to 100 is the range of each joint in the robot"),
])  # fmt: skip
def test_a_lerobot_data_set_in_each_unit(s, five, tmp_path, unit, of_rad, words):
    arm = s.position - s.position.mean(axis=0)
    gripper = np.insert(of_rad(arm[:, [3, 0, 1, 2, 4]]), 4, 50.0, axis=1)
    names = [f"{NAMES[k]}.pos" for k in (3, 0, 1, 2)] + ["gripper.pos", "wrist_roll.pos"]
    folder = lerobot(tmp_path / "set", s, names, gripper)
    log, draft = imported(Request(folder, unit, robot=str(five)), tmp_path)
    rows = s.motion > 0
    np.testing.assert_allclose(joined(log, "position"), arm[rows][:, :5], atol=1e-5)
    np.testing.assert_allclose(joined(log, "command"), arm[rows][:, :5], atol=1e-5)
    assert [m.role for m in log.motions] == ["calibrate"] * 4 + ["validate"]
    assert [m.kind for m in log.motions] == ["task 0"] * 4 + ["task 1"]
    assert draft.settings["clock"]["kind"] == "index"
    noted(draft, words)
    noted(draft, "they show no jitter of the recording")
    noted(draft, "joints by name: shoulder_pan.pos, shoulder_lift.pos")
    assert log.mechanism.joint_names == NAMES


@pytest.mark.parametrize("unit", ["steps", "deg", "normalised"])
def test_a_lerobot_data_set_with_its_calibration(s, five, tmp_path, unit):
    """The ranges of the servos, not the limits of the robot file, state the angles."""
    arm = (s.position - s.position.mean(axis=0))[:, :5]
    ranges = np.array([(700, 3400), (810, 3260), (905, 3109), (840, 3231), (0, 4095)])
    keys = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
    values = [(k + 1, 0, 30 * k, *ends) for k, ends in enumerate(ranges.tolist())]
    content = {name: dict(zip(keys, v, strict=True)) for name, v in zip(NAMES, values, strict=True)}
    (tmp_path / "c.json").write_text(json.dumps(content))
    steps = arm / (2 * np.pi) * 4096
    shown = {"steps": steps + ranges.mean(axis=1), "deg": steps * 360 / 4095}
    shown["normalised"] = 200 * steps / np.diff(ranges)[:, 0]
    folder = lerobot(tmp_path / "set", s, NAMES, shown[unit])
    draft = convert(Request(folder, unit, robot=str(five), calibration=tmp_path / "c.json"))
    found = np.column_stack([draft.columns[f"q{k + 1}_deg"] for k in range(5)])
    np.testing.assert_allclose(found, np.degrees(arm[s.motion > 0]), atol=2e-4)  # float32 of 4000 steps


@pytest.mark.parametrize("said", ["q*0 deg", "dq*0 / 10 rad"])
def test_commands_in_another_unit_are_seen(table, said):
    draft = convert(Request(table, f"{MAP}, j*_command={said}", robot=ARM, motions="pause:0.5 s"))
    assert "are unit and joint of the commands right?" in draft.wrong


@pytest.mark.parametrize("said", ["t * 1000 s", "t us"])
def test_times_in_another_unit_are_seen(table, tmp_path, said):
    folder = tmp_path / "in"
    folder.mkdir()
    for name in "ab":
        (folder / f"{name}.csv").write_text(table.read_text())
    map_ = f"time={said}, j*=q*0 rad, j*_torque=tau*0 Nm"
    assert "is the unit of time right?" in convert(Request(folder, map_, robot=ARM)).wrong


def test_angles_in_another_unit_than_stated_are_seen_by_their_steps():
    ranges = np.array([2532.0, 2400.0, 2199.0, 2351.0, 3840.0])
    time = np.linspace(0, 30, 900)[:, None]
    steps = np.round(0.4 * ranges * np.sin(time * [0.3, 0.4, 0.5, 0.6, 0.7]))
    degrees, normalised = 360 / 4096 * steps, 200 / ranges * steps
    assert misread(degrees, "deg") == misread(360 / 4095 * steps, "deg") == ""
    assert misread(normalised, "normalised") == misread(np.radians(degrees), "rad") == ""
    assert "are normalised values" in misread(normalised.astype("float32").astype(float), "deg")
    assert "are deg stated as normalised" in misread(degrees.astype("float32").astype(float), "normalised")
    assert "are angles in rad stated as deg" in misread(np.radians(degrees), "deg")
    geared = np.round(degrees / (0.001 * np.arange(1, 6))) * (0.001 * np.arange(1, 6))
    assert misread(geared, "deg") == ""  # fine encoders behind different gears


def test_lerobot_without_unit_or_beyond_its_range_is_refused(s, five, tmp_path):
    folder = lerobot(tmp_path / "set", s, NAMES, np.degrees(s.position[:, :5]), info=True, real=True)
    usual = {"log": folder, "robot": str(five)}
    fails("the unit of observation.state is not stated", **usual)
    fails("normalised values up to", map="normalised", **usual)
    draft = convert(Request(map="rad", **usual))
    assert "beyond its limits" in draft.wrong
    assert draft.settings["clock"]["kind"] == "stamps"
    refused("beyond its limits", lambda: write(draft, tmp_path / "out"))


@pytest.mark.parametrize("info", ["[]", '{"features": 3, "fps": "x"}'])
def test_a_data_set_with_a_damaged_description_has_no_names(s, five, tmp_path, info):
    folder = lerobot(tmp_path / "set", s, NAMES, s.position[:, :5] - s.position[:, :5].mean(axis=0))
    (folder / "meta/info.json").write_text(info)
    draft = convert(Request(folder, "rad", robot=str(five)))
    noted(draft, "the log does not name them")
    assert draft.settings["clock"]["kind"] == "stamps"


def test_a_parquet_file_without_names(s, five, tmp_path):
    folder = lerobot(tmp_path / "set", s, NAMES, s.position[:, :5] - s.position[:, :5].mean(axis=0))
    file = folder / "data/chunk-000/file-000.parquet"
    draft = convert(Request(file, "rad", robot=str(five), table="parquet"))
    noted(draft, "the log does not name them")
    write(draft, tmp_path / "out")
    written = {p.name for p in (tmp_path / "out").iterdir() if p.name[0] != "."}
    assert written == {"dataset.yaml", "motion.parquet", "so101.urdf"}
    assert len(read_log(tmp_path / "out").motions) == 5


MJCF = """<mujoco model="two"><compiler angle="degree"/><option gravity="0 0 -9.7"/><worldbody>
<body pos="0 0 0.3" quat="0.9 0.1 0.2 0"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
<body name="a" pos="0.1 0 0.2"><joint name="j1" axis="0 1 0.2" pos="0 0 0.05" range="-180 180" armature="0.3"
damping="2" frictionloss="1.5"/>
<inertial mass="3" pos="0.1 0.02 0.2" quat="0.8 0.3 0 0" diaginertia="0.1 0.2 0.25"/>
<body name="b" pos="0 0 0.4" quat="0.7 0 0.7 0"><joint name="j2" axis="0 1 0"/>
<inertial mass="2" pos="0 0.03 0.15" diaginertia="0.05 0.04 0.02"/>
<body name="tool" pos="0 0 0.3" quat="0.9 0 0 0.3">
<inertial mass="0.7" pos="0.02 0 0.05" diaginertia="0.003 0.002 0.004"/>
<body name="jaw" pos="0 0.02 0.05"><joint name="gripper" axis="1 0 0" range="0 60"/>
<inertial mass="0.1" pos="0 0 0.02" diaginertia="1e-4 1e-4 1e-4"/></body></body></body></body></body>
</worldbody></mujoco>"""


def test_an_mjcf_model_is_written_out_with_its_dynamics(s, tmp_path):
    import mujoco

    path = tmp_path / "two.xml"
    path.write_text(MJCF)
    table = write_csv(tmp_path / "log.csv", {"t": s.time} | of_joints("q", s.position[:, :2]))
    request = Request(table, "time=t s, j*=q*0 rad", robot=str(path), motions="pause:0.5 s")
    log, draft = imported(request, tmp_path)
    noted(draft, "joints at zero, as parts of the last body: gripper")
    assert log.mechanism.joint_names == ("j1", "j2")
    np.testing.assert_allclose(log.mechanism.armature, [0.3, np.nan])
    np.testing.assert_allclose(log.mechanism.coulomb, [1.5, np.nan])
    np.testing.assert_allclose(log.mechanism.limits, [[-np.pi, np.pi], [np.nan, np.nan]])
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    model.dof_armature[:], model.dof_damping[:], model.dof_frictionloss[:] = 0, 0, 0
    for q, dq, ddq in rng.uniform(-2, 2, (5, 3, 2)):
        data.qpos[:], data.qvel[:], data.qacc[:] = (np.append(x, 0) for x in (q, dq, ddq))
        mujoco.mj_inverse(model, data)
        parts = regressor(log.mechanism, q[None], dq[None], ddq[None], log.gravity)[0]
        got = np.einsum("jkp,kp->j", parts, log.mechanism.inertials)
        np.testing.assert_allclose(got, data.qfrc_inverse[:2], rtol=1e-8, atol=1e-9)


def test_models_that_are_no_serial_arm_are_refused(table, tmp_path):
    path = tmp_path / "arm.xml"
    second = '<body><joint name="x"/><geom size="1"/></body></worldbody>'
    path.write_text(MJCF.replace("</worldbody>", second))
    fails("are no serial chain", log=table, map=MAP, robot=str(path), motions="pause:0.5 s")
    path.write_text("<robot/>")
    fails("<robot> is no MJCF", log=table, map=MAP, robot=str(path), motions="pause:0.5 s")
    path.write_text("<mujoco><worldbody><body/><bogus/></worldbody></mujoco>")
    fails("MuJoCo cannot load it", log=table, map=MAP, robot=str(path), motions="pause:0.5 s")


def test_sage_folders(s, tmp_path):
    order = np.argsort(UR)  # as a list by name
    listed = replace(s, **{k: getattr(s, k)[:, order] for k in ("position", "velocity", "torque")})
    for number in (1, 2, 3):
        sage(tmp_path / f"real/arm/custom/wave_{number}", listed, number, names=sorted(UR))
    log, draft = imported(Request(tmp_path / "real", robot=ARM), tmp_path)
    kept = np.concatenate([np.flatnonzero(s.motion == k)[10:-10] for k in (1, 2, 3)])
    np.testing.assert_allclose(joined(log, "position"), s.position[kept], atol=1e-6)
    np.testing.assert_allclose(joined(log, "torque"), s.torque[kept], atol=1e-6)
    motions = [np.flatnonzero(s.motion == k) for k in (1, 2, 3)]
    last = np.concatenate([rows[4 * (np.arange(10, len(rows) - 10) // 4)] for rows in motions])
    np.testing.assert_allclose(joined(log, "command"), s.position[last], atol=1e-6)
    noted(draft, "times in µs")
    noted(draft, "20 rows before MOTION_START or after DISABLE left out")
    noted(draft, "the last one sent before it")


def test_corrupt_values_a_cut_row_and_repeated_stamps_are_left_out(table, tmp_path):
    lines = table.read_text().splitlines()
    cells = lines[100].split(",")
    cells[3] = "1e111"
    lines[100] = ",".join(cells)
    lines.insert(301, lines[300])
    lines[-1] = lines[-1][:20]
    table.write_text("\n".join(lines))
    draft = convert(Request(table, MAP, robot=ARM, motions="pause:0.5 s"))
    noted(draft, "1 rows of log.csv left out, first: `position` is 1e+111 (line 101)")
    noted(draft, "1 with the stamp of the row above, 0 with an earlier one (line 302)")
    noted(draft, "1 line of log.csv that is cut off left out")
    assert len(draft.columns["t_s"]) == len(lines) - 4


def test_a_clock_that_begins_anew_is_refused(s, table):
    head, *rows = table.read_text().splitlines()
    table.write_text("\n".join([head, *rows, *rows]))
    fails("rows cannot be used", log=table, map=MAP, motions="pause:0.5 s")


@pytest.mark.parametrize(("unit", "factor"), [("A", 1.0), ("mA", 1e-3)])
def test_units_of_current(s, tmp_path, unit, factor):
    columns = {"t": s.time} | of_joints("q", s.position) | of_joints("i", s.current / factor)
    path = write_csv(tmp_path / "log.csv", columns)
    said = f"time=t s, j*=q*0 rad, j*_current=i*0 {unit}"
    draft = convert(Request(path, said, robot=ARM, motions="pause:0.5 s", torque="current: 12 12 10 5 5 5"))
    np.testing.assert_allclose(draft.columns["current2_A"], s.current[:, 1], rtol=1e-7)


@pytest.mark.parametrize("text", ["dq* * 6 degps", "6 * {dq*} degps", "{rate *} * 6 degps", "{rate *} degps"])
def test_values_of_all_joints_are_multiplied(s, tmp_path, text):
    """As rpm; the number of a joint is beside the sign of a product."""
    factor = 6.0 if "6" in text else 1.0
    rates = np.degrees(s.velocity) / factor
    columns = {"t": s.time} | of_joints("q", s.position, 1)
    columns |= of_joints("rate " if "rate" in text else "dq", rates, 1)
    path = write_csv(tmp_path / "log.csv", columns)
    said = f"time=t s, j*=q* rad, j*_velocity={text}"
    draft = convert(Request(path, said, robot=ARM, motions="pause:0.5 s"))
    np.testing.assert_allclose(draft.columns["dq2_degps"], np.degrees(s.velocity[:, 1]), atol=1e-5)


def test_a_pause_without_rows_is_where_motions_are_divided(s, tmp_path):
    """A logger that stops shortly before each motion ends, and begins with the next one."""
    near = np.ones(len(s.time), bool)
    for row in np.flatnonzero(np.diff(s.motion) > 0):
        near[row - 72 : row - 30] = False
    path = write_csv(tmp_path / "log.csv", {"t": s.time[near]} | of_joints("q", s.position[near]))
    draft = convert(Request(path, "time=t s, j*=q*0 rad", robot=ARM, motions="pause:0.4 s"))
    steps = pd.DataFrame(draft.columns).groupby("motion", sort=False)["t_s"].apply(lambda t: t.diff().max())
    assert len(steps) == 5
    assert steps[1:-1].max() < 0.02


def test_unsigned_currents_are_magnitudes(s, tmp_path):
    unsigned = replace(s, current=np.abs(s.current))
    path = rtde(tmp_path / "r.csv", unsigned)
    usual = {"format": "ur-rtde", "robot": ARM, "motions": "pause:0.5 s", "torque": "current: 12 12 10 5 5 5"}
    log, draft = imported(Request(path, **usual), tmp_path)
    noted(draft, "no sign, torque is not assessed")
    assert not log.signed
    np.testing.assert_allclose(draft.columns["torque_magnitude2_Nm"], 12 * unsigned.current[:, 1], rtol=1e-6)


SWAPPED = "j1=q1 rad, j2=q0 rad, j3=q2 rad, j4=q3 rad, j5=q4 rad, j6=q5 rad"


@pytest.mark.parametrize(("positions", "velocities", "words"), [
    ("j*=q*0 deg", "j*_velocity=dq*0 degps", "no joint moves more than 1.2 deg: are angles in rad stated"),
    ("j*=q*0 rad", "j*_velocity=dq*0 degps", "velocities are in rad/s, not deg/s"),
    ("j*=q*0 rad", "j*_velocity=dq*0 / 0.0174533 radps", "velocities are in deg/s, not rad/s"),
    (SWAPPED, "j*_velocity=dq*0 radps", "times that of its positions and stamps: are units, stamps and"),
    ("j*=q*0 + 9 rad", "j*_velocity=dq*0 radps", "deg beyond its limits: are the unit and the order"),
])  # fmt: skip
def test_wrong_units_and_joints_are_seen(table, tmp_path, positions, velocities, words):
    draft = convert(Request(table, f"time=t s, {positions}, {velocities}", robot=ARM, motions="pause:0.5 s"))
    assert words in draft.wrong
    with pytest.raises(BayescalError):
        write(draft, tmp_path / "out")
    write(draft, tmp_path / "out", force=True)
    assert read_log(tmp_path / "out").n == 6


@pytest.mark.parametrize(("options", "words"), cases("import_motion_refusals"))
def test_what_is_missing_is_refused(table, options, words):
    fails(words, log=table, **{"map": MAP, "motions": "files"} | options)


def test_quantities_of_joint_logs_are_refused_in_logs_of_contacts(table):
    said = "j*=q*0 rad, j*_current=tau*0 A, x=q0 mm, y=q1 mm, z=q2 mm"
    fails("`j1_current` is a quantity of joint logs", log=table, map=said, noise="1 mm")
    fails("is an option of logs of motions", log=table, map=said, topic="/a")


def test_repeats_are_found_by_trajectory_not_by_length(s):
    go = [np.flatnonzero(s.motion == k) for k in (1, 2, 3)]
    shifted = s.position.copy()
    shifted[go[1][3:]] = s.position[go[1][:-3]]  # the second begins three samples later
    rows = Rows(s.time, np.maximum(s.motion, 1), {"position": shifted}, tuple("12345"), ("",) * 5)
    assert repeats(rows) == (1, 1, 3, 4, 5)
    scaled = s.position.copy()
    scaled[go[1]] = s.position[go[1]][0] + 1.05 * (s.position[go[1]] - s.position[go[1]][0])
    assert repeats(replace(rows, cells={"position": scaled})) == (1, 2, 3, 4, 5)


def test_velocities_are_not_compared_with_positions_over_missing_rows():
    time = np.arange(0.0, 20.0, 0.01)
    time = time[(time < 4.0) | (time > 6.0)]
    cells = {"position": np.sin(time)[:, None], "velocity": np.cos(time)[:, None]}
    rows = Rows(time, np.ones(len(time), int), cells, ("1",), ("",))
    free = np.array([[-9.0, 9.0]])
    assert contradiction(rows, np.eye(1), free) == ""
    half = replace(rows, cells=cells | {"velocity": 0.5 * cells["velocity"]})
    assert "0.5 times" in contradiction(half, np.eye(1), free)
