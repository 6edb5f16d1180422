"""Cells of two coordinates, of a memory and of random errors: their functions, and what they find."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from gap_problems import BASELINE, Bench, bench_of, left_by
from sessions import circumstances

from bayescal.arm.chain import frames
from bayescal.arm.motion import CONTACT, TURN, Term
from bayescal.effects import named, parameters_of
from bayescal.effects.common import tilts
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, Site, joint, link
from bayescal.gap.linear.evidence import SCALE_PRIOR, SCALES, Bank, weigh_clusters, weigh_sets, weighed_sets
from bayescal.gap.linear.problem import Problem
from bayescal.gap.linear.state import fit_state
from bayescal.gap.search import cell_kinds, makers
from bayescal.gap.search.beam import Search
from bayescal.gap.search.candidates import candidates
from bayescal.gap.search.cells import _activity, _waits, cells, sets_of
from bayescal.gap.search.refit import model_name
from bayescal.gap.search.unknown import Pool, filled, unknown
from bayescal.gap.settings import CELLS, SEARCH, UNKNOWN


@pytest.fixture(scope="module")
def dataset(cube):
    return cube(seed=7, count=180).dataset


@pytest.fixture(scope="module")
def bench(cube):
    return bench_of(cube, 7, 180)


def test_a_torque_times_functions_of_angles_turns_its_own_link(bench):
    """A softer tooth of joint 3, a softer place of its range, and a joint that softens with another angle."""
    c = bench.circumstances
    load, angle = c.moments[:, 3, 2], c.q[:, 2]

    def half_wave(j, k):
        x = c.readings[:, j]
        return np.cos(np.pi * k * (x - x.min()) / np.ptp(x))

    for form, wanted, most in (
        ("own angle", load * np.sin(2 * angle + 0.4), 1e-12),
        ("own angle", load * (half_wave(2, 1) + half_wave(2, 3)), 1e-2),
        ("other angle", load * half_wave(4, 2), 1e-2),
        ("and angle", half_wave(2, 1) + load / np.std(load) * half_wave(2, 4), 1e-2),
    ):
        driver = Driver("torque", 3, form=form)
        assert bench.left_by(joint(3), driver, "rz", wanted, 3) < most, form
    (own,) = bench.pool.cells[bench.number(joint(3), driver)].sets
    size = [np.max(np.abs(p.terms[0].driver)) for p in own[:5]]
    np.testing.assert_allclose(size, 1 / np.arange(1, 6), rtol=0.05)


@pytest.mark.parametrize("j", [2, 3, 5])
def test_the_torque_of_any_masses_at_the_frames_is_in_the_cell_without_masses(dataset, j):
    """The sag of an arm whose robot file has no masses was an error of the base by the place."""
    c = circumstances(dataset)
    assert not list(cell_kinds.masses_unknown(c))
    pose = frames(c.chain, c.q)
    masses = np.random.default_rng(j).uniform(1.0, 9.0, c.robot.n + 2)
    force = masses[:, None] * c.gravity
    moments = np.sum(np.cross(pose[:, j + 1 :, :3, 3] - pose[:, j, None, :3, 3], force[j + 1 :]), axis=1)
    torque = np.sum(pose[:, j, :3, 2] * moments, axis=1)
    cell = next(x for x in cell_kinds.masses_unknown(replace(c, loads=None)) if x.site == joint(j))
    drivers = np.column_stack([np.asarray(p.terms[0].driver) for p in cell.sets[0]])
    left = torque - drivers @ np.linalg.lstsq(drivers, torque)[0]
    np.testing.assert_allclose(left, 0.0, atol=1e-9 * np.ptp(torque))


def test_two_angles_are_multiplied_in_every_pair(bench):
    """Twisting of a hollow wrist: an error that exists only where two joints are both turned."""
    c = bench.circumstances
    x = c.readings[c.fitted]
    low, size = x.min(axis=0), np.ptp(x, axis=0)
    u = np.clip((c.readings - low) / size, 0, 1)
    for a, b in ((0, 5), (3, 4), (1, 2)):
        wanted = np.cos(np.pi * u[:, a]) * np.cos(2 * np.pi * u[:, b])
        assert bench.left_by(joint(4), Driver("two angles"), "rz", wanted, 4) < 1e-12
    for j, count in ((4, 15), (2, 30)):  # the reading of joint 2 turns link 3 too
        assert len(bench.pool.cells[bench.number(joint(j), Driver("two angles"))].sets) == count


@pytest.mark.parametrize("order", [3.3, 7.0, 12.6, 19.5])
def test_orders_between_harmonics_and_gear_mesh_are_all_near_one_of_the_scan(bench, order):
    angle = bench.circumstances.q[:, 4]
    wanted = np.sin(order * angle + 0.7)
    wanted -= wanted.mean()
    assert bench.left_by(joint(5), Driver("angle", 5, form="waves"), "rz", wanted, 5) < 0.35


def test_a_base_rocks_about_the_axis_of_its_moment(bench):
    """About x, y or a diagonal of an upright arm: where that moment passes zero or its median."""
    c = bench.circumstances
    moment = c.moments[:, 0] @ c.chain.base[:3, :3].T
    cell = bench.pool.cells[bench.number(BASE, Driver("base moment", form="sign"))]
    for axis in np.array([[1, 0], [0, 1], [1, 1], [1, -1]], float):
        axis /= np.linalg.norm(axis)
        about = moment[:, :2] @ axis
        for at in (0.0, np.median(about[c.fitted])):
            state = np.tanh((about - at) / (0.1 * np.quantile(np.abs(about[c.fitted]), 0.9)))
            wanted = {f"r{name}": part * state for name, part in zip("xy", axis, strict=True) if part}
            assert any(
                {t.axis for t in p.terms} == set(wanted)
                and all(np.allclose(t.driver, wanted[t.axis]) for t in p.terms)
                for (p,) in cell.sets
            )


def test_lost_motion_persists_as_a_play_operator():
    """Prandtl: y follows x within the half-width, and the state is (x - y) over it."""
    x = np.cumsum(0.02 * np.random.default_rng(3).standard_normal(300))
    widths = np.array([0.01, 0.05, 0.3])
    found = makers.slack(x, widths)
    for width, state in zip(widths, found, strict=True):
        y, half = x[0], width / 2
        for k, value in enumerate(x):
            y = max(value - half, min(value + half, y))
            assert state[k] == pytest.approx((value - y) / half, abs=1e-9)


def test_a_seat_is_kept_until_the_other_is_taken():
    x = np.sin(np.linspace(0.0, 20.0, 300)) * np.linspace(0.1, 1.0, 300)
    thresholds = np.array([0.05, 0.3, 2.0])
    for at, found in zip(thresholds, makers.seats(x, thresholds), strict=True):
        seat, wanted = 0.0, []
        for value in x:
            seat = 1.0 if value > at else -1.0 if value < -at else seat
            wanted.append(seat)
        assert found.tolist() == wanted


def test_a_tool_on_two_seats_is_unmodelled_at_the_tool(bench):
    """Gravity lays it over across the flange, and it stays there: rows are in the order of time."""
    c, seat, states = bench.circumstances, 0.0, []
    for across in makers.at_tool(c)[:, 0]:
        seat = 1.0 if across > 0.2 else -1.0 if across < -0.2 else seat
        states.append(seat)
    shift = Term(c.chain.n + 1, "ty", np.array(states))
    decision = bench.decision(5, bench.of_terms(shift, strength=200.0, seed=0))
    assert decision.probability["unknown"] > 0.9
    place = next(w for w in bench.places(decision) if not w.explained_by)
    assert (place.site, place.driver) == (TOOL, Driver("gravity direction", form="past"))


def test_fading_is_the_mean_direction_of_earlier_travel():
    """Weighted by exp(-travel since / length): an integral over the path, here by steps of a thousandth."""
    x = np.array([0.3, 0.8, 0.8, 0.1, 0.15, 0.9])
    lengths = np.array([0.1, 0.7])
    found = makers.fading(x, lengths)
    step = 1e-4
    sign = np.concatenate([np.full(round(abs(d) / step), np.sign(d)) for d in np.diff(x)])
    ends = np.concatenate([[0], np.cumsum([round(abs(d) / step) for d in np.diff(x)])])
    for length, states in zip(lengths, found, strict=True):
        for end, state in zip(ends, states, strict=True):
            since = (end - np.arange(end) - 0.5) * step
            wanted = np.sum(sign[:end] * np.exp(-since / length)) * step / length
            assert state == pytest.approx(wanted, abs=1e-3)


def test_a_memory_follows_the_order_of_time(dataset):
    """Rows in another order with the times of their measurement have the same states."""
    c = circumstances(dataset)
    c = replace(c, time=60.0 * np.arange(len(c.q)))
    mixed = np.random.default_rng(0).permutation(len(c.q))
    other = replace(c, readings=c.readings[mixed], time=c.time[mixed], fitted=np.argsort(mixed)[c.fitted])
    rows = replace(c, time=None)
    for cell, same, plain in zip(*(cell_kinds.travel(k) for k in (c, other, rows)), strict=True):
        for a, b, d in zip(cell.sets, same.sets, plain.sets, strict=True):
            np.testing.assert_allclose(b[0].terms[0].driver, a[0].terms[0].driver[mixed])
            np.testing.assert_allclose(d[0].terms[0].driver, a[0].terms[0].driver)


def test_random_errors_of_clusters_weigh_as_a_column_for_each_of_them():
    rng = np.random.default_rng(5)
    rows, count = 90, 12
    clusters, column = rng.integers(0, count, rows), rng.normal(1.0, 0.4, rows)
    residual = rng.standard_normal(rows) + 0.7 * column * rng.standard_normal(count)[clusters]
    every = column[:, None] * (clusters[:, None] == np.arange(count))
    at = np.arange(rows)
    p = Problem(residual, 1e-6 * np.ones((rows, 1)), every, np.zeros(1), at, at, np.full(rows, 1e-6))
    state = fit_state(p, (), (), robust=False)
    pool = Pool(every, (), rows, cells=(), owner=np.zeros(0, int))
    wanted = weigh_sets(state, replace(pool, sets=(np.arange(count),)))[0]
    found, small = weigh_clusters(state, column, clusters)
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert np.max(found) > 3
    same = weighed_sets(state, replace(pool, sets=(np.arange(count),)))[1][0]
    np.testing.assert_allclose(small, same, atol=1e-4)
    unseen = np.sum(every**2) * SCALES**2 < 9 * state.kappa**2
    assert (
        np.isfinite(same).tolist() == unseen.tolist() == [True] * np.sum(unseen) + [False] * np.sum(~unseen)
    )
    assert 0 < np.sum(unseen) < len(SCALES)
    np.testing.assert_allclose(same[unseen], np.minimum(wanted, 0)[unseen])


def test_a_random_error_of_readings_is_found_at_its_joint(bench):
    """A drive that stops elsewhere every time, 50 µrad, seen by three contacts at each of its readings."""
    c = bench.circumstances
    thrice = np.repeat(np.arange(len(c.q) // 3), 3)
    pool = replace(
        bench.pool,
        cells=tuple(
            replace(q, clusters=thrice) if q.clusters is not None and q.site == joint(2) else q
            for q in bench.pool.cells
        ),
    )
    column = bench.columns(bench.number(joint(2), Driver("reading", 2)))[:, 0]
    group = thrice[bench.problem.rows[bench.problem.contact]]
    every = np.random.default_rng(2).standard_normal(thrice.max() + 1)
    error = 0.5 * column[: bench.problem.count] * every[group]
    contribution = np.concatenate([error, np.zeros(len(column) - len(error))])
    there = replace(bench, pool=pool)
    decision = there.decision(31, contribution)
    assert decision.kind == "unknown"
    first = there.places(decision)[0]
    assert (str(first.site), first.driver) == ("joint 2", Driver("reading", 2))
    assert first.family_p_value < 1e-3
    size = error[: bench.problem.lengths] * bench.problem.sigma
    assert first.rms == pytest.approx(np.sqrt(np.mean(size**2)), rel=0.2)
    assert not np.any(first.curve.fitted)


@pytest.mark.parametrize("values", [2, 3])
def test_functions_of_a_coordinate_of_few_values_are_no_constants(values):
    x = np.tile(np.arange(values) * 2.0, 10)
    functions = makers.smooth(x, np.arange(len(x)), 4)
    every = np.column_stack([np.ones(len(x)), *functions])
    assert np.linalg.matrix_rank(every) == every.shape[1] == values


def test_repetitions_tell_an_error_of_the_reading_from_one_of_the_pose(bench):
    """Of contacts repeated at equal readings the first differs between them, the second does not."""
    c = bench.circumstances
    twice = np.arange(len(c.q)) // 2 * 2
    label = np.where(twice < 20, twice.astype(str), "")
    again = replace(c, readings=c.readings[twice], repeat=label)
    anew, same = (k.clusters for k in cell_kinds.scatter(again) if k.site == joint(2))
    first = anew[::2] == anew[1::2]
    assert not np.any(first[:10])
    assert np.all(first[10:])
    assert np.all(same[::2] == same[1::2])
    (only,) = (k for k in cell_kinds.scatter(replace(again, repeat=None)) if k.site == joint(2))
    assert only.driver == Driver("reading", 2)


def test_what_depends_on_two_coordinates_is_found(bench):
    sets = np.flatnonzero(bench.pool.owner == bench.number(joint(2), Driver("two angles")))
    own = bench.pool.sets[int(sets[len(sets) // 2])]
    decision = bench.decision(61, bench.visible(bench.pool.columns[:, own], 300.0, seed=3))
    assert decision.kind in ("unknown", "named+unexplained")
    assert decision.probability["unknown"] > 0.9
    assert bench.places(decision)[0].site == joint(2)


def test_a_cell_at_the_place_of_a_name_contradicts_it_by_what_exceeds_its_form(bench):
    """A share of 3 % of a name's nats is its form; the rest of such a cell counts against the name."""
    there = bench.of_effect("encoder-scale", 200.0, seed=1, site="joint 5")
    search = Search(bench.made_up(77, there), bench.known)
    search.run()
    h = search.hypotheses[frozenset(("encoder-scale",))]
    null = search.hypotheses[frozenset()].log_evidence
    site, driver = h.members[0].variant.places[0]
    at = bench.number(site, driver.course)
    (*_, strict), (*_, free) = unknown(h, bench.pool, null), unknown(h, bench.pool, h.log_evidence)
    assert strict[at].rival
    assert free[at].gain - strict[at].gain == pytest.approx(0.03 * (h.log_evidence - null))
    elsewhere = bench.number(joint(1), Driver("two angles"))
    assert not bench.pool.cells[elsewhere].of_known_effect
    assert free[elsewhere].gain == strict[elsewhere].gain


