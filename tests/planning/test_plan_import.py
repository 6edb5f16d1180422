"""What was measured of a plan comes back by id: the round trip of a simulated probing, and its refusals."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from made_up_plans import made_up_plan

import bayescal as bc
from bayescal.dataset.write import table_text
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write
from bayescal.reporting.plan.record import write_plan
from bayescal.simulation.touch import touch


@pytest.fixture(scope="module")
def session():
    return bc.simulate(contacts=70, later=10, repeats=3, spheres=0, payload=2.0, seed=3).data


@pytest.fixture(scope="module")
def plan(session):
    """Contacts near those of a session; the arm that will measure them is not nominal."""
    m = session.dataset.measurements
    away = 1e-3 * np.random.default_rng(1).standard_normal(m.readings.shape)
    planned = replace(session.dataset, measurements=replace(m, readings=m.readings + away))
    return made_up_plan(planned, count=70, validation=10)


@pytest.fixture(scope="module")
def probed(session, plan):
    """The planned session as the simulated arm measures it, with noise."""
    noise = 5e-6 * np.random.default_rng(0).standard_normal(len(plan.purpose))
    return touch(session.world, plan.session, noise)


@pytest.fixture(scope="module")
def folder(plan, tmp_path_factory):
    out = tmp_path_factory.mktemp("plan") / "run"
    write_plan(plan, out)
    return out


def log_of(dataset, path, rows=slice(None), change=lambda table: table):
    """The columns of measurements.csv that a controller logs: id, readings and time."""
    table = list(csv.DictReader(table_text(dataset).splitlines()))
    kept = ("id", *(f"j{k}_deg" for k in range(1, 7)), "time_s")
    table = change([{key: row[key] for key in kept} for row in table][rows])
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    return path


def test_from_plan_to_fit(folder, plan, probed, tmp_path, command):
    """Planned, probed in another order and not wholly, logged, imported, fitted: as if measured by hand."""
    order = np.random.default_rng(1).permutation(len(plan.purpose))[:-3]
    log = log_of(probed, tmp_path / "log.csv", change=lambda table: [table[k] for k in order])
    out = tmp_path / "session"
    code, said, error = command("import", log, "--plan", folder, "--out", out)
    assert code == 0, error
    ids = [plan.session.measurements.ids[k] for k in order]
    lost = [name for name in plan.session.measurements.ids if name not in ids]
    assert f"3 rows of the plan missing in log.csv: {', '.join(lost)}" in said
    dataset = bc.read_dataset(out)
    m, planned, at = dataset.measurements, plan.session.measurements, order
    assert list(m.ids) == ids
    for name in ("role", "target", "tool", "repeat"):
        assert (getattr(m, name) == getattr(planned, name)[at]).all()
    np.testing.assert_allclose(m.readings, probed.measurements.readings[at], atol=2e-9)
    np.testing.assert_allclose(m.velocity, planned.velocity[at], atol=1e-7)
    np.testing.assert_allclose(m.payload, planned.payload[at])
    np.testing.assert_allclose(m.time, probed.measurements.time[at], atol=1e-3)
    assert dataset.targets[0].values["offset"] == plan.session.targets[0].values["offset"]
    fitted = bc.fit(dataset, samples=0).record["residuals"]
    rms = [r["rms_um"] for r in fitted if r.get("role", "calibrate") == "calibrate"]
    assert np.sqrt(np.mean(np.square(rms))) < 8  # 5 µm of noise


def test_a_continued_session_is_one_session(session, plan, probed, tmp_path, command):
    """The rows that were measured come first, with their own times and repeats; the table is read again."""
    first = session.dataset
    m = replace(first.measurements, repeat=np.where(np.arange(len(first.measurements.ids)) < 2, "r1", ""))
    first = replace(first, measurements=replace(m, temperature=None))
    pool = replace(plan.pool, setup=replace(plan.pool.setup, dataset=first), measured=len(m.ids))
    write_plan(replace(plan, pool=pool), tmp_path / "run")
    log = log_of(probed, tmp_path / "log.csv", slice(20))
    code, said, error = command("import", log, "--plan", tmp_path / "run", "--out", tmp_path / "all")
    assert code == 0, error
    assert "20 rows of fanuc-lrmate200ic from log.csv" in said
    assert f"they continue {len(m.ids)} rows" in said
    rows = bc.read_dataset(tmp_path / "all").measurements
    assert rows.ids == (*m.ids, *probed.measurements.ids[:20])
    np.testing.assert_allclose(rows.readings[: len(m.ids)], m.readings, atol=1e-8)
    assert np.min(np.diff(rows.time)) > 0
    later = set(rows.repeat[len(m.ids) :].tolist())
    assert later == {"", "r1.later"}
    bare = log_of(probed, tmp_path / "bare.csv", slice(20), lambda t: [{**r, "time_s": ""} for r in t])
    code, said, error = command("import", bare, "--plan", tmp_path / "run", "--out", tmp_path / "bare")
    assert code == 1
    assert "`time_s` is empty" in error


def converted(folder, log, **options):
    return convert(Request(log=log, plan=folder, **options))


def test_a_log_without_ids_is_taken_in_order(folder, probed, tmp_path):
    def nameless(table):
        return [{k: v for k, v in row.items() if k != "id"} for row in table]

    log = log_of(probed, tmp_path / "log.csv", change=nameless)
    draft = converted(folder, log)
    assert draft.dataset.measurements.ids == probed.measurements.ids
    shorter = log_of(probed, tmp_path / "shorter.csv", slice(1, None), nameless)
    with pytest.raises(BayescalError, match="79 rows without ids, but 80 contacts"):
        converted(folder, shorter)
    turned = log_of(probed, tmp_path / "turned.csv", change=lambda table: nameless(table)[::-1])
    with pytest.raises(BayescalError, match="not at the readings of `p001`") as refused:
        converted(folder, turned)
    assert refused.value.where == "turned.csv:2"


def test_units_of_a_mapped_log_are_still_checked(folder, probed, tmp_path):
    log = log_of(probed, tmp_path / "log.csv")
    draft = converted(folder, log, map="id=id, j*=j*_deg rad")
    assert "cannot be in rad" in draft.wrong
    with pytest.raises(BayescalError, match="cannot be in rad"):
        write(draft, tmp_path / "session")
    assert converted(folder, log, map="id=id, j*=j*_deg deg").wrong == ""


def test_the_plan_itself_is_no_measurement(folder, probed, plan, tmp_path):
    """A copy of plan.csv is refused, and so are its rows in a log that was not filled in to its end."""
    with pytest.raises(BayescalError, match="nothing was measured"):
        converted(folder, folder / "plan.csv")
    half = np.arange(len(plan.purpose)) < 50
    readings = np.where(half[:, None], probed.measurements.readings, plan.session.measurements.readings)
    mixed = replace(probed, measurements=replace(probed.measurements, readings=readings))
    draft = converted(folder, log_of(mixed, tmp_path / "log.csv"))
    assert draft.dataset.measurements.ids == probed.measurements.ids[:50]
    assert any("30 rows of log.csv without a measurement" in note for note in draft.notes)


def test_what_the_urscript_logs_is_read(folder, probed, tmp_path):
    """Its text messages: the id and a list in rad."""
    m = probed.measurements
    lines = [
        f"{name}, [{', '.join(map(repr, q.tolist()))}]" for name, q in zip(m.ids, m.readings, strict=True)
    ]
    log = tmp_path / "messages.txt"
    log.write_text("\n".join(lines) + "\n")
    draft = converted(folder, log, map="id=#1, " + ", ".join(f"j{k}=#{k + 1} rad" for k in range(1, 7)))
    np.testing.assert_allclose(draft.dataset.measurements.readings, m.readings, rtol=0, atol=1e-15)


def test_commanded_poses_are_noticed(folder, plan, probed, tmp_path):
    """A controller that logs where it was sent, with fewer digits than the plan."""
    m = plan.session.measurements
    sent = replace(probed, measurements=replace(m, readings=np.radians(np.round(np.degrees(m.readings), 3))))
    draft = converted(folder, log_of(sent, tmp_path / "log.csv"))
    assert any("not the commanded ones" in note for note in draft.notes)
    draft = converted(folder, log_of(probed, tmp_path / "log.csv"))
    assert not any("commanded" in note for note in draft.notes)


def test_rows_that_are_not_planned_are_said(folder, probed, tmp_path):
    def other(table):
        return [{**table[0], "id": "warm-up"}, *table[1:]]

    draft = converted(folder, log_of(probed, tmp_path / "log.csv", change=other))
    assert len(draft.dataset.measurements.ids) == 79
    assert "1 row of log.csv excluded: not in the plan: warm-up" in draft.notes
    assert "1 row of the plan missing in log.csv: p001" in draft.notes


def renamed(table):
    return [{**row, "id": f"x{k}"} for k, row in enumerate(table)]


def only(*keys):
    return lambda table: [{key: row[key] for key in keys} for row in table]


@pytest.mark.parametrize(
    ("change", "words", "line"),
    [
        (renamed, "no id of log.csv is in plan.csv", ""),
        (lambda table: [*table, table[4]], "id `p005` is given twice", ":6"),
        (lambda table: [{**row, "target": "cube"} for row in table], "target `cube`, but `cube.", ":2"),
        (only("id", "time_s"), "`p001` needs the joint readings", ":2"),
        (only("id", "j1_deg", "j2_deg"), "no column holds `j3`", ""),
        (lambda table: [{**row, "j4": "0"} for row in table], "column `j4` has no unit", ":1"),
    ],
)
def test_refusals(folder, probed, tmp_path, change, words, line):
    log = log_of(probed, tmp_path / "log.csv", change=change)
    with pytest.raises(BayescalError) as refused:
        converted(folder, log)
    assert words in refused.value.what
    assert refused.value.where == f"log.csv{line}"
    assert refused.value.remedy


def test_the_plan_states_the_robot(folder, probed, tmp_path, command):
    log = log_of(probed, tmp_path / "log.csv")
    code, _, error = command("import", log, "--plan", folder, "--robot", "kuka-kr6", "--out", tmp_path / "s")
    assert code == 1
    assert "the plan states robot, tools and targets already" in error
    code, _, error = command("import", log, "--plan", tmp_path, "--out", tmp_path / "s")
    assert code == 1
    assert "there is no plan.csv" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "s").exists()


def test_points_of_a_tracker_need_no_readings(tracker, tmp_path):
    """The arm stands where it was commanded: the log has the points by id alone."""
    measured = tracker(seed=1).dataset
    plan = made_up_plan(measured)
    plan = replace(plan, approach=plan.session.measurements.readings)
    write_plan(plan, tmp_path / "run")
    m = plan.session.measurements
    lines = [
        f"{name},{','.join(f'{1e3 * v:.6f}' for v in xyz)}" for name, xyz in zip(m.ids, m.xyz, strict=True)
    ]
    lines[5] = f"{m.ids[5]},,,"
    log = tmp_path / "points.csv"
    log.write_text("\n".join(["id,x_mm,y_mm,z_mm", *lines[::-1]]) + "\n")
    draft = converted(tmp_path / "run", log)
    back = draft.dataset.measurements
    assert draft.dataset.readings == "command"
    assert "joint readings are those of the plan, as commanded" in draft.notes
    assert back.ids == tuple(name for name in m.ids[::-1] if name != m.ids[5])
    at = [m.ids.index(name) for name in back.ids]
    np.testing.assert_allclose(back.xyz, m.xyz[at], atol=1e-9)
    np.testing.assert_allclose(back.readings, m.readings[at], atol=1e-8)
    assert any("without a measurement" in note and m.ids[5] in note for note in draft.notes)
