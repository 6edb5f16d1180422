"""An exported arm as the robot of the next session: the fit finds nothing to correct."""

from dataclasses import replace

import numpy as np
import pytest
from export_arms import fake, robot_of, session_of

from bayescal.dataset import Measurements, Target, read_dataset, write_dataset
from bayescal.estimate import calibrated
from bayescal.exporting.export import export
from bayescal.model import ARM
from bayescal.model.scene import Scene

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


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "universal-robots-ur5e"])
def test_urdf(name, tmp_path):
    """What it cannot hold, the compliance, is found again; the geometry needs no correction."""
    arm = fake(session_of(name), ("geometry", "compliance"))
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


def test_through_the_files(tmp_path):
    """The dataset with the exported robot is written and read as any other."""
    arm = fake(session_of(), ("geometry", "compliance"))
    (tmp_path / "arm.yaml").write_text(export(arm, "robot.yaml").written.content)
    write_dataset(measured(arm, robot_of("arm.yaml", tmp_path), np.eye(6)), tmp_path / "next")
    z, _ = corrections(read_dataset(tmp_path / "next"), ("geometry", "compliance"))
    assert max(abs(value) for value in z.values()) < 0.1
