"""The history of an arm: trends and steps by brute force, and runs of sessions with a zero that shifted."""

import csv
import re
from dataclasses import replace
from datetime import date, timedelta

import numpy as np
import pytest
from cases import refused
from influences import check_written

import bayescal as bc
from bayescal.changes import history as module
from bayescal.changes.history import STEP, TREND, _reduced, _search
from bayescal.dataset.join import arm_difference
from bayescal.errors import BayescalError
from bayescal.fitted.file import read_arm
from bayescal.reporting.history import _panel, history_record, size

ARM = {"effects": "geometry", "contacts": 50, "later": 2, "repeats": 0, "spheres": 0, "arm_seed": 3}
DATES = ("2025-01-01", "2025-02-10", "2025-12-31")


def test_constants_are_integrated_out_as_by_generalised_least_squares():
    """Four runs of three parameters, a prior of one on the constants, and two patterns of change."""
    rng = np.random.default_rng(0)
    roots, values = rng.standard_normal((4, 3, 3)), rng.standard_normal((4, 3))
    told = [(r @ r.T, r @ r.T @ v) for r, v in zip(roots, values, strict=True)]
    patterns = np.array([[-0.5, -0.1, 0.2, 0.5], [0, 0, 1, 1]])
    g, s = _reduced(told, patterns)
    # measurements R'v = R'(constant + sum of patterns x amplitude) + noise of one
    each = zip(roots, patterns.T, strict=True)
    design = np.concatenate([r.T @ np.kron(np.append(1.0, f), np.eye(3)) for r, f in each])
    y = np.concatenate([r.T @ v for r, v in zip(roots, values, strict=True)])
    wide = np.eye(12) + design[:, :3] @ design[:, :3].T
    by = design[:, 3:]
    np.testing.assert_allclose(g, by.T @ np.linalg.solve(wide, by))
    np.testing.assert_allclose(s, by.T @ np.linalg.solve(wide, y))


def test_what_the_measurements_of_a_run_tell_is_free_of_its_prior(runs):
    """Of a linear model of known information and score, solved under another prior than the last."""
    arm, rng = read_arm(runs / "run-0"), np.random.default_rng(2)
    own = tuple(replace(p, sd=2.0 * p.sd, mean=p.nominal + 0.3 * p.sd) for p in arm.model.parameters)
    last = {p.name: p for p in arm.model.parameters}
    model, count = replace(arm.model, parameters=own), len(own)
    root = rng.standard_normal((count, count))
    told, score = root @ root.T, rng.standard_normal(count)  # of x, in units of the priors of `last`
    unit = np.array([p.sd for p in last.values()])
    centre = np.array([p.centre - p.nominal for p in last.values()])
    precision = np.diag((unit / model.sd) ** 2)
    posterior = np.linalg.inv(told + precision)
    x = posterior @ (score + precision @ ((model.shift - centre) / unit))
    covariance = posterior * np.outer(unit, unit)
    run = replace(arm, model=model, values=centre + unit * x, covariance=covariance, solved=covariance)
    found = module._information(module.Entry("run", run, ""), list(last), last)
    np.testing.assert_allclose(found[0], told, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found[1], score, rtol=1e-6, atol=1e-6)
    with pytest.raises(BayescalError, match="earlier version"):
        module._information(module.Entry("run", replace(arm, solved=None), ""), list(last), last)


