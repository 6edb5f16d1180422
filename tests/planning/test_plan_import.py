"""What was measured of a plan comes back by id: the round trip of a simulated probing, and its refusals."""

import csv
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from cases import refused
from made_up_plans import made_up_plan
from rich.console import Console
from sessions import with_columns

import bayescal as bc
from bayescal.dataset import read_dataset
from bayescal.dataset.write import table_text, write_setup
from bayescal.estimate import calibrated
from bayescal.estimate.unexplained import unexplained
from bayescal.importing import Request, convert, write
from bayescal.model import Scene
from bayescal.planning.result import VALIDATE
from bayescal.reporting import plan_sheets
from bayescal.reporting.figures.figures import drawn
from bayescal.reporting.figures.plan import plan_content, plan_picture
from bayescal.reporting.page.plan import plan_page, plan_record, table_of_plan, write_plan
from bayescal.reporting.plan_sheets import plan_summary
from bayescal.simulation import touch


@pytest.fixture(scope="module")
def session():
    return bc.simulate(contacts=70, later=10, repeats=3, spheres=0, payload=2.0, seed=3).data


@pytest.fixture(scope="module")
def plan(session):
    """Contacts near those of a session; the arm that will measure them is not nominal."""
    m = session.dataset.measurements
    away = 1e-3 * np.random.default_rng(1).standard_normal(m.readings.shape)
    return made_up_plan(with_columns(session.dataset, readings=m.readings + away), count=70, validation=10)


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


def test_from_plan_to_fit(folder, plan, probed, tmp_path, output_of):
    """Planned, probed in another order and not wholly, logged, imported, fitted: as if measured by hand."""
    order = np.random.default_rng(1).permutation(len(plan.purpose))[:-3]
    log = log_of(probed, tmp_path / "log.csv", change=lambda table: [table[k] for k in order])
    out = tmp_path / "session"
    said = output_of("import", log, "--plan", folder, "--out", out)
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
    assert unexplained(calibrated(Scene(dataset), ("geometry", "compliance"))).fitted < 8e-6  # 5 µm of noise


def test_a_continued_session_is_one_session(session, plan, probed, tmp_path, error_of, output_of):
    """The rows that were measured come first, with their own times and repeats; the table is read again."""
    first = session.dataset
    m = replace(first.measurements, repeat=np.where(np.arange(len(first.measurements.ids)) < 2, "r1", ""))
    first = replace(first, measurements=replace(m, temperature=None))
    pool = replace(plan.pool, setup=replace(plan.pool.setup, dataset=first), measured=len(m.ids))
    write_plan(replace(plan, pool=pool), tmp_path / "run")
    log = log_of(probed, tmp_path / "log.csv", slice(20))
    said = output_of("import", log, "--plan", tmp_path / "run", "--out", tmp_path / "all")
    assert "20 rows of fanuc-lrmate200ic from log.csv" in said
    assert f"they continue {len(m.ids)} rows" in said
    rows = bc.read_dataset(tmp_path / "all").measurements
    assert rows.ids == (*m.ids, *probed.measurements.ids[:20])
    np.testing.assert_allclose(rows.readings[: len(m.ids)], m.readings, atol=1e-8)
    assert np.min(np.diff(rows.time)) > 0
    assert set(rows.repeat[len(m.ids) :].tolist()) == {"", "r1.later"}
    bare = log_of(probed, tmp_path / "bare.csv", slice(20), lambda t: [{**r, "time_s": ""} for r in t])
    error = error_of("import", bare, "--plan", tmp_path / "run", "--out", tmp_path / "bare")
    assert "`time_s` is empty" in error


def converted(folder, log, **options):
    return convert(Request(log=log, plan=folder, **options))


