"""A light model with a script: the same TCP positions, as a user runs it, without this package."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).parents[3]))

from analysis.simulators import BASE, differences, drawn
from bayescal.exporting.export import export
from bayescal.exporting.mjcf.format import replay_table
from bayescal.exporting.mjcf.replay import Replay
from bayescal.verifying.levels import File, Place

SCENE = Path(__file__).with_name("ur5e_scene.xml")
EFFECTS = (*BASE, "encoder-scale", "coupling", "eccentricity", "gear-mesh@100", "backlash")


@pytest.mark.parametrize(
    ("robot", "into"), [("fanuc-lrmate200ic", ""), ("universal-robots-ur5e", str(SCENE))]
)
def test_script_gives_the_points_of_the_model(robot, into, tmp_path):
    arm = drawn(robot, EFFECTS)
    found = export(arm, "mjcf", into=into, readings="script", force=True)
    record = found.record("arm.xml")
    off, size = differences(arm, 8, File(found.written.content, tmp_path, "arm.xml", Place.of(arm, record)))
    assert np.max(off) < 2e-8
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
    from bayescal.exporting.mjcf.content import Content
    from bayescal.exporting.mjcf.readings import Joints

    table = replay_table(Content(arm, 3), Joints.of(arm.dataset.robot.joint_names), True, {})
    replay, scene = Replay(table), arm.model.scene
    c = scene.circumstances(scene.rows("calibrate"))
    for block in arm.model.blocks:
        expected = block.at_contact(arm.values)
        found = [replay.contact_error(c.approach[row], c.speed[row]) for row in block.rows]
        assert np.allclose(found, expected, atol=1e-12)
        assert np.max(np.abs(expected)) > 1e-6
