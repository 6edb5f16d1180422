"""What changed between sessions: evidence by brute force, and changes made by hand in one session."""

import csv
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import refused
from influences import check_written
from scipy.stats import multivariate_normal
from sessions import misread, tracker, with_columns, with_rows

import bayescal as bc
from bayescal import changes
from bayescal.arm.motion import Term
from bayescal.changes import changed, linear
from bayescal.changes.joint import AT, Shift, prepared, tied
from bayescal.changes.search import SCALES, Member, averaged, gains, options
from bayescal.dataset.join import joined
from bayescal.effects import UNITS, Parameter
from bayescal.effects.location import BASE, PLACEMENT
from bayescal.model import Scene, standing, with_parameters
from bayescal.programs.text import Target
from bayescal.public.changes import ChangedResult
from bayescal.reporting.changed import (
    _pose,
    changed_page,
    changed_record,
    difference,
    found_from,
    items_csv,
    sized,
    words,
)
from bayescal.reporting.text import with_u

ARM = {"effects": "geometry", "later": 4, "repeats": 0, "spheres": 0, "arm_seed": 3}
SHIFT = 4e-4


def stated(result):
    """Differences that are named, alone or in a class."""
    return [d for d in result.differences if d.stated]


@pytest.fixture(scope="module")
def sessions():
    """Three sessions on one cube that was not touched: parts of one."""
    d = bc.simulate(contacts=120, seed=5, **ARM).dataset
    return tuple(rows_of(d, np.arange(k, 120, 3), name) for k, name in enumerate("ABC"))


def rows_of(d, rows, name):
    """Rows of a session as one of its own; without times and temperatures there are fewer changes to try."""
    return replace(with_columns(with_rows(d, rows), time=None, temperature=None), name=name, sha256=name)


def shifted(session, joint=4, by=SHIFT):
    """A session whose joint reads more than before: its zero has another value."""
    return replace(misread(session, joint, by), sha256=f"{session.sha256}{by}")


@pytest.fixture(scope="module")
def crashed(sessions):
    """What changed where a joint zero shifted before the second session, and at two given poses."""
    a, b, _ = sessions
    far = np.eye(4) + 1e3 * np.eye(4, k=3)
    first = b.measurements.readings[0]
    targets = [Target("t:2", readings=first, payload=0.0, id="grasp"), Target("t:3", pose=far)]
    return changed([a, shifted(b)], ("geometry",), targets=targets)


def test_gravity_stays_where_targets_are_placed_anew():
    """Their place is a displacement of the base, by which gravity would turn in it."""
    scene = Scene(bc.simulate(contacts=24, seed=2, repeats=0, spheres=0).dataset)

    def moments(effect):
        turn = Parameter("rx", "rad", (Term(0, "rx", 1.0),), 1e-2, site=BASE, effect=effect)
        model = with_parameters(scene, (), (turn,))
        return [standing(model, np.array([by])).moments for by in (0.0, 1e-2)]

    still, placed = moments(PLACEMENT)
    np.testing.assert_array_equal(placed, still)
    still, tilted = moments("")
    assert np.max(np.abs(tilted - still)) == pytest.approx(1e-2 * np.max(np.abs(still)), rel=0.5)


def test_columns_integrated_out_have_the_density_of_brute_force():
    rng = np.random.default_rng(0)
    x, by, y = rng.standard_normal((12, 4)), rng.standard_normal((4, 2)), rng.standard_normal(12)
    _, _, found = linear.integrated(x.T @ x, x.T @ y, by)
    wide = np.eye(12) + x @ by @ by.T @ x.T
    expected = multivariate_normal(np.zeros(12), wide).logpdf(y) - multivariate_normal(np.zeros(12)).logpdf(y)
    assert found == pytest.approx(expected)


def test_gains_are_those_of_each_prior_width():
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((9, 3)), rng.standard_normal(9)
    g, s = x.T @ x, x.T @ y
    expected = [linear.integrated(g, s, scale * np.eye(3))[2] for scale in SCALES]
    assert gains(g, s) == pytest.approx(expected)
    assert averaged(gains(g, s)) == pytest.approx(np.log(np.mean(np.exp(expected))))