def test_one_of_several_tools_moves_alone(bench):
    """A reflector that slips, or all of them with the flange; a tool that is read as a pose also turns."""
    c = bench.circumstances
    tool = np.arange(len(c.q)) % 3
    several = replace(c, tool=tool, fitted_tools=(0, 2), turned_tools=(2,), tool_centres=np.zeros((3, 3)))
    of = {(q.site, q.driver): q for q in reversed(list(cells(several)))}
    (plain,) = (q for q in cells(c) if (q.site, q.driver) == (TOOL, Driver("event")))
    slipped = of[TOOL, Driver("event")].sets
    assert len(slipped) == 3 * len(plain.sets)
    assert [t.axis for p in plain.sets[0] for t in p.terms] == ["tx", "ty", "tz"]
    rows = [np.asarray(own[0].terms[0].driver) > 0 for own in slipped[:: len(plain.sets)]]
    np.testing.assert_array_equal(rows[1], rows[0] & (tool == 0))
    np.testing.assert_array_equal(rows[2], rows[0] & (tool == 2))
    frames = [(t.frame, t.axis) for p in slipped[-1] for t in p.terms]
    assert frames == [(7, a) for a in ("tx", "ty", "tz")] + [(TURN, a) for a in ("rx", "ry", "rz")]
    assert len(of[TOOL, Driver("time")].sets) == 3


