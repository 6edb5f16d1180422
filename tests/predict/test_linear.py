"""The slopes that all predictions go through, against locating the targets again for every draw."""

from dataclasses import replace

import numpy as np
import pytest
from kind_sessions import of_pieces, sphere
from sessions import misread, with_columns
from test_crossvalidation import BALLS, FULL, with_spheres

from bayescal.dataset import Certificate
from bayescal.estimate import estimate
from bayescal.model import ARM, Scene, build
from bayescal.posterior import gaussian
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.forecast import elsewhere
from bayescal.predict.locate import Rows, search
from bayescal.predict.targets import prepared
from bayescal.predict.validation import validate

DRAWS = 1500


@pytest.fixture(scope="module")
def fitted(cube):
    """Few contacts, so that the arm is uncertain by several times the noise."""
    return estimate(build(Scene(with_spheres(cube(seed=3, count=40))), FULL), robust=False)


def relocated(found, t, draws, rng, excess=0.0):
    """Centres (S, 3) of a located target, found anew for every draw of the arm and of the noise."""
    model = found.model
    values = model.deviations(draws.flat[:, model.slices[ARM]])
    block, count = t.block, len(draws.flat)
    p = block.motion.points(values) + excess * rng.standard_normal((count, 3, 1))
    scale = (draws.kappa / found.weights.scale["contact"])[:, :, None]
    noise = scale * t.noise * rng.standard_normal((count, 1, len(t.noise)))
    away = p - t.centre[:, None]
    seen = p - noise * away / np.linalg.norm(away, axis=1, keepdims=True)
    at = search(Rows(block.touched(values[0]), seen, t.noise[None]), np.tile(t.state, (count, 1)))
    assert np.all(at.step_length < 0.01)
    return block.kind.centre + at.x[:, :3]


@pytest.mark.parametrize("excess", [0.0, 30e-6])
def test_slopes_agree_with_locating_every_draw_again(fitted, excess):
    draws, rng = gaussian(fitted, 0, DRAWS), np.random.default_rng(1)
    located = prepared(fitted).located
    centres = {name: relocated(fitted, t, draws, rng, excess) for name, t in located.items()}
    (d,) = validate(fitted, draws.flat, draws.kappa, excess).distances
    drawn = np.linalg.norm(np.subtract(*(centres[n] for n in d.between)), axis=1)
    mean = np.linalg.norm(np.subtract(*(located[n].centre for n in d.between)))
    assert d.error == pytest.approx(mean - d.certified)
    assert np.std(d.predicted) == pytest.approx(np.std(drawn), rel=0.08)
    assert abs(np.mean(drawn) - mean) < 0.1 * np.std(drawn)
    if not excess:
        assert validation_errors(fitted).distances.predicted_sd()[0] == pytest.approx(np.std(drawn), rel=0.08)


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_noise_of_what_is_predicted_has_the_scale_of_the_fit(fitted, factor):
    """Of every row, and of the rows that locate a target."""
    scale = {group: factor * own for group, own in fitted.weights.scale.items()}
    before, after = prepared(fitted), prepared(replace(fitted, weights=replace(fitted.weights, scale=scale)))
    for one, other in zip(before.rows, after.rows, strict=True):
        np.testing.assert_allclose(other.noise, factor * one.noise)
    for name, one in before.located.items():
        np.testing.assert_allclose(after.located[name].noise, factor * one.noise)


def test_unexplained_error_is_added_to_located_spheres(fitted):
    """One shift a sphere: the variance of a distance grows by twice its square, that of a diameter not."""
    draws = gaussian(fitted, 0, 4000)
    without, with_it = (validate(fitted, draws.flat, draws.kappa, e) for e in (0.0, 40e-6))
    grown = np.var(with_it.distances[0].predicted) - np.var(without.distances[0].predicted)
    assert np.sqrt(grown) == pytest.approx(np.sqrt(2) * 40e-6, rel=0.06)
    for a, b in zip(without.diameters, with_it.diameters, strict=True):
        assert np.std(b.predicted) == pytest.approx(np.std(a.predicted), rel=0.1)