def test_noise_is_a_factor_on_the_stated_one(sessions):
    """Without the model errors, which the scale of the joint fit contains."""
    d = bc.simulate(contacts=180, seed=5, **{**ARM, "effects": "geometry, backlash"}).dataset
    found = changed([rows_of(d, np.arange(k, 180, 2), name) for k, name in enumerate("AB")], ("geometry",))
    assert found.noise == pytest.approx((1.0, 1.0), abs=0.12)


def once(function, named):
    """A function that is computed once for each of these names of its first argument."""
    done = {}

    def found(first, *others):
        key = named(first)
        if key not in done:
            done[key] = function(first, *others)
        return done[key]

    return found


def test_two_sessions_in_the_other_order_have_the_same_changes_reversed(monkeypatch):
    """An arm that is worn in the first session is no less different from the other."""
    monkeypatch.setattr(changes, "prepared", once(prepared, lambda some: tuple(d.name for d in some)))
    monkeypatch.setattr(changes, "evidence", once(changes.evidence, lambda joint: joint.names))
    monkeypatch.setattr(changes.search, "search", once(changes.search.search, lambda e: e.joint.names))
    arm = {**ARM, "contacts": 50, "seed": 5}
    made = {"new": "geometry", "worn": "geometry, backlash"}
    new, worn = (
        rows_of(bc.simulate(**arm | {"effects": of}).dataset, np.arange(54), name)
        for name, of in made.items()
    )
    way = Target("t:2", readings=new.measurements.readings[0], velocity=np.full(6, 0.1), id="way")
    poses = [way, replace(way, velocity=None, id="still")]
    there, back = (changed(both, ("geometry",), targets=poses) for both in ([new, worn], [worn, new]))
    assert there.verdict == back.verdict == "changed"
    assert there.same == pytest.approx(back.same, rel=1e-6)
    assert [s.name for s in back.sessions] == ["worn", "new"]
    assert back.noise == pytest.approx(there.noise[::-1])
    assert there.distances.largest == pytest.approx(-back.distances.largest)
    assert np.linalg.norm(there.shifts[0].shift) > 1e-5
    assert there.shifts[0].shift == pytest.approx(-back.shifts[0].shift)
    # lost motion of an unknown direction is not in the displacement, which has no U of it
    assert np.all(there.shifts[1].shift == 0.0)
    assert [w.partition(":")[0] for w in there.warnings if "lost motion" in w] == ["pose still"]
    pairs = list(zip(there.differences, back.differences, strict=True))
    for one, other in pairs:
        assert one.item.name == other.item.name
        assert one.difference == pytest.approx(-other.difference)
        assert one.u == pytest.approx(other.u)
        assert (one.before, one.after) == (other.after, other.before)
        assert (one.sessions, other.sessions) == (("worn",), ("new",))
    # lost motion that was repaired became smaller
    sizes = [d for d in stated(back) if d.item.effect == "backlash"]
    assert len(sizes) > 1
    assert all(d.before > abs(d.after) and d.difference < 0 for d in sizes)


def test_nothing_changed_between_sessions_of_one_arm(sessions):
    found = changed(sessions[:2], ("geometry",))
    assert (found.verdict, found.arm) == ("same", "same")
    assert not stated(found)
    assert 0 < next(d for d in found.detectable if d.parameter.name == "theta4").value < SHIFT


def test_model_errors_are_those_that_the_sessions_tell():
    """An error of which the prior's mean is not zero, as of a spring, is none where there is none."""

    def errors(effects):
        d = bc.simulate(contacts=140, seed=5, **{**ARM, "effects": effects}).dataset
        parts = [rows_of(d, np.arange(k, 140, 2), name) for k, name in enumerate("AB")]
        return dict(changed(parts, ("geometry", "compliance")).errors)

    assert errors("geometry, compliance") == {}
    assert set(errors("geometry, compliance, eccentricity")) == {"eccentricity"}


def test_a_joint_zero_that_shifted_is_named_with_its_u(crashed):
    assert (crashed.verdict, crashed.arm) == ("changed", "changed")
    (d,) = stated(crashed)
    assert (d.item.name, d.sessions) == ("theta4", ("B",))
    assert d.difference == pytest.approx(SHIFT, abs=3 * d.u)  # the link turns by minus the reading
    assert d.u < 0.05 * SHIFT
    assert d.after - d.before == pytest.approx(d.difference)
    assert crashed.distances.rms > 3 * crashed.distances.u_rms


