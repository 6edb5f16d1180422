"""A plan for a controller: every motion, in order, where the nominal arm has it; other readers agree."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from made_up_plans import made_up_plan

from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rpy_matrix
from bayescal.compensating.compensation import read_targets
from bayescal.errors import BayescalError
from bayescal.exporting.plan import FORMATS, Probe, formats_of
from bayescal.exporting.plan.format import motions
from bayescal.exporting.plan.probing import guarded
from bayescal.programs import PROGRAMS
from bayescal.reporting.plan.record import write_plan

CYCLE = ("approach", "contact", "retract")


@pytest.fixture(scope="module")
def plan(cube):
    return made_up_plan(cube(seed=1).dataset)


def text_of(plan, name, probe=None):
    """All files of a format, one behind the other."""
    return "".join(FORMATS[name].files(plan, probe or Probe()).values())


def table(plan, name):
    return list(csv.DictReader(io.StringIO(text_of(plan, name))))


def expected_readings(plan):
    """Approach, contact, retract of every row, (3 N, n), rad."""
    at = plan.session.measurements.readings
    return np.stack([plan.approach, at, plan.approach], axis=1).reshape(-1, at.shape[1])


def test_readings_of_the_controller(plan):
    rows = table(plan, "csv")
    assert [r["motion"] for r in rows] == list(CYCLE) * len(plan.purpose)
    assert [r["id"] for r in rows[::3]] == list(plan.session.measurements.ids)
    read = [[float(r[f"j{k}_deg"]) for k in range(1, 7)] for r in rows]
    np.testing.assert_allclose(read, np.degrees(expected_readings(plan)), atol=6e-6)
    assert [float(r["payload_kg"]) for r in rows[1::3]] == plan.session.measurements.payload.tolist()
    assert {r["tool"] for r in rows} == {"ball"}


def test_compensate_reads_the_programs_back(plan):
    """The readers of robot programs find the joints of the same motions."""
    slots = PROGRAMS["robodk"].read(text_of(plan, "robodk"), 6).slots
    read = np.array([slot.target.readings for slot in slots])
    np.testing.assert_allclose(read, expected_readings(plan), atol=1.1e-7)
    for name in ("fanuc", "kuka", "abb"):
        program = PROGRAMS[name].read(text_of(plan, name), 6)
        read = np.array([slot.target.readings for slot in program.slots])
        far = np.abs(plan.approach[:, None] - read).max(axis=2).min(axis=1)
        assert far.max() < 1.1e-7, name
        assert not program.elsewhere


@pytest.mark.parametrize("name", ["urscript", "fanuc", "kuka", "abb"])
def test_programs_say_what_they_are_and_stop_for_changes(plan, name):
    leave = tuple(
        plan.approach[k : k + 1] if k in (0, 3) else np.empty((0, 6)) for k in range(len(plan.purpose))
    )
    ways = [np.empty((0, 6))] * len(plan.purpose)
    ways[6] = None
    words = tuple("jog manually to p007" if k == 6 else "" for k in range(len(ways)))
    changes = {3: 'remove "it"; [all]', 5: "attach 0.5 kg"}
    changes = tuple(changes.get(k, "") for k in range(len(plan.purpose)))  # the second without a pose to wait
    text = text_of(replace(plan, leave=leave, via=tuple(ways), changes=changes, by_hand=words), name)
    assert "not run on a" in " ".join(text.lower().replace("not been run", "not run").split())
    assert "<<" not in text
    assert text.count("attach 0.5 kg") == text.count("jog manually to") == 1
    assert text.index("attach 0.5 kg") < text.index("jog manually to")
    assert '"it"' not in text


@pytest.mark.parametrize(
    ("name", "probe", "words"),
    [
        ("urscript", Probe("tool:1"), "return get_tool_digital_in(1)"),
        ("urscript", Probe(force=7.5), "return bc_force() > 7.5"),
        ("fanuc", Probe("tool:2"), "SKIP CONDITION RI[2]=ON"),
        ("kuka", Probe("measure:1"), "WHEN $MEAS_PULSE[1]==TRUE DO"),
        ("abb", Probe("di_touch"), "SearchL\\Stop,di_touch,found"),
    ],
)
def test_the_probe_of_a_program(plan, name, probe, words):
    assert words in text_of(plan, name, probe)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("fanuc", {"force": 5.0}, "cannot measure a force"),
        ("abb", {"input": "7"}, "`7` is no input of the format abb"),
        ("urscript", {"input": "DI1"}, "no input of the format urscript"),
        ("csv", {"beyond": 0.0}, "a search 0 mm beyond"),
        ("csv", {"force": -1.0}, "a force of -1 N"),
        ("csv", {"input": "0", "force": 1.0}, "either the input or the force"),
    ],
)
def test_a_probe_that_cannot_be_is_refused_before_a_plan_is_made(name, options, words):
    with pytest.raises(BayescalError, match=words) as refused:
        formats_of([name], Probe(**options))
    assert refused.value.where.startswith("--probe-")
    assert refused.value.remedy


def test_a_search_ends_where_the_arm_can_reach(plan):
    """Along the line of the approach; less beyond the surface at a limit of a joint."""
    guard = guarded(plan, 5e-3)
    arm = NominalArm(plan.session.robot, plan.session.tools[0].centre)
    at, away, end, begin = (
        arm.ball(arm.frames(q))
        for q in (plan.session.measurements.readings, plan.approach, guard.end, guard.begin)
    )
    way = (at - away) / np.linalg.norm(at - away, axis=1)[:, None]
    np.testing.assert_allclose(end - at, guard.beyond[:, None] * way, atol=2e-8)
    ahead = np.minimum(10e-3, np.linalg.norm(at - away, axis=1))
    found = np.any(guard.begin != plan.approach, axis=1)
    assert found.mean() > 0.8  # of the others the line leaves the limits: the search begins at the approach
    np.testing.assert_allclose((at - begin)[found], (ahead[:, None] * way)[found], atol=2e-8)
    limits = np.stack([plan.session.measurements.readings.min(axis=0), guard.end.max(axis=0)], axis=1)
    narrow = replace(plan.session.robot, limits=limits, link_from_reading=np.eye(6))
    short = guarded(replace(plan, session=replace(plan.session, robot=narrow)), 5e-3)
    assert short.beyond.min() < 5e-3


def test_points_that_are_passed_come_before_the_approach(plan):
    """A motion without a free way stops the program."""
    ways = [np.empty((0, 6))] * len(plan.purpose)
    ways[2], ways[4] = plan.approach[:2] + 0.1, None
    words = tuple("move by hand: J1 first" if k == 4 else "" for k in range(len(ways)))
    around = replace(plan, via=tuple(ways), by_hand=words)
    rows = table(around, "csv")
    assert [r["motion"] for r in rows] == [*CYCLE * 2, "pass", "pass", *CYCLE * (len(plan.purpose) - 2)]
    assert {r["id"] for r in rows if r["motion"] == "pass"} == {"p003"}
    assert text_of(around, "urscript").count("move by hand: J1 first") == 1


def test_names_do_not_leave_their_comment_or_string(plan):
    m = plan.session.measurements
    ids = ('a"\n  movej([0,0,0,0,0,0])', *m.ids[1:])
    hostile = replace(plan, session=replace(plan.session, measurements=replace(m, ids=ids)))
    for name in ("urscript", "fanuc", "kuka", "abb"):
        text, plain = text_of(hostile, name), text_of(plan, name)
        assert text.count("\n") == plain.count("\n")
        assert text.count('"') == plain.count('"')


def test_poses_are_those_of_the_nominal_arm(plan, tmp_path):
    """In F0, of the tool's frame with its stated orientation; `compensate` reads the table."""
    turned = replace(plan.session.tools[0], rpy=np.array([0.3, -0.2, 1.1]))
    plan = replace(plan, session=replace(plan.session, tools=(turned,)))
    path = tmp_path / "poses.csv"
    path.write_text(text_of(plan, "poses"))
    targets = read_targets(path, 6).targets
    arm = NominalArm(plan.session.robot, turned.centre, rpy_matrix(turned.rpy))
    poses = arm.tool_poses(arm.frames(expected_readings(plan)))
    read = np.array([t.pose for t in targets])
    np.testing.assert_allclose(read[:, :3, 3], poses[:, :3, 3], atol=6e-8)
    np.testing.assert_allclose(read[:, :3, :3], poses[:, :3, :3], atol=3e-7)
    np.testing.assert_allclose([t.readings for t in targets], expected_readings(plan), atol=1.1e-7)


