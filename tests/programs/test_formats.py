"""Positions of programs: what is found, and that all else is kept byte for byte."""

import re

import numpy as np
import program_texts as programs
import pytest
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.errors import BayescalError
from bayescal.programs import PROGRAMS
from bayescal.programs.text import Corrected, rewritten

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
        expected = DOWN + off * np.eye(4)[:, [1]] @ np.eye(4)[[3]]
        np.testing.assert_allclose(program.slots[k].target.pose, expected, atol=1e-7)
    assert program.elsewhere == ""


@pytest.mark.parametrize("name", PROGRAMS)
def test_only_numbers_of_positions_change(name):
    """Blanks in the places of all numbers of positions: what is left is equal, and the same as before."""
    form, text = PROGRAMS[name], TEXTS[name]
    slots = form.read(text, 6).slots
    shift = rigid(rpy_matrix(np.full(3, 1e-3)))
    moved = [Corrected("", own.readings + 1e-3, shift @ own.pose, own.nominal) for own in kept(slots)]
    new = rewritten(text, form, slots, moved)
    again = form.read(new, 6).slots
    assert len(again) == len(slots)

    def places(of, slot):
        if slot.whole is not None:
            return [slot.whole]
        if name == "urscript":  # whole lists: a pose has become one
            return [(of.rfind("[", 0, slot.spans[0][0]), of.find("]", slot.spans[-1][1]) + 1)]
        return list(slot.spans)

    def rest(of, positions):
        holes = sorted(span for slot in positions for span in places(of, slot))
        ends = [0, *(high for _, high in holes)]
        return [of[a:b] for a, b in zip(ends, [*(low for low, _ in holes), len(of)], strict=True)]

    assert rest(new, again) == rest(text, slots)
    for own, slot in zip(moved, again, strict=True):
        if slot.target.pose is None:
            np.testing.assert_allclose(slot.target.readings, own.readings, atol=1e-7)
        else:
            np.testing.assert_allclose(slot.target.pose, own.pose, atol=2e-7)
    # a program whose positions do not move keeps its values
    again = form.read(rewritten(text, form, slots, kept(slots)), 6).slots
    for a, b, own in zip(slots, again, kept(slots), strict=True):
        if b.target.pose is None:
            np.testing.assert_allclose(b.target.readings, own.readings, atol=1e-7)
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
    assert program.notes == ("line 7: a motion to a register (PR[5]) is kept",)
    framed = TEXTS["fanuc"].replace("UF : 0, UT : 1,\t\tCONFIG", "UF : 2, UT : 1,\t\tCONFIG")
    assert PROGRAMS["fanuc"].read(framed, 6).elsewhere == "line 9, P[1]: UF : 2"


def test_fanuc_positions_that_are_not_read_are_told():
    program = PROGRAMS["fanuc"].read(TEXTS["fanuc"].replace("W =  -180.000 deg", "W =  ******** deg"), 6)
    assert "P[1]: neither X ... R nor J1 ... J6 of the first group; kept" in program.notes


def test_kuka_turn_selects_and_is_written():
    slots = PROGRAMS["kuka"].read(TEXTS["kuka"], 6).slots
    assert [slot.name for slot in slots] == ["", "XHOME", "", "", ""]
    assert [slot.target.straight for slot in slots] == [False, False, True, True, True]
    assert not any(slot.target.strict for slot in slots[1:])
    assert PROGRAMS["kuka"].read(TEXTS["kuka"].replace("PTP {Z 100}", "PTP XHOME"), 6).slots[1].target.strict
    admits = slots[1].target.admits  # T 35: A1, A2 and A6 negative
    assert admits(np.radians([-10, -20, 30, 40, 50, -60.0]))
    assert not admits(np.radians([-10, -20, 30, -40, 50, -60.0]))
    assert admits(np.radians([-10, -20, 0.05, 40, 50, -60.0]))
    found = kept(slots)
    for external in (0, 1, 5):  # the bits of external axes are kept
        text = TEXTS["kuka"].replace(",T 35,", f",T {35 + 64 * external},")
        new = rewritten(text, PROGRAMS["kuka"], PROGRAMS["kuka"].read(text, 6).slots, found)
        assert f",S 2,T {42 + 64 * external},E1 0.0}}" in new
    assert PROGRAMS["kuka"].read(TEXTS["kuka"], 6).notes == (
        "line 10: a PTP_REL is kept", "line 11: a LIN_REL is kept",
        "line 12: not all components are given; kept",
    )  # fmt: skip
    other = TEXTS["kuka"].replace("$BASE=$NULLFRAME", "$BASE=BASE_DATA[2]")
    assert PROGRAMS["kuka"].read(other, 6).elsewhere == "line 6: $BASE=BASE_DATA[2]"


