"""Positions of programs: what is found, and that all else is kept byte for byte."""

import re

import numpy as np
import programs
import pytest

from bayescal.arm.transforms import rigid, rotation, rpy_matrix
from bayescal.errors import BayescalError
from bayescal.exporting.compensate.formats import PROGRAMS
from bayescal.exporting.compensate.formats.program import rewritten
from bayescal.exporting.compensate.targets import Corrected

TEXTS = {name: getattr(programs, name.upper()).decode("latin-1") for name in PROGRAMS}
DOWN = rigid(rpy_matrix(np.array([np.pi, 0, 0])), np.array([0.45, 0.0, 0.2]))
POSED = {"fanuc": [1], "kuka": [1, 2, 3, 4], "abb": [1, 2], "urscript": [1, 2], "robodk": []}
"""Which of the positions, as visited, are poses; the others are joints."""
JOINTS = np.radians([5, 10, -15.5, 2, -70, 0.5])


def kept(slots, rng=None) -> list[Corrected]:
    """Targets as they are: joints as they were given, poses where they were given."""
    here = np.radians([10.0, -20, 30, -40, 50, -60])
    return [
        Corrected("", here if s.target.readings is None or s.target.pose is not None else s.target.readings,
                  s.target.pose if s.target.pose is not None else np.eye(4), here)
        for s in slots
    ]  # fmt: skip


@pytest.mark.parametrize("name", PROGRAMS)
def test_positions_are_found_in_the_order_of_motion(name):
    program = PROGRAMS[name].read(TEXTS[name], 6)
    posed = [k for k, slot in enumerate(program.slots) if slot.target.pose is not None]
    assert posed == POSED[name]
    joints = program.slots[0].target.readings
    if name != "kuka":
        assert joints == pytest.approx(JOINTS, abs=1e-4)
    for k in posed[:1]:
        off = 0.01 if name == "kuka" else 0.0
        np.testing.assert_allclose(
            program.slots[k].target.pose, DOWN + off * np.eye(4)[:, [1]] @ np.eye(4)[[3]], atol=1e-7
        )
    assert program.elsewhere == ""


@pytest.mark.parametrize("name", PROGRAMS)
def test_only_numbers_of_positions_change(name):
    """Blanks in the places of all numbers of positions: what is left is equal, and the same as before."""
    form, text = PROGRAMS[name], TEXTS[name]
    slots = form.read(text, 6).slots
    moved = [
        Corrected("", own.readings + 1e-3, rigid(rpy_matrix(np.full(3, 1e-3))) @ own.pose, own.nominal)
        for own in kept(slots)
    ]
    new = rewritten(text, form, slots, moved)
    again = form.read(new, 6).slots
    assert len(again) == len(slots)

    def rest(of, positions):
        holes = sorted(span for slot in positions for span in slot.spans)
        ends = [0, *(high for _, high in holes)]
        starts = [*(low for low, _ in holes), len(of)]
        return [of[a:b] for a, b in zip(ends, starts, strict=True)]

    assert rest(new, again) == rest(text, slots)
    for own, slot in zip(moved, again, strict=True):
        if slot.target.pose is None:
            np.testing.assert_allclose(slot.target.readings, own.readings, atol=1e-7)
        else:
            np.testing.assert_allclose(slot.target.pose, own.pose, atol=2e-7)


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_whose_positions_do_not_move_keeps_its_values(name):
    form, text = PROGRAMS[name], TEXTS[name]
    slots = form.read(text, 6).slots
    again = form.read(rewritten(text, form, slots, kept(slots)), 6).slots
    for a, b in zip(slots, again, strict=True):
        if a.target.pose is None:
            np.testing.assert_allclose(b.target.readings, a.target.readings, atol=1e-7)
        else:
            np.testing.assert_allclose(b.target.pose, a.target.pose, atol=2e-7)


def test_a_position_without_solution_leaves_nothing_written():
    form, text = PROGRAMS["fanuc"], TEXTS["fanuc"]
    slots = form.read(text, 6).slots
    found = kept(slots)
    found[1] = Corrected("out of reach by 12 mm")
    with pytest.raises(BayescalError, match=r"line 9, P\[1\]: no solution: out of reach by 12 mm"):
        rewritten(text, form, slots, found)


def test_fanuc_user_frame_of_a_pose_and_register():
    program = PROGRAMS["fanuc"].read(TEXTS["fanuc"], 6)
    assert [slot.name for slot in program.slots] == ["P[2]", "P[1]"]
    assert [slot.target.straight for slot in program.slots] == [False, True]
    assert program.notes == ("line 7: a motion to a position register is kept",)
    framed = TEXTS["fanuc"].replace("UF : 0, UT : 1,\t\tCONFIG", "UF : 2, UT : 1,\t\tCONFIG")
    assert PROGRAMS["fanuc"].read(framed, 6).elsewhere == "line 9, P[1]: UF : 2"


