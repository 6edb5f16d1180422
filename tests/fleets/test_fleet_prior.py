"""The distribution of parameters over arms, and what a session tells without its prior: closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from bayescal.effects import UNITS, Parameter
from bayescal.effects.location import TOOL, joint
from bayescal.estimate.moments import shifts
from bayescal.fleets import SPREAD, Arms, learn, left_out, log_score, widened
from bayescal.fleets.compare import Likelihood, Member, likelihood_of, models_of, priors
from bayescal.reporting.fleet import _effects, with_gap

K = 5
PARAMETERS = tuple(
    Parameter(f"theta{k + 2}", "rad", (), 2e-3, site=joint(k + 2), effect="geometry") for k in range(K)
)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def rows(rng, count=40, size=3.0):
    """Whitened rows (R, K) of a session; two parameters are nearly known by their sum alone."""
    out = size * rng.standard_normal((count, K))
    out[:, 1] = out[:, 0] + 0.02 * rng.standard_normal(count)
    return out


def told(rng, t, by=None):
    """Information and score of an arm with the parameters t, and its rows and residuals."""
    by = rows(rng) if by is None else by
    y = by @ t + rng.standard_normal(len(by))
    return by.T @ by, by.T @ y, by, y


def fleet_of(rng, count, mean, sd):
    every = [told(rng, mean + sd * rng.standard_normal(K)) for _ in range(count)]
    return Arms(np.array([e[0] for e in every]), np.array([e[1] for e in every]))


def test_many_arms_that_are_known_give_their_mean_and_scale(rng):
    mean, sd = np.array([1.0, -2.0, 0.5, 0.0, 3.0]), np.array([0.1, 0.3, 1.0, 0.2, 0.5])
    t = mean + sd * rng.standard_normal((400, K))
    t[0, 2] += 50.0
    found = learn(Arms(np.tile(1e8 * np.eye(K), (400, 1, 1)), 1e8 * t))
    assert found.mean == pytest.approx(mean, abs=4 * np.max(sd) / 20)
    assert found.scale == pytest.approx(sd, rel=0.15)  # the one far away does not widen it
    assert found.spread[2] == pytest.approx(np.std(t[:, 2], ddof=1), rel=0.02)  # but is within the spread
    assert found.spread[2] > 2.0 * sd[2]
    assert found.dof == pytest.approx(np.full(K, 400.0), rel=0.2)
    assert found.u_mean[[0, 4]] == pytest.approx(sd[[0, 4]] / 20.0, rel=0.2)


def test_the_spread_of_few_arms_is_that_of_their_model():
    """In the mean over fleets of four arms that are known; the scale is a most probable one."""
    square = []
    for seed in range(40):
        t = 0.5 * np.random.default_rng(seed).standard_normal((4, K))
        square.append(learn(Arms(np.tile(1e6 * np.eye(K), (4, 1, 1)), 1e6 * t)).spread ** 2)
    assert np.mean(square) == pytest.approx(0.25, rel=0.15)


def test_few_arms_that_tell_nothing_keep_the_stated_prior():
    found = learn(Arms(np.tile(1e-8 * np.eye(K), (3, 1, 1)), np.zeros((3, K))))
    assert found.mean == pytest.approx(np.zeros(K), abs=1e-6)
    assert found.scale**2 * np.exp(2 * SPREAD**2) + found.u_mean**2 == pytest.approx(np.ones(K), rel=0.03)
    assert np.all((found.sd > 0.9) & (found.sd < 1.3))


def test_log_score_is_the_density_of_the_data(rng):
    information, score, by, y = told(rng, rng.standard_normal(K))
    a, b = (rng.standard_normal(K), np.full(K, 0.5)), (np.zeros(K), np.ones(K))
    direct = [multivariate_normal(by @ m, (by * s**2) @ by.T + np.eye(len(y))).logpdf(y) for m, s in (a, b)]
    computed = [log_score(information, score, m, s) for m, s in (a, b)]
    assert computed[0] - computed[1] == pytest.approx(direct[0] - direct[1], rel=1e-8)


def test_a_shift_is_that_of_generalised_least_squares(rng):
    mean, sd = rng.standard_normal(K), np.exp(rng.standard_normal(K))
    information, score, by, y = told(rng, mean + np.array([0, 0, 0, 6.0, 0]))
    first, second = shifts(information, score, mean, np.diag(sd**2), 2)
    weight = np.linalg.inv((by * sd**2) @ by.T + np.eye(len(y)))
    for found, free in ((first, [first.index]), (second, [first.index, second.index])):
        covariance = np.linalg.inv(by[:, free].T @ weight @ by[:, free])
        value = covariance @ by[:, free].T @ weight @ (y - by @ mean)
        assert found.value == pytest.approx(value[-1], rel=1e-6)
        assert found.u == pytest.approx(np.sqrt(covariance[-1, -1]), rel=1e-6)
        assert found.ratio == pytest.approx(found.value / found.u)


def test_arms_left_out_score_better_and_one_unlike_them_widens_its_parameter(rng):
    mean, sd = np.array([2.0, -1.0, 1.0, -2.0, 0.0]), np.full(K, 0.2)
    arms = fleet_of(rng, 10, mean, sd)
    every = learn(arms)
    others, gains = left_out(arms, every)
    assert np.all(gains > 0)
    by_hand = learn(arms.without([3]))
    assert others[3].mean == pytest.approx(by_hand.mean, abs=0.02)
    assert others[3].sd == pytest.approx(by_hand.sd, rel=0.05)
    one = told(rng, mean + np.array([0, 0, 4.0, 0, 0]))
    more = Arms(np.append(arms.information, [one[0]], axis=0), np.append(arms.score, [one[1]], axis=0))
    with_it = learn(more)
    assert with_it.sd[2] > 2.5 * every.sd[2]  # a prior that includes the arm
    assert with_it.scale[2] < 2.0 * every.scale[2]  # beside usual arms it is an outlier
    others, gains = left_out(more, with_it)
    assert gains[-1] < -20.0
    usual = np.arange(11) < 10
    assert 1.0 <= widened(more, others, with_it, usual).factor < 1.3
    wide = widened(more, others, with_it, ~usual)
    assert wide.factor > 3.0  # the arm would widen all parameters
    assert wide.sd == pytest.approx(wide.factor * with_it.sd)


def test_a_distribution_that_is_too_narrow_is_widened(rng):
    arms = fleet_of(rng, 10, np.zeros(K), np.full(K, 0.5))
    narrow = [replace(of, spread=of.spread / 4, scale=of.scale / 4) for of in left_out(arms, learn(arms))[0]]
    assert widened(arms, narrow, narrow[0], np.ones(10, bool)).factor == pytest.approx(3.5, abs=1.2)


def member(rng, arm, t, session=""):
    information, score, *_ = told(rng, t)
    return Member(session or arm, arm, "robot", Likelihood(PARAMETERS, information, score))


def test_equal_arms_seldom_differ_and_one_that_differs_is_found():
    mean, sd, fleets, false, right = np.array([1.0, -1.0, 0.5, 2.0, 0.0]), 0.3, 24, 0, 0
    for seed in range(fleets):
        rng = np.random.default_rng(seed)
        t = mean + sd * rng.standard_normal((6, K))
        equal = [member(rng, f"arm {k}", t[k]) for k in range(6)]
        (plain,) = models_of(equal)
        false += any(d.stated for d in plain.unlike)
        odd = member(rng, "arm 3", t[3] + np.array([0, 0, 0, 5.0, 0]))
        (found,) = models_of([*equal[:3], odd, *equal[4:]])
        right += ("arm 3", "theta5") in [(d.arm, d.parameter.name) for d in found.unlike if d.stated]
    assert false <= 4  # 1.2 of 24 are expected at most; more than 4 have a probability below 0.01
    assert right >= 0.9 * fleets


def test_an_arm_that_changed_is_told_and_counts_as_it_is_now(rng):
    t = np.tile(np.array([1.0, -1.0, 0.5, 2.0, 0.0]), (4, 1)) + 0.3 * rng.standard_normal((4, K))
    moved = np.array([0, 0, 0, 0, 0.7])
    sessions = [member(rng, f"arm {k}", t[k]) for k in range(4)]
    sessions += [member(rng, "arm 0", t[0], "again"), member(rng, "arm 1", t[1] + moved, "later")]
    (found,) = models_of(sessions)
    stated = [(d.arm, d.since, d.parameter.name) for d in found.changed if d.stated]
    assert stated == [("arm 1", "later", "theta6")]
    (change,) = (d for d in found.changed if d.stated)
    assert change.value == pytest.approx(0.7 * 2e-3, abs=4 * change.u)
    assert found.pairs == 2 * K
    (now,) = models_of([*sessions[2:5], sessions[0], replace(sessions[5], session="arm 1")])
    assert [p.mean for p in priors(found)] == pytest.approx([p.mean for p in priors(now)], rel=1e-3, abs=1e-6)


def test_p_is_two_sided_and_of_all_comparisons(rng):
    """Of a change by the normal distribution of its ratio, of an outlier with heavier tails than that."""
    t = 0.3 * rng.standard_normal((5, K)) + 2.0 * np.eye(5)
    again = [member(rng, f"arm {k}", t[k] + 0.1 * rng.standard_normal(K), "again") for k in range(5)]
    (found,) = models_of([*(member(rng, f"arm {k}", t[k]) for k in range(5)), *again])
    assert len(found.changed) >= 5
    for d in found.changed:
        assert d.p == pytest.approx(2.0 * norm.sf(abs(d.value / d.u)), rel=1e-6)
        assert d.p_all == pytest.approx(min(1.0, found.pairs * d.p), rel=1e-6)
    for d in found.unlike:
        assert d.p > 2.0 * norm.sf(abs(d.value / d.u))
        assert d.p_all == pytest.approx(min(1.0, found.comparisons * d.p), rel=1e-6)


def test_the_learnt_prior_is_of_deviations_from_nominal(rng):
    """With another stated mean, what was learnt moves by as much, and nothing else."""
    members = [member(rng, f"arm {k}", rng.standard_normal(K)) for k in range(4)]
    off = 1e-3 * np.arange(1.0, K + 1)
    moved = tuple(replace(p, nominal=0.2, mean=0.2 + x) for p, x in zip(PARAMETERS, off, strict=True))
    others = [replace(m, likelihood=replace(m.likelihood, parameters=moved)) for m in members]
    for p, q, x in zip(*(priors(models_of(some)[0]) for some in (members, others)), off, strict=True):
        assert (q.mean, q.u_mean, q.usual, q.sd) == pytest.approx((p.mean + x, p.u_mean, p.usual, p.sd))


def test_two_arms_or_other_nominal_values_are_no_fleet(rng):
    one, other = member(rng, "a", np.zeros(K)), member(rng, "b", np.zeros(K))
    (model,) = models_of([one, other])
    assert model.learnt is None
    assert priors(model) == ()
    p, *rest = other.likelihood.parameters
    moved = replace(other.likelihood, parameters=(replace(p, nominal=1e-3, mean=None), *rest))
    assert len(models_of([one, replace(other, likelihood=moved)])) == 2


def test_the_likelihood_is_that_of_the_rows_whatever_prior_the_fit_had(rng):
    """Errors of the rows have another covariance than the solver assumed; a tool is integrated out."""
    by, covariance = rng.standard_normal((30, 3)) * 4.0, np.diag(rng.uniform(0.5, 3.0, 30))
    sd, mean = np.array([4e-3, 4e-3, 5e-3]), np.array([1e-3, 0.0, 0.0])
    y = rng.standard_normal(30) * 3.0
    solved = np.linalg.inv(by.T @ by + np.eye(3))
    z = solved @ by.T @ y
    stated = solved @ by.T @ covariance @ by @ solved + solved @ solved
    names = [("theta2", "rad", joint(2)), ("theta3", "rad", joint(3)), ("ball x", "m", TOOL)]
    parameters = [
        {"name": name, "effect": "geometry" if "theta" in name else "tool", "site": str(site), "nominal": 0.0,
         "unit": UNITS[unit][0], "value": (mean[k] + sd[k] * z[k]) * UNITS[unit][1],
         "prior_mean": mean[k] * UNITS[unit][1], "prior_sd": sd[k] * UNITS[unit][1]}
        for k, (name, unit, site) in enumerate(names)
    ]  # fmt: skip
    record = {"prior_width": 1.0, "prior_widths": {"geometry angles of joints": 2.0}}
    record["parameters"] = parameters
    of = {"covariance_si": stated, "solver_covariance_si": solved}
    record |= {key: (value * np.outer(sd, sd)).tolist() for key, value in of.items()}
    found = likelihood_of(record, ["geometry"])
    # by hand: B'y has the covariance B'SB, and the tool (with its prior) adds to it
    spread = by.T @ covariance @ by
    full = np.linalg.inv(np.linalg.inv(by.T @ by) @ spread @ np.linalg.inv(by.T @ by))
    score = full @ np.linalg.solve(by.T @ by, by.T @ y)
    kept = full[:2, :2] - np.outer(full[:2, 2], full[2, :2]) / (full[2, 2] + 1.0)
    pulled = score[:2] - full[:2, 2] * score[2] / (full[2, 2] + 1.0)
    assert [p.sd for p in found.parameters] == pytest.approx([2e-3, 2e-3])  # without the width of the data
    assert found.information == pytest.approx(kept / 4.0, rel=1e-6)
    assert found.score == pytest.approx(pulled / 2.0, rel=1e-6)


def test_effects_of_a_fleet_do_not_depend_on_the_order_of_its_sessions():
    """An arm counts once, by the session in which an effect is most probable."""

    def session(arm, p, value):
        named = [{"effect": "backlash", "site": "joint 3", "value": value, "unit": "urad"}] if value else []
        about = {"robot": "r", "gap": {"verdict": "named"}}
        return about | {"arm": arm, "probability": {"backlash": p}, "effects": named}

    sessions = [session("a", 0.9, 50.0), session("a", 0.2, None), session("b", 0.1, None)]
    sessions += [session("c", 0.95, 80.0), session("c", 0.99, 70.0)]
    for order in (sessions, sessions[::-1], [sessions[k] for k in (3, 1, 4, 0, 2)]):
        (found,) = _effects(order)
        assert set(found["arms"]) == {"a", "c"}
        assert (found["of"], found["values"]) == (3, [50.0, 80.0])
        assert found["expected_arms"] == pytest.approx(0.9 + 0.1 + 0.99)


@pytest.mark.parametrize(
    ("sites", "of_amplitudes", "wanted"),
    [
        (["joint 2"], ["joint 2"], ["joint 2"]), ([], ["joint 1", "joint 3"], ["joint 1", "joint 3"]),
        ([], [], [""]),
    ],
)  # fmt: skip
def test_an_effect_of_all_joints_is_one_of_the_session(sites, of_amplitudes, wanted, tmp_path):
    keys = ("value", "u", "unit", "what", "driver")
    amplitudes = [dict.fromkeys(keys) | {"effect": "backlash", "site": site} for site in of_amplitudes]
    record = {
        "schema": "bayescal-gap/1", "named": [{"effect": "backlash", "sites": sites, "probability": 0.99}],
        "amplitudes": amplitudes, "verdict": "named", "words": [], "probability": {}, "class": None,
    }  # fmt: skip
    (tmp_path / "gap.json").write_text(json.dumps(record))
    assert [e["site"] for e in with_gap({}, tmp_path)["effects"]] == wanted
