"""Blind spots against refits of sessions that have the effect; advice against whole problems built anew."""

import csv
import io
import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import camera_session
from gap_diagnoses import diagnosis
from gap_problems import BASELINE
from sessions import circumstances, with_columns

from bayescal.effects import EFFECTS
from bayescal.estimate import Estimate, estimate, solve
from bayescal.gap import advise as advising
from bayescal.gap import candidate_contacts
from bayescal.gap.advise import blind_spots, distances, located, next_contacts, seats, unseen
from bayescal.gap.candidate_contacts import AGAIN, SPHERES, contacts_of, possibilities, stated_masses
from bayescal.gap.linear.evidence import project
from bayescal.gap.linear.problem import problem
from bayescal.gap.linear.state import fit_state
from bayescal.gap.result import Advice
from bayescal.gap.search.beam import Member, Search
from bayescal.gap.search.candidates import Single, candidates, extended, with_own_settings
from bayescal.gap.settings import DESIGN
from bayescal.model import ARM, Model, build
from bayescal.model.scene import Scene
from bayescal.reporting.gap import first_contacts, table_of_contacts
from bayescal.reporting.gap.record import contact_records, gap_record, write_gap
from bayescal.simulation import Options, simulate

NONE = np.empty(0, int), np.empty(0)


class Session:
    def __init__(self, dataset):
        self.dataset, self.fitted = dataset, estimate(build(Scene(dataset), BASELINE), robust=False)
        self.scene = self.fitted.model.scene
        self.known = candidates(circumstances(self.scene), BASELINE)
        self.problem = problem(self.fitted, self.known.pool)
        self.state = fit_state(self.problem, *NONE, robust=False)
        self.search = Search(self.problem, self.known)
        beside = problem(self.fitted, self.known.pool, stated_masses(self.fitted))
        self.with_masses = Search(beside, self.known)

    def refit(self, dataset) -> Estimate:
        """Of another session, at the noise as it was."""
        model = build(Scene(dataset), BASELINE)
        return replace(self.fitted, model=model, z=solve(model, self.fitted.weights, self.fitted.z)[0])

    def linear(self, columns) -> np.ndarray:
        """Errors of distances by columns of the pool."""
        used = np.array(columns)
        seen = project(self.state, self.problem.pool[:, used])
        return distances(self.fitted, [self.known.pool[k] for k in used], used, seen)

    def rival(self, *named):
        """The same as `hypothesis`, beside errors of the stated masses."""
        return self.hypothesis(*named, search=self.with_masses)

    def possible(self, words, *rivals):
        """The intervention that has the words, to tell some hypotheses from each other."""
        every = possibilities(self.fitted, self.known, [m for h in rivals for m in h.members])
        return next(v for v in every if words in v.what)

    def hypothesis(self, *named, search=None):
        """Effects, each at a site ("" for all)."""
        members = []
        for effect, site in named:
            own = self.known.variants[effect]
            members.append(Member(next(v for v in own if v.site == site or len(own) == 1), 1.0, 0.0))
        return (search or self.search).hypothesis(members)


@cache
def spheres() -> Session:
    """A little session with spheres to validate."""
    options = Options(contacts=100, later=0, repeats=0, placements=1, sphere_contacts=8, seed=3)
    return Session(simulate(options).dataset)


@pytest.fixture(scope="module")
def cubes(cube):
    return Session(cube(seed=1, count=160).dataset)


def states(s: Session) -> dict[int, tuple]:
    """Kind and z of every target, as fitted or as found."""
    model, out = s.fitted.model, {}
    wide = Model(s.scene, BASELINE, model.parameters, (), ())
    values = model.deviations(s.fitted.z[model.slices[ARM]])
    for t, item in enumerate(s.dataset.targets):
        if item.name in model.block_of:
            out[t] = model.block_of[item.name].kind, s.fitted.z[model.slices[item.name]]
        else:
            block, z = located(s.fitted, wide, t, values)
            out[t] = block.kind, z
    return out