def test_a_parameter_has_one_trend_or_step_and_chance_none():
    rng = np.random.default_rng(1)
    g = np.diag(np.full(6, 1e4))
    noise = 1e2 * rng.standard_normal(6)
    assert _search(g, noise, 3, 2)[0] == []
    chosen, odds = _search(g, noise + 1e4 * np.array([0, 0.2, 0, 0, 0.3, 0]), 3, 2)
    assert chosen == [4]  # the second parameter's step; its trend is then no candidate
    assert odds[4] > 10
    assert np.isneginf(odds[1])


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Three runs of one arm with dates; in the last two its fourth joint reads more than before."""
    folder = tmp_path_factory.mktemp("arm")
    for k, day in enumerate(DATES):
        d = bc.simulate(name=f"s{k}", seed=k, **ARM).dataset
        m = d.measurements
        readings = m.readings + (5e-4 * np.eye(6)[3] if k > 0 else 0.0)
        record = replace(d.record, date=day, serials={"arm": "7"})
        d = replace(d, record=record, sha256=str(k), measurements=replace(m, readings=readings))
        bc.fit(d, "geometry", samples=0).save(folder / f"run-{k}", pictures=False)
    return folder


def test_a_step_is_found_in_the_order_of_the_dates(runs, tmp_path):
    result = bc.history(runs, limit_mm=1.0)
    record = result.record
    assert [r["date"] for r in record["runs"]] == list(DATES)
    assert (record["serial"], record["time_unit"], record["limit"]) == ("7", "day", None)
    assert any("no time follows at which the limit" in note for note in record["notes"])
    (step,) = [p for p in record["parameters"] if p["change"]]
    assert (step["name"], step["change"], step["from_run"]) == ("theta4", "step", "run-1")
    assert step["size"] == pytest.approx(np.degrees(5e-4), abs=2 * step["U"])
    assert step["U"] == pytest.approx(2.0 * step["u"])
    assert result.save(tmp_path / "out") == ("history.json", "history.html", "history.csv")
    assert "<svg" in (tmp_path / "out" / "history.html").read_text()
    count = len(record["parameters"])
    assert str(result).splitlines()[2] == f"1 of {count} parameters changed over 3 sessions."
    rows = list(csv.DictReader((tmp_path / "out" / "history.csv").read_text().splitlines()))
    assert len(rows) == 3 * len(record["parameters"])
    for row in rows:
        (p,) = [p for p in record["parameters"] if p["name"] == row["parameter"]]
        pairs = zip(record["runs"], p["values"], strict=True)
        ((run, value),) = [both for both in pairs if both[0]["folder"] == row["run"]]
        assert (row["unit"], row["date"], float(row["time"])) == (p["unit"], run["date"], run["time"])
        assert (float(row["value"]), float(row["u"])) == pytest.approx((value["value"], value["u"]))


def test_every_number_of_a_history_is_in_its_record_under_its_name(runs):
    result = bc.history(runs).data
    # a step and a trend, of an angle and of a length
    angle, length = (next(c for c in result.courses if c.parameter.unit == unit) for unit in ("rad", "m"))
    made = {"size": 3e-4, "u": 2e-5, "probability": 0.75}
    courses = replace(angle, kind=STEP, since=1, **made), replace(length, kind=TREND, **made)
    limit = module.Limit(1e-4, 3e-7, 2e-8, (10.0, 20.0, 30.0), ())

    def record(given):
        own = zip(courses, given["parameters"], strict=True)
        parts = {"courses": tuple(replace(c, **numbers) for c, numbers in own), "limit": given["limit"]}
        return history_record(replace(result, **parts))

    keys = ("values", "size", "u", "probability")
    given = {"parameters": [{key: getattr(c, key) for key in keys} for c in courses], "limit": limit}
    units = {
        r"_um$": lambda x: 1e6 * x,
        r"^limit|probability": np.copy,
        r"U$": lambda x: 2.0 * np.concatenate([1e3 * x, np.degrees(x)]),
        r"": lambda x: np.concatenate([1e3 * x, np.degrees(x)]),
    }
    check_written(record, given, but="", called={"times": "time_after_last_run"}, units=units)


def test_an_order_is_a_time(runs):
    record = bc.history(runs, order="run-2,run-0,run-1").record
    assert [r["folder"] for r in record["runs"]] == ["run-2", "run-0", "run-1"]
    assert [r["time"] for r in record["runs"]] == [0, 1, 2]
    assert not [note for note in record["notes"] if "left out" in note]
    record = bc.history(runs, order="run-2,run-0").record
    assert "--order does not name run-1: left out" in record["notes"]
    refused("no run folder `run-9`", lambda: bc.history(runs, order=["run-9"]))


def test_the_time_to_a_limit_by_a_drift(runs):
    """A drift of the second zero alone: the error of a distance is its slope times the time."""
    last = module.Entry("run-2", read_arm(runs / "run-2"), DATES[-1])
    rate = 1e-6
    found = module._limit(1e-4, last, ["theta2"], np.array([rate]), np.array([[1e-20]]), "day")
    assert found.times == pytest.approx([1e-4 / found.rate] * 3, rel=1e-3)
    assert 0.05 * rate < found.rate < rate  # m per day, of distances within a metre
    twice = module._limit(2e-4, last, ["theta2"], np.array([rate]), np.array([[1e-20]]), "day")
    assert twice.times[1] == pytest.approx(2 * found.times[1])
    # the same drift as a sum of two, of which the sum alone is known
    parts, known = np.array([3.0, -2.0]) * rate, 1e-12 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    both = module._limit(1e-4, last, ["theta2", "theta2"], parts, known + 1e-20 * np.eye(2), "day")
    assert both.times == pytest.approx(found.times, rel=1e-3)
    assert both.u_rate < 1e-3 * found.rate


def test_a_drift_that_the_last_run_does_not_have_is_not_in_the_time_to_the_limit(runs, monkeypatch):
    """Of runs of different models; what both have drifts as if the other were none."""
    entries = module._read(runs, lambda *_: None)
    arm = entries[-1].arm
    kept = [k for k, p in enumerate(arm.model.parameters) if p.name != "theta3"]
    model = replace(arm.model, parameters=tuple(arm.model.parameters[k] for k in kept))
    square = np.ix_(kept, kept)
    parts = {"values": arm.values[kept], "covariance": arm.covariance[square], "solved": arm.solved[square]}
    several = [*entries[:-1], replace(entries[-1], arm=replace(arm, model=model, **parts))]
    names = [p.name for p in arm.model.parameters]
    monkeypatch.setattr(module, "_read", lambda *_: several)

    def limit(*drifting):
        chosen = [names.index(name) for name in drifting]  # of the first pattern, the trend
        monkeypatch.setattr(module, "_search", lambda g, s, *_: (chosen, np.zeros(len(s))))
        return module.history(runs, limit=1e-4)

    both, alone = limit("theta2", "theta3"), limit("theta2")
    assert any("does not have theta3" in note for note in both.notes)
    assert not any("does not have" in note for note in alone.notes)
    assert len(both.limit.times) == len(alone.limit.times) == 3
    (soon, *_), (day, *_) = alone.limit.times, alone.limit.dates  # after the last run
    assert day == (date.fromisoformat(DATES[-1]) + timedelta(days=soon)).isoformat()
    assert limit("theta3").limit is None


def test_runs_of_another_arm_and_folders_without_runs_are_refused(runs, tmp_path):
    refused("no run folders", lambda: bc.history(tmp_path))
    one = read_arm(runs / "run-0")
    entries = [module.Entry(f"r{k}", one, "") for k in range(2)]
    refused("two sessions", lambda: module._ordered(entries, (), tmp_path))
    fewer = replace(one, values=one.values[:1])
    three = [module.Entry(f"{len(arm.values)}", arm, "") for arm in (one, fewer, read_arm(runs / "run-1"))]
    kept = [e for e in module._ordered(three, (), tmp_path)[0] if e.folder == "1"]
    assert not kept  # of one session, the run with more parameters counts
    other = replace(one.dataset, record=replace(one.dataset.record, serials={"arm": "8"}))
    assert arm_difference(one.dataset, other) == "serial number 8, not 7"
    assert arm_difference(one.dataset, one.dataset) == ""


def test_names_with_numbers_are_in_their_order():
    assert sorted(["run-10", "run-9", "run-1"], key=module._natural) == ["run-1", "run-9", "run-10"]


@pytest.mark.parametrize(("unit", "change", "words"), [
    ("day", TREND, "365(37) µm per year"), ("session", TREND, "1.00(10) µm per session"),
    ("day", STEP, "1.00(10) µm"),
])  # fmt: skip
def test_a_trend_is_told_per_year_or_session(unit, change, words):
    assert size({"unit": "mm", "change": change, "size": 1e-3, "u": 1e-4}, {"time_unit": unit}) == words


def test_a_step_is_drawn_between_two_runs():
    runs = [{"folder": f"run-{k}", "time": t} for k, t in enumerate((0.0, 10.0, 30.0))]
    values = [{"value": x, "u": 0.1} for x in (0.0, 1.0, 1.0)]
    p = {"name": "a2", "unit": "mm", "change": STEP, "from_run": "run-1", "size": 1.0, "u": 0.1}
    drawing = _panel({**p, "values": values}, {"time_unit": "day", "runs": runs})[1]
    line = re.search(r'class="zero" points="([^"]+)"', str(drawing))[1].split()
    first, before, after, last = (float(point.split(",")[0]) for point in line)
    assert before == after == pytest.approx(first + (last - first) * 5.0 / 30.0, abs=0.1)
