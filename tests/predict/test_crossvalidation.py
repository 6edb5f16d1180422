"""What an estimate leaves on rows that did not fit: predictions against draws, closed form against refits."""

from dataclasses import replace

import numpy as np
import pytest
from kind_sessions import of_pieces, sphere
from sessions import with_columns

from bayescal.dataset import Certificate
from bayescal.estimate import calibrated, estimate, solve
from bayescal.gap.outcome.magnitude import noise_floor
from bayescal.model import Scene, build
from bayescal.posterior import gaussian
from bayescal.predict.crossvalidation import BLOCKED, LEFT_OUT, VALIDATED, folds, validation_errors
from bayescal.predict.errors import kept
from bayescal.predict.targets import predicted_rows
from bayescal.predict.validation import validate

FULL = ("geometry", "compliance")
BALLS = {"ball.A@1": (0.45, -0.2, 0.2), "ball.B@1": (0.35, 0.2, 0.25)}


def with_spheres(session, held=0, seed=0):
    """The session with two spheres touched by the true arm, and its last contacts with faces, to validate."""
    pieces = [sphere(name, centre, [1e-4, 1e-4, 1e-4], count=14, held=14) for name, centre in BALLS.items()]
    length = float(np.linalg.norm(np.subtract(*BALLS.values())))
    paper = (Certificate("distance", tuple(BALLS), length, 1e-6),)
    paper += tuple(Certificate("diameter", (name,), u_distance=1e-6) for name in BALLS)
    data = of_pieces(session, pieces, paper, seed).dataset
    role, on_faces = data.measurements.role.copy(), np.flatnonzero(data.measurements.target < 4)
    role[on_faces[len(on_faces) - held :]] = "validate"
    return with_columns(data, role=role)


@pytest.fixture(scope="module")
def fitted(cube):
    return estimate(build(Scene(with_spheres(cube(seed=3, count=150), 30)), FULL))


def test_linear_predictions_agree_with_the_draws(fitted):
    h = validation_errors(fitted)
    assert (h.how, h.main) == (VALIDATED, "contact")
    draws = gaussian(fitted, 0, 4000)
    checked = validate(fitted, draws.flat, draws.kappa)
    for p in checked.planes:
        mine = h.target == p.target
        np.testing.assert_allclose(h.residual[mine], p.residuals, atol=1e-12)
        np.testing.assert_allclose(h.sd[mine], p.predicted.std(axis=0), rtol=0.08)
    assert [d.between for d in checked.distances] == list(h.distances.names)
    np.testing.assert_allclose(h.distances.error, [d.error for d in checked.distances], atol=1e-8)
    sd = [d.predicted.std() for d in checked.distances]
    np.testing.assert_allclose(h.distances.predicted_sd(), sd, rtol=0.05)


def test_predicted_sd_is_the_error_that_is_made(cube):
    """Over sessions with other noise and another arm each: distances and held-out contacts over their sd."""
    scores, contacts = [], []
    for seed in range(4):
        data = with_spheres(cube(seed=seed, count=110), 20, seed)
        h = validation_errors(estimate(build(Scene(data), FULL)))
        scores.append(h.distances.error / h.distances.predicted_sd())
        contacts.append(h.residual / h.sd)
    assert 0.4 < np.sqrt(np.mean(np.concatenate(scores) ** 2)) < 1.6
    assert np.sqrt(np.mean(np.concatenate(contacts) ** 2)) == pytest.approx(1.0, abs=0.15)


def refitted_without(found, dataset, rows):
    """The fit to the session of which some rows are only predicted, at the same noise scale."""
    role = dataset.measurements.role.copy()
    role[rows] = "validate"
    model = build(Scene(with_columns(dataset, role=role)), FULL)
    sigma, counts = {}, {}
    for b, old in zip(model.blocks, found.model.blocks, strict=True):
        keep = np.isin(old.rows, b.rows)
        sigma[b.target] = found.weights.sigma[b.target][np.tile(keep, old.kind.rows)]
        counts[b.target] = found.weights.row[b.target][keep]
    z, covariance, _ = solve(model, replace(found.weights, sigma=sigma, row=counts), found.z)
    return replace(found, model=model, z=z, covariance=covariance())