def test_nothing_is_approached_where_nothing_is_touched(tracker):
    plan = made_up_plan(tracker(seed=1).dataset)
    plan = replace(plan, approach=plan.session.measurements.readings)
    assert [m.kind for m in motions(plan)] == ["measure"] * len(plan.purpose)
    text = text_of(plan, "urscript")
    assert "bc_contact([" not in text
    assert "press and release" not in text
    assert text.count("sleep(2.00)") == len(plan.purpose)  # the instrument reads an arm at rest


def test_an_arm_without_six_joints_has_no_urscript(plan):
    short = replace(plan.session, robot=replace(plan.session.robot, joint_names=("J1", "J2")))
    with pytest.raises(BayescalError, match="arms of 6 joints"):
        text_of(replace(plan, session=short), "urscript")


def test_formats_are_written_beside_the_plan(plan, tmp_path):
    names = write_plan(plan, tmp_path / "run", ("poses", "csv", "poses"))
    assert {"plan-poses.csv", "plan-joints.csv"} <= set(names)
    assert (tmp_path / "run" / "plan-joints.csv").read_text() == text_of(plan, "csv")
    with pytest.raises(BayescalError, match="there is no format `rapid`"):
        formats_of(["csv", "rapid"])
    with pytest.raises(BayescalError, match="there is no format"):
        write_plan(plan, tmp_path / "other", ("rapid",))
    assert not (tmp_path / "other").exists()
