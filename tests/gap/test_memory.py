"""Hysteresis with a memory and a coupling that levels off: forms written down without the effects."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_problems import BASELINE, Bench, bench_of, log_bayes
from scipy.stats import chi2
from sessions import circumstances, geared, reflectors, with_columns

from bayescal.arm.motion import CONTACT, Term
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.assess.shared_causes import Completed
from bayescal.dataset import Target
from bayescal.effects import EFFECTS, Parameter, parameters_of
from bayescal.effects.common import base_terms, lagging, successions, tilts
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, joint
from bayescal.effects.vocabulary import Session
from bayescal.estimate import calibrated
from bayescal.estimate.outliers import limit
from bayescal.exporting.mjcf import holds
from bayescal.gap import examine as examining
from bayescal.gap.examine import examine
from bayescal.gap.linear.evidence import project, shared_variance, weigh_sets, worth
from bayescal.gap.linear.problem import Problem, Slopes
from bayescal.gap.linear.state import fit_state
from bayescal.gap.outcome import events
from bayescal.gap.outcome.events import sizes
from bayescal.gap.search.beam import Search
from bayescal.gap.search.candidates import Candidates, extended
from bayescal.gap.search.cell_kinds import remembering
from bayescal.gap.search.refit import model_name
from bayescal.gap.search.unknown import cell_fits, with_set
from bayescal.model.options import USUAL, FitOptions
from bayescal.model.scene import Scene


@pytest.fixture(scope="module")
def bench(cube):
    return bench_of(cube, 3, 240)


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


def named(bench, *terms, strength=300.0):
    """The decision on a session with a made-up error of these terms, and its only name."""
    decision = bench.decision(1, bench.of_terms(*terms, strength=strength, seed=1))
    (member,) = decision.members
    return decision, member


def told(bench, joint, turn, strength=300.0):
    """The verdict on an error of a joint by a driver (N,), and the effect at its site in its form."""
    decision, member = named(bench, Term(joint, "rz", turn), strength=strength)
    return decision.kind, member.effect, member.variant.site, member.variant.setting


def test_a_wind_up_that_follows_its_load_late_is_hysteresis(bench):
    """It was hardening; without the memory it still is."""
    torque = bench.circumstances.torques[:, 4]
    late, prompt = (Term(5, "rz", magnetised(torque, fade)) for fade in (0.5, 0.0))
    decision, member = named(bench, late, strength=100.0)
    assert (member.effect, member.variant.site) == ("hysteresis", "joint 5")
    assert member.variant.setting.startswith("late-")
    assert model_name(member, bench.known).startswith(f"hysteresis@{member.variant.setting} at joint 5")
    assert decision.probability["hysteresis"] > 0.9
    decision, member = named(bench, prompt, strength=100.0)
    assert member.effect == "hardening"
    assert decision.probability["hysteresis"] < 0.3


def test_a_coupling_that_levels_off_on_coupled_axes(bench):
    """A straight line of J2 at J3 is nearly absorbed there: the error was an unmodelled effect."""
    c = bench.circumstances
    angle = c.readings[:, 1]
    reach = 1.2 * np.std(angle)
    turn = reach * np.arctan((angle - np.median(angle)) / reach)
    assert told(bench, 3, turn, 150.0)[1:] == ("coupling", "joint 3", "levels-off")


def test_an_eccentricity_with_a_part_of_the_third_order(bench):
    """A quarter of the amplitude in the third order made it an unmodelled error of the joint."""
    turn = bench.circumstances.q[:, 2]
    wave = np.sin(turn + 0.7) + 0.25 * np.sin(3.0 * turn + 2.0)
    assert told(bench, 3, wave) == ("named", "eccentricity", "joint 3", "third-order")
    forms = bench.known.variants["eccentricity"]
    (variant,) = (v for v in forms if (v.site, v.setting) == ("joint 3", "third-order"))
    names = {bench.known.pool[k].name.removeprefix("eccentricity ") for k in variant.columns}
    assert names == {"J3 sin", "J3 cos", "third order J3 sin", "third order J3 cos"}


def test_amplitudes_of_one_change_share_the_margin(bench):
    """A probability of 0.007 is below the stated 0.01 for one amplitude, not for each of three."""
    moved, known = slipping(bench), []
    for z in np.linspace(4e-6, 6e-6, 5):
        _, shift = measured(bench, TOOL, Driver("event"), moved, np.array([60e-6, -40e-6, z]))
        p = chi2.sf((shift[2].value / shift[2].u) ** 2, 1)
        assert shift[2].significant == (3 * p < 0.01)
        known.append(p)
    assert any(0.01 / 3 < p < 0.01 for p in known), known


def test_a_stiffness_that_differs_between_the_flanks(bench):
    """Two corners, at 55 % of the usual torque of one sign and 25 % of the other: it was unmodelled."""
    torque = bench.circumstances.torques[:, 4]
    usual = np.quantile(np.abs(torque[bench.circumstances.fitted]), 0.9)
    wind = np.clip(torque, -0.55 * usual, 0.25 * usual)
    assert told(bench, 5, wind) == ("named", "hardening", "joint 5", "uneven")


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
    turns = [Term(j, "rz", by * warm) for j, by in ((2, 2.0), (3, -1.5), (4, 2.0), (5, 1.5))]
    lengths = (Term(frame, "tz", warm) for frame in (0, 4))
    decision, member = named(bench, *lengths, *turns, strength=200.0)
    assert (decision.kind, member.effect) == ("named", "thermal-drift")
    assert member.variant.setting.startswith("paused-")
    assert model_name(member, bench.known).startswith(f"thermal-drift@{member.variant.setting}")


# --- Row and size of an unmodelled sudden change, and size of a rocking of the base, with their uncertainty.

ROW = 101  # of the session, from 0: between two rows that the cells try


@pytest.fixture(scope="module")
def sudden_bench(cube):
    return bench_of(cube, 7, 160)


def measured(bench, site, driver, parameters, amplitudes, left_out=()):
    """What is told of a cell of a session with a made-up error, without the contacts of some rows."""
    columns = bench.slopes.columns(parameters)
    # the error is what the model has to be moved by: residuals have the opposite sign
    p = bench.made_up(4, -columns @ (amplitudes / np.array([q.sd for q in parameters])))
    state = fit_state(p, (), ())
    f = cell_fits(state, bench.pool)[bench.number(site, driver)]
    wider = with_set(state, bench.pool, f.best, f.scale)
    kept = ~np.isin(p.rows[p.contact], left_out)
    wider = replace(wider, weight=np.append(wider.weight[: p.count] * kept, wider.weight[p.count :]))
    return sizes(state, wider, bench.pool, f, bench.circumstances)


def since(bench):
    return (np.arange(len(bench.circumstances.q)) >= ROW).astype(float)


def slipping(bench):
    """A shift of the tool along each axis of the flange."""
    end = bench.circumstances.chain.n + 1
    return [Parameter("", "m", (Term(end, f"t{axis}", since(bench)),), 1e-5) for axis in "xyz"]


def test_a_stylus_that_shifts_has_its_row_and_a_vector(sudden_bench):
    truth = np.array([60e-6, -40e-6, 25e-6])
    event, shift = measured(sudden_bench, TOOL, Driver("event"), slipping(sudden_bench), truth)
    first, last = event.interval95
    assert first <= min(event.row, ROW) <= max(event.row, ROW) <= last <= first + 6
    assert [(a.what, a.unit, a.site) for a in shift] == [(f"shift {axis}", "m", TOOL) for axis in "xyz"]
    chi = [(a.value - value) / a.u for a, value in zip(shift, truth, strict=True)]
    assert np.max(np.abs(chi)) < 3.5
    assert all(a.u < 6e-6 and a.significant for a in shift)


def test_a_small_change_has_an_interval_of_many_rows(sudden_bench):
    small = [Parameter("", "m", (Term(CONTACT, "normal", since(sudden_bench)),), 1e-5)]
    large, _ = measured(sudden_bench, PROBE, Driver("event"), small, np.array([40e-6]))
    event, (shift,) = measured(sudden_bench, PROBE, Driver("event"), small, np.array([4e-6]))
    assert np.ptp(event.interval95) > np.ptp(large.interval95)
    assert (shift.what, shift.unit) == ("shift", "m")
    assert abs(shift.value - 4e-6) < 3.5 * shift.u


def test_rows_that_a_contact_left_out_does_not_distinguish(sudden_bench, monkeypatch):
    """The first of them is told, whatever rounding adds to their evidence."""
    shifted = [Parameter("", "m", (Term(CONTACT, "normal", since(sudden_bench)),), 1e-5)]
    first = sudden_bench.circumstances.fitted[sudden_bench.circumstances.fitted >= ROW][0]
    arguments = sudden_bench, PROBE, Driver("event"), shifted, np.array([300e-6]), [first]
    event, _ = measured(*arguments)
    assert event.row == first
    monkeypatch.setattr(
        events, "weigh_sets", lambda *a: weigh_sets(*a) + 1e-9 * np.arange(len(a[1].sets))[:, None]
    )
    assert measured(*arguments)[0].row == first
    # 95 % of rows that are equally probable
    sets = []
    monkeypatch.setattr(events, "weigh_sets", lambda *a: sets.extend(a[1].sets) or np.zeros((len(sets), 1)))
    assert np.ptp(measured(*arguments)[0].interval95) == pytest.approx(0.95 * len(sets), abs=1.0)


def test_the_zero_of_a_joint_that_changes(sudden_bench):
    turned = [Parameter("", "rad", (Term(4, "rz", since(sudden_bench)),), 1e-4)]
    event, (turn,) = measured(sudden_bench, joint(4), Driver("event"), turned, np.array([3e-4]))
    assert np.ptp(event.interval95) <= 6
    assert (turn.what, turn.unit, turn.significant) == ("rotation", "rad", True)
    assert abs(turn.value - 3e-4) < 3.5 * turn.u


def test_a_rocking_base_has_a_half_angle_about_an_axis(sudden_bench):
    c = sudden_bench.circumstances
    by = tilts(c)[0]
    mine = by.moment[c.fitted]
    knee = 0.02 * np.quantile(np.abs(mine), 0.9)
    rock = np.tanh((by.moment - np.median(mine)) / knee)
    parameters = [Parameter("", "rad", base_terms(c, "r", by.axis, rock), 1e-4)]
    driver = Driver("base moment", form="sign")
    event, (angle,) = measured(sudden_bench, BASE, driver, parameters, np.array([4e-4]))
    assert event is None
    x, y, _ = by.axis
    azimuth = round(np.degrees(np.arctan2(y, x))) % 180
    assert angle.what == f"half-angle about the horizontal axis at {azimuth} deg from x"
    assert abs(angle.value - 4e-4) < 3.5 * angle.u
    assert angle.significant


def test_the_azimuth_of_an_axis_is_that_in_the_frame_of_the_session():
    """Of an arm whose base is turned by 30 deg."""
    c = SimpleNamespace(chain=SimpleNamespace(base=rigid(rpy_matrix([0.0, 0.0, np.pi / 6]))))
    assert "at 30 deg" in events._about(Parameter("", "rad", (Term(0, "rx", np.ones(1)),), 1e-4), c)


def test_only_significant_locations_have_a_size(sudden_bench):
    p = sudden_bench.made_up(4, sudden_bench.slopes.columns(slipping(sudden_bench))[:, 0] * 6.0)
    chosen = Search(p, sudden_bench.known).hypothesis(())
    found = sudden_bench.places(SimpleNamespace(hypothesis=chosen))
    assert (found[0].site, found[0].driver) == (TOOL, Driver("event"))
    assert found[0].event is not None
    assert found[0].amplitudes
    assert all(not q.amplitudes for q in found if q.family_p_value > 0.01)


# --- Steps of the base, of a reflector and of an instrument: alternatives, each with its row.


@pytest.fixture(scope="module")
def steps_bench(tracker):
    return bench_of(tracker, 3, 120)


def two_instruments(dataset):
    """Every second row is read by another instrument, beside the first."""
    first = dataset.targets[0]
    other = Target("radar", "instrument", {**first.values, "xyz": first.values["xyz"] + [0.0, 0.5, 0.0]})
    m = dataset.measurements
    m = replace(m, target=np.arange(len(m.ids)) % 2)
    return replace(dataset, targets=(first, other), measurements=m)


def found(bench, frame, rows=1.0):
    """The verdict on a shift of a frame from row 60 on (from 1), written down without the effect."""
    since = (np.arange(len(bench.circumstances.q)) >= 59) * rows
    shift = [Parameter("truth", "m", (Term(frame, axis, since),), 5e-5) for axis in ("tx", "ty", "tz")]
    decision = bench.decision(1, bench.visible(bench.slopes.columns(shift), 250.0, 2))
    (member,) = decision.members
    return decision.kind, member


@pytest.mark.parametrize("frame", [0, 7])
def test_the_base_or_the_reflector_shifted(steps_bench, frame):
    """In sessions of a tracker; a shift of the reflector was an unmodelled effect."""
    kind, member = found(steps_bench, frame)
    assert (kind, member.effect) == ("named", "step")
    assert abs(member.variant.setting - 60) <= 3
    name = f"step@{member.variant.setting:g}" + (" at tool" if frame else "")
    assert model_name(member, steps_bench.known).split(" x")[0] == name


def test_one_of_two_instruments_shifted(tracker):
    bench = Bench.of(two_instruments(tracker(seed=3, count=120).dataset))
    c = bench.circumstances
    kind, member = found(bench, 0, np.arange(len(c.q)) % 2)
    assert (kind, member.effect, member.variant.site) == ("named", "step", "radar")
    names = {p.name for p in parameters_of((model_name(member, bench.known),), c) if p.effect == "step"}
    assert names == {f"step radar {axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")}


def test_a_step_of_an_instrument_turns_it_about_its_own_place(tracker):
    d = tracker(seed=3, count=40).dataset
    c = circumstances(d)
    p = next(p for p in EFFECTS["step"].at(c, 20.0) if p.name == "step tracker rz")
    axes = {(term.frame, term.axis): np.broadcast_to(term.driver, 40) for term in p.terms}
    frame = rigid(rpy_matrix(d.targets[0].values["rpy"]), d.targets[0].values["xyz"])
    points = d.measurements.xyz @ frame[:3, :3].T + frame[:3, 3]
    shift = np.column_stack([axes[0, axis] for axis in ("tx", "ty", "tz") if (0, axis) in axes])
    moved = axes[0, "rz"][:, None] * np.cross([0.0, 0.0, 1.0], points)[:, :2] + shift
    about = np.cross([0.0, 0.0, 1.0], points - d.targets[0].values["xyz"])[:, :2]
    np.testing.assert_allclose(moved[19:], about[19:], atol=1e-12)
    np.testing.assert_allclose(moved[:19], 0.0)


@pytest.mark.parametrize("place", [(2.0, 0.3, 0.5), (0.0, 0.0, 0.0)])
def test_the_only_instrument_is_a_site_of_its_own_far_from_the_base(tracker, place):
    d = tracker(seed=3, count=40).dataset
    d = replace(d, targets=(replace(d.targets[0], values=d.targets[0].values | {"xyz": np.array(place)}),))
    sites = {str(p.site) for p in EFFECTS["step"].at(circumstances(d), 20.0)}
    assert sites == {"base", "tool"} | ({"tracker"} if any(place) else set())


def test_without_a_site_a_step_is_of_the_base(steps_bench, cube):
    c = steps_bench.circumstances
    for name, sites in (("step@60", {BASE}), ("step@60 at tool", {TOOL}), ("step", {BASE})):
        assert {p.site for p in parameters_of((name,), c) if p.effect == "step"} == sites
    touching = EFFECTS["step"].at(circumstances(cube(seed=1).dataset), 60.0)
    assert {p.site for p in touching} == {BASE}


def test_each_of_several_reflectors_and_all_of_them(tracker):
    d = tracker(seed=3, count=60).dataset
    tools = (d.tools[0], replace(d.tools[0], name="upper"))
    d = replace(d, tools=tools, measurements=replace(d.measurements, tool=np.arange(60) % 2))
    sites = [str(p.site) for p in EFFECTS["step"].at(circumstances(d), 30.0)]
    name = d.tools[0].name
    assert list(dict.fromkeys(sites)) == ["base", "tool", f"tool of {name}", "tool of upper", "tracker"]


def test_alternatives_share_a_part_of_the_prior(steps_bench):
    step, c = EFFECTS["step"], steps_bench.circumstances
    rows = [float(row) for row in step.scan.values(c)]
    variants = extended(Candidates((), {}, {}), step, rows, c).variants["step"]
    assert sum(np.exp(v.log_prior) for v in variants) == pytest.approx(1.0)
    own = [v for v in variants if v.setting == variants[0].setting]
    assert [v.site for v in own] == ["", "tool", "tracker"]
    for v in own[1:]:
        assert np.exp(v.log_prior - own[0].log_prior) == pytest.approx(3 / 14)


def test_a_base_under_a_constant_moment_does_not_move_in_its_clearance(tracker):
    d = tracker(seed=1, count=20).dataset
    c = circumstances(with_columns(d, readings=np.repeat(d.measurements.readings[:1], 20, axis=0)))
    with warnings.catch_warnings(action="error"):
        (by_moment, *_) = remembering(c)
    assert by_moment.sets == ()


# --- Measurements of one pose that share an error: three reflectors are not three independent measurements.


def test_three_reflectors_at_a_few_stops_do_not_make_sure_names():
    """The error is one of the stops; for three independent measurements it would be several sure names."""
    found = examine(Scene(reflectors(60e-6, 2)), ("geometry",), FitOptions()).decision
    assert found.kind == "null"
    assert all(p < 0.5 for name, p in found.probability.items() if name != "null")


def test_an_effect_that_the_reflectors_of_a_stop_show_alike_is_no_shared_error():
    """Twice a turn of J1: before it is named, all reflectors of a stop are off by the same."""
    found = examine(Scene(reflectors(0.0, 2, wave=4e-4)), ("geometry",), FitOptions())
    assert (found.decision.kind, found.decision.hypothesis.names) == ("named", ("second-harmonic",))
    assert found.problem.worth is None


def made_up(shared: float, seed: int, poses: int = 60, count: int = 3):
    """Points of a made-up problem of five parameters, with the error of each pose."""
    rng = np.random.default_rng(seed)
    rows = 3 * count * poses
    contact = np.arange(rows) // 3
    gradient = 1e5 * np.tile(np.eye(3), (count * poses, 1))
    r = rng.standard_normal(rows) + shared * rng.standard_normal((poses, 3)).repeat(count, axis=0).ravel()
    jacobian = 5 * rng.standard_normal((rows, 5))
    p = Problem(
        r, jacobian, np.zeros((rows, 0)), np.zeros(5), contact, np.arange(count * poses), np.ones(rows)
    )
    return p, gradient, contact // count


def test_the_shared_variance_is_that_of_the_simulation():
    def variance(p, gradient, pose):
        return shared_variance(fit_state(p, (), (), robust=False), gradient, pose)

    assert np.mean([variance(*made_up(2.0, seed)) for seed in range(8)]) == pytest.approx(4.0, rel=0.15)
    assert not any(variance(*made_up(0.0, seed)) for seed in range(8))
    assert variance(*made_up(2.0, 0, count=1)) == 0.0  # nothing repeats


def test_what_a_measurement_is_worth():
    """Three points of one pose: as a mean of three with a shared variance. Other directions share nothing."""
    p, gradient, pose = made_up(2.0, 0, poses=2)
    assert worth(4.0, p.contact, p.lengths, gradient, pose) == pytest.approx(np.full(18, 5 / 13))
    assert worth(0.0, p.contact, p.lengths, gradient, pose) == pytest.approx(np.ones(18))
    contact = np.arange(6)
    faces = np.eye(3)[[0, 1, 2, 0, 0, 0]]
    found = worth(4.0, contact, 5, faces[:5], np.array([0, 0, 0, 1, 1]))
    assert found == pytest.approx([1.0, 1.0, 1.0, 5 / 9, 5 / 9, 1.0])  # the last is an orientation


def test_evidence_of_rows_that_are_worth_half_is_that_of_half_as_many():
    """The same data twice, each worth one half: as the data once."""
    p = made_up(0.0, 0)[0]
    pool = 3 * np.random.default_rng(9).standard_normal((len(p.residual), 2))
    once = replace(p, pool=pool)
    contacts = int(p.contact.max()) + 1
    twice = replace(
        once, residual=np.tile(p.residual, 2), jacobian=np.tile(p.jacobian, (2, 1)),
        pool=np.tile(pool, (2, 1)),
        contact=np.concatenate([p.contact, p.contact + contacts]), rows=np.arange(2 * contacts),
        sigma=np.ones(2 * len(p.residual)), worth=np.full(2 * len(p.residual), 0.5),
    )  # fmt: skip
    sets = [np.array([0]), np.array([0, 1])]
    for columns in ((), (1,)):
        a, b = (fit_state(q, columns, np.ones(len(columns)), robust=False) for q in (once, twice))
        assert a.log_evidence == pytest.approx(b.log_evidence)
        of_one, of_two = (log_bayes(project(s, s.problem.pool), sets) for s in (a, b))
        assert of_one == pytest.approx(of_two)
    robust = fit_state(twice, (), ())
    assert robust.gross == 0
    assert robust.log_evidence == pytest.approx(fit_state(once, (), ()).log_evidence)


def test_a_stop_that_is_wrong_as_a_whole_is_one_outlier():
    """A column that explains one stop gains less than by its three contacts, and no other differs."""
    p, _, pose = made_up(0.0, 0)
    push = 30.0 * np.random.default_rng(1).standard_normal(len(p.residual)) * (pose == 20)
    p = replace(p, residual=p.residual + push, pool=push[:, None])
    stops = replace(p, stop=pose[::3])
    lost = np.flatnonzero(stops.stop == 20)
    assert p.excluded(lost[:1]) == stops.excluded(lost[:1])
    assert stops.excluded(np.append(lost, 7)) == pytest.approx(
        stops.excluded(lost) + p.excluded(np.array([7])), rel=1e-12
    )
    assert -0.5 * limit(np.full(180, 9))[0] == pytest.approx(stops.excluded(lost))
    alone, together = (fit_state(q, (0,), np.ones(1)).log_evidence for q in (p, stops))
    assert alone - fit_state(p, (), ()).log_evidence > together - fit_state(stops, (), ()).log_evidence + 10


def test_repeated_contacts_of_a_surface_are_independent(cube, monkeypatch):
    """What they share is lack of fit, which has a cell."""
    dataset, seen = cube(seed=7, count=60).dataset, []

    def variance(_, gradient, poses):
        seen.append(poses)
        raise RuntimeError("enough")

    rows = np.arange(len(dataset.measurements.ids)) // 3
    monkeypatch.setattr(examining, "shared_variance", variance)
    with pytest.raises(RuntimeError, match="enough"):
        examine(Scene(with_columns(dataset, stop=rows)), ("geometry",), replace(USUAL, robust=False))
    assert len(np.unique(seen[0])) == len(seen[0])


# --- Rows that share a cause are no outliers of a diagnosis: it has to explain them.

COUNT, FIRST, OFF = 120, 90, np.array([0.0, 4e-4, 0.0])


@pytest.fixture(scope="module")
def slipped(tracker):
    """A reflector that slips on the flange before the last quarter of the rows."""
    d = geared(tracker(seed=5, count=COUNT).dataset)
    moved = replace(d, tools=(replace(d.tools[0], centre=d.tools[0].centre + OFF),))
    change = (Scene(moved).points - Scene(d).points) @ rpy_matrix(np.asarray(d.targets[0].values["rpy"]))
    change[:FIRST] = 0.0
    return with_columns(d, xyz=d.measurements.xyz + change)


def test_a_slipped_reflector_is_found_with_its_row_and_not_deleted(slipped):
    found = examine(Scene(slipped), BASELINE, FitOptions())
    assert "tool ball from row c90 on" in {cause.label for cause in found.causes}
    assert len(np.intersect1d(found.fitted.rejected, np.arange(FIRST, COUNT))) == 0
    for h in found.search.hypotheses.values():
        used = h.state.weight[: found.problem.count] > 0
        assert np.all(used[np.isin(found.problem.rows[found.problem.contact], found.causes[0].rows)])
    (member,) = found.decision.members
    assert (found.decision.kind, member.effect, member.variant.sites) == ("named", "step", (TOOL,))
    assert abs(member.variant.setting - (FIRST + 1)) <= 2  # a scan of 48 rows


def test_a_noise_of_each_target_weighs_as_rows_that_state_it(tracker):
    """The same problem as one whose table states that noise."""
    d = tracker(seed=5, count=COUNT).dataset
    fitted = calibrated(Scene(d), BASELINE, FitOptions(robust=False))
    slopes, ratio = Slopes.of(fitted), np.where(np.arange(COUNT) % 2, 3.0, 0.5)
    (name,) = fitted.weights.sigma
    stated = {name: fitted.weights.sigma[name] * np.tile(ratio, 3)}
    asked = Slopes.of(replace(fitted, weights=replace(fitted.weights, sigma=stated)))
    found = slopes.with_noise(ratio)
    assert not np.allclose(found.residual, slopes.residual)
    for name in ("residual", "jacobian", "axes", "sigma"):
        np.testing.assert_allclose(getattr(found, name), getattr(asked, name), rtol=1e-9, atol=1e-12)


def test_contacts_that_share_a_cause_are_outliers_of_no_hypothesis(tracker):
    """Five rows are gross. Of these, the one that shares a cause is kept."""
    d = tracker(seed=5, count=COUNT).dataset
    slopes = Slopes.of(calibrated(Scene(d), BASELINE, FitOptions(robust=False)))
    p = slopes.problem(np.zeros(slopes.jacobian.shape[1]), (), ())
    gross = np.array([3, 20, 50, 77, 101])
    p = replace(p, residual=p.residual + 40.0 * np.isin(p.contact, gross))
    sharing = np.arange(COUNT) == 50
    for one, left in ((p, gross), (replace(p, sharing=sharing), np.setdiff1d(gross, 50))):
        weight = fit_state(one, (), ()).weight[: p.count]
        assert set(p.contact[weight == 0]) == set(left.tolist())


@pytest.mark.parametrize(
    ("causes", "kinds", "which", "calls"),
    [(("c",), ("null", "unknown"), 1, 2), (("c",), ("null", "null"), 0, 2),
     (("c",), ("class",), 0, 1), ((), ("null",), 0, 1)],
)  # fmt: skip
def test_outliers_that_nothing_explains_are_left_out_after_all(monkeypatch, causes, kinds, which, calls):
    """Where that shows an unmodelled effect: a few true outliers may share a cause by chance."""
    nothing = dict.fromkeys(("fitted", "circumstances", "candidates", "slopes", "problem", "pool", "search"))
    found = [examining.Examined(**nothing, decision=SimpleNamespace(kind=k)) for k in kinds]
    asked = []

    def examined(fitted, of, options, further):
        asked.append((fitted, of))
        return found[len(asked) - 1]

    plain, every = (SimpleNamespace(model=SimpleNamespace(effects=("geometry",))) for _ in range(2))
    monkeypatch.setattr(examining, "completed", lambda *_: Completed(every, (), causes))
    monkeypatch.setattr(examining, "_examined", examined)
    result = examining._of_baseline((plain, replace(USUAL, robust=True), ("told",)), False)
    assert (result.decision, result.widths) == (found[which].decision, ("told",))
    assert asked == [(every, causes), (plain, ())][:calls]