def test_a_log_without_ids_is_taken_in_order(folder, probed, tmp_path):
    def nameless(table):
        return [{k: v for k, v in row.items() if k != "id"} for row in table]

    draft = converted(folder, log_of(probed, tmp_path / "log.csv", change=nameless))
    assert draft.dataset.measurements.ids == probed.measurements.ids
    shorter = log_of(probed, tmp_path / "shorter.csv", slice(1, None), nameless)
    refused("79 rows without ids, but 80 contacts", lambda: converted(folder, shorter))
    turned = log_of(probed, tmp_path / "turned.csv", change=lambda table: nameless(table)[::-1])
    assert refused("not at the readings of `p001`", lambda: converted(folder, turned)).where == "turned.csv:2"


def test_units_of_a_mapped_log_are_still_checked(folder, probed, tmp_path):
    log = log_of(probed, tmp_path / "log.csv")
    draft = converted(folder, log, map="id=id, j*=j*_deg rad")
    assert "cannot be in rad" in draft.wrong
    refused("cannot be in rad", lambda: write(draft, tmp_path / "session"))
    assert converted(folder, log, map="id=id, j*=j*_deg deg").wrong == ""


def test_the_plan_itself_is_no_measurement(folder, probed, plan, tmp_path):
    """A copy of plan.csv is refused, and so are its rows in a log that was not filled in to its end."""
    refused("nothing was measured", lambda: converted(folder, folder / "plan.csv"))
    half = np.arange(len(plan.purpose)) < 50
    readings = np.where(half[:, None], probed.measurements.readings, plan.session.measurements.readings)
    draft = converted(folder, log_of(with_columns(probed, readings=readings), tmp_path / "log.csv"))
    assert draft.dataset.measurements.ids == probed.measurements.ids[:50]
    assert any("30 rows of log.csv without a measurement" in note for note in draft.notes)


def test_what_the_urscript_logs_is_read(folder, probed, tmp_path):
    """Its text messages: the id and a list in rad."""
    m = probed.measurements
    lines = [f"{name}, {q}" for name, q in zip(m.ids, m.readings.tolist(), strict=True)]
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


@pytest.mark.parametrize(("change", "words", "line"), [
    (renamed, "no id of log.csv is in plan.csv", ""),
    (lambda table: [*table, table[4]], "id `p005` is given twice", ":6"),
    (lambda table: [{**row, "target": "cube"} for row in table], "target `cube`, but `cube.", ":2"),
    (only("id", "time_s"), "`p001` needs the joint readings", ":2"),
    (only("id", "j1_deg", "j2_deg"), "no column holds `j3`", ""),
    (lambda table: [{**row, "j4": "0"} for row in table], "column `j4` has no unit", ":1"),
])  # fmt: skip
def test_refusals(folder, probed, tmp_path, change, words, line):
    log = log_of(probed, tmp_path / "log.csv", change=change)
    error = refused(re.escape(words), lambda: converted(folder, log))
    assert error.where == f"log.csv{line}"
    assert error.remedy