def test_a_kuka_tool_is_turned_about_z_then_y_then_x():
    stated = "\nTOOL_DATA[7]={X 1,Y 2,Z 3,A 10,B 20,C 30}\n$TOOL=TOOL_DATA[7]\n"
    pose = PROGRAMS["kuka"].read(TEXTS["kuka"] + stated, 6).tools[-1].pose
    turn = Rotation.from_euler("ZYX", [10, 20, 30], degrees=True).as_matrix()
    np.testing.assert_allclose(pose, rigid(turn, np.array([1e-3, 2e-3, 3e-3])), atol=1e-12)


@pytest.mark.parametrize("external", [0, 1 << 6, 1 << 7, 0b111 << 6])
def test_kuka_turn_of_external_axes_is_kept(external):
    text = TEXTS["kuka"].replace("T 35", f"T {35 | external}")
    slots = PROGRAMS["kuka"].read(text, 6).slots
    assert f",T {42 | external}," in rewritten(text, PROGRAMS["kuka"], slots, kept(slots))


def test_abb_quarters_select_and_are_written():
    slots = PROGRAMS["abb"].read(TEXTS["abb"], 6).slots
    assert [slot.name for slot in slots] in (["home", "p10", ""], ["p10", "home", ""])
    pose = next(s for s in slots if s.name == "p10")
    assert pose.target.straight
    assert pose.target.admits(np.radians([10, 0, 0, -20, 0, 30.0]))
    assert not pose.target.admits(np.radians([10, 0, 0, 20, 0, 30.0]))
    assert rewritten(TEXTS["abb"], PROGRAMS["abb"], slots, kept(slots)).count("[0,-1,-1,1]") == 2
    for sign in ("", "-"):  # of the two quaternions of an orientation, that of the program
        text = TEXTS["abb"].replace("[0,1,0,0]", f"[0,{sign}1,0,0]")
        own = PROGRAMS["abb"].read(text, 6).slots
        assert rewritten(text, PROGRAMS["abb"], own, kept(own)).count(f",{sign}1.000000000,") == 2
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


def test_urscript_poses_become_joints_at_the_motion():
    """The controller inverts a pose with its own calibration: joints are the same for both."""
    text = """def go():
  set_tcp(gun)
  gun = p[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
  q = [0.1, 0.2, -0.3, 0.0, -1.2, 0.0]
  a = p[0.45, 0.0, 0.2, 3.14, 0.0, 0.0]
  b = p[0.45, 0.0, 0.3, 3.14, 0.0, 0.0]
  b[2] = 0.4
  movel(a, a=1.2, v=0.25)
  movep(p[.4, 0, .2, 3.1, 0, 0], r=0.02)
  movec(p[.4, 0, .21, 3.1, 0, 0], p[.4, 0, .22, 3.1, 0, 0], a=1)
  movej(get_inverse_kin(a, q), a=1)
  movel(b)
  movel(pose_add(a, p[0, 0, 0.1, 0, 0, 0]))
  servol(p[.4, 0, .2, 3.1, 0, 0])
  x = pose_trans(a, p[0, 0, 0.1, 0, 0, 0])
end
"""
    form = PROGRAMS["urscript"]
    program = form.read(text, 6)
    assert [s.name for s in program.slots] == ["a", "", "", "", "a"]
    assert [s.target.straight for s in program.slots] == [True] * 4 + [False]
    assert program.slots[4].target.readings == pytest.approx([0.1, 0.2, -0.3, 0.0, -1.2, 0.0])
    own = "kept: the controller would invert it with its own calibration"
    assert program.notes == (
        f"line 12: the position of a movel is computed (b is assigned more than once); {own}",
        f"line 13: the position of a movel is computed; {own}",
        f"line 14: the position of a servol must be a pose; {own}",
    )
    np.testing.assert_allclose(program.tools[0].pose, rigid(None, np.array([0, 0, 0.1])))
    moved = [Corrected("", np.full(6, k / 8), np.eye(4), np.zeros(6)) for k in range(5)]
    new = rewritten(text, form, program.slots, moved)
    assert "movel([0.0000000, 0.0000000, 0.0000000, 0.0000000, 0.0000000, 0.0000000], a=1.2" in new
    assert re.search(r"movec\(\[0\.25.*?\], \[0\.375.*?\], a=1\)", new)
    assert re.search(r"movej\(\[0\.5[0-9., ]*\], a=1\)", new)
    for line in (3, 4, 5, 6, 7, 12, 13, 14, 15):
        assert new.splitlines()[line - 1] == text.splitlines()[line - 1]


