"""robot.yaml: built-in, round trip, refusals."""

import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from cases import cases, refused
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import bayescal as bc
from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.cli import app
from bayescal.robots import builtin_robots, load_robot, robot_to_yaml

NAME = "fanuc-lrmate200ic"


def read(tmp_path, text: str) -> Robot:
    (tmp_path / "robot.yaml").write_text(text, encoding="utf-8")
    return load_robot("robot.yaml", tmp_path)[0]


def arrays(n: int, low: float, high: float):
    return st.lists(st.floats(low, high, allow_subnormal=False), min_size=n, max_size=n).map(np.array)


def symmetric(values):
    square = values.reshape(-1, 3, 3)
    return square + square.transpose(0, 2, 1)


@st.composite
def robots(draw) -> Robot:
    n = draw(st.integers(1, 7))
    name = st.text(st.characters(exclude_categories=["Cs", "Cc", "Cf", "Zl", "Zp"]), min_size=1, max_size=10)
    limits = np.sort(draw(arrays(2 * n, -6, 6)).reshape(n, 2), axis=1) + np.array([-0.1, 0.1])
    rpy = draw(arrays(3, -1.5, 1.5))
    masses = draw(st.none() | arrays(n, 0, 50))
    convention = draw(st.sampled_from(("mdh", "dh")))
    flange = rigid(rpy_matrix(draw(arrays(3, -1.5, 1.5))), draw(arrays(3, -2, 2)))
    return Robot(
        name=draw(name),
        convention=convention,
        joint_names=tuple(draw(st.lists(name, min_size=n, max_size=n, unique=True))),
        alpha=draw(arrays(n, -3.2, 3.2)),
        a=draw(arrays(n, -1, 1)) + 1.5,
        d=draw(arrays(n, -1, 1)),
        offset=draw(arrays(n, -3.2, 3.2)),
        beta=draw(st.just(np.zeros(n)) | arrays(n, -0.1, 0.1)),
        limits=limits,
        link_from_reading=np.eye(n) + np.tril(draw(arrays(n * n, -1, 1)).reshape(n, n), -1),
        base=rigid(rpy_matrix(rpy), draw(arrays(3, -2, 2))),
        masses=masses,
        centres_of_mass=None if masses is None else draw(arrays(3 * n, -1, 1)).reshape(n, 3),
        compliance=draw(st.none() | arrays(n, 0, 1e-2)),
        reductions=draw(st.none() | arrays(n, 1, 300)),
        flange=flange if convention == "mdh" else np.eye(4),
        coupling=draw(st.sampled_from(["display", "mechanical"])),
        radii=draw(st.none() | arrays(n, 1e-3, 1)) if masses is not None else None,
        inertias=draw(st.none() | arrays(9 * n, 0, 1).map(symmetric)) if masses is not None else None,
        velocities=draw(st.none() | arrays(n, 1e-3, 10)),
        torques=draw(st.none() | arrays(n, 1e-3, 1e3)),
        prismatic=draw(st.none() | st.lists(st.booleans(), min_size=n, max_size=n).filter(any).map(np.array)),
    )


@given(robot=robots(), comment=st.text(st.characters(codec="ascii", exclude_categories=["Cc"])))
@settings(max_examples=100, deadline=None)
def test_round_trip(robot, comment, tmp_path_factory):
    again = read(tmp_path_factory.mktemp("robot"), robot_to_yaml(robot, comment))
    for f in fields(Robot):
        a, b = getattr(robot, f.name), getattr(again, f.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-12, err_msg=f.name)
        else:
            assert a == b, f.name


def test_friction_that_is_stated_as_zero_is_known(tmp_path):
    none = dict.fromkeys(("coulomb", "viscous", "armatures"), np.zeros(6))
    again = read(tmp_path, robot_to_yaml(replace(load_robot(NAME)[0], **none)))
    for name in none:
        np.testing.assert_array_equal(getattr(again, name), np.zeros(6))


def test_one_joint_a_line():
    text = robot_to_yaml(load_robot(NAME)[0], "calibrated\nby nobody")
    assert text.startswith("# calibrated\n# by nobody\nschema: bayescal-robot/1\n")
    row = "  - {name: J3, alpha_deg: 0, a_mm: 300, d_mm: 0, offset_deg: 0, limits_deg: [-142, 230]}\n"
    assert row in text
    assert "  - [0, -1, -1, 0, 0, 0]\n" in text


VALID = robot_to_yaml(load_robot(NAME)[0])

SPOILT = cases("robot_refusals")


@pytest.mark.parametrize(("old", "new", "line", "words"), SPOILT)
def test_refusals(tmp_path, old, new, line, words):
    assert old in VALID
    caught = refused(re.escape(words), lambda: read(tmp_path, VALID.replace(old, new, 1)))
    assert caught.where == f"robot.yaml:{line}"
    assert caught.remedy


def test_lengths_in_metres(tmp_path):
    text = VALID.replace("mm: 75", "mm: 0.075").replace("mm: 300", "mm: 0.3").replace("mm: 320", "mm: 0.32")
    refused("are in mm", lambda: read(tmp_path, text.replace("d_mm: 80", "d_mm: 0.08")))


def test_names():
    refused(f"mean `{NAME}`", lambda: load_robot("fanuc-lrmate-200ic"))
    refused("mean `universal-robots-ur10`", lambda: load_robot("UR10"))
    refused("no such file", lambda: load_robot("nowhere.yaml"))


def test_standard_rows_end_at_the_flange(tmp_path):
    text = VALID.replace("links:", "flange: {xyz_mm: [0, 0, 10]}\nlinks:")
    assert read(tmp_path, text).flange[2, 3] == pytest.approx(0.01)
    refused("leave `flange` out", lambda: read(tmp_path, text.replace("convention: mdh", "convention: dh")))


def test_table_of_built_in_robots():
    """Reach against formulas of arms whose axes 2, 3 and 5 are parallel: a1 + a2 + |elbow to wrist| + d6."""
    abb, kuka = bc.robots.table("irb1"), bc.robots.table("KR6R")
    assert list(abb.index) == [name for name in builtin_robots() if "irb1" in name]
    assert abb.loc["abb-irb1600-10-145", "reach_mm"] == pytest.approx(150 + 700 + 600 + 65, abs=0.1)
    assert kuka.loc["kuka-kr6r700", "reach_mm"] == pytest.approx(25 + 315 + np.hypot(365, 35) + 80, abs=0.1)
    assert list(abb.index[abb.masses]) == ["abb-irb120"]
    assert kuka.loc["kuka-kr6r700", "sources"].startswith("KUKA KR 6 R700 sixx: lengths and signs as in")
    assert not any("#" in text for text in kuka.sources)


def test_command_lists_robots_by_a_part_of_their_name():
    done = CliRunner().invoke(app, ["robots", "ur10", "--to", "json"])
    names = [r["name"] for r in json.loads(done.output)["robots"]]
    assert names == ["universal-robots-ur10", "universal-robots-ur10e"]
    done = CliRunner().invoke(app, ["robots", "kr16"])
    assert "kuka-kr16-2" in done.output
    assert "1 built-in" in done.output
    assert "`no-such`" in str(CliRunner().invoke(app, ["robots", "no-such"]).exception)