def test_every_cell_of_a_joint_that_does_not_move_has_columns(dataset):
    c = circumstances(dataset)
    still = np.where(np.arange(6) == 3, 0.2, c.readings)
    found = list(cells(replace(c, q=still, readings=still)))
    alone = cells(replace(c, fitted=c.fitted[:1]))
    assert all(own for cell in (*found, *alone) for own in cell.sets)
    none = (Driver("travel", 4), Driver("angle", 4, form="waves"))
    assert not [q for q in found if q.driver in none]
    assert not [q for q in found if str(q.site) == "joint 4" and q.driver == Driver("angle", 4)]


def test_sets_that_are_not_kept_are_made_anew(bench, monkeypatch):
    """Of a large session the columns of all cells are computed one cell after another, and the sets freed."""
    monkeypatch.setattr("bayescal.gap.search.unknown.MOST_ROWS", 0)
    c, of = bench.circumstances, bench.pool
    every = list(cells(c))
    pool = filled(partial(cells, c), bench.slopes, np.arange(len(bench.slopes.rows)), bench.problem)
    np.testing.assert_array_equal(pool.columns[:, :], of.columns)
    assert [own.tolist() for own in pool.sets] == [own.tolist() for own in of.sets]
    np.testing.assert_array_equal(pool.owner, of.owner)
    assert not any(cell.sets for cell in pool.cells)
    for k, (cell, whole) in enumerate(zip(pool.cells, every, strict=True)):
        assert (cell.site, cell.driver) == (whole.site, whole.driver)
        if k % 20 == 0:
            for own, same in zip(sets_of(cell, k, c), whole.sets, strict=True):
                for a, b in zip(own, same, strict=True):
                    assert a.same(b)