def with_effect(s: Session, parameter, size: float):
    """The session as it would be with an effect: the arm goes on until every contact is as it was."""
    model, m = s.fitted.model, s.dataset.measurements
    at = model.deviations(s.fitted.z[model.slices[ARM]])
    found, out = states(s), s.dataset
    wanted = np.zeros(len(m.ids))
    for step in range(3):
        scene = Scene(out)
        own = build(scene, BASELINE).parameters
        extra, values = ((parameter,), np.append(at, size)) if step else ((), at)
        wide, readings = Model(scene, BASELINE, (*own, *extra), (), ()), out.measurements.readings.copy()
        for t, (kind, z) in found.items():
            rows = np.flatnonzero(m.target == t)
            block = wide.block(t, rows)
            block = replace(block, kind=replace(kind, radius=block.kind.radius))
            r = block.residual(values, z)[0]
            if not step:
                wanted[rows] = r
                continue
            by = block.by_readings(values, z, s.dataset.robot.link_from_reading)
            by[:, 3:] = 0.0
            readings[rows] -= by * ((r - wanted[rows]) / np.sum(by**2, axis=1))[:, None]
        out = with_columns(out, readings=readings)
    return out


def certified(fitted: Estimate) -> np.ndarray:
    model = fitted.model
    wide = Model(model.scene, model.effects, model.parameters, (), ())
    values = model.deviations(fitted.z[model.slices[ARM]])
    centre = {}
    for t, item in enumerate(model.scene.dataset.targets):
        if item.kind == "sphere":
            block, z = located(fitted, wide, t, values)
            centre[item.name] = block.kind.centre + block.state(z)[:3]
    pairs = [c.targets for c in model.scene.dataset.certificates if c.kind == "distance"]
    return np.array([np.linalg.norm(centre[a] - centre[b]) for a, b in pairs])


@pytest.mark.parametrize(
    "name", ["bending J2 link z", "backlash J2", "eccentricity J1 sin", "ball-radius ball", "lobing cos"]
)
def test_distances_of_spheres_err_as_after_a_refit(name):
    s = spheres()
    k = next(k for k, p in enumerate(s.known.pool) if p.name == name)
    parameter = s.known.pool[k]
    moved = certified(s.refit(with_effect(s, parameter, parameter.sd))) - certified(s.fitted)
    assert np.sqrt(np.mean(moved**2)) > 1e-7
    np.testing.assert_allclose(moved, s.linear([k])[:, 0], atol=0.05 * np.max(np.abs(moved)))


def test_a_wrong_paper_moves_distances_as_after_a_refit():
    s = spheres()
    k = next(k for k, p in enumerate(s.known.pool) if p.name.startswith("artefact") and p.unit == "m")
    sd = s.known.pool[k].sd  # true minus certified: the truth stays, the paper is wrong
    papers = tuple(
        replace(c, distance=c.distance - sd) if c.kind == "parallel" else c for c in s.dataset.certificates
    )
    moved = certified(s.refit(replace(s.dataset, certificates=papers))) - certified(s.fitted)
    np.testing.assert_allclose(moved, s.linear([k])[:, 0], atol=0.05 * np.max(np.abs(moved)))


def test_without_spheres_distances_between_points_are_told(cubes):
    k = next(k for k, p in enumerate(cubes.known.pool) if p.name == "encoder-scale J2")
    parameter = cubes.known.pool[k]
    there = with_effect(cubes, parameter, parameter.sd)
    fitted, scene = cubes.refit(there), Scene(there)
    old, new = cubes.fitted.model, fitted.model
    rows = scene.rows("calibrate")
    wide = Model(scene, BASELINE, (*new.parameters, parameter), (), ())
    values = np.append(old.deviations(cubes.fitted.z[old.slices[ARM]]), parameter.sd)
    believed = new.motion(rows).points(new.deviations(fitted.z[new.slices[ARM]]))
    true = wide.motion(rows).points(values)
    a, b = np.triu_indices(len(rows), 1)
    apart = [np.linalg.norm(p[:, a] - p[:, b], axis=0) for p in (believed, true)]
    error = (apart[0] - apart[1])[apart[1] > 50e-3]
    told = np.sqrt(np.mean(cubes.linear([k]) ** 2))
    assert np.sqrt(np.mean(error**2)) == pytest.approx(told, rel=0.2)


