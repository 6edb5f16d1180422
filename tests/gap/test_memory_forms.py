"""Hysteresis with a memory and a coupling that levels off: forms written down without the effects."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_problems import Bench

from bayescal.arm.motion import Term
from bayescal.effects import EFFECTS, Parameter
from bayescal.effects.common import lagging, successions
from bayescal.effects.vocabulary import Session
from bayescal.exporting.mjcf.format import holds
from bayescal.gap.search.refit import model_name


@pytest.fixture(scope="module")
def bench(cube):
    return Bench.of(cube(seed=3, count=240).dataset)


def langevin(x):
    """Curve of Jiles and Atherton without losses."""
    small = np.abs(x) < 1e-3
    safe = np.where(small, 1.0, x)
    return np.where(small, x / 3, 1 / np.tanh(safe) - 1 / safe)


def magnetised(torque, fade):
    """A state that follows Langevin's curve of successive torques (N,); at once where `fade` is 0."""
    size = np.std(torque)
    goal = langevin(torque / (0.2 * size))
    out, state = [], goal[0]
    for k, aim in enumerate(goal):
        step = abs(torque[k] - torque[k - 1]) / size if k else 0.0
        state = aim + (state - aim) * (np.exp(-step / fade) if fade else 0.0)
        out.append(state)
    return np.array(out)


def named(bench, column, strength):
    decision, _ = bench.decided(bench.made_up(1, bench.visible(bench.slopes.columns([column]), strength, 1)))
    (member,) = decision.members
    return decision, member


@pytest.mark.parametrize(("joint", "strength"), [(4, 300.0), (5, 100.0)])
def test_a_wind_up_that_follows_its_load_late_is_hysteresis(bench, joint, strength):
    """It was hardening; without the memory it still is."""
    c = bench.circumstances
    torque = c.torques[:, joint - 1]
    late, prompt = (
        Parameter("truth", "rad", (Term(joint, "rz", magnetised(torque, fade)),), 1e-4) for fade in (0.5, 0.0)
    )
    decision, member = named(bench, late, strength)
    assert (member.effect, member.variant.site) == ("hysteresis", f"joint {joint}")
    assert member.variant.setting.startswith("late-")
    assert model_name(member, bench.known).startswith(f"hysteresis@{member.variant.setting} at joint {joint}")
    assert decision.probability["hysteresis"] > 0.9
    decision, member = named(bench, prompt, strength)
    assert member.effect == "hardening"
    assert decision.probability["hysteresis"] < 0.3


def test_a_coupling_that_levels_off_on_coupled_axes(bench):
    """A straight line of J2 at J3 is nearly absorbed there: the error was an unmodelled effect."""
    c = bench.circumstances
    angle = c.readings[:, 1]
    reach = 1.2 * np.std(angle)
    turn = reach * np.arctan((angle - np.median(angle)) / reach)
    _, member = named(bench, Parameter("truth", "rad", (Term(3, "rz", turn),), 1e-4), 150.0)
    assert (member.effect, member.variant.site, member.variant.setting) == (
        "coupling",
        "joint 3",
        "levels-off",
    )


def test_an_eccentricity_with_a_part_of_the_third_order(bench):
    """A quarter of the amplitude in the third order made it an unmodelled error of the joint."""
    turn = bench.circumstances.q[:, 2]
    wave = np.sin(turn + 0.7) + 0.25 * np.sin(3.0 * turn + 2.0)
    decision, member = named(bench, Parameter("truth", "rad", (Term(3, "rz", wave),), 1e-4), 300.0)
    assert (decision.kind, member.effect, member.variant.site, member.variant.setting) == (
        "named",
        "eccentricity",
        "joint 3",
        "third-order",
    )
    names = {bench.known.pool[k].name.removeprefix("eccentricity ") for k in member.variant.columns}
    assert names == {"J3 sin", "J3 cos", "third order J3 sin", "third order J3 cos"}


def test_an_eccentricity_of_one_order_keeps_its_form(bench):
    turn = bench.circumstances.q[:, 2]
    _, member = named(bench, Parameter("truth", "rad", (Term(3, "rz", np.sin(turn + 0.7)),), 1e-4), 300.0)
    assert (member.effect, member.variant.setting) == ("eccentricity", None)


