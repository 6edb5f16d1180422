"""Targets whose stated place is far off: located all the same, or refused by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import read_dataset
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.model.scene import Scene
from bayescal.predict import validate
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.locate import locate
from factors.cylinder import Cylinder
from factors.distance import Distance
from factors.instrument import Instrument
from factors.sphere import Sphere

CUBE = Path(__file__).parents[2] / "data" / "lrmate200ic-cube"
DIAMETER, RADIUS, SIGMA = 50.8e-3, 3e-3, 5e-6
LOOSE = np.array([0.05, 0.05, 0.05, 1e-3])
TRUE = np.array([0.4, -0.1, 0.2])


def touched(directions, noise=0.0, rng=None):
    """Ball centres (3, C) that touch the true sphere from some directions (3, C)."""
    u = directions / np.linalg.norm(directions, axis=0)
    off = noise * rng.standard_normal(u.shape[1]) if noise else 0.0
    return TRUE[:, None] + u * (DIAMETER / 2 + RADIUS + off)


def from_above(rng, count=11, low=0.0):
    u = rng.standard_normal((3, count))
    u[2] = low * np.linalg.norm(u[:2], axis=0) + np.abs(u[2])
    return u


@pytest.fixture(scope="module")
def example():
    """The example's calibration, of its fitted contacts alone: they do not see where a sphere is stated."""
    return calibrated(Scene(read_dataset(CUBE)), ("geometry", "compliance"))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_sphere_stated_30_mm_off_is_located(example, axis, sign):
    """With no certified diameter: distances, and what is predicted of them, are as with its true place."""
    d = example.model.scene.dataset
    off = sign * 0.03 * np.eye(3)[axis]
    targets = tuple(
        replace(t, values={**t.values, "centre": np.asarray(t.values["centre"]) + off})
        if t.name == "ball.A@1"
        else t
        for t in d.targets
    )
    certificates = tuple(c for c in d.certificates if c.kind != "diameter")
    moved = replace(d, targets=targets, certificates=certificates)
    h = validation_errors(replace(example, model=replace(example.model, scene=Scene(moved)))).distances
    known = validation_errors(
        replace(example, model=replace(example.model, scene=Scene(replace(d, certificates=certificates))))
    ).distances
    np.testing.assert_allclose(h.error, known.error, atol=0.2e-6)
    np.testing.assert_allclose(h.predicted_sd(), known.predicted_sd(), rtol=0.01)
    assert np.max(np.abs(h.error) / h.predicted_sd()) < 4


def test_fit_locates_it_too(example):
    d = example.model.scene.dataset
    targets = tuple(
        replace(t, values={**t.values, "centre": np.add(t.values["centre"], [0, 0, -0.03])})
        if t.name == "ball.A@1"
        else t
        for t in d.targets
    )
    certificates = tuple(c for c in d.certificates if c.kind != "diameter")
    scene = Scene(replace(d, targets=targets, certificates=certificates))
    z = np.tile(example.z, (2, 1))
    scale = np.full((2, 1), example.weights.scale["contact"])
    found = validate(replace(example, model=replace(example.model, scene=scene)), z, scale)
    assert found.distance_errors.maximum < 50e-6


@pytest.mark.parametrize("seed", range(8))
def test_any_start_leads_to_the_same_place(seed):
    """Spheres stated up to 50 mm off, touched from above, with an unknown diameter."""
    rng = np.random.default_rng(seed)
    stated = TRUE + 0.05 * rng.uniform(-1, 1, 3)
    kind = Sphere(stated, DIAMETER, np.full(11, RADIUS), LOOSE)
    at, keep = locate("ball", kind, touched(from_above(rng), SIGMA, rng), np.full((1, 11), SIGMA))
    assert keep.sum() >= 10
    sd = LOOSE * np.sqrt(np.diag(np.linalg.inv(at.information[0])))
    assert np.all(np.abs(stated + at.x[0, :3] - TRUE) < 5 * sd[:3])
    assert np.all(sd[:3] < 0.1e-3)