def test_the_smallest_amplitude_that_is_named():
    s = spheres()
    spots = blind_spots(s.fitted, s.known, s.state, ("lobing",))
    assert {b.effect for b in spots} == set(s.known.variants) - {"lobing"}
    assert len(spots) == len({b.effect for b in spots})
    errors = [b.distance_error for b in spots]
    assert errors == sorted(errors, reverse=True)
    assert all(np.isfinite(e) for e in errors)
    assert unseen(spots)
    assert set(unseen(spots)) == {b for b in spots if b.smallest > b.plausible}
    p, count = s.problem, s.problem.count
    white = np.ones(len(p.residual))
    white[:count] /= s.state.kappa
    # the prior as rows: least squares of the columns on all that the model absorbs
    j = np.vstack([p.jacobian * white[:, None], np.eye(len(p.z))])
    for spot in spots:
        place = spot.effect, spot.site, spot.unit
        site = next(t for t in seats(s.known) if (t.effect, t.site, t.unit) == place)
        x = np.vstack([p.pool[:, site.columns] * white[:, None], np.zeros((len(p.z), len(site.columns)))])
        left = x - j @ np.linalg.lstsq(j, x, rcond=None)[0]
        strength = np.sum(left**2)
        if strength > 1e-8 * np.sum(x**2):
            assert (spot.smallest / spot.plausible) ** 2 * strength == pytest.approx(DESIGN.named, rel=1e-3)
        sd = [s.known.pool[k].sd for k in site.columns]
        assert min(sd) * (1.0 - 1e-9) <= spot.plausible <= max(sd) * (1.0 + 1e-9)
        # the error of distances where all parameters of the site are drawn from their priors
        drawn = np.random.default_rng(0).standard_normal((4000, len(site.columns)))
        off = drawn @ s.linear(site.columns).T
        assert spot.distance_error == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.05)


def test_what_is_named_no_longer_hides_and_absorbs():
    s = spheres()
    h = s.hypothesis(("bending", ""))
    free = {b.effect: b for b in blind_spots(s.fitted, s.known, s.state)}
    beside = {b.effect: b for b in blind_spots(s.fitted, s.known, h.state, h.names)}
    assert "bending" not in beside
    alike = [n for n in beside if (beside[n].site, beside[n].unit) == (free[n].site, free[n].unit)]
    assert len(alike) > 3
    assert all(beside[n].smallest >= 0.999 * free[n].smallest for n in alike)


def brute(s: Session, dataset, true, rival) -> float:
    """Lambda of what `true` has beyond its rival, all contacts counting: dense least squares."""
    scene = Scene(dataset)
    model, old = build(scene, BASELINE), s.fitted.model
    found = {s.dataset.targets[t].name: (kind, z) for t, (kind, z) in states(s).items()}
    z, sigma = np.zeros(model.size), {}
    z[model.slices[ARM]] = s.fitted.z[old.slices[ARM]]
    for b in model.blocks:
        kind, at = found[b.target]
        physical = np.zeros(len(kind.sd))
        physical[kind.sd > 0] = at * kind.sd[kind.sd > 0]
        z[model.slices[b.target]] = physical[b.free] / b.sd
        sigma[b.target] = np.tile(b.sigma, b.kind.rows)
    row = {b.target: np.ones(len(b.rows)) for b in model.blocks}
    scale = {b.group: 1.0 for b in model.blocks}
    weights = replace(s.fitted.weights, sigma=sigma, row=row, scale=scale)
    moved = replace(s.fitted, model=model, z=z, weights=weights)
    known = candidates(scene.circumstances(s.scene.rows("calibrate")), BASELINE)
    beyond = [m for m in true.members if m.effect not in rival.names]
    at = np.concatenate([m.variant.columns for m in beyond])
    keep = [np.full(len(m.variant.columns), m in beyond) for m in true.members]
    masses = {p.name: p for p in stated_masses(moved)}
    same = [masses[p.name] for p in stated_masses(s.fitted)]
    p = problem(moved, [known.pool[k] for k in (*rival.state.columns, *at)], same)
    white = np.ones(len(p.residual))
    white[: p.count] = 1.0 / rival.state.kappa
    free = len(rival.state.columns)
    j = np.column_stack([p.jacobian, p.pool[:, :free] * rival.state.scales]) * white[:, None]
    x = (p.pool[:, free:] * white[:, None]) @ true.state.amplitudes[np.concatenate(keep)]
    j, x = np.vstack([j, np.eye(j.shape[1])]), np.append(x, np.zeros(j.shape[1]))
    return float(np.sum((x - j @ np.linalg.lstsq(j, x, rcond=None)[0]) ** 2))