@pytest.mark.parametrize("worth", [False, True])
def test_evidence_with_constant_products_of_the_jacobian(bench, worth):
    """With effects in the state, rows left out and rows that are worth less: as from the state's design."""
    rng = np.random.default_rng(3)
    p = bench.made_up(5, gross=0.05)
    if worth:
        p = replace(p, worth=rng.uniform(0.3, 1.0, p.count))
    state = fit_state(p, [0, 7], [1.0, 2.0])
    assert state.gross
    sets = tuple(rng.choice(p.pool.shape[1], size, replace=False) for size in (1, 2, 2, 5))
    plain, known = (Bank(p.pool, sets, p.count, p.worth, of) for of in (None, p.jacobian))
    np.testing.assert_allclose(weigh_sets(state, known), weigh_sets(state, plain), rtol=1e-6, atol=1e-7)


# --- Cells of two quantities and of earlier contacts, and their prior.


def test_a_quantity_of_a_joint_is_multiplied_by_any_other(bench):
    """Errors that are written down here, of a speed or direction and of another quantity."""
    c = bench.circumstances
    fitted = c.fitted
    low, span = c.readings[fitted].min(axis=0), np.ptp(c.readings[fitted], axis=0)
    angle = np.clip((c.readings - low) / span, 0.0, 1.0)
    speed = c.velocity[:, 2]
    way = speed / np.hypot(speed, np.radians(0.03))
    tired = way * (1.0 + 0.5 * np.cos(2 * np.pi * angle[:, 4]))
    lag = speed * (0.2 + np.cos(np.pi * angle[:, 0]))
    by_way, by_speed = (Driver(kind, 3, form="and another") for kind in ("direction", "joint speed"))
    assert bench.left_by(joint(3), by_way, "rz", tired) < 1e-6
    assert bench.left_by(joint(3), by_speed, "rz", lag) < 1e-6
    assert bench.left_by(joint(3), by_speed, "rz", tired) > 1e-2
    assert bench.left_by(link(2), Driver("angle", 1), "ry", np.cos(np.pi * angle[:, 0])) < 1e-6