@pytest.mark.parametrize("maker", ["cube", "tracker"])
def test_leaving_out_is_refitting_without(maker, request):
    """At the same noise scale, since that is what the closed form holds fixed."""
    session = request.getfixturevalue(maker)(seed=1, count=60)
    found = estimate(build(Scene(session.dataset), FULL), robust=False)
    h = validation_errors(found)
    assert h.how == LEFT_OUT
    assert h.main == ("contact" if maker == "cube" else "point")
    for row in (0, 17, 41):
        again = refitted_without(found, session.dataset, row)
        block = again.model.block(int(session.dataset.measurements.target[row]), np.array([row]))
        # the pivot of a surface moves with its rows: only what a contact itself leaves can be compared
        expected = again.residuals(block)[:, 0]
        mine = h.rows == row
        scale = h.noise[mine]
        assert np.max(np.abs(h.residual[mine] - expected) / scale) < 0.05


@pytest.mark.parametrize("maker", ["cube", "tracker"])
def test_leaving_out_a_block_is_refitting_without_it(maker, request):
    """Residuals and their covariance, of the session of which one block is only predicted."""
    session = request.getfixturevalue(maker)(seed=1, count=60)
    found = estimate(build(Scene(session.dataset), FULL), robust=False)
    h = validation_errors(found, without=BLOCKED)
    assert h.how == BLOCKED
    fold = h.fold == 3
    rows = np.unique(h.rows[fold])
    assert 3 <= len(rows) <= 9
    again = refitted_without(found, session.dataset, rows)
    for t in np.unique(session.dataset.measurements.target[rows]):
        block = again.model.block(int(t), rows[session.dataset.measurements.target[rows] == t])
        new = predicted_rows(again, block)
        # the pivot of a surface moves with its rows: only what contacts leave can be compared
        mine = np.concatenate([np.flatnonzero(fold & (h.rows == r)) for r in block.rows])
        mine = mine.reshape(len(block.rows), -1).T.ravel()
        sd = np.sqrt(new.noise**2 + np.einsum("rd,de,re->r", new.by_z, again.covariance, new.by_z))
        assert np.max(np.abs(h.residual[mine] - new.residual) / h.sd[mine]) < 0.05
        np.testing.assert_allclose(h.sd[mine], sd, rtol=0.02)


def test_blocks_are_of_time_and_poses(tracker):
    """Ten stretches of every target; rows of one pose and residuals of one row are never apart."""
    d = tracker(seed=1, count=60).dataset
    readings = d.measurements.readings.copy()
    readings[40] = readings[3]
    m = replace(d.measurements, readings=readings, target=np.repeat([0, 1], [40, 20]))
    found = folds(m, np.tile(np.arange(60), 3)).reshape(3, 60)
    assert np.all(found == found[0])
    assert found[0, 3] == found[0, 40] == 0
    for own in (found[0, :40], found[0, 41:]):
        assert np.all(np.diff(own) >= 0)
        assert np.array_equal(np.unique(own), np.arange(10))


def test_a_rejected_contact_is_as_uncertain_as_a_new_one(cube):
    """It had no part in the fit: its noise, and the parameters' uncertainty where it is."""
    found = estimate(build(Scene(cube(seed=1, count=60).dataset), ("geometry",)), robust=False)
    block = found.model.blocks[0]
    weight = np.where(np.arange(len(block.rows)) == 2, 0.0, found.weights.row[block.name])
    weights = replace(found.weights, row={**found.weights.row, block.name: weight})
    z, covariance, _ = solve(found.model, weights, found.z)
    again = replace(found, weights=weights, z=z, covariance=covariance())
    new = predicted_rows(again, block)
    spread = np.einsum("rd,de,re->r", new.by_z, again.covariance, new.by_z)[2]
    h = validation_errors(again)
    assert h.sd[h.rows == block.rows[2]][0] == pytest.approx(np.sqrt(new.noise[2] ** 2 + spread), rel=1e-6)