@pytest.mark.parametrize(
    "what", [AGAIN, "kg additional", "both directions", "times the speed", "cold start", SPHERES]
)
def test_lambda_grows_as_if_the_contacts_had_been_made(what):
    s = spheres()
    true, rival = (s.rival(("bending", "link 2"), ("backlash", "")), s.rival(("encoder-scale", "joint 2")))
    interventions = possibilities(s.fitted, s.known, [*true.members, *rival.members])
    intervention = next(v for v in interventions if what in v.what)
    side = intervention.side(true, rival)
    before = side.strength
    order, after = advising.choose([side], intervention.contact, intervention.pose, 12)
    assert len({int(intervention.pose[k]) for k in order}) == 12
    if what == SPHERES:
        dataset, rows = s.dataset, intervention.pose
    else:
        dataset, appended = candidate_contacts.widened(s.scene, np.unique(interventions[0].pose))
        rows = next(v.rows for v in appended if what in v.what)
    chosen = rows[order]
    role = dataset.measurements.role.copy()
    role[chosen] = "calibrate"
    grown = with_columns(dataset, role=role)
    if what == SPHERES:  # the other contacts of those spheres are none the fit has
        assert any(b.target.startswith("ball") for b in build(Scene(grown), BASELINE).blocks)
    assert brute(s, s.dataset, true, rival) == pytest.approx(before, rel=1e-6)
    assert brute(s, grown, true, rival) == pytest.approx(after, rel=2e-2)
    assert after > before


def test_the_first_contact_is_the_best_of_all():
    s = spheres()
    a, b = s.rival(("bending", "link 2")), s.rival(("encoder-scale", "joint 2"))
    intervention = s.possible("kg", a, b)
    reached = []
    for k in range(len(intervention.pose)):
        ends = []
        for pair in ((a, b), (b, a)):
            side = intervention.side(*pair)
            for row in np.flatnonzero(intervention.contact == k):
                side.add(np.array([row]))
            ends.append(side.strength)
        reached.append(min(ends))
    both = [intervention.side(a, b), intervention.side(b, a)]
    order, after = advising.choose(both, intervention.contact, intervention.pose, 1)
    assert order == [int(np.argmax(reached))]
    assert after == pytest.approx(max(reached))


def large(h, size=3.0):
    """The same hypothesis, at three times the prior's size."""
    own = len(h.state.step) - len(h.state.columns)
    step = np.append(h.state.step[:own], np.full(len(h.state.columns), size))
    return replace(h, state=replace(h.state, step=step))


def test_more_load_tells_a_bent_link_and_turning_tells_play(cubes, monkeypatch):
    bent, scaled = large(cubes.rival(("bending", "link 2"))), large(cubes.rival(("encoder-scale", "joint 2")))
    wave, play = (cubes.rival((name, "joint 4")) for name in ("eccentricity", "backlash"))
    wave, play = large(wave), large(play, 1.0)
    none = cubes.rival()
    pairs = [(bent, scaled), (play, wave), (wave, none)]
    found = advising.advise(cubes.fitted, cubes.known, pairs)
    load = next(a for a in found if a.separates == ("bending", "encoder-scale"))
    assert "kg additional" in load.what
    assert load.lambda_after > 3 * load.lambda_before
    assert len(load.poses) == DESIGN.contacts
    readings = {tuple(r) for r in cubes.dataset.measurements.readings.tolist()}
    assert set(load.poses) <= readings
    assert any(a.separates == ("eccentricity", "noise only") for a in found)
    assert any("both directions" in a.what for a in found if a.separates[0] == "backlash")
    small = tuple(replace(h, state=replace(h.state, step=1e-4 * h.state.step)) for h in (bent, scaled))
    for equal in ([small], [], [(none, none)]):
        assert advising.advise(cubes.fitted, cubes.known, equal) == ()
    most = max(a.lambda_after - a.lambda_before for a in found)
    assert most + 0.1 < max(a.lambda_after for a in found)
    monkeypatch.setattr(advising, "DESIGN", replace(DESIGN, least=most + 0.1))
    assert advising.advise(cubes.fitted, cubes.known, pairs) == ()