def test_a_base_stays_where_its_clearance_lets_it(bench):
    """Its position within the clearance follows the moment only at its ends."""
    c = bench.circumstances
    (by, *_) = tilts(c)
    width = CELLS.clearance[2] * np.std(by.moment[c.fitted])
    order = np.arange(len(c.q)) if c.time is None else np.argsort(c.time, kind="stable")
    place, state = np.zeros(len(order)), 0.0
    last = by.moment[order[0]]
    for row in order:
        state = float(np.clip(state + 2 * (by.moment[row] - last) / width, -1.0, 1.0))
        place[row], last = state, by.moment[row]
    axis = "rx" if abs(by.axis[0]) > 0.5 else "ry"
    assert bench.left_by(BASE, Driver("base moment", form="past"), axis, place) < 1e-6


def test_a_contact_pushes_the_tool_aside_for_the_next_ones(bench):
    c = bench.circumstances
    order = np.arange(len(c.q)) if c.time is None else np.argsort(c.time, kind="stable")
    aside, state = np.zeros(len(order)), 0.0
    for row in order:
        aside[row] = state
        state = CELLS.kept[1] * state + np.nan_to_num(c.approach)[row, 0]
    assert bench.left_by(TOOL, Driver("contact direction", form="past"), "tx", aside) < 1e-9


def test_a_trigger_that_hangs_errs_by_contact_direction_and_gravity(bench):
    cell = bench.pool.cells[bench.number(PROBE, Driver("contact direction", form="and another"))]
    assert {t.frame for own in cell.sets for q in own for t in q.terms} == {CONTACT}


def test_a_kind_of_site_keeps_its_prior_whatever_its_cells_weigh(bench):
    prior = np.exp(bench.pool.log_prior)
    kinds = np.array([q.site.kind for q in bench.pool.cells])
    whole = [q.site == joint(1) and q.weight >= 1 and not q.of_known_effect for q in bench.pool.cells]
    of_joints = prior[np.array(whole)]
    assert np.max(of_joints) == pytest.approx(CELLS.paired * np.min(of_joints))
    ratio = np.sum(prior[kinds == "link"]) / np.sum(prior[kinds == "probe"])
    known = [q.of_known_effect for q in bench.pool.cells if q.site.kind in ("link", "probe")]
    assert not any(known)
    assert ratio == pytest.approx(UNKNOWN.sites["link"] / UNKNOWN.sites["probe"])


# --- Coupled axes: an error of an encoder or a gear on the side of the links, or on that of the readings.


@pytest.fixture(scope="module")
def forms_bench(cube):
    return bench_of(cube, 3, 120)