COMPUTED = {
    "fanuc": (
        TEXTS["fanuc"].replace("L P[1:start] 500mm/sec FINE", "L P[1:start] 500mm/sec FINE Offset,PR[2]"),
        "line 6: P[1:start] is computed (Offset); kept", ["P[2]"]),
    "fanuc by a register": (TEXTS["fanuc"].replace("L P[1:start]", "L P[R[3]]"),
                            "line 6: a motion to a register (P[R[3]]) is kept", ["P[2]", "P[1]"]),
    "kuka": (TEXTS["kuka"].replace("PTP {Z 100}", "xhome.X = xhome.X + 5\nPTP XHOME"),
             "line 12: XHOME is computed; kept", ["", "", "", ""]),
    "kuka by a frame": (TEXTS["kuka"].replace("PTP {Z 100}", "LIN XHOME:{X 10,Y 0,Z 0,A 0,B 0,C 0}"),
                        "line 12: XHOME is computed; kept", ["", "", "", ""]),
    "abb": (TEXTS["abb"].replace("MoveL p10,", "MoveL Offs(p10, 0, 0, 50),"),
            "line 9: the position of a MoveL is computed (Offs(p10, 0, 0, 50)); kept", ["p10", "home", ""]),
    "abb by its parts": (TEXTS["abb"].replace("    MoveL", "    p10.trans.z := 5 + p10.trans.z;\n    MoveL"),
                         "line 2, p10: it is computed in line 9; kept", ["home", ""]),
    "abb with a flag": (TEXTS["abb"].replace("MoveL p10,", "MoveL \\Conc, RelTool(p10, 0, 0, 5),"),
                        "line 9: the position of a MoveL is computed (RelTool(p10, 0, 0, 5)); kept",
                        ["p10", "home", ""]),
}  # fmt: skip


@pytest.mark.parametrize("case", COMPUTED)
def test_computed_positions_are_kept_and_listed(case):
    text, note, names = COMPUTED[case]
    program = PROGRAMS[case.split()[0]].read(text, 6)
    assert note in program.notes
    assert [slot.name for slot in program.slots] == names


def test_positions_that_no_motion_uses():
    fanuc = TEXTS["fanuc"].replace("   2:L P[1:start] 500mm/sec FINE    ;\r\n", "")
    assert {s.name: s.used for s in PROGRAMS["fanuc"].read(fanuc, 6).slots} == {"P[2]": True, "P[1]": False}
    assert [s.used for s in PROGRAMS["kuka"].read(TEXTS["kuka"], 6).slots] == [True, False, True, True, True]
    declared = TEXTS["kuka"].splitlines()[2] + "\nXHOME={X 450,Y 10,Z 200,A 0,B 0,C 180,S 2,T 35}\n"
    assert [s.used for s in PROGRAMS["kuka"].read(declared, 6).slots] == [True]  # a .dat has no motions
    abb = TEXTS["abb"].replace("MoveL p10,", "MoveL p11,")
    assert [s.name for s in PROGRAMS["abb"].read(abb, 6).slots if not s.used] == ["p10"]
    spoken = abb.replace("MoveL p11", "ArcL p10, v10, seam;\n    MoveL p11")  # used in a way that is not read
    assert all(s.used for s in PROGRAMS["abb"].read(spoken, 6).slots)