def test_turning_leaves_the_ball_where_it_is(cubes):
    rows = cubes.scene.rows("calibrate")[:20]
    start = cubes.scene.points[rows]
    for way in candidate_contacts.turns(cubes.scene, rows):
        assert np.all(np.linalg.norm(way, axis=1) > 0)
        m = cubes.dataset.measurements
        step = 1e-6 * way / np.linalg.norm(way, axis=1, keepdims=True)
        readings = m.readings.copy()
        readings[rows] += step
        after = Scene(with_columns(cubes.dataset, readings=readings)).points[rows]
        assert np.max(np.abs(after - start)) < 1e-10


def test_points_of_an_instrument_are_judged_too(tracker):
    s = Session(tracker(seed=2, count=60).dataset)
    spots = blind_spots(s.fitted, s.known, s.state)
    assert spots
    assert all(b.distance_error >= 0 for b in spots)
    a, b = s.rival(("bending", "link 2")), s.rival(("encoder-scale", "joint 2"))
    intervention = s.possible(AGAIN, a, b)
    side = intervention.side(a, b)
    _, after = advising.choose([side], intervention.contact, intervention.pose, 10_000)
    assert after > 1.5 * intervention.side(a, b).strength
    assert advising.advise(s.fitted, s.known, [(large(a), large(b))])


def test_contacts_are_advised_where_several_shifts_are_an_explanation():
    s, step = spheres(), EFFECTS["step"]
    singles = extended(s.known, step, [30.0, 70.0], circumstances(s.scene))
    places = [v.places[0] for v in singles.variants["step"]]
    choice = [Single(row, *place) for row, place in zip((30.0, 70.0), places, strict=True)]
    known = with_own_settings(singles, step, [choice], 100)
    *each, both = (Member(v, 1.0, 0.0) for v in known.variants["step"])
    wanted, found = possibilities(s.fitted, known, each), possibilities(s.fitted, known, [both])
    assert len(found) == len(wanted) > 1
    for a, b in zip(wanted, found, strict=True):
        assert np.array_equal(a.used, b.used)
        assert np.array_equal(a.pool, b.pool)


# --- Contacts that are advised can be sent: target, readings, motion, payload; repeats say what they repeat.


def advised(dataset, what, velocity=None, payload=None):
    """Advice of three contacts at the rows 7, 2 and 30 of a session."""
    rows = np.array([2, 7, 11, 30])
    chosen = SimpleNamespace(what=what, pose=rows, velocity=velocity, payload=payload, measured=False)
    contacts = next_contacts(dataset, chosen, [1, 0, 3])
    own = Advice(("bending", "coupling"), what, (), 1.0, 9.0, contacts)
    return SimpleNamespace(dataset=dataset, advice=(own,)), rows[[1, 0, 3]]


def tabulated(gap):
    """Contacts of the only advice, as in gap.json, and rows of their file."""
    contacts = contact_records(gap.advice[0], 1, gap.dataset.robot)
    return contacts, list(csv.DictReader(io.StringIO(table_of_contacts(contacts))))


@pytest.fixture(scope="module")
def dataset(cube):
    return cube(seed=1).dataset