def test_a_session_that_alone_differs_is_found_among_three(sessions):
    a, b, c = sessions
    found = changed([a, shifted(b), c], ("geometry",))
    assert [(d.item.name, d.sessions) for d in stated(found)] == [("theta4", ("B",))]
    assert found.distances is None  # the last session has the zero of the first
    of_joint = SimpleNamespace(sessions="ABC", items=[SimpleNamespace(name="x")], scattered=())
    assert {m.sessions for m in options(SimpleNamespace(joint=of_joint))} == {(1, 2), (2,), (0,), (1,)}
    assert Member(0, (0,)).weights(3).tolist() == [-1, -1]


def test_a_cube_that_was_placed_anew_is_not_a_change_of_the_arm(sessions):
    found = changed([sessions[0], bc.simulate(name="B", contacts=60, seed=6, **ARM).dataset], ("geometry",))
    assert (found.verdict, found.arm) == ("changed", "same")
    assert {d.item.name for d in stated(found)} == {"base"}


def test_targets_that_are_described_otherwise_are_not_one_target(sessions):
    a, b, _ = sessions
    moved = [replace(b.targets[0], values=b.targets[0].values | {"offset": 1.0}), *b.targets[1:]]
    joint, placed = tied(joined([a, replace(b, targets=tuple(moved))], own_noise=False))
    assert f"A:{b.targets[0].name}" in {t.name for t in joint.targets}
    assert placed == {t.name for t in b.targets[1:]}
    assert len(joint.targets) == len(a.targets) + 1
    # a certificate of targets that did not move counts once, as one session states it
    assert tied(joined([a, b], own_noise=False))[0].certificates == a.certificates != ()
    assert len(joint.certificates) > len(a.certificates)
    # sessions of other arms and single ones are refused
    refused("needs two sessions", lambda: changed([a], ("geometry",)))
    other = replace(b, robot=replace(b.robot, d=b.robot.d + 1e-3))
    refused("not the robot", lambda: changed([a, other], ("geometry",)))
    with_serial = (replace(d, record=replace(d.record, serials={"arm": s})) for d, s in ((a, "7"), (b, "8")))
    refused("serial number 8, not 7", lambda: changed([*with_serial], ("geometry",)))


def test_poses_are_rows_that_are_not_fitted(crashed):
    m = crashed.dataset.measurements
    assert (m.role[-1], m.ids[-1]) == (AT, f"B:{AT} 1")
    near, far = crashed.shifts
    assert 0 < np.trace(near.covariance) ** 0.5 < np.linalg.norm(near.shift) < 1e-3
    assert np.linalg.norm(near.shift) > 1e-5
    assert (far.shift, far.reason) == (None, "the nominal arm does not reach it")
    assert (near.where, far.where) == ("grasp", "2")


def test_ids_of_a_table_name_its_poses_and_columns_without_use_are_said(crashed, monkeypatch, tmp_path):
    read = []

    def found(*_, targets, **__):
        read.extend(targets)
        return crashed

    monkeypatch.setattr("bayescal.changes.changed", found)
    joints = ",".join(f"j{k}_deg" for k in range(1, 7))
    (tmp_path / "at.csv").write_text(f"id,{joints},fixture\ngrasp,0,0,0,0,0,0,left\n")
    result = bc.changed(crashed.sessions, "geometry", at=tmp_path / "at.csv")
    assert [t.id for t in read] == ["grasp"]
    assert "at.csv: `fixture` states nothing of a target" in result.record["warnings"][-1]


