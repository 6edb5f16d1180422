"""A plan for a controller: every motion, in order, where the nominal arm has it; other readers agree."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from made_up_plans import made_up_plan

from bayescal.arm.nominal import NominalArm
from bayescal.arm.transforms import rpy_matrix
from bayescal.errors import BayescalError
from bayescal.exporting.compensate.formats import PROGRAMS
from bayescal.exporting.compensate.table import read_targets
from bayescal.exporting.plan import FORMATS, formats_of
from bayescal.exporting.plan.format import motions
from bayescal.reporting.plan.files import write_plan

CYCLE = ("approach", "contact", "retract")


@pytest.fixture(scope="module")
def plan(cube):
    return made_up_plan(cube(seed=1).dataset)


def table(plan, name):
    return list(csv.DictReader(io.StringIO(FORMATS[name].text(plan))))


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
    """The readers of robot programs find the same motions at the same joints, lines as lines."""
    for name in ("urscript", "robodk"):
        slots = PROGRAMS[name].read(FORMATS[name].text(plan), 6).slots
        read = np.array([slot.target.readings for slot in slots])
        np.testing.assert_allclose(read, expected_readings(plan), atol=1.1e-7)
        if name == "urscript":
            assert [s.target.straight for s in slots] == [False, True, True] * len(plan.purpose)


def test_the_program_logs_each_contact_and_stops_for_each_payload(plan):
    leave = tuple(
        plan.approach[k : k + 1] if k in (0, 3, 5) else np.empty((0, 6)) for k in range(len(plan.purpose))
    )
    changes = tuple({3: "attach 0.5 kg", 5: 'remove "it"'}.get(k, "") for k in range(len(plan.purpose)))
    plan = replace(plan, leave=leave, changes=changes)
    text = FORMATS["urscript"].text(plan)
    lines = [line.strip() for line in text.splitlines()]
    ids = plan.session.measurements.ids
    assert [line for line in lines if line.startswith("textmsg")] == [
        f'textmsg("{name}, ", get_actual_joint_positions())' for name in ids
    ]
    logged = lines.index('textmsg("p001, ", get_actual_joint_positions())')
    assert lines[logged - 1].endswith("# contact")
    assert lines[logged + 1].endswith("# retract")
    stops = [k for k, line in enumerate(lines) if line.endswith("# stop")]
    assert [lines[k + 1] for k in stops[1:]] == [
        'popup("attach 0.5 kg", title="change", blocking=True)',
        'popup("remove \'it\'", title="change", blocking=True)',
    ]
    assert text.count("popup(") == 2


def test_points_that_are_passed_come_before_the_approach(plan):
    """A motion without a free way stops the program."""
    ways = [np.empty((0, 6))] * len(plan.purpose)
    ways[2], ways[4] = plan.approach[:2] + 0.1, None
    words = tuple("move by hand: J1 first" if k == 4 else "" for k in range(len(ways)))
    around = replace(plan, via=tuple(ways), by_hand=words)
    rows = table(around, "csv")
    assert [r["motion"] for r in rows] == [*CYCLE * 2, "pass", "pass", *CYCLE * (len(plan.purpose) - 2)]
    assert {r["id"] for r in rows if r["motion"] == "pass"} == {"p003"}
    program = FORMATS["urscript"].text(around)
    slots = PROGRAMS["urscript"].read(program, 6).slots
    np.testing.assert_allclose([s.target.readings for s in slots[6:8]], ways[2], atol=1.1e-7)
    assert [s.target.straight for s in slots[6:9]] == [False] * 3
    assert program.count("move by hand: J1 first") == 1


def test_names_do_not_leave_their_comment_or_string(plan):
    m = plan.session.measurements
    ids = ('a"\n  movej([0,0,0,0,0,0])', *m.ids[1:])
    hostile = replace(plan, session=replace(plan.session, measurements=replace(m, ids=ids)))
    text = FORMATS["urscript"].text(hostile)
    plain = FORMATS["urscript"].text(plan)
    assert text.count("\n") == plain.count("\n")
    assert len(PROGRAMS["urscript"].read(text, 6).slots) == 3 * len(ids)


def test_poses_are_those_of_the_nominal_arm(plan, tmp_path):
    """In F0, of the tool's frame with its stated orientation; `compensate` reads the table."""
    turned = replace(plan.session.tools[0], rpy=np.array([0.3, -0.2, 1.1]))
    plan = replace(plan, session=replace(plan.session, tools=(turned,)))
    path = tmp_path / "poses.csv"
    path.write_text(FORMATS["poses"].text(plan))
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
    text = FORMATS["urscript"].text(plan)
    assert "movel" not in text
    assert text.count("sleep(") == len(plan.purpose)  # the instrument reads an arm at rest


def test_an_arm_without_six_joints_has_no_urscript(plan):
    short = replace(plan.session, robot=replace(plan.session.robot, joint_names=("J1", "J2")))
    with pytest.raises(BayescalError, match="arms of 6 joints"):
        FORMATS["urscript"].text(replace(plan, session=short))


def test_formats_are_written_beside_the_plan(plan, tmp_path):
    names = write_plan(plan, tmp_path / "run", ("poses", "csv", "poses"))
    assert {"plan-poses.csv", "plan-joints.csv"} <= set(names)
    assert (tmp_path / "run" / "plan-joints.csv").read_text() == FORMATS["csv"].text(plan)
    with pytest.raises(BayescalError, match="there is no format `rapid`"):
        formats_of(["csv", "rapid"])
    with pytest.raises(BayescalError, match="there is no format"):
        write_plan(plan, tmp_path / "other", ("rapid",))
    assert not (tmp_path / "other").exists()
