"""Noise, fits and evidence against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from bayescal.logs.read import read_log
from bayescal.motion import signals
from bayescal.motion.effects import Form
from bayescal.motion.linear import Further, Normal, fitted, gains
from bayescal.motion.noise import Noise, noise_of
from bayescal.motion.quantities import UNKNOWN
from bayescal.motion.search import Hypothesis, Member, Search
from bayescal.motion.settings import SEARCH, SIGNALS
from bayescal.motion.signals import Bands, derivative, low_passed, signals_of
from bayescal.motion.terms import Term
from bayescal.motion.together import _moved


def problem(seed=0, rows=40, size=6):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(rows, size)), rng.normal(size=rows)
    terms = tuple(Term(f"t{k}", "1", 1.0) for k in range(size))
    return x, y, Normal(terms, x.T @ x, x.T @ y, np.array([y @ y]))


def log_evidence(x, y):
    return multivariate_normal(np.zeros(len(y)), np.eye(len(y)) + x @ x.T).logpdf(y)


def test_a_fit_is_the_posterior_mean():
    x, y, p = problem()
    f = fitted(p, [0, 2, 3], np.array([1.0, 0.5, 2.0]))
    wide = x[:, [0, 2, 3]] * [1.0, 0.5, 2.0]
    covariance = np.linalg.inv(wide.T @ wide + np.eye(3))
    assert f.covariance == pytest.approx(covariance)
    assert list(f.values.values()) == pytest.approx(covariance @ wide.T @ y * [1.0, 0.5, 2.0])
    assert list(f.u.values()) == pytest.approx(np.sqrt(np.diag(covariance)) * [1.0, 0.5, 2.0])
    left = y - wide @ (covariance @ wide.T @ y)
    assert f.chi2() == pytest.approx(left @ left)


def test_a_fit_with_another_measurement_is_that_of_the_rows_of_both():
    """Information and score of the other are in SI, whatever the units of the terms."""
    (x, y, p), size = problem(2, rows=60), 6
    sd = 10.0 ** np.linspace(-3.0, 2.0, size)
    terms = tuple(Term(t.name, "1", s) for t, s in zip(p.terms, sd, strict=True))
    own, other = slice(0, 35), slice(35, 60)
    chosen = [4, 1, 2]  # that the other tells of, in its order
    y[other] -= x[other] @ np.where(np.isin(np.arange(size), chosen), 0.0, 1.0)
    x[np.ix_(np.arange(35, 60), np.setdiff1d(np.arange(size), chosen))] = 0.0
    per = x[other] / sd  # by values in SI
    information, score = (per.T @ per)[np.ix_(chosen, chosen)], (per.T @ y[other])[chosen]
    alone = Normal(terms, x[own].T @ x[own], x[own].T @ y[own], np.array([y[own] @ y[own]]))
    both = Further(tuple(terms[k].name for k in chosen), information, score).beside(alone)
    assert both.gram == pytest.approx(x.T @ x)
    assert both.score == pytest.approx(x.T @ y)


def test_the_change_by_another_measurement_is_compared_with_what_it_may_be():
    """Its covariance is that before less that after; directions of which it tells nothing do not count."""
    _, _, p = problem(3)
    names = ("t1", "t3", "t4")
    root = 30.0 * np.random.default_rng(4).normal(size=(3, 3))
    for told in (root, root * [[1.0, 0.0, 1.0]] * [1.0, 0.0, 1.0]):
        further = Further(names, told @ told.T, np.array([3.0, -2.0, 1.0]) @ told.T)
        alone, both = (fitted(q, range(6)) for q in (p, further.beside(p)))
        at = np.ix_([1, 3, 4], [1, 3, 4])
        change = (both.vector - alone.vector)[[1, 3, 4]]
        spread = alone.covariance[at] - both.covariance[at]
        values = np.linalg.eigvalsh(spread)
        chi2, dof = _moved(alone, both, names)
        assert dof == np.sum(values > 1e-9 * values[-1])
        assert chi2 == pytest.approx(change @ np.linalg.pinv(spread, rcond=1e-9) @ change)


def test_gains_are_ratios_of_evidences():
    x, y, p = problem(1)
    base = fitted(p, [0, 1])
    scales, sets = np.array([0.5, 2.0]), [np.array([2]), np.array([3, 4]), np.array([5])]
    table, trace = gains(base, sets, scales)
    for i, chosen in enumerate(sets):
        for k, scale in enumerate(scales):
            wide = np.column_stack([x[:, :2], scale * x[:, chosen]])
            assert table[i, k] == pytest.approx(log_evidence(wide, y) - log_evidence(x[:, :2], y))
    more, gained = fitted(p, [0, 1, 2]), log_evidence(x[:, :3], y) - log_evidence(x[:, :2], y)
    assert more.log_evidence - base.log_evidence == pytest.approx(gained)
    within = np.linalg.inv(np.eye(40) + x[:, :2] @ x[:, :2].T)
    assert trace[0] == pytest.approx(x[:, 2] @ within @ x[:, 2])


def lagged(white, keep=0.8):
    """Noise of the first order."""
    return lfilter([1.0], [1.0, -keep], white, axis=0)


def test_noise_is_whitened():
    rng = np.random.default_rng(0)
    parts = [lagged(rng.normal(size=(3000, 2))) * [1.0, 5.0] for _ in range(3)]
    noise = noise_of(parts)
    assert noise.lag1 == pytest.approx(0.8, abs=0.03)
    assert noise.sd[1] / noise.sd[0] == pytest.approx(5.0, rel=0.1)
    white = noise.whitened(parts[0][:, 1], 1)
    assert np.corrcoef(white[1:], white[:-1])[0, 1] == pytest.approx(0.0, abs=0.05)
    assert 0.8 < white.std() <= 1.01  # 1 % of white noise is added to the model


def slow_noise(seed: int, rows: int, count: int = 3) -> list[np.ndarray]:
    """Motions (rows, 1) of first-order noise of variance 1 with a time constant of ten rows."""
    rng, keep = np.random.default_rng(seed), np.exp(-0.1)
    white = np.sqrt(1.0 - keep**2) * rng.normal(size=(count, rows + 200, 1))
    return list(lfilter([1.0], [1.0, -keep], white, axis=1)[:, 200:])


def density(noise: Noise) -> float:
    """Of the noise at frequency 0, over that of white noise of variance 1."""
    return float(np.sum(noise.filters[0]) ** -2.0)


def test_missing_rows_leave_the_likelihood_of_the_others():
    """As the covariance of the rows that are there says; of all rows it follows from the whitening itself."""
    rng = np.random.default_rng(1)
    parts = [lagged(rng.standard_normal((400, 1))) for _ in range(5)]
    noise, x = noise_of(parts), rng.standard_normal((60, 3))
    every = noise.whitened(np.eye(60), 0)
    covariance = np.linalg.inv(every.T @ every)
    missing = np.r_[0, 1, 5, 20:35, 59]
    there = np.setdiff1d(np.arange(60), missing)
    white = noise.without(noise.whitened(x, 0), missing, 0)
    expected = x[there].T @ np.linalg.solve(covariance[np.ix_(there, there)], x[there])
    assert white.T @ white == pytest.approx(expected)


def test_noise_of_rows_that_are_there_is_that_of_all():
    """Rows of weight 0 are no small residuals."""
    rng = np.random.default_rng(2)
    parts = [lagged(rng.standard_normal((2000, 1))) for _ in range(5)]
    weights = [np.repeat(rng.random((40, 1)) < 0.6, 50, axis=0).astype(float) for _ in parts]
    found = noise_of([w * x for w, x in zip(weights, parts, strict=True)], weights=weights)
    assert found.sd == pytest.approx(noise_of(parts).sd, rel=0.05)
    assert found.lag1 == pytest.approx(noise_of(parts).lag1, abs=0.02)


def test_what_a_fit_follows_of_slow_noise_is_added():
    # 12 waves of the time follow much of slow noise: by degrees of freedom alone it would seem far less
    rows, true = 250, (1.0 + np.exp(-0.1)) / (1.0 - np.exp(-0.1))
    x = np.cos(np.pi * np.linspace(0.0, 1.0, rows)[:, None] * np.arange(1, 13))
    keep = np.exp(-0.1 * np.abs(np.subtract.outer(np.arange(rows), np.arange(rows))))
    information = np.linalg.inv(keep)
    covariance = np.linalg.inv(3.0 * x.T @ information @ x)
    found, without = [], []
    for seed in range(20):
        parts = slow_noise(seed, rows)
        b = covariance @ x.T @ information @ sum(parts)
        left = [r - x @ b for r in parts]
        followed = [[x @ np.linalg.cholesky(covariance)]] * 3
        found.append(density(noise_of(left, followed)))
        without.append(density(noise_of(left)))
    assert np.mean(found) == pytest.approx(true, rel=0.15)
    assert np.mean(without) < 0.8 * np.mean(found)


def test_the_mean_of_a_motion_is_no_noise_but_has_its_share_of_it():
    true = (1.0 + np.exp(-0.1)) / (1.0 - np.exp(-0.1))
    sets = [slow_noise(seed, 200) for seed in range(30)]
    found = [density(noise_of(parts)) for parts in sets]
    assert np.mean(found) == pytest.approx(true, rel=0.15)
    moved = [density(noise_of([r + 5.0 * k for k, r in enumerate(parts)])) for parts in sets]
    assert moved == pytest.approx(found)


def test_a_motion_of_few_rows_adds_to_the_noise_what_it_has():
    parts = slow_noise(0, 300)
    noise = noise_of([*parts, parts[0][:5]])
    assert noise.sd == pytest.approx(noise_of(parts).sd, rel=0.02)
    # its first rows are whitened by the covariance of them alone
    assert noise.whitened(parts[0][:5, 0], 0) == pytest.approx(noise.whitened(parts[0][:, 0], 0)[:5])


def test_noise_of_positions_is_seen_beside_their_motion():
    t = np.arange(4000.0)[:, None] / 200.0
    noise = np.random.default_rng(0).normal(size=(len(t), 2)) * [1e-5, 3e-4]
    assert signals.white(np.sin(2.0 * t) + noise) == pytest.approx([1e-5, 3e-4], rel=0.1)


def test_steps_of_an_encoder_are_noise_though_the_joint_rests_for_most_of_a_motion():
    t, steps = np.arange(0.0, 20.0, 0.01), np.deg2rad([0.01, 0.005])
    true = 0.4 * (1.0 - np.cos(0.5 * np.pi * np.clip(t - 2.0, 0.0, 2.0)))
    read = np.round(true[:, None] / steps) * steps
    read[::2] += 1e-12  # the same value with other digits
    assert np.all(signals.white(read) < 1e-9)
    assert signals.rounded(read) == pytest.approx(steps / np.sqrt(12.0))
    assert signals.rounded(np.zeros((5, 2))).tolist() == [0.0, 0.0]
    assert signals.noise_of_positions(read, signals.rounded(read)) == pytest.approx(steps / np.sqrt(12.0))
    noisy = read + 1e-3 * np.random.default_rng(0).normal(size=read.shape)
    assert signals.noise_of_positions(noisy, signals.rounded(read)) == pytest.approx([1e-3, 1e-3], rel=0.1)


def test_the_band_is_that_in_which_the_noise_of_accelerations_is_small(null_log):
    """Noise of torques by that of positions, against its definition; beside it, that of torques."""
    log, rng, sd = read_log(null_log).divided, np.random.default_rng(0), 3e-4
    none = {"mass": np.zeros(3), "inertia": np.zeros((3, 3, 3))}
    rotors = replace(log.mechanism, **none, armature=np.array([1.0, 2.0, 0.0]))
    motions = [replace(m, position=m.position + sd * rng.normal(size=m.position.shape)) for m in log.motions]
    coarse = replace(log, motions=tuple(motions), mechanism=rotors)
    bands = Bands.of(coarse)
    assert (bands.rows, bands.wide, bands.reversing) == (SIGNALS.band, SIGNALS.wide, SIGNALS.wide)

    def added(rows):
        errors = [x.position - m.position for x, m in zip(motions, log.motions, strict=True)]
        dt = float(np.median(np.diff(log.motions[0].time)))
        accelerations = [derivative(derivative(low_passed(x, dt, rows), dt), dt)[20:-20] for x in errors]
        return np.std(np.concatenate(accelerations), axis=0) * [1.0, 2.0, 0.0]

    for rows in (SIGNALS.band, 5.0):
        assert replace(bands, rows=rows).accelerations(coarse) == pytest.approx(added(rows), rel=0.1)
    torques = bands.accelerations(coarse)
    equal, resting = torques + np.array([0.0, torques[1], 0.0]), np.array([0.0, 2.0 * torques[1], 1.0])
    assert bands.share(coarse, equal) == pytest.approx(1.0)
    assert bands.share(coarse, resting) == pytest.approx(0.5)
    assert bands.narrower(3.0 * SIGNALS.small).rows == pytest.approx(SIGNALS.band * 3.0**-0.4)
    assert bands.narrower(1.01 * SIGNALS.small).rows == pytest.approx(SIGNALS.band * SIGNALS.step)
    assert bands.narrower(100.0).rows == SIGNALS.narrow


def test_friction_reverses_when_the_joint_does(null_log):
    """A smoothed speed reverses too early where a joint leaves a reversal faster than it came."""
    log, rng, dt = read_log(null_log).divided, np.random.default_rng(0), 0.005
    fine = np.arange(0.0, 20.0, dt / 20.0)
    phase = (fine % 2.0) - 1.0  # slowly to rest at 0, then away four times as fast
    speed = 0.2 * np.where(phase < 0.0, phase, 4.0 * phase * np.exp(-8.0 * phase)) * (-1.0) ** (fine // 2.0)
    angle = np.cumsum(speed) * dt / 20.0
    friction = np.tanh(speed[::20] / 0.02)[:, None] * np.ones(3)
    position, time = angle[::20, None] * np.ones(3), fine[::20]
    motion = replace(
        log.motions[0], time=time, position=position, velocity=None, torque=friction, payload=0 * time
    )

    def early(bands):
        s = signals_of(log, motion, 0.0, 0.0, bands)
        off, rate = s.kept(s.torque - np.tanh(s.turning / 0.02)), s.kept(-derivative(s.torque, s.step))
        return float(off[:, 0] @ rate[:, 0] / (rate[:, 0] @ rate[:, 0]))

    noise = rng.normal(size=position.shape)
    read = [replace(log, motions=(replace(motion, position=position + sd * noise),)) for sd in (1e-7, 1e-4)]
    exact, noisy = map(Bands.of, read)
    assert (exact.reversing, noisy.reversing) == (40.0, 20.0)
    assert early(noisy) > 1e-3
    assert 0.0 < early(exact) < 0.3 * early(noisy)


def test_a_joint_at_rest_has_no_direction():
    # its noise is that of its positions; a reversal on the way, and slow motion, are motion
    rng, t = np.random.default_rng(0), np.arange(0.0, 12.0, 0.008)
    angle = np.where(t < 6.0, 0.3 * (1.0 - np.cos(np.pi * t)), 0.0)  # two turns back, then rest
    true = np.column_stack([angle, 0.02 * t])
    q = low_passed(true + 2e-5 * rng.standard_normal(true.shape), 0.008, SIGNALS.band)
    slope = derivative(signals.impulse(len(q), 0.008, SIGNALS.band), 0.008)
    noise = 2e-5 * np.linalg.norm(slope) * np.ones(2)
    speeds, at = derivative(q, 0.008), (t > 1.0) & (t < 11.0)
    error = speeds - np.column_stack([0.3 * np.pi * np.sin(np.pi * t) * (t < 6.0), np.full(len(t), 0.02)])
    away = at & (np.abs(t - 6.0) > 0.5)
    assert np.std(error[away], axis=0) == pytest.approx(noise, rel=0.2)
    share = signals.moving(speeds, noise, 0.008)
    assert np.mean(share[at & (t > 6.2), 0]) < 0.02
    assert np.all(share[at & (t < 5.9), 0] == 1.0)
    assert np.all(share[at, 1] == 1.0)


def test_names_are_searched_on_where_a_general_function_leads():
    # two effects; alone each explains less than a general function, which has most of both
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(400, 3)), rng.normal(size=400)
    y += x[:, 0] + x[:, 1]
    x[:, 2] = x[:, 0] + x[:, 1] + 0.5 * x[:, 2]
    terms = tuple(Term(name, "1", 1.0) for name in ("stribeck", "ripple", UNKNOWN))
    p = Normal(terms, x.T @ x, x.T @ y, np.array([y @ y]))
    forms = tuple((Form(t.name, "joint 1", "speed"), (t.name,)) for t in terms)
    hypotheses = Search(p, forms, (), {}).run()
    alone = {h.names: h.score for h in hypotheses if len(h.members) == 1}
    assert alone[UNKNOWN,] > max(alone["stribeck",], alone["ripple",]) + 20.0
    assert set(hypotheses[0].names) == {"stribeck", "ripple"}


def test_a_further_effect_must_exceed_what_may_belong_to_names_of_its_own_channels_only():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(400, 3)), rng.normal(size=400)
    x[:200, 1:] = x[200:, 0] = 0.0  # rows of two channels
    y += 200.0 * x[:, 0] + 0.45 * x[:, 1]
    sd = np.array([100.0, 1.0, 1.0])
    terms = tuple(Term(name, "1", s) for name, s in zip(("elasticity", "ripple", "delay"), sd, strict=True))
    chi2 = np.array([y[:200] @ y[:200], y[200:] @ y[200:]])
    p = Normal(terms, (x.T @ x) * np.outer(sd, sd), (x.T @ y) * sd, chi2)
    forms = tuple((Form(t.name, "joint 1", "speed"), (t.name,)) for t in terms)
    acting = {"elasticity": frozenset((0,)), "ripple": frozenset((1,)), "delay": frozenset((0, 1))}
    search, shared = Search(p, forms, (), {}, acting=acting), Search(p, forms, (), {})
    assert set(search.run()[0].names) == {"elasticity", "ripple"}
    assert set(shared.run()[0].names) == {"elasticity"}
    first = next(h for h in search.run() if h.names == ("elasticity",))
    least = search.of_form(first)
    assert least(acting["ripple"]) == 0.0
    assert least(acting["delay"]) == pytest.approx(SEARCH.form * first.log_evidence)
    both = Hypothesis((*first.members, Member(forms[1][0], 1.0)), first.log_evidence, 0.0)
    gained = search.fit(both.members).log_evidence - search.fit(first.members).log_evidence
    whole = search.fit(both.members).log_evidence - search.fit().log_evidence
    share = gained / whole  # of what both explain
    assert search.of_form(both)(frozenset((1,))) == pytest.approx(SEARCH.form * share * first.log_evidence)