def test_the_side_of_a_coupled_axis_is_found(forms_bench):
    """Play on the side of the reading of a FANUC's third joint, which is written down without the effect.

    The name, the joint and the side; and what `--model` takes is that very form.
    """
    c = forms_bench.circumstances
    play = Term(3, "rz", -np.sign(c.velocity[:, 2]))
    (member,) = forms_bench.decision(1, forms_bench.of_terms(play, strength=800.0, seed=1)).members
    assert (member.effect, member.variant.site) == ("backlash", "joint 3")
    name = model_name(member, forms_bench.known)
    assert named(name)[1] == "reading"
    own = [p for p in parameters_of((name,), c) if p.site == joint(3) and p.effect != "tool"]
    wanted = member.scale * forms_bench.problem.pool[:, member.variant.columns]
    np.testing.assert_allclose(forms_bench.slopes.columns(own), wanted, atol=1e-12)


def test_an_elevation_of_a_face_is_no_wrong_certificate(forms_bench):
    """A wide one changes the mean height and the slopes of the face, which contradicts the certified ones."""
    face = forms_bench.circumstances.faces[1]
    far = np.sum(((face.place - [0.3, -0.1]) / [0.5, 0.7]) ** 2, axis=1)
    height = Term(CONTACT, "normal", -np.exp(-far / 2) * face.rows)
    decision = forms_bench.decision(1, forms_bench.of_terms(height, strength=150.0, seed=1))
    found = [(m.effect, m.variant.site, m.variant.setting) for m in decision.members]
    assert (decision.kind, found) == ("named", [("plane-form", face.name, "raised")])
    assert decision.probability["artefact"] < 0.05


def test_a_form_that_contradicts_a_certificate_has_a_fifth_of_the_prior_of_a_form(forms_bench):
    share = {}
    for v in forms_bench.known.variants["plane-form"]:
        share[v.setting] = share.get(v.setting, 0.0) + np.exp(v.log_prior)
    assert share["raised"] == pytest.approx(0.2 * SEARCH.other_forms)
    assert sum(share.values()) == pytest.approx(1.0)


def test_gravity_holds_a_joint_on_one_flank(forms_bench):
    """Neither motion alone nor torque alone decides: backlash, where it was hardening of both joints."""
    c = forms_bench.circumstances
    torque = c.torques[:, 4]
    friction = 0.3 * np.quantile(np.abs(torque[c.fitted]), 0.9)
    way = np.sign(c.velocity @ c.robot.link_from_reading[4])
    flank = np.sign(friction * way - torque)
    assert 0.1 < np.mean(flank != way) < 0.9
    decision = forms_bench.decision(1, forms_bench.of_terms(Term(5, "rz", flank), strength=200.0, seed=1))
    (member,) = decision.members
    found = (decision.kind, member.effect, member.variant.site, member.variant.setting)
    assert found == ("named", "backlash", "joint 5", "held-30")
    assert model_name(member, forms_bench.known).startswith("backlash@held-30 at joint 5")


def test_other_forms_share_a_part_of_the_prior(forms_bench):
    """At all joints, and at each joint where the axes are coupled; none where no axes are."""
    for effect, forms in (("backlash", 3), ("encoder-scale", 1)):
        variants = forms_bench.known.variants[effect]
        assert sum(np.exp(v.log_prior) for v in variants) == pytest.approx(1.0)
        other = [v for v in variants if v.setting == "reading"]
        assert [v.site for v in other] == ["", "joint 2", "joint 3"]
        assert sum(np.exp(v.log_prior) for v in other) == pytest.approx(SEARCH.other_forms / forms)
        assert not [v for v in variants if v.setting == "link"]


def test_uncoupled_axes_have_one_form(forms_bench, cube):
    dataset = cube(seed=3, count=120).dataset
    robot = replace(dataset.robot, link_from_reading=np.diag([1.0, 1, -1, -1, -1, -1]))
    c = circumstances(replace(dataset, robot=robot))
    known = candidates(c, BASELINE)
    for effect in ("backlash", "encoder-scale"):
        held = {"held-30", "held-60"} if effect == "backlash" else set()
        assert {v.setting for v in known.variants[effect]} == {None} | held
        assert sum(np.exp(v.log_prior) for v in known.variants[effect]) == pytest.approx(1.0)
    assert all(
        len(cell.sets) == 1
        for cell in cells(c)
        if cell.site.kind == "joint" and str(cell.driver) in ("angle 2", "approach 2", "angle 3")
    )