def test_a_stiffness_that_differs_between_the_flanks(bench):
    """Two corners, at 55 % of the usual torque of one sign and 25 % of the other: it was unmodelled."""
    torque = bench.circumstances.torques[:, 4]
    usual = np.quantile(np.abs(torque[bench.circumstances.fitted]), 0.9)
    wind = np.clip(torque, -0.55 * usual, 0.25 * usual)
    decision, member = named(bench, Parameter("truth", "rad", (Term(5, "rz", wind),), 1e-4), 300.0)
    assert (decision.kind, member.effect, member.variant.site, member.variant.setting) == (
        "named",
        "hardening",
        "joint 5",
        "uneven",
    )
    even = np.clip(torque, -0.4 * usual, 0.4 * usual)
    _, member = named(bench, Parameter("truth", "rad", (Term(5, "rz", even),), 1e-4), 300.0)
    assert (member.effect, member.variant.setting) in {("hardening", knee) for knee in (0.3, 0.45, 0.8)}


def test_a_state_that_lags(bench):
    """Along a straight path in equal steps d the lag is d times the sum of the powers of exp(-d/length)."""
    c = bench.circumstances
    c = replace(c, time=None)
    d, length = 0.1, 0.4
    path = d * np.arange(len(c.q))
    keep = np.exp(-d / length)
    wanted = path - d * np.cumsum(np.append(0.0, keep ** np.arange(1, len(path))))
    np.testing.assert_allclose(lagging(c, path, path, length), wanted, atol=1e-12)
    np.testing.assert_allclose(lagging(c, path, path, 1e-6), path, atol=1e-12)


def test_the_order_is_that_of_time_and_each_session_begins_anew(bench):
    c = bench.circumstances
    rows = np.arange(len(c.q))
    backwards = replace(c, time=-rows.astype(float))
    path = np.sin(rows)
    forwards = lagging(replace(c, time=None), path[::-1], path[::-1], 0.5)
    np.testing.assert_allclose(lagging(backwards, path, path, 0.5), forwards[::-1])
    two = tuple(Session(name, (rows < 100) == (name == "A"), False) for name in "AB")
    assert [len(own) for own in successions(replace(c, sessions=two))] == [100, len(rows) - 100]
    own = lagging(replace(c, time=None, sessions=two), path, path, 0.5)
    assert own[100] == path[100]


@pytest.mark.parametrize(
    ("effect", "form"), [("hysteresis", "late-20"), ("coupling", "levels-off"), ("hardening", "uneven")]
)
def test_no_element_of_mujoco_has_them(bench, effect, form):
    c = bench.circumstances
    usual, other = (EFFECTS[effect].at(c, setting)[0] for setting in (None, form))
    model = SimpleNamespace(parameters=(usual, other), scene=SimpleNamespace(moments=c.moments))
    arm = SimpleNamespace(model=model, values=np.full(2, 1e-6))
    assert holds(arm, 0)
    assert not holds(arm, 1)


def test_a_drift_with_a_pause_and_two_time_constants(bench):
    """Written down as an integration in small steps; it was an unmodelled error of the base over time."""
    c = bench.circumstances
    span = np.ptp(c.time[c.fitted])
    fine = np.linspace(0.0, 1.0, 4001)
    state, course = np.zeros(2), []
    for t in fine:
        course.append(state @ [0.7, 0.3])
        goal = 0.0 if 0.36 < t < 0.6 else 1.0
        state = state + (goal - state) / np.array([500.0, 4000.0]) * span * (fine[1] - fine[0])
    warm = np.interp((c.time - np.min(c.time[c.fitted])) / span, fine, course)
    turned = [Term(j, "rz", by * warm) for j, by in ((2, 2.0), (3, -1.5), (4, 2.0), (5, 1.5))]
    moved = Parameter("truth", "m", (Term(0, "tz", warm), Term(4, "tz", warm), *turned), 2e-5)
    decision, member = named(bench, moved, 200.0)
    assert (decision.kind, member.effect) == ("named", "thermal-drift")
    assert member.variant.setting.startswith("paused-")
    assert model_name(member, bench.known).startswith(f"thermal-drift@{member.variant.setting}")