def test_the_result_as_text_page_and_table(crashed, tmp_path):
    result = ChangedResult(crashed)
    assert str(result).splitlines()[2].startswith("Changed from B on: zero of joint 4 (theta4) by")
    assert result.save(tmp_path / "run") == ("changed.json", "changed.html", "changed.csv")
    assert "zero of joint 4" in (tmp_path / "run" / "changed.html").read_text()
    assert (tmp_path / "run" / "changed.csv").read_text().splitlines()[1].startswith("theta4,theta4,geometry")
    record = result.record
    assert record["schema"] == "bayescal-changed/1"
    assert record["items"][0]["U"] == pytest.approx(2 * record["items"][0]["u"])
    assert [p["reason"] for p in record["poses"]] == ["", "the nominal arm does not reach it"]
    assert set(result.detectable.columns) == {"item", "parameter", "site", "unit", "value", "tcp_um"}
    assert result.items["parameter"].tolist()[0] == "theta4"
    # the arm as it is now is that of the last session; a cell of several texts has them apart
    assert "bayescal fit last" in changed_page({**record, "folders": ["first", "last"]})
    several = items_csv({"items": [entry("a3", 0.5, True, sessions=("B", "C of D"))]})
    assert next(csv.DictReader(several.splitlines()))["sessions"] == "B; C of D"


IN_UNITS = {
    r"U$": lambda x: 2.0 * np.concatenate([1e3 * x, np.degrees(x)]),
    r"_um$": lambda x: 1e6 * x,
    r"probability": np.copy,
    r"detectable": lambda x: np.concatenate([factor * x for _, factor in UNITS.values()]),
    r"": lambda x: np.concatenate([1e3 * x, np.degrees(x)]),
}
"""What is written of lengths and angles, by the key: their unit is beside it."""


def test_every_number_of_changes_is_in_their_record_and_in_their_table(crashed):
    fields = {"differences": ("before", "after", "difference", "u", "probability")}
    fields["detectable"] = ("value", "tcp")

    def record(given):
        parts = {
            part: tuple(replace(x, **numbers) for x, numbers in zip(getattr(crashed, part), own, strict=True))
            for part, own in given.items()
        }
        return changed_record(replace(crashed, **parts))

    given = {
        part: [{key: getattr(x, key) for key in keys} for x in getattr(crashed, part)]
        for part, keys in fields.items()
    }
    check_written(record, given, but="", called={}, units=IN_UNITS)
    items = changed_record(crashed)["items"]
    rows = list(csv.DictReader(items_csv({"items": items}).splitlines()))
    assert {"item", "parameter", "unit", *fields["differences"]} <= rows[0].keys()
    for row, item in zip(rows, items, strict=True):
        for key, cell in row.items():
            of_list = isinstance(item[key], list)
            assert cell == ("; ".join(item[key]) if of_list else "" if item[key] is None else str(item[key]))


def entry(name, probability, stated, group=(), sessions=("after",), kind="arm", **more):
    return {
        "item": name, "parameter": name, "effect": "geometry", "site": "joint 3", "kind": kind, "unit": "deg",
        "sessions": list(sessions), "before": 1.0, "after": 1.01, "difference": 0.01, "u": 0.001, "U": 0.002,
        "k": 2.0, "probability": probability, "class": list(group), "stated": stated,
    } | more  # fmt: skip


def said(verdict, items, arm="same", same=0.0):
    usual = {"distances": None, "sessions": ["before", "after"], "detectable": [], "model": ["geometry"]}
    probability = {"same": same, "arm_same": 1.0}
    return words(usual | {"verdict": verdict, "arm": arm, "probability": probability, "items": items})


def test_the_words_of_a_verdict():
    words = "No change was found. That nothing changed has a probability of 90 %."
    assert said("same", [], same=0.9) == [words]
    pair = ("theta3", "a3")
    both = [entry(name, p, True, pair) for name, p in zip(pair, (0.6, 0.39), strict=True)]
    (told,) = said("changed", both, arm="changed")
    assert told.startswith("Changed from after on: zero of joint 3 (theta3) by 10.0(1.0) mdeg or ")
    assert told.endswith("these sessions do not tell which.")
    base = entry("base", 1.0, True, kind="setup", site="base")
    assert said("changed", [base])[1] == "The arm itself did not change (probability > 99 %)."
    assert "Possible: zero of joint 3 (theta3) (40 %)" in said("ambiguous", [entry("theta3", 0.4, False)])[0]