def test_a_torque_turns_its_own_link(forms_bench):
    """In the cells too, while an angle may turn what the reading moves."""
    of = {(str(cell.site), str(cell.driver)): cell for cell in cells(forms_bench.circumstances)}

    def frames(driver):
        return [{t.frame for p in own for t in p.terms} for own in of["joint 2", driver].sets]

    assert frames("torque 2") == [{2}]
    assert set(map(tuple, frames("past torque 2"))) == {(2,)}
    assert frames("angle 4") == frames("approach 2") == [{2}, {2, 3}]


# --- The variant of a large effect is that which fits best by itself, not by the noise without the effect.


def test_the_chosen_variant_of_an_effect_fits_best_by_itself(tracker):
    """From some thousand on, all joints together looked better than the one that has the effect."""
    bench = Bench.of(tracker(seed=3, count=40).dataset)
    variants = bench.known.variants["encoder-scale"]
    own = next(v for v in variants if v.sites == (joint(2),))
    p = bench.made_up(1, bench.visible(bench.problem.pool[:, own.columns], 30_000.0, 1))
    search = Search(p, bench.known)
    search.hypotheses[frozenset()] = search.hypothesis(())
    search.extend(search.hypotheses[frozenset()], 0.0)
    found = search.hypotheses[frozenset({"encoder-scale"})]
    (member,) = found.members

    def evidence(variant, k):
        scales = np.full(len(variant.columns), SCALES[k])
        return fit_state(p, variant.columns, scales).log_evidence + variant.log_prior + SCALE_PRIOR[k]

    chosen = evidence(member.variant, int(np.flatnonzero(member.scale == SCALES)[0]))
    near = [int(k) for k in np.flatnonzero((member.scale / 2 <= SCALES) & (2 * member.scale >= SCALES))]
    every = [evidence(v, k) for v in variants for k in near]
    assert chosen == pytest.approx(max(every))
    assert chosen <= found.log_evidence + 1e-9 <= float(np.logaddexp.reduce(every)) + 0.1


def test_motion_is_forgotten_with_its_time_constant(dataset):
    """Against a sum over all rows before."""
    c = circumstances(dataset)
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(20.0, 400.0, len(c.q)))
    way = np.abs(np.diff(c.readings, axis=0, prepend=c.readings[:1])).sum(axis=1)
    for constant, found in zip(CELLS.warm, _activity(c, time), strict=True):
        since = time[:, None] - time[None]
        expected = np.where(since >= 0.0, np.exp(-np.maximum(since, 0.0) / constant), 0.0) @ way
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    (ranks,) = _waits(c, time)
    assert np.array_equal(np.argsort(ranks[1:]), np.argsort(np.diff(time)))


