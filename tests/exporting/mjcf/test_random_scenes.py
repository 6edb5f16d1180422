"""Scenes of arms with arbitrary frames, axes, references and orientations: the patched arm is the model."""

import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[3]))

from analysis.simulators import BASE, differences, drawn, patched
from bayescal.arm.transforms import rigid
from bayescal.exporting.geometry import zero_frames
from bayescal.verifying.levels import limit

EFFECTS = (*BASE, "base-compliance", "coupling", "backlash")


def words(values) -> str:
    return " ".join(repr(float(v)) for v in values)


def turned(rng, rotation: np.ndarray, degrees: bool) -> dict[str, str]:
    """One of the attributes that state an orientation."""
    own, kind = Rotation.from_matrix(rotation), rng.integers(4)
    if kind == 0:
        x, y, z, w = own.as_quat()
        return {"quat": words(3.0 * np.array([w, x, y, z]))}
    if kind == 1:
        return {"euler": words(own.as_euler("zyx", degrees=degrees))}
    if kind == 2:
        angle = own.magnitude()
        return {
            "axisangle": words(
                [*own.as_rotvec() / max(angle, 1e-12), np.degrees(angle) if degrees else angle]
            )
        }
    return {"xyaxes": words([*rotation[:, 0], *rotation[:, 1]])}


def about(axis: np.ndarray, at: np.ndarray, angle: float) -> np.ndarray:
    """A rotation (4, 4) about an axis through a point."""
    turn = Rotation.from_rotvec(angle * axis).as_matrix()
    return rigid(turn, at - turn @ at)


def random_scene(robot, rng) -> str:
    """An arm in a scene; its joints, at zero, are where those of the robot are."""
    degrees = bool(rng.integers(2))
    unit = np.degrees if degrees else float
    root = ET.Element("mujoco")
    ET.SubElement(
        root, "compiler", angle="degree" if degrees else "radian", eulerseq="ZYX", autolimits="true"
    )
    ET.SubElement(root, "option", timestep="0.001")
    world = ET.SubElement(root, "worldbody")
    place = rigid(
        Rotation.random(random_state=rng).as_matrix() if rng.integers(2) else np.eye(3), rng.normal(size=3)
    )
    down = place[:3, :3] @ (0.0, 0.0, -9.81)
    root.find("option").set("gravity", words(down))
    parent, before = (
        ET.SubElement(
            world, "body", name="foot", pos=words(place[:3, 3]), **turned(rng, place[:3, :3], degrees)
        ),
        np.eye(4),
    )
    ET.SubElement(parent, "geom", size=".1")
    for k, frame in enumerate(zero_frames(robot)[:-1]):
        own = frame @ rigid(Rotation.random(random_state=rng).as_matrix(), 0.1 * rng.normal(size=3))
        inverse, sign = np.linalg.inv(own), rng.choice([-1.0, 1.0])
        axis = inverse[:3, :3] @ (sign * frame[:3, 2])
        anchor = (inverse @ (frame @ [0.0, 0.0, 0.1 * rng.normal(), 1.0]))[:3]
        reference = float(rng.normal()) if rng.integers(2) else 0.0
        local = np.linalg.inv(before) @ own @ about(axis, anchor, reference)
        parent = ET.SubElement(
            parent, "body", name=f"part{k}", pos=words(local[:3, 3]), **turned(rng, local[:3, :3], degrees)
        )
        ET.SubElement(parent, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        ET.SubElement(
            parent,
            "joint",
            name=f"turn{k}",
            axis=words(2.0 * axis),
            pos=words(anchor),
            ref=words([unit(reference)]),
        )
        before = own
    hand = ET.SubElement(parent, "body", name="hand")
    for k in (1, 2):
        finger = ET.SubElement(hand, "body", name=f"finger{k}")
        ET.SubElement(finger, "joint", name=f"knuckle{k}", axis="0 1 0", stiffness="1")
        ET.SubElement(finger, "geom", size=".01", mass="1e-6")
    ET.indent(root, "\t")
    return ET.tostring(root, encoding="unicode")


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "robot", ["fanuc-lrmate200ic", "universal-robots-ur5e", "franka-panda", "unimation-puma560"]
)
def test_an_arm_in_any_frames(tmp_path, robot, seed):
    arm = drawn(robot, EFFECTS)
    rng = np.random.default_rng(seed)
    text = random_scene(arm.dataset.robot, rng)
    (tmp_path / "scene.xml").write_text(text)
    mujoco.MjModel.from_xml_string(text)
    off, _ = differences(arm, 3, patched(arm, tmp_path / "scene.xml"))
    assert np.max(off) < limit(EFFECTS)