def test_fanuc_positions_that_are_not_read_are_told():
    text = TEXTS["fanuc"].replace("W =  -180.000 deg", "W =  ******** deg")
    program = PROGRAMS["fanuc"].read(text, 6)
    assert "P[1]: neither X ... R nor J1 ... J6 of the first group; kept" in program.notes


def test_kuka_turn_selects_and_is_written():
    slots = PROGRAMS["kuka"].read(TEXTS["kuka"], 6).slots
    assert [slot.name for slot in slots] == ["", "XHOME", "", "", ""]
    assert [slot.target.straight for slot in slots] == [False, False, True, True, True]
    assert not any(slot.target.strict for slot in slots[1:])
    ptp = PROGRAMS["kuka"].read(TEXTS["kuka"].replace("PTP {Z 100}", "PTP XHOME"), 6).slots
    assert ptp[1].target.strict
    admits = slots[1].target.admits  # T 35: A1, A2 and A6 negative
    assert admits(np.radians([-10, -20, 30, 40, 50, -60.0]))
    assert not admits(np.radians([-10, -20, 30, -40, 50, -60.0]))
    assert admits(np.radians([-10, -20, 0.05, 40, 50, -60.0]))
    found = kept(slots)
    assert ",S 2,T 42,E1 0.0}" in rewritten(TEXTS["kuka"], PROGRAMS["kuka"], slots, found)
    assert PROGRAMS["kuka"].read(TEXTS["kuka"], 6).notes == ("line 12: not all components are given; kept",)
    other = TEXTS["kuka"].replace("$BASE=$NULLFRAME", "$BASE=BASE_DATA[2]")
    assert PROGRAMS["kuka"].read(other, 6).elsewhere == "line 6: $BASE=BASE_DATA[2]"


def test_abb_quarters_select_and_are_written():
    slots = PROGRAMS["abb"].read(TEXTS["abb"], 6).slots
    assert [slot.name for slot in slots] == ["home", "p10", ""] or [s.name for s in slots] == [
        "p10",
        "home",
        "",
    ]
    pose = next(s for s in slots if s.name == "p10")
    assert pose.target.straight
    assert pose.target.admits(np.radians([10, 0, 0, -20, 0, 30.0]))
    assert not pose.target.admits(np.radians([10, 0, 0, 20, 0, 30.0]))
    new = rewritten(TEXTS["abb"], PROGRAMS["abb"], slots, kept(slots))
    assert new.count("[0,-1,-1,1]") == 2
    other = TEXTS["abb"].replace("wobj0", "wobj1")
    assert PROGRAMS["abb"].read(other, 6).elsewhere == "line 9: \\WObj:=wobj1"


def test_urscript_takes_qnear_as_the_reference():
    program = PROGRAMS["urscript"].read(TEXTS["urscript"], 6)
    near = program.slots[1].target
    assert near.readings == pytest.approx([0.1, 0.2, -0.3, 0.0, -1.2, 0.0])
    assert not near.straight
    assert program.slots[2].target.straight
    assert [note.split(":")[0] for note in program.notes] == ["line 10"]
    new = rewritten(TEXTS["urscript"], PROGRAMS["urscript"], program.slots, kept(program.slots))
    assert "P1_q = [0.1, 0.2, -0.3, 0.0, -1.2, 0.0]" in new


def test_a_rotation_vector_stays_on_its_side():
    """Of the two vectors of a rotation near half a turn that nearer to the program's is written."""
    form = PROGRAMS["urscript"]
    old = [0.45, 0.0, 0.2, 3.15, 0.0, 0.0]
    turned = [n.value for n in form.pose(rigid(rotation(0, 3.151)), np.zeros(6), old)][3:]
    assert turned == pytest.approx([3.151, 0, 0])


def test_robodk_refuses_a_row_without_joints():
    with pytest.raises(BayescalError, match="line 3: the first 6 cells are not numbers"):
        PROGRAMS["robodk"].read("J1,J2,J3,J4,J5,J6\n1,2,3,4,5,6\n1,2,x,4,5,6\n", 6)
    bare = PROGRAMS["robodk"].read("1,2,3,4,5,6,0.5\n", 6)
    assert len(bare.slots) == 1


def test_numbers_keep_the_decimals_that_they_had():
    text = TEXTS["fanuc"].replace("450.000  mm", "450.0000012  mm")
    form = PROGRAMS["fanuc"]
    slots = form.read(text, 6).slots
    new = rewritten(text, form, slots, kept(slots))
    assert re.search(r"X =   450\.0000012  mm,\tY =      0\.0000  mm", new)