def test_a_repeat_is_the_contact_of_the_session(dataset):
    m = dataset.measurements
    gap, rows = advised(dataset, AGAIN, m.velocity[[2, 7, 11, 30]])
    contacts, table = tabulated(gap)
    assert [t["id"] for t in table] == ["next-1-001", "next-1-002", "next-1-003"]
    assert [t["repeat_of"] for t in table] == [m.ids[r] for r in rows]
    assert [t["target"] for t in table] == [dataset.targets[m.target[r]].name for r in rows]
    joints = range(1, dataset.robot.n + 1)
    read = [[float(t[f"j{k}_deg"]) for k in joints] for t in table]
    np.testing.assert_allclose(read, np.degrees(m.readings[rows]), atol=1e-6)
    moved = [[float(t[f"j{k}_degps"]) for k in joints] for t in table]
    np.testing.assert_allclose(moved, np.degrees(m.velocity[rows]), atol=1e-6)
    signs = ["".join("-0+"[1 + int(sign)] for sign in np.sign(v)) for v in m.velocity[rows]]
    assert [str(row[-1]) for row in first_contacts(contacts).rows] == signs
    assert "payload_kg" not in table[0]


@pytest.mark.parametrize("payload", [2.0, 0.75, 1.2345, 0.0, 12.5])
def test_a_changed_condition_is_no_repeat(dataset, payload):
    velocity = -dataset.measurements.velocity[[2, 7, 11, 30]]
    gap, _ = advised(dataset, "more payload", velocity, np.full(4, payload))
    contacts, table = tabulated(gap)
    assert {t["repeat_of"] for t in table} == {""}
    assert [float(t["payload_kg"]) for t in table] == [payload] * 3
    assert json.loads(json.dumps(contacts[0]))["payload_kg"] == payload
    assert len(first_contacts(contacts).rows) == 3


def test_the_file_is_written_where_contacts_are_advised(dataset, tmp_path):
    told, _ = advised(dataset, AGAIN, dataset.measurements.velocity[[2, 7, 11, 30]])
    for folder, advice in ((tmp_path / "none", ()), (tmp_path / "three", told.advice)):
        gap = replace(diagnosis(dataset), advice=advice)
        names = write_gap(gap, folder, gap_record(gap), pictures=False)
        assert ("next.csv" in names) == (folder / "next.csv").exists() == bool(advice)
    rows = list(csv.DictReader(io.StringIO((folder / "next.csv").read_text(encoding="utf-8"))))
    assert [row["id"] for row in rows] == ["next-1-001", "next-1-002", "next-1-003"]


def test_residuals_of_a_contact_at_once_are_as_one_after_another():
    rng = np.random.default_rng(2)
    design, root = rng.standard_normal((20, 5)), rng.standard_normal((5, 5))

    def side():
        return candidate_contacts.PairSide(1.0, root @ root.T, np.full(5, 0.3), design, np.arange(20.0))

    one, other, rows = side(), side(), np.array([2, 7, 8, 19])
    one.add(rows)
    for row in rows:
        other.add(np.array([row]))
    for name in ("strength", "covariance", "variance", "error"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-10)
    assert one.strength > 1.0


def test_an_image_is_one_contact_with_all_its_corners():
    scene = Scene(camera_session(images=6, velocity=False))
    rows = np.arange(48, 120)
    number, first = contacts_of(scene, np.tile(rows, 2))
    np.testing.assert_array_equal(number, np.repeat(np.arange(6), 24))
    np.testing.assert_array_equal(first, np.arange(0, 144, 24))
    assert scene.in_images.all()
    plain = spheres().fitted.model.scene
    number, first = contacts_of(plain, np.arange(12))
    np.testing.assert_array_equal(number, np.arange(12))
    assert not plain.in_images.any()


def test_corners_of_an_image_need_not_be_together_in_the_session():
    session = camera_session(images=5, velocity=False)
    m = session.measurements
    mixed = np.random.default_rng(3).permutation(len(m.ids))
    rows = {k: getattr(m, k)[mixed] for k in ("readings", "pixel", "stop")}
    session = with_columns(session, ids=tuple(np.array(m.ids)[mixed]), **rows)
    found = estimate(build(Scene(session), ("geometry",)))
    chosen = candidate_contacts._poses(found)
    number, first = contacts_of(found.model.scene, chosen)
    assert len(first) == 5
    assert len(chosen) == 5 * 24 - len(found.rejected)
    readings = session.measurements.readings[chosen]
    np.testing.assert_array_equal(readings, readings[first][number])