def test_unexplained_error_of_an_instrument_is_another_at_every_point(cube, tracker):
    """Its rows, and the frame that they locate, are as uncertain as that makes them."""
    session = tracker(seed=1, count=60)
    d = with_columns(session.dataset, role=np.where(np.arange(60) < 30, "locate", "validate"))
    found = estimate(build(Scene(session.dataset), FULL))
    found = replace(found, model=replace(found.model, scene=Scene(d), blocks=(), constraints=()))
    own = found.model.slices[ARM]
    found = replace(found, z=found.z[own], covariance=found.covariance[own, own])
    draws = np.tile(found.z, (3000, 1))
    kappa = np.full((3000, 1), found.weights.scale["point"])
    found = replace(found, weights=replace(found.weights, scale={}))
    (plain,) = validate(found, draws, kappa).points
    (wide,) = validate(found, draws, kappa, 50e-6).points
    noise = np.sqrt(np.mean(np.var(plain.predicted, axis=0)))
    sd = np.sqrt(np.mean(np.var(wide.predicted, axis=0)))
    assert sd / noise == pytest.approx(np.hypot(1.0, 50e-6 / d.noise.point), rel=0.05)


def certified_within(fitted, kind, u):
    """The same fit, with certificates of one kind that are uncertain by u, m."""
    data = fitted.model.scene.dataset
    stated = tuple(replace(c, u_distance=u) if c.kind == kind else c for c in data.certificates)
    return replace(fitted, model=replace(fitted.model, scene=Scene(replace(data, certificates=stated))))


@pytest.mark.parametrize("kind", ["distance", "diameter"])
def test_the_uncertainty_of_a_certificate_is_part_of_its_predicted_error(fitted, kind):
    draws, u = gaussian(fitted, 0, 4000), 50e-6
    exact, unsure = (certified_within(fitted, kind, within) for within in (0.0, u))
    checks = [getattr(validate(f, draws.flat, draws.kappa), f"{kind}s") for f in (exact, unsure)]
    for sharp, loose in zip(*checks, strict=True):
        assert np.sqrt(np.var(loose.predicted) - np.var(sharp.predicted)) == pytest.approx(u, rel=0.08)
    if kind == "distance":
        sd = [validation_errors(f).distances.predicted_sd() for f in (exact, unsure)]
        np.testing.assert_allclose(sd[1] ** 2 - sd[0] ** 2, u**2)


@pytest.mark.parametrize(("second", "shared"), [(0.5e-3, 0.9), (0.4e-3, 0.0)])
def test_a_length_of_one_artefact_at_two_placements_has_one_error(cube, second, shared):
    """That of its certificate; certificates of different numbers are of different artefacts."""
    centres = {f"{name}@{k}": np.add(c, (0.0, 0.0, 0.05 * k)) for name, c in BALLS.items() for k in (1, 2)}
    pieces = [sphere(name, c, [1e-4] * 3, count=14, held=14) for name, c in centres.items()]
    length, u = float(np.linalg.norm(np.subtract(*BALLS.values()))), (0.5e-3, second)
    pairs = (tuple(f"{name}@{k}" for name in BALLS) for k in (1, 2))
    paper = [Certificate("distance", pair, length, of) for pair, of in zip(pairs, u, strict=True)]
    data = of_pieces(cube(seed=3, count=60), pieces, tuple(paper), 0).dataset
    fitted = estimate(build(Scene(data), FULL), robust=False)
    by = validation_errors(fitted).distances.by_certificates
    np.testing.assert_allclose(by @ by.T, np.outer(u, u) * [[1.0, shared], [shared, 1.0]], atol=1e-18)
    draws = gaussian(fitted, 0, 4000)
    drawn = [d.predicted for d in validate(fitted, draws.flat, draws.kappa).distances]
    assert np.corrcoef(drawn)[0, 1] == pytest.approx(shared, abs=0.06)


def test_a_slipped_row_has_no_part_in_where_its_sphere_is(fitted):
    """Nor in its uncertainty: its residual moves nothing, the others do."""
    data = fitted.model.scene.dataset
    name = data.targets[-1].name
    rows = np.flatnonzero(data.measurements.target == len(data.targets) - 1)
    scene = Scene(misread(data, 2, 3e-3, rows[3]))
    t = prepared(replace(fitted, model=replace(fitted.model, scene=scene))).located[name]
    assert np.flatnonzero(~t.gain.any(axis=0)).tolist() == [3]


def test_poses_elsewhere_are_approached_from_either_side(cube):
    """What a play contributes to a distance would cancel between poses approached from one side."""
    model = build(Scene(cube(seed=3, count=40).dataset), ("geometry", "backlash"))
    readings = model.scene.dataset.measurements.readings[:4]
    motion = elsewhere(model, np.arange(4), readings)
    play = [t.driver for k, t in motion.terms if model.names[k].startswith("backlash")]
    assert np.abs(np.diff(np.sign(play), axis=1)).tolist() == [[2, 2, 2]] * 5