def test_a_face_shifts_only_where_contacts_of_it_are_before(bench):
    """Without any before it, a shift is a constant: an error of a certified value."""
    c = bench.circumstances
    face = c.faces[0]
    late = face.rows * (np.arange(len(c.q)) >= c.fitted[len(c.fitted) // 2])
    event = Driver("event")

    def moments(rows):
        faces = (replace(face, rows=rows), *c.faces[1:])
        (cell,) = (
            q for q in cells(replace(c, faces=faces)) if q.site.name == face.name and q.driver == event
        )
        return [np.asarray(p.terms[0].driver) != 0.0 for (p, *_) in cell.sets]

    assert len(moments(late)) < len(moments(face.rows))
    assert all((late[c.fitted] > 0).sum() - m[c.fitted].sum() >= CELLS.few for m in moments(late))


@pytest.mark.parametrize(
    ("site", "frame", "turns"), [("base", 0, 33.4), ("tool", 7, 7.1), ("probe", CONTACT, 20.3)]
)
def test_what_goes_to_and_fro_is_near_a_wave_of_any_rhythm(bench, site, frame, turns):
    """Faster than 20 periods a session too, and at tool and probe; two states are mostly a wave."""
    c = bench.circumstances
    x = np.arange(len(c.q)) if c.time is None else c.time
    state = np.sin(2 * np.pi * turns * x / np.ptp(x[c.fitted]) + 0.4)
    cell = bench.pool.cells[bench.number(Site(site), Driver("time", form="to and fro"))]
    wanted = state if site == "base" else np.sign(state)
    shares = [left_by(cell, axis, wanted, frame) for axis in ({t.axis for t in cell.sets[0][0].terms})]
    assert min(shares) < 0.55


def test_a_defect_at_one_place_of_a_joint_has_a_cell(bench):
    x = bench.circumstances.q[:, 2]
    bump = np.exp(-0.5 * ((x - np.quantile(x, 0.4)) / 0.07) ** 2)
    assert bench.left_by(joint(3), Driver("angle", 3, form="one place"), "rz", bump) < 0.3


def test_an_error_that_jumps_at_an_angle_has_a_cell(bench):
    x = bench.circumstances.readings[:, 3]
    for angle in np.quantile(x[bench.circumstances.fitted], [0.2, 0.45, 0.73]):
        wanted = np.where(x > angle, 1.0, -1.0)
        assert bench.left_by(joint(4), Driver("angle", 4, form="jump"), "rz", wanted) < 0.15


def test_a_tool_that_a_load_has_bent_creeps_back(dataset):
    """What a load has left, forgotten with a time constant, alone and beside the load itself."""
    c = circumstances(dataset)
    load = np.repeat(np.array([0.0, 3.0, 1.0, 0.0]), len(c.q) // 4 + 1)[: len(c.q)]
    c = replace(c, load_mass=1.0 + load, time=20.0 * np.arange(len(c.q)))
    (cell,) = (q for q in cells(c) if (q.site, q.driver) == (TOOL, Driver("load", form="past")))
    lag = np.zeros(len(load))
    for k in range(1, len(lag)):
        lag[k] = np.exp(-20.0 / CELLS.memory[1]) * (lag[k - 1] + load[k - 1] - load[k])
    assert min(left_by(cell, "tx", lag), left_by(cell, "tx", lag + 0.3 * load)) < 1e-9
    assert left_by(cell, "tx", lag + load) < 1e-2


def test_bodies_and_their_pieces_move_and_bend(dataset):
    """A plate that drifts while it is probed, a ball on a stand that bends; the only body has no cells."""
    c = circumstances(dataset)
    rows = (np.arange(len(c.q)) % 3 == 1).astype(float)
    middle = np.zeros(3)
    pieces = (("plate.A", 1.0 - rows, middle), ("plate.A@2", rows, middle))
    c = replace(c, artefacts=(("plate@2", rows, middle),), pieces=pieces)
    of = {(cell.site.name, cell.driver.kind): cell for cell in cells(c)}
    clock = np.arange(len(c.q)) if c.time is None else c.time
    own = c.fitted[rows[c.fitted] > 0]
    u = (clock - clock[own].min()) / np.ptp(clock[own])
    assert left_by(of["plate@2", "time"], "ty", rows * np.cos(np.pi * np.clip(u, 0, 1))) < 1e-9
    assert {t.frame for own in of["plate@2", "time"].sets for p in own for t in p.terms} == {0, CONTACT}
    flange = frames(c.chain, c.q)[:, -1, :3, :3]
    up = np.einsum("nj,nj->n", flange[:, 2], np.where(c.touching[:, None], c.approach, 0.0))
    assert left_by(of["plate.A", "contact direction"], "normal", (1.0 - rows) * (3 * up**2 - 1)) < 1e-9
    assert ("plate.A", "time") not in of  # in placements one after another, a wrong certificate
    # in one placement it moves about its mean, which is one
    moved = [t.driver for some in of["plate.A@2", "time"].sets for p in some for t in p.terms]
    assert np.allclose([np.mean(d[own]) for d in moved], 0.0, atol=1e-12)
    assert left_by(of["plate.A@2", "time"], "tz", rows * np.cos(np.pi * np.clip(u, 0, 1))) < 0.1
    assert ("plate.A@2", "contact direction") not in of  # that of the piece has it
    whole = replace(c, artefacts=(("plate", np.ones(len(c.q)), middle),), pieces=())
    assert not [cell for cell in cells(whole) if cell.site.name == "plate"]


def test_what_wanders_is_drawn_anew_in_blocks_of_rows(bench):
    """Not smoothly with time, and the same for rows that follow one another."""
    c = bench.circumstances
    place = joint(2), Driver("count", form="blocks")
    k = bench.number(*place)
    cell, column = bench.pool.cells[k], bench.columns(k)[:, 0]
    assert np.array_equal(cell.clusters, np.arange(len(c.q)) // CELLS.blocks[0])
    drawn = 2.0 * np.random.default_rng(2).standard_normal(len(c.q))[cell.clusters]
    p = bench.problem
    moved = column.copy()
    moved[: p.count] *= drawn[p.rows[p.contact]]
    null = Search(bench.made_up(4, 3.0 * moved), bench.known).hypothesis(())
    _, _, fits = unknown(null, bench.pool, 0.0)
    best = bench.pool.cells[max((f for f in fits if f.rival), key=lambda f: f.gain).cell]
    assert (best.site, best.driver) == place