def test_what_would_have_been_found_is_a_range_of_what_is_visible():
    """Of each kind of parameters, from the least to the most; invisible ones have no size, and are named."""

    def found(**tcp):
        each = [
            {"item": name, "parameter": name, "effect": "geometry", "site": f"joint {k}", "unit": "deg",
             "value": um and 1e-3, "tcp_um": um}
            for k, (name, um) in enumerate(tcp.items(), 1)
        ]  # fmt: skip
        return found_from({"detectable": each, "items": [], "model": ["geometry"]})

    seen, unseen = found(theta1=7.0, theta2=3.0, theta3=None, theta4=5.0)
    assert seen.endswith("moved the TCP by: joint zeros 3 to 7 µm.")
    assert unseen == "Not visible in these sessions: theta3."
    assert found(theta1=4.0)[0].endswith("joint zeros 4 µm.")
    assert found(theta1=None) == ["Not visible in these sessions: theta1."]


@pytest.mark.parametrize(
    ("change", "u"), [((0.3, 0.4), (0.01, 0.05)), ((0.5, 0.0, 0.0), (0.02, 0.3, 0.3)), ((0.2,), (0.01,))]
)
def test_the_length_of_a_change_has_the_u_along_it(change, u):
    """That of the derivatives of the length, in the unit of print."""
    entries = [{"unit": "mm", "difference": d, "u": s} for d, s in zip(change, u, strict=True)]
    steps = 1e-6 * np.eye(len(change))
    slopes = [(np.linalg.norm(change + h) - np.linalg.norm(change - h)) / 2e-6 for h in steps]
    length = np.linalg.norm(np.array(slopes) * u)
    assert sized(entries) == f"{with_u(1e3 * np.linalg.norm(change), 1e3 * length)} µm"


def test_the_expanded_uncertainty_of_a_displacement_is_that_of_its_vector():
    """Twice the root mean square length of its errors, along whatever axes they are."""
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    for u in ([3e-5, 0.0, 0.0], [2e-5, 2e-5, 2e-5], [1e-5, 2e-5, 4e-5]):
        along = turn * u
        errors = along @ rng.standard_normal((3, 20_000))
        pose = _pose(Shift("1", np.array([1e-3, 2e-3, 2e-3]), along @ along.T))
        assert pose["length_um"] == pytest.approx(3000.0)
        assert pose["U_um"] == pytest.approx(2e6 * np.sqrt(np.mean(np.sum(errors**2, axis=0))), rel=0.03)


def test_the_tool_of_one_session_alone_has_no_change(sessions):
    """A tool that was remounted is measured in one session: there is nothing to compare it with."""
    a, b, _ = sessions
    effects = {d.item.effect for d in changed([a, b], ("geometry",), remounted=True).detectable}
    assert "geometry" in effects
    assert "tool" not in effects


@pytest.mark.parametrize(("value", "u", "text"), [
    (1.1009, 0.0075, "+1101 ± 15 µm"),
    (0.0387, 0.001, "+38.7 ± 2.0 µm"),
    (-2.0, 0.08, "-2000 ± 160 µm"),
    (0.00001, 0.001, "0.0 ± 2.0 µm"),
])  # fmt: skip
def test_a_difference_has_the_decimals_of_its_expanded_uncertainty(value, u, text):
    assert difference({"difference": value, "u": u, "unit": "mm"}) == text


def test_an_arm_far_from_nominal_is_no_change(monkeypatch):
    """Its widths are told by both sessions; with the stated ones its residuals are many times the noise."""
    one, model = tracker(seed=0, count=80, noise=1e-4, spread=12.0).dataset, ("geometry", "compliance")
    parts = [rows_of(one, np.flatnonzero(np.arange(80) % 2 == k), name) for k, name in enumerate("AB")]
    found = prepared(parts, model).estimate
    assert max(found.weights.scale.values()) < 1.5
    (theta3,) = (p for p in found.model.parameters if p.name == "theta3" and p.effect == "geometry")
    assert theta3.sd > 3 * 2e-3
    # a change has the stated prior
    assert max(p.sd for p in found.model.parameters if p.effect == "change" and p.unit == "rad") < theta3.sd
    monkeypatch.setattr("bayescal.changes.joint.with_widths", lambda found, _, __, options: (found, options))
    assert max(prepared(parts, model).estimate.weights.scale.values()) > 3
