"""xacro files: programs, executed only where the user says so, and then apart and within limits."""

import shutil
from contextlib import suppress

import numpy as np
import pytest
from cases import EXAMPLE
from typer.testing import CliRunner

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.errors import BayescalError
from bayescal.robots import load_robot, xacro_file

ARM = """<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:arg name="reach" default="0.3"/><xacro:include filename="part.xacro"/>
<xacro:part length="$(arg reach)"/></robot>"""
PART = """<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:macro name="part" params="length">
<link name="base"/><link name="tool0"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="tool0"/>
<origin xyz="0 0 ${2 * length}" rpy="0 0 ${pi / 2}"/><axis xyz="0 0 1"/>
<limit lower="${radians(-90)}" upper="1" effort="0" velocity="0"/></joint></xacro:macro></robot>"""
BOMB = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><robot name="&b;"/>'

SYSTEM = "(lambda: xacro.load_yaml.__globals__['os'].system('touch WITNESS'))()"
"""An expression that leaves xacro's own guard, which looks at names outside of lambdas alone."""
PIECES = SYSTEM.replace("__", "_$(arg u)")  # what a filter of the text does not find
ESCAPES = {
    "an attribute": f'<xacro:arg name="u" default="_"/><link name="${{{PIECES}}}"/>',
    "a comment": f"<!-- xacro:eval-comments --><!-- ${{{SYSTEM}}} -->",
    "a YAML file": "<link name=\"${xacro.load_yaml('more.yaml')}\"/>",
}


def read(folder, text=ARM, **allow):
    (folder / "part.xacro").write_text(PART)
    (folder / "arm.xacro").write_text(text)
    return load_robot("arm.xacro", folder, **allow)


def test_expanded_where_allowed(tmp_path):
    found, content = read(tmp_path, allow_xacro=True)
    tip = frames(chain_of(found), link_angles(found, np.zeros((1, 1))))[0, -1]
    np.testing.assert_allclose(tip[:3, 3], [0, 0, 0.6], atol=1e-15)
    assert found.limits[0, 0] == pytest.approx(-np.pi / 2)
    (tmp_path / "part.xacro").write_text(PART.replace("2 *", "3 *"))
    assert load_robot("arm.xacro", tmp_path, allow_xacro=True)[1] != content  # the hash covers included files
    (tmp_path / "moved").mkdir()
    assert read(tmp_path / "moved", allow_xacro=True)[1] == content  # and not where they lie


@pytest.mark.parametrize("place", ESCAPES)
def test_no_expression_runs_unasked(tmp_path, place):
    witness = tmp_path / "witness"
    (tmp_path / "more.yaml").write_text(f'a: !degrees "{SYSTEM}"'.replace("WITNESS", str(witness)))
    text = ARM.replace("</robot>", f"{ESCAPES[place]}</robot>".replace("WITNESS", str(witness)))
    with pytest.raises(BayescalError, match="is a program") as caught:
        read(tmp_path, text)
    assert not witness.exists()
    assert "`xacro arm.xacro > arm.urdf`" in caught.value.remedy
    assert "--allow-xacro" in caught.value.remedy
    with suppress(BayescalError):
        read(tmp_path, text, allow_xacro=True)
    assert witness.exists()  # the file does what it seems to do: the test would see it


def test_every_command_refuses_and_takes_the_option(tmp_path):
    from bayescal.cli import app

    folder = shutil.copytree(EXAMPLE, tmp_path / "set")
    settings = (folder / "dataset.yaml").read_text()
    (folder / "dataset.yaml").write_text(settings.replace("robot: fanuc-lrmate200ic", "robot: arm.xacro"))
    (folder / "arm.xacro").write_text('<robot name="arm"><link name="base"/></robot>')
    (tmp_path / "log.csv").write_text("A1,X,Y,Z\n0,1,2,3\n")
    log = [str(tmp_path / "log.csv"), "--map", "j*=A* deg, x=X mm", "--out", str(tmp_path / "new")]
    arm = ["--robot", str(folder / "arm.xacro")]
    calls = (
        ["fit", str(folder)],
        ["gap", str(folder)],
        ["compare", str(folder)],
        ["import", *log, *arm],
        ["import", *log, "--template", str(folder)],
        ["simulate", "--out", str(tmp_path / "new"), *arm],
    )
    for call in calls:
        refused, told = (CliRunner().invoke(app, [*call, *option]) for option in ([], ["--allow-xacro"]))
        assert "--allow-xacro" in str(refused.exception), call
        assert "no joint turns" in str(told.exception), call  # it was expanded, and is no arm


def test_the_child_has_no_environment_and_limits(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET_TOKEN", "hush")
    with pytest.raises(BayescalError, match="SECRET_TOKEN"):
        read(tmp_path, ARM.replace('default="0.3"', 'default="$(env SECRET_TOKEN)"'), allow_xacro=True)
    monkeypatch.setattr(xacro_file, "BYTES", 2**27)
    with pytest.raises(BayescalError, match="MemoryError"):
        read(tmp_path, ARM.replace("$(arg reach)", "${len([0] * 2**28)}"), allow_xacro=True)


def test_an_endless_expression_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(xacro_file, "SECONDS", 1)
    with pytest.raises(BayescalError, match="stopped after 1 s"):
        read(tmp_path, ARM.replace("$(arg reach)", "${10**10**9}"), allow_xacro=True)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (ARM.replace("part.xacro", "http://127.0.0.1/part.xacro"), "cannot expand it: .*No such file"),
        (ARM.replace("part.xacro", "$(find somewhere)/part.xacro"), "cannot expand it: .*ROS is installed"),
        (ARM.replace("part.xacro", "nowhere.xacro"), "No such file"),
        (ARM.replace("part.xacro", "bomb.xacro"), "DTDForbidden"),
        (BOMB, "DTDForbidden"),
        (ARM.replace(' default="0.3"', ""), "missing attribute 'default'"),
        (ARM.replace("$(arg reach)", "${1 / 0}"), "division by zero"),
    ],
)
def test_refusals(tmp_path, text, told):
    (tmp_path / "bomb.xacro").write_text(BOMB)
    with pytest.raises(BayescalError, match=told) as caught:
        read(tmp_path, text, allow_xacro=True)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_said_to_be_missing(tmp_path):
    with pytest.raises(BayescalError, match="no such file"):
        load_robot("nowhere.xacro", tmp_path, allow_xacro=True)
