"""Model levels of a calibration: joint offsets, geometry, compliance; and the validation errors of each."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.calibration import fit
from bayescal.estimate import calibrated
from bayescal.exporting.robot import calibrated_robot
from bayescal.gap.diagnose import diagnose
from bayescal.model import ARM, build, check_asked
from bayescal.model.scene import Scene

FULL = ("geometry", "compliance")
ZEROS = np.array([0.0, 2e-3, -1.5e-3, 1e-3, -2.5e-3, 0.0])
SCALES = np.array([1e-4, -8e-5, 1.2e-4, 6e-5, -1e-4, 5e-5])


@pytest.fixture(scope="module")
def split(cube):
    """Contacts of an arm with errors, a quarter of them validation measurements."""
    dataset = cube(seed=11, count=160).dataset
    role = np.where(np.arange(160) % 4 == 0, "validate", "calibrate")
    return replace(dataset, measurements=replace(dataset.measurements, role=role))


@pytest.fixture(scope="module")
def misread(cube):
    """A nominal arm with errors of the joint readings alone: zeros and scales."""
    dataset = cube(seed=12, count=280, spread=0.0).dataset
    rows, coupling = dataset.measurements, dataset.robot.link_from_reading
    links = rows.readings @ coupling.T - ZEROS
    readings = links @ np.linalg.inv(coupling).T / (1.0 + SCALES)
    return replace(dataset, measurements=replace(rows, readings=readings))


def test_every_level_reduces_validation_errors(split):
    """Nominal, joint offsets, geometry, compliance."""
    result = fit(split, FULL, samples=0)
    assert [r.effects for r in result.levels] == [("nominal",), ("joint",), ("geometry",), FULL]
    rms = [
        np.sqrt(np.mean(np.concatenate([p.residuals for p in r.validation.planes]) ** 2))
        for r in result.levels
    ]
    assert rms[0] > 1.5 * rms[1] > 3 * rms[2] > 3 * rms[3]
    assert rms[3] < 10e-6


def test_a_model_without_geometry_has_no_level_of_joints(split):
    """The level of the joints is only before the geometry, of which it is a part."""
    assert [r.effects for r in fit(split, ("joint",), samples=0).levels] == [("nominal",), ("joint",)]


def test_zeros_and_scales_are_found(misread):
    """The first level estimates them, and the robot file contains them."""
    found = calibrated(Scene(misread), ("joint", "compliance"))
    model = found.model
    names = dict(zip(model.names, zip(model.physical(found.z), found.sd, strict=True), strict=True))
    sd = {p.name: p.sd for p in model.parameters}
    assert not {n for n in sd if n[0] in "ad" and n[1:].isdigit()}, "no length, no twist"
    for i in range(2, 6):
        value, z_sd = names[f"theta{i}"]
        expected = model.scene.dataset.robot.offset[i - 1] + ZEROS[i - 1]
        assert abs(value - expected) < 4 * z_sd * sd[f"theta{i}"]
    for i, true in enumerate(SCALES, start=1):
        value, z_sd = names[f"encoder-scale J{i}"]
        assert abs(value - true) < 4 * z_sd * sd[f"encoder-scale J{i}"]
    assert found.sd[model.names.index("encoder-scale J2")] < 0.7
    stiff = replace(calibrated_robot(found.model, found.arm), compliance=None)
    values = model.deviations(found.z[model.slices[ARM]]).copy()
    values[[p.effect in ("compliance", "tool") for p in model.parameters]] = 0.0
    rows = np.arange(len(misread.measurements.ids))
    q = link_angles(stiff, misread.measurements.readings)
    p = points(chain_of(stiff), q, model.scene.tools)
    np.testing.assert_allclose(p, model.motion(rows).points(values).T, atol=1e-9)


@pytest.mark.parametrize(
    ("effects", "whole"),
    [
        (("joint", "geometry"), ("geometry", "encoder-scale")),
        (("geometry", "joint"), ("geometry", "encoder-scale")),
        (("encoder-scale", "joint"), ("joint",)),
    ],
)
def test_a_parameter_of_two_effects_is_in_the_model_once(split, effects, whole):
    """Twice it would have twice the variance, and which of the two a fit means would be open."""
    check_asked(effects, 1.0)
    names = build(Scene(split), effects).names
    assert len(set(names)) == len(names)
    assert set(names) == set(build(Scene(split), whole).names)


def test_gap_takes_the_first_level(split):
    """Joint offsets leave the errors of the geometry; the level itself is no cause to name."""
    found = diagnose(split, ("joint", "compliance"))
    assert found.baseline == ("joint", "compliance")
    assert "encoder-scale" not in {*found.verdict.probability, *found.verdict.missing}
    check_asked(found.refit, 1.0)
    assert "joint" not in found.verdict.probability
    assert [n.effect for n in found.verdict.named][:1] == ["geometry"]
