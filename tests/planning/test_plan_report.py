"""What a user sees of a plan: summary, plan.json, plan.csv, figure, page; from the frozen result alone."""

import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from made_up_plans import made_up_plan
from rich.console import Console

from bayescal.dataset import read_dataset
from bayescal.dataset.write import write_setup
from bayescal.planning.result import VALIDATE
from bayescal.reporting.plan import sheets
from bayescal.reporting.plan.page import plan_page
from bayescal.reporting.plan.picture import draw_plan
from bayescal.reporting.plan.record import plan_record, table_of_plan, write_plan
from bayescal.reporting.plan.summary import plan_summary

CONTRACT = {
    "schema", "contacts", "expected", "observability", "curve", "detectable", "confusable", "seconds",
}  # fmt: skip


@pytest.fixture(scope="module")
def plan(cube):
    return made_up_plan(cube(seed=1).dataset)


def shown(plan, width=200):
    out = io.StringIO()
    Console(file=out, width=width, highlight=False).print(plan_summary(plan))
    return out.getvalue()


def test_the_summary_states_cost_and_gain(plan):
    text = shown(plan)
    assert "Expected U = 9.8 µm (k = 2) of 15 certified distances, assuming the model is correct" in text
    assert "Equivalent to about 460 random contacts" in text
    assert "20 further contacts: U = 9.6 µm (2.0 % less)" in text
    assert "200 distances in the volume of interest" in text
    assert re.search(r"15 certified distances +9\.8 +14 +21 % +4 % +72 % +3 %", text)
    assert "16 distances, 20 gap, 4 repeats, 8 validation" in text
    assert "36 min of motion between contacts; order: sweeps" in text
    assert "812 beyond a joint limit; 95 arm hits the table" in text
    assert re.search(r"backlash, joint 6 +0\.0011 deg +0\.0029 deg", text)
    assert "would be separated by a payload of 2 kg" in text
    assert "fewer contacts than unknowns + 40" in text


def test_a_plan_without_some_figures_prints(plan):
    """No distances, nothing to detect, no candidates that equal it: no figure is invented."""
    bare = replace(
        plan, expected=(), parameters=(), observability={}, observability_random={}, curve=(),
        curve_random=(), detectable=(), confusable=(), equals_random=np.inf, next_u=np.nan, warnings=(),
    )  # fmt: skip
    assert "Expected U" not in shown(bare)
    record = plan_record(bare)
    assert record["expected"]["distance_sd_um"] is None
    assert record["expected"]["equals_random_contacts"] is None
    assert "nan" not in plan_page(bare, b"")
    draw_plan(bare)
    never = replace(plan, equals_random=np.inf)
    assert "No number of the candidates" in shown(never)


def test_targets_and_payloads_add_up(plan):
    sheet = sheets.by_target(plan)
    *targets, every = [[int(cell) for cell in row[1:]] for row in sheet.rows]
    assert np.sum(targets, axis=0).tolist() == every
    assert every[0] == sum(every[1 : 1 + len(set(plan.purpose))]) == len(plan.purpose)
    assert every[0] == sum(every[-2:])  # with 0 kg and with 0.5 kg


def test_targets_of_validation_alone_share_a_row(plan):
    """Fifteen spheres are one line."""
    m = plan.session.measurements
    target = np.where(np.array(plan.purpose) == VALIDATE, np.where(m.target == 3, 2, m.target), 3)
    target[40:] = [0, 1, 2, 0, 1, 2, 0, 1]
    session = replace(plan.session, measurements=replace(m, target=target))
    rows = sheets.by_target(replace(plan, session=session)).rows
    assert [row[:2] for row in rows] == [("cube.+z", "40"), ("3 validation targets", "8"), ("all", "48")]


def test_the_least_favourable_site_is_shown(plan):
    assert next((d.effect, str(d.site)) for d in sheets.least_favourable(plan)) == ("backlash", "joint 6")
    ratios = [np.sqrt(4 / 7 * 2 / 5), 1 / 4, 1.2 / 1.4]  # backlash of two joints, bending, lobing
    assert sheets.gain(plan) == pytest.approx(np.prod(ratios) ** (1 / 3))
    assert "not detectable" in {r[0]: r[1] for r in sheets.detectable(plan).rows}["latency, probe"]