@pytest.mark.parametrize(("name", "old", "new", "expected"), [
    ("urscript", "", "", [("line 3", "set_tcp(p[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])", [0, 0, 0.1])]),
    ("urscript", "p[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]", "x", [("line 3", "set_tcp(x)", None)]),
    ("fanuc", "", "", [("line 9, P[1]", "UT : 1", None)]),
    ("fanuc", "UT : 1", "UT : 0", [("line 9, P[1]", "UT : 0", [0, 0, 0])]),
    ("fanuc", "/MN\r\n", "/MN\r\n   0:  UTOOL_NUM=2 ;\r\n",
     [("line 10, P[1]", "UT : 1", None), ("line 5", "UT : 2", None)]),
    ("kuka", "", "", [("line 4", "$TOOL={X 10,Y 0,Z 100,A 0,B 0,C 0}", [0.01, 0, 0.1])]),
    ("kuka", "$TOOL={X 10,Y 0,Z 100,A 0,B 0,C 0}", "$TOOL=TOOL_DATA[3]",
     [("line 4", "$TOOL=TOOL_DATA[3]", None)]),
    ("kuka", "$TOOL={X 10", "$TOOL=TOOL_DATA[3]\nTOOL_DATA[3]={X 10",
     [("line 4", "$TOOL=TOOL_DATA[3]", [0.01, 0, 0.1])]),
    ("kuka", "$TOOL={X 10,Y 0,Z 100,A 0,B 0,C 0}", "BAS(#TOOL, 2)", [("line 4", "#TOOL, 2", None)]),
    ("abb", "", "", [(f"line {k}", "tGun", [0.06, 0, 0.12]) for k in (8, 9, 10)]),
    ("abb", "tGun:=[TRUE", "tGun:=[FALSE",
     [(f"line {k}", "tGun, which the robot does not hold", None) for k in (8, 9, 10)]),
    ("abb", "v100,fine,tGun;", "v100,fine,tool0;",
     [("line 8", "tool0", [0, 0, 0])] + [(f"line {k}", "tGun", [0.06, 0, 0.12]) for k in (9, 10)]),
])  # fmt: skip
def test_tools_of_programs(name, old, new, expected):
    tools = PROGRAMS[name].read(TEXTS[name].replace(old, new, 1), 6).tools
    assert [(t.where, t.text) for t in tools] == [(where, text.upper() if name == "kuka" else text)
                                                  for where, text, _ in expected]  # fmt: skip
    for tool, (_, _, centre) in zip(tools, expected, strict=True):
        if centre is None:
            assert tool.pose is None
        else:
            np.testing.assert_allclose(tool.pose, rigid(None, np.array(centre, float)), atol=1e-12)


@pytest.mark.parametrize("name", ["urscript", "fanuc", "kuka", "abb"])
def test_a_warning_is_a_comment(name):
    """It changes no position, and stands where the language has comments."""
    form, text = PROGRAMS[name], TEXTS[name]
    new = form.remarked(text, "bad fit")
    line = next(k for k, one in enumerate(new.splitlines()) if "bad fit" in one)
    assert line == {"urscript": 1, "fanuc": 4, "kuka": 2, "abb": 1}[name]
    assert new.count("\r\n") == text.count("\r\n") + (name == "fanuc")
    before, after = form.read(text, 6), form.read(new, 6)
    assert [s.name for s in after.slots] == [s.name for s in before.slots]
    if name == "fanuc":
        assert re.findall(r"(?m)^\s*(\d+):", new[: new.find("/POS")]) == ["1", "2", "3", "4"]


def test_robodk_refuses_a_row_without_joints():
    with pytest.raises(BayescalError, match="line 3: the first 6 cells are not numbers"):
        PROGRAMS["robodk"].read("J1,J2,J3,J4,J5,J6\n1,2,3,4,5,6\n1,2,x,4,5,6\n", 6)
    assert len(PROGRAMS["robodk"].read("1,2,3,4,5,6,0.5\n", 6).slots) == 1


def test_numbers_keep_the_decimals_that_they_had():
    text = TEXTS["fanuc"].replace("450.000  mm", "450.0000012  mm")
    form = PROGRAMS["fanuc"]
    slots = form.read(text, 6).slots
    new = rewritten(text, form, slots, kept(slots))
    assert re.search(r"X =   450\.0000012  mm,\tY =      0\.0000  mm", new)