def test_a_slip_is_gross_but_a_common_error_is_none(fitted):
    h = validation_errors(fitted)
    slipped = h.residual.copy()
    slipped[3] += 40 * h.sd[3]
    one = replace(h, residual=slipped)
    assert one.gross.sum() == 1
    assert not kept(one, one)[3]
    assert kept(h, one)[3] or h.gross[3]  # gross under one model only: it stays
    assert not replace(h, residual=h.residual + 40 * h.sd).gross.any()
    gathered = h.residual.copy()
    gathered[h.target == h.target[0]] += 40 * h.sd[0]
    assert not replace(h, residual=gathered).gross[h.target == h.target[0]].any()


@pytest.mark.parametrize("share", [0.3, 0.4])
def test_errors_of_a_third_of_the_measurements_are_no_slips(fitted, share):
    h = validation_errors(fitted)
    off = np.arange(len(h.residual)) < share * len(h.residual)
    spread = np.random.default_rng(0).permutation(off)
    assert not replace(h, residual=h.residual + np.where(spread, 40.0 * h.sd, 0.0)).gross[spread].any()


def test_noise_far_above_the_stated_is_no_noise(cube):
    """Without repeats a fit that leaves three times the stated noise leaves a gap."""
    found = estimate(build(Scene(cube(seed=2, noise=15e-6, stated=5e-6).dataset), FULL))
    floor = noise_floor(found, "contact")
    assert (floor.source, floor.sd) == ("stated", pytest.approx(5e-6))
    found = estimate(build(Scene(cube(seed=2, noise=6e-6, stated=5e-6).dataset), FULL))
    assert noise_floor(found, "contact").source == "fit"


def test_repeats_tell_the_noise(cube):
    d = cube(seed=4, count=500, noise=6e-6, stated=3e-6).dataset
    found = estimate(build(Scene(d), FULL))
    repeat = np.array([f"r{k // 4}" if k < 240 else "" for k in range(500)])
    again = replace(found, model=build(Scene(with_columns(d, repeat=repeat)), FULL))
    floor = noise_floor(again, "contact")
    assert floor.source == "repeats"
    assert floor.interval95[0] < 6e-6 < floor.interval95[1]
    # repeats between which something changed scatter more than all residuals: these tell the noise
    less = {"contact": again.weights.scale["contact"] / 2}
    assert noise_floor(replace(again, weights=replace(again.weights, scale=less)), "contact").source == "fit"


def test_rows_that_locate_their_target_scatter_as_predicted(tracker):
    """Four points of an instrument at another place, where it is not fitted, take up half of their noise."""
    session = tracker(1, 64)
    m, late = session.dataset.measurements, np.arange(64) >= 60
    (first, *_) = session.dataset.targets
    dataset = replace(session.dataset, targets=(first, replace(first, name="second")))
    dataset = with_columns(dataset, target=late.astype(int), role=np.where(late, "validate", "calibrate"))
    found, drawn = calibrated(Scene(dataset), ("geometry", "compliance")), []
    true = (session.arm.points(m.readings, m.payload) - session.frame[:3, 3]) @ session.frame[:3, :3]
    for seed in range(40):
        read = true + 10e-6 * np.random.default_rng(seed).standard_normal(true.shape)
        xyz = np.where(late[:, None], read, m.xyz)
        again = Scene(replace(dataset, measurements=replace(dataset.measurements, xyz=xyz)))
        held = validation_errors(replace(found, model=replace(found.model, scene=again)))
        own = held.target == "second"
        drawn.append(held.residual[own])
    noise = held.noise[own] / found.weights.scale["point"]
    assert np.mean(np.var(drawn, axis=0)) == pytest.approx(np.mean(noise**2), rel=0.15)
    assert np.mean(noise**2) < 0.75 * 10e-6**2