def test_two_mirrored_places_are_refused_by_name():
    """Contacts round one circle do not say on which side of it the centre lies; a close enough place does."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.full(12, 0.6)])
    p, height = touched(ring), 0.6 / np.hypot(1, 0.6) * (DIAMETER / 2 + RADIUS)
    stated = np.add(TRUE, [0, 0, height])  # in the plane of the circle
    sharp = np.append(LOOSE[:3], 1e-6)
    kind = Sphere(stated, DIAMETER, np.full(12, RADIUS), sharp)
    with pytest.raises(BayescalError, match=r"ball\.A@1.* two places .*u_mm"):
        locate("ball.A@1", kind, p, np.full((1, 12), SIGMA))
    # a model level that only serves for comparison takes one of the two
    at, _ = locate("ball.A@1", kind, p, np.full((1, 12), SIGMA), strict=False)
    assert np.linalg.norm(stated + at.x[0, :3] - TRUE) == pytest.approx(2 * height, abs=1e-5) or np.allclose(
        stated + at.x[0, :3], TRUE, atol=1e-5
    )
    near = replace(kind, centre=np.add(TRUE, [0, 0, 2e-3]), sd=np.array([2e-3, 2e-3, 2e-3, 1e-6]))
    at, _ = locate("ball.A@1", near, p, np.full((1, 12), SIGMA))
    np.testing.assert_allclose(near.centre + at.x[0, :3], TRUE, atol=1e-5)


def test_what_does_not_converge_is_refused_by_name(monkeypatch):
    rng = np.random.default_rng(3)
    kind = Sphere(TRUE + 0.04, DIAMETER, np.full(11, RADIUS), LOOSE)
    monkeypatch.setattr("bayescal.predict.locate.ITERATIONS", 1)
    monkeypatch.setattr("bayescal.predict.locate.starts", lambda kind, p: np.zeros((1, 4)))
    with pytest.raises(BayescalError, match=r"target ball\.B@2 .*did not reach an optimum.*; state its pos"):
        locate("ball.B@2", kind, touched(from_above(rng)), np.full((1, 11), SIGMA))


def test_a_slip_and_a_wrong_place_at_once():
    rng = np.random.default_rng(5)
    p = touched(from_above(rng), SIGMA, rng)
    p[:, 4] += 0.5e-3 * (p[:, 4] - TRUE) / np.linalg.norm(p[:, 4] - TRUE)
    kind = Sphere(np.add(TRUE, [0.03, 0, 0.02]), DIAMETER, np.full(11, RADIUS), LOOSE)
    at, keep = locate("ball", kind, p, np.full((1, 11), SIGMA))
    assert keep[4] == 0.0
    assert np.linalg.norm(kind.centre + at.x[0, :3] - TRUE) < 0.1e-3


def test_an_instrument_stated_with_its_axes_turned():
    """By 0.5 rad, 0.3 m off: far beyond its prior, and back by what it read."""
    rng = np.random.default_rng(2)
    nominal = rigid(rpy_matrix(np.array([0.1, -0.2, 1.0])), np.array([2.0, 0.5, 0.3]))
    true = rigid(rpy_matrix(np.array([0.4, 0.1, 1.3])), np.array([2.2, 0.3, 0.4]))
    p = np.array([0.4, 0, 0.3]) + rng.uniform(-0.2, 0.2, (12, 3))
    xyz = (p - true[:3, 3]) @ true[:3, :3]
    kind = Instrument(nominal, p.mean(axis=0), xyz, np.array([0.2] * 3 + [0.05] * 3))
    at, keep = locate("tracker", kind, p.T, np.full((3, 12), 1e-5))
    assert keep.all()
    np.testing.assert_allclose(kind.describe(at.x[0])["frame"], true, atol=1e-5)


def test_a_ball_bar_and_a_pin_stated_far_off():
    rng = np.random.default_rng(4)
    u = rng.standard_normal((3, 20))
    u /= np.linalg.norm(u, axis=0)
    u[2] = np.abs(u[2])
    bar = Distance(np.add(TRUE, [0.04, -0.03, 0.02]), np.full(20, 0.3), np.full(3, 0.05))
    at, _ = locate("bar", bar, TRUE[:, None] + 0.3 * u, np.full((1, 20), SIGMA))
    np.testing.assert_allclose(bar.centre + at.x[0], TRUE, atol=1e-6)
    turn, height = rng.uniform(-2, 2, 20), rng.uniform(-0.03, 0.03, 20)
    p = TRUE[:, None] + np.stack([13e-3 * np.cos(turn), 13e-3 * np.sin(turn), height])
    sd = np.array([0.2, 0.2, 0.05, 0.05, 1e-3])
    pin = Cylinder(np.add(TRUE, [0.03, 0.02, 0]), np.array([0, 0, 1.0]), 20e-3, np.full(20, RADIUS), sd)
    at, _ = locate("pin", pin, p, np.full((1, 20), SIGMA))
    np.testing.assert_allclose(pin.describe(at.x[0])["point"][:2], TRUE[:2], atol=1e-5)


def test_a_closely_stated_place_has_no_rivals(monkeypatch):
    """Other starts count only where the prior lets a second place compete; all are searched from at once."""
    rng, counted = np.random.default_rng(7), []
    p, sigma = touched(from_above(rng), SIGMA, rng), np.full((1, 11), SIGMA)

    def check(name, found, *others):
        counted.append(len(found.x))

    monkeypatch.setattr("bayescal.predict.locate._check", check)
    for prior in (np.full(4, 1e-4), LOOSE):
        at, _ = locate("ball", Sphere(TRUE + 5e-5, DIAMETER, np.full(11, RADIUS), prior), p, sigma)
        assert np.linalg.norm(TRUE + 5e-5 + at.x[0, :3] - TRUE) < 0.1e-3
    assert counted[0] == 1 < counted[1]