def test_the_record_follows_the_contract(plan):
    record = json.loads(json.dumps(plan_record(plan), allow_nan=False))
    assert record.keys() >= CONTRACT
    assert record["schema"] == "bayescal-plan/1"
    assert (record["contacts"], record["rows"]) == (40, 48)
    expected = record["expected"]
    assert expected["distance_sd_um"] == pytest.approx(4.9)
    assert expected["distance_sd_um_random"] == pytest.approx(7.1)
    assert expected["parameters"][0] == {"name": "a2", "unit": "mm", "u": 0.0071, "prior_u": 0.3}
    assert sum(expected["distances"][0]["shares"].values()) == pytest.approx(1.0)
    assert record["curve"][0] == {"contacts": 50, "distance_sd_um": pytest.approx(8.8)}
    assert set(record["observability"]) == {"O1", "O2", "O3", "O4", "O5"}
    latency = record["detectable"][-1]
    assert (latency["smallest"], latency["plausible"], latency["unit"]) == (None, 1.0, "ms")
    assert record["confusable"][1]["intervention"] == "a payload of 2 kg"
    assert record["volume"] == {"centre_mm": [400, 0, 300], "size_mm": [300, 400, 200]}


def test_the_table_is_a_session_without_results(plan, tmp_path):
    """In the order of probing, with columns of measurements.csv alone, and without times."""
    text = table_of_plan(plan)
    header, first, *_ = text.splitlines()
    joints = [f"j{k}_{kind}" for kind in ("deg", "degps") for k in range(1, 7)]
    assert header.split(",") == [
        "id",
        "role",
        "target",
        "tool",
        *joints,
        "payload_kg",
        "repeat",
        "clearance_mm",
    ]
    assert first.startswith("p001,calibrate,cube.+z,ball,")
    (tmp_path / "session").mkdir()
    assert write_setup(plan.session, tmp_path / "session") == ("dataset.yaml", "robot.yaml")
    (tmp_path / "session" / "measurements.csv").write_text(text)
    again = read_dataset(tmp_path / "session", judge=False).measurements
    m = plan.session.measurements
    assert again.ids == m.ids
    np.testing.assert_allclose(again.readings, m.readings, atol=1e-8)
    np.testing.assert_allclose(again.payload, m.payload)
    assert again.time is None
    assert again.torque is None


def test_an_instrument_has_empty_cells(tracker):
    session = tracker(seed=1).dataset
    header, first, *_ = table_of_plan(made_up_plan(session)).splitlines()
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


def test_the_page_is_one_file_and_escapes_names(plan):
    attack = "<script>alert(1)</script>"
    targets = tuple(replace(t, name=f"{t.name}{attack}") for t in plan.session.targets)
    hostile = replace(
        plan,
        session=replace(plan.session, name=attack, targets=targets),
        warnings=(attack,),
    )
    text = plan_page(hostile, b"png", [("import", f"bayescal import --plan {attack}")])
    page = Page(text)
    assert not page.open
    assert "script" not in page.tags
    assert text.count("&lt;script&gt;") > 4
    assert [a for a in page.addresses if a[0] != "#"] == ["data:image/png;base64,cG5n"]
    assert (
        text.index("What to do next") < text.index("<img") < text.index(">What to expect", text.index("<img"))
    )
    assert text.count("<tr>") > 48


def test_the_figure_is_readable_without_colours(plan):
    """Purposes differ in marker and hatching, the order of probing in lightness."""
    from matplotlib import colormaps

    from bayescal.reporting.plan.picture import FILLS, MARKERS, ORDER

    assert len(set(MARKERS.values())) == len(MARKERS)
    assert len(set(FILLS.values())) == len(FILLS)
    r, g, b, _ = colormaps[ORDER](np.linspace(0, 1, 30)).T
    assert np.all(np.diff(0.299 * r + 0.587 * g + 0.114 * b) > 0)
    labels = [axes.get_xlabel() for axes in draw_plan(plan).axes]
    assert labels[:3] == ["x (mm)", "y (mm)", "x (mm)"]


def test_the_folder_is_written(plan, tmp_path):
    names = write_plan(plan, tmp_path / "my plan")
    there = {p.name for p in (tmp_path / "my plan").iterdir() if not p.name.startswith(".")}
    assert there == set(names)
    assert there >= {"plan.csv", "plan.json", "plan.html", "plan.png", "dataset.yaml"}
    record = json.loads((tmp_path / "my plan" / "plan.json").read_text())
    assert f"--plan '{tmp_path / 'my plan'}'" in record["commands"]["import"]


def test_durations():
    assert [sheets.duration(s) for s in (4.2, 2150, 12000)] == ["4 s", "36 min", "3.3 h"]
