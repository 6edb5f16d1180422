"""Arms with drawn parameters in MuJoCo, an independent simulator, against our own model."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from analysis.simulators import BASE, CASES, differences, drawn
from bayescal.arm.motion import Term
from bayescal.effects.location import joint
from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.format import mjcf
from bayescal.model import with_parameters
from bayescal.simulation import Options, simulate
from bayescal.verifying.levels import File, Machine, Place, limit, modelled, replayed

POSES = 8


@pytest.mark.parametrize("effects", CASES, ids=lambda case: f"{case[-1]} of {len(case)}")
def test_every_effect_of_a_coupled_arm(effects):
    off, size = differences(drawn("fanuc-lrmate200ic", effects), POSES)
    assert np.max(off) < limit(effects)
    assert size > 2e-6  # there is an effect to hold


@pytest.mark.parametrize("robot", ["universal-robots-ur5e", "franka-panda", "unimation-puma560"])
def test_other_arms(robot):
    effects = (*BASE, "base-compliance", "hysteresis", "coupling", "eccentricity", "backlash")
    off, _ = differences(drawn(robot, effects), POSES)
    assert np.max(off) < limit(effects)


def test_a_stand_with_axes_of_its_own():
    """Two hinges along its principal axes, 0.4 m below the base."""
    arm, depth = drawn("universal-robots-ur5e", (*BASE, "base-compliance@turned")), 0.4
    xx, yy, cross = 1.2e-5, 6e-6, 4e-6
    given = {"x": xx, "y": yy, "cross": cross}
    given |= {"slide x": -depth * xx, "slide y": depth * yy, "slide cross": depth * cross}
    at = {p.name: k for k, p in enumerate(arm.model.parameters)}
    values = arm.values.copy()
    for name, value in given.items():
        values[at[f"base-compliance {name}"]] = value
    off, size = differences(arm.valued(values), POSES)
    assert np.max(off) < limit((*BASE, "base-compliance")) + 5e-8  # three times the tilt of other tests
    assert size > 1e-4


def test_an_added_load_elsewhere_is_a_further_mass(monkeypatch):
    """The body of the further mass is moved, and its mass counts by a factor."""
    counts = {"contacts": 60, "repeats": 0, "later": 10, "spheres": 0, "placements": 0}
    loaded = simulate(Options(seed=2, payload=2.0, **counts)).dataset
    monkeypatch.setattr("analysis.simulators.session", lambda robot, seed: loaded)
    arm = drawn("fanuc-lrmate200ic", (*BASE, "payload@added"))
    off, size = differences(arm, POSES)
    assert np.max(off) < limit((*BASE, "payload"))
    assert size > 2e-6


@pytest.mark.parametrize("side", ["reading", "link"])
def test_lost_motion_of_coupled_axes_is_at_its_gear(side):
    off, size = differences(drawn("fanuc-lrmate200ic", (*BASE, f"backlash@{side}")), POSES)
    assert np.max(off) < limit((*BASE, "backlash"))
    assert size > 2e-6


def test_a_difference_is_seen():
    """Ten micrometres in the file are ten micrometres in the comparison."""
    arm = drawn("universal-robots-ur5e", BASE)
    text = mjcf(arm, len(arm.dataset.measurements.ids) - 1)
    x = re.search(r'<body name="base" .*?pos="(\S+) ', text)
    wrong = text[: x.start(1)] + repr(float(x[1]) + 1e-5) + text[x.end(1) :]
    off, _ = differences(arm, POSES, File(wrong, Path(), "wrong", Place.of(arm, {})))
    assert np.allclose(off, 1e-5, atol=1e-8)


def test_leading_backlash_and_negative_compliance_are_refused():
    arm = drawn("universal-robots-ur5e", (*BASE, "backlash"))
    backlash = np.array([p.effect == "backlash" for p in arm.model.parameters])
    compliance = np.array([p.effect == "compliance" for p in arm.model.parameters])
    leading = arm.valued(np.where(backlash, -arm.values, arm.values))
    with pytest.raises(BayescalError, match="backlash of J1 leads by"):
        mjcf(leading, 0)
    off, _ = differences(leading, POSES, File.new(leading, 0, script=True))
    assert np.max(off) < 2e-8
    with pytest.raises(BayescalError, match="J2 turns against its torque"):
        mjcf(arm.valued(np.where(compliance, -arm.values, arm.values)), 0)


def test_a_joint_without_torque_where_the_arm_stands_has_no_spring():
    """A fit may have a compliance of a first joint that only a leaning base loads; a file then needs none."""
    arm = drawn("universal-robots-ur5e", BASE)
    scene, extra = arm.model.scene, next(p for p in arm.model.parameters if p.name == "compliance J2")
    upright = replace(extra, name="compliance J1", site=joint(1), terms=(Term(1, "rz", 0.0),))
    model = with_parameters(scene, arm.model.effects, (*arm.model.parameters, upright))
    further = replace(arm, model=model, values=np.append(arm.values, 1e-4), covariance=np.zeros((1, 1)))
    assert mjcf(further, 0) == mjcf(arm, 0)


def test_springs_and_friction_hold_the_largest_moments_of_the_session():
    """At the poses of the largest torques, and friction of twice the largest torque of any joint."""
    arm = drawn("universal-robots-ur5e", (*BASE, "hardening", "backlash"))
    torques = np.abs(arm.model.scene.moments[:, 1:, 2])
    rows = np.unique(np.argmax(torques, axis=0))
    state = len(torques) - 1
    text = mjcf(arm, state)
    machine = Machine.of(arm, state)
    reached, points = replayed(machine.simulator(text, Path(), "arm"), machine, arm, rows)
    off = np.linalg.norm(points - modelled(arm, rows, reached, state), axis=1)
    assert np.max(off) < limit((*BASE, "hardening", "backlash"))
    model = mujoco.MjModel.from_xml_string(text)
    held = [
        model.tendon_stiffness[t] * float(e.get("springyield"))
        for e in ElementTree.fromstring(text).iter("fixed")
        if e.get("name").endswith("_friction")
        for t in [model.tendon(e.get("name")).id]
    ]
    assert held == pytest.approx([max(30.0, 2.0 * torques.max())] * 6, rel=1e-12)