def test_the_plan_states_the_robot(folder, probed, tmp_path, error_of):
    log = log_of(probed, tmp_path / "log.csv")
    error = error_of("import", log, "--plan", folder, "--robot", "kuka-kr6", "--out", tmp_path / "s")
    assert "the plan states robot, tools and targets already" in error
    assert "there is no plan.csv" in error_of("import", log, "--plan", tmp_path, "--out", tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_points_of_a_tracker_need_no_readings(tracker, tmp_path):
    """The arm stands where it was commanded: the log has the points by id alone."""
    plan = made_up_plan(tracker(seed=1).dataset)
    plan = replace(plan, approach=plan.session.measurements.readings)
    write_plan(plan, tmp_path / "run")
    m = plan.session.measurements
    rows = zip(m.ids, 1e3 * m.xyz, strict=True)
    lines = [f"{name},{','.join(f'{v:.6f}' for v in xyz)}" for name, xyz in rows]
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


# --- What a user sees of a plan: summary, plan.json, plan.csv, figure, page; from the frozen result alone.

CONTRACT = {
    "schema", "contacts", "expected", "observability", "curve", "detectable", "confusable", "seconds",
}  # fmt: skip


@pytest.fixture(scope="module")
def reported_plan(cube):
    return made_up_plan(cube(seed=1).dataset)


def shown(plan, width=200):
    out = io.StringIO()
    Console(file=out, width=width, highlight=False).print(plan_summary(plan))
    return out.getvalue()


def test_the_summary_states_cost_and_gain(reported_plan):
    text = shown(reported_plan)
    assert "Expected U = 9.8 µm (k = 2) of 15 certified distances, assuming that model" in text
    assert "model and stated noise are correct" in text
    assert "Equivalent to about 460 random contacts" in text
    assert "20 contacts more: U = 9.6 µm (2.0 % less)" in text
    assert "200 distances in the volume of interest" in text
    assert re.search(r"15 certified distances +9\.8 +14 +21 % +4 % +72 % +3 %", text)
    assert "16 distances, 20 gap, 4 repeats, 8 validation" in text
    assert "36 min of motion between contacts; order: sweeps" in text
    assert "812 beyond a joint limit; 95 arm hits the table" in text
    assert re.search(r"backlash, joint 6 +0\.0011 deg +0\.0029 deg", text)
    assert "would be separated by a payload of 2 kg" in text
    assert "fewer contacts than unknowns + 40" in text


def test_a_plan_without_some_figures_prints(reported_plan):
    """No distances, nothing to detect, no candidates that equal it: no figure is invented."""
    bare = replace(
        reported_plan, expected=(), parameters=(), observability={}, observability_random={}, curve=(),
        curve_random=(), detectable=(), confusable=(), equals_random=np.inf, next_u=np.nan, warnings=(),
    )  # fmt: skip
    assert "Expected U" not in shown(bare)
    record = plan_record(bare)
    assert record["expected"]["distance_sd_um"] is None
    assert record["expected"]["equals_random_contacts"] is None
    assert "nan" not in plan_page(bare, b"")
    assert "few contacts on cube.+z" in plan_page(replace(bare, warnings=("few contacts on cube.+z",)), b"")
    assert plan_picture(bare).startswith(b"\x89PNG")
    assert "No number of the candidates" in shown(replace(reported_plan, equals_random=np.inf))


def test_targets_and_payloads_add_up(reported_plan):
    sheet = plan_sheets.by_target(reported_plan)
    *targets, every = [[int(cell) for cell in row[1:]] for row in sheet.rows]
    assert np.sum(targets, axis=0).tolist() == every
    assert every[0] == sum(every[1 : 1 + len(set(reported_plan.purpose))]) == len(reported_plan.purpose)
    assert every[0] == sum(every[-2:])  # with 0 kg and with 0.5 kg


def test_targets_of_validation_alone_share_a_row(reported_plan):
    """Fifteen spheres are one line."""
    m = reported_plan.session.measurements
    target = np.where(np.array(reported_plan.purpose) == VALIDATE, np.where(m.target == 3, 2, m.target), 3)
    target[40:] = [0, 1, 2, 0, 1, 2, 0, 1]
    session = with_columns(reported_plan.session, target=target)
    rows = plan_sheets.by_target(replace(reported_plan, session=session)).rows
    assert [row[:2] for row in rows] == [("cube.+z", "40"), ("3 validation targets", "8"), ("all", "48")]


def test_the_least_favourable_site_is_shown(reported_plan):
    worst = next(iter(plan_sheets.least_favourable(reported_plan)))
    assert (worst.effect, str(worst.site)) == ("backlash", "joint 6")
    ratios = [np.sqrt(4 / 7 * 2 / 5), 1 / 4, 1.2 / 1.4]  # backlash of two joints, bending, lobing
    assert plan_sheets.gain(reported_plan) == pytest.approx(np.prod(ratios) ** (1 / 3))
    smallest = {row[0]: row[1] for row in plan_sheets.detectable(reported_plan).rows}
    assert "not detectable" in smallest["latency, probe"]


def test_the_record_follows_the_contract(reported_plan):
    record = json.loads(json.dumps(plan_record(reported_plan), allow_nan=False))
    assert record.keys() >= CONTRACT
    assert record["schema"] == "bayescal-plan/1"
    assert (record["contacts"], record["rows"]) == (40, 48)
    assert record["expected"]["parameters"][0] == {"name": "a2", "unit": "mm", "u": 0.0071, "prior_u": 0.3}
    assert set(record["observability"]) == {"O1", "O2", "O3", "O4", "O5"}
    latency = record["detectable"][-1]
    assert (latency["smallest"], latency["plausible"], latency["unit"]) == (None, 1.0, "ms")
    assert record["confusable"][1]["intervention"] == "a payload of 2 kg"
    assert record["volume"] == {"centre_mm": [400, 0, 300], "size_mm": [300, 400, 200]}
    assert record["smallest_clearance_mm"] == pytest.approx(1e3 * reported_plan.pool.setup.clearance)


def test_the_table_is_a_session_without_results(reported_plan, tmp_path):
    """In the order of probing, with columns of measurements.csv alone, and without times."""
    text = table_of_plan(reported_plan)
    header, first, *_ = text.splitlines()
    joints = ",".join(f"j{k}_{kind}" for kind in ("deg", "degps") for k in range(1, 7))
    assert header == f"id,role,target,tool,{joints},payload_kg,repeat,clearance_mm"
    assert first.startswith("p001,calibrate,cube.+z,ball,")
    (tmp_path / "session").mkdir()
    assert write_setup(reported_plan.session, tmp_path / "session") == ("dataset.yaml", "robot.yaml")
    (tmp_path / "session" / "measurements.csv").write_text(text)
    again = read_dataset(tmp_path / "session", judge=False).measurements
    m = reported_plan.session.measurements
    assert again.ids == m.ids
    np.testing.assert_allclose(again.readings, m.readings, atol=1e-8)
    np.testing.assert_allclose(again.payload, m.payload)
    assert again.time is None
    assert again.torque is None


def test_an_instrument_has_empty_cells(tracker):
    header, first, *_ = table_of_plan(made_up_plan(tracker(seed=1).dataset)).splitlines()
    cells = dict(zip(header.split(","), first.split(","), strict=True))
    assert cells["x_mm"] == cells["y_mm"] == cells["z_mm"] == ""


class Page(HTMLParser):
    """Tags and addresses of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.addresses, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [v for k, v in attrs if k in ("src", "href")]
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_page_is_one_file(reported_plan):
    """That names are escaped is tested in `reporting/test_hostile_names.py`."""
    text = plan_page(reported_plan, b"png", [("import", "bayescal import --plan run")])
    page = Page(text)
    assert not page.open
    assert "script" not in page.tags
    assert [a for a in page.addresses if a[0] != "#"] == ["data:image/png;base64,cG5n"]
    picture = text.index("<img")
    assert text.index("What to do next") < picture < text.index(">What to expect", picture)
    assert text.count("<tr>") > 48


def test_the_figure_is_readable_without_colours(reported_plan):
    """Purposes differ in marker and hatching, the order of probing in lightness."""
    from matplotlib import colormaps

    from bayescal.reporting.figures.plan import FILLS, MARKERS, ORDER

    assert len(set(MARKERS.values())) == len(MARKERS)
    assert len(set(FILLS.values())) == len(FILLS)
    r, g, b, _ = colormaps[ORDER](np.linspace(0, 1, 30)).T
    assert np.all(np.diff(0.299 * r + 0.587 * g + 0.114 * b) > 0)
    labels = [axes.get_xlabel() for axes in drawn(plan_content(reported_plan)).axes]
    assert labels[:3] == ["x (mm)", "y (mm)", "x (mm)"]


def test_the_folder_is_written(reported_plan, tmp_path):
    names = write_plan(reported_plan, tmp_path / "my plan")
    there = {p.name for p in (tmp_path / "my plan").iterdir() if not p.name.startswith(".")}
    assert there == set(names)
    assert there >= {"plan.csv", "plan.json", "plan.html", "plan.png", "dataset.yaml"}
    record = json.loads((tmp_path / "my plan" / "plan.json").read_text())
    assert f"--plan '{tmp_path / 'my plan'}'" in record["commands"]["import"]


def test_durations():
    assert [plan_sheets.duration(s) for s in (4.2, 2150, 12000)] == ["4 s", "36 min", "3.3 h"]
