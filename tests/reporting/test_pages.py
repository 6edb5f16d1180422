"""Pages as text: every verdict, figures equal to the records, names from files cannot inject."""

import base64
import copy
import html
import json
import re
import shutil
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from cases import refused, undrawn
from rails import rail_session
from test_gap_report import SETS, diagnosis
from typer.testing import CliRunner

import bayescal as bc
from bayescal.arm import chain as reference
from bayescal.cli import app
from bayescal.estimate import calibrated
from bayescal.gap.result import OTHER
from bayescal.model.scene import Scene
from bayescal.reporting import motion
from bayescal.reporting import page as render
from bayescal.reporting.body import arm_drawing, posed
from bayescal.reporting.gap.record import gap_record
from bayescal.reporting.origin import rows_record
from bayescal.reporting.page import FIGURES, STILL, Run, _png, build, common, read_run, svg
from bayescal.reporting.page.build import run_page
from bayescal.reporting.page.svg import draw_arm, marked_sites, ticks
from bayescal.reporting.text import length

EVIL = "<script>alert(1)</script><!--"


@pytest.fixture(scope="module")
def found(cube):
    return calibrated(Scene(cube(seed=1, count=80).dataset), ("geometry",))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "fit"
    return folder, bc.fit(simulated(1), "geometry", samples=0).save(folder)


def simulated(seed):
    """A session of an arm."""
    options = {"contacts": 60, "later": 8, "repeats": 5, "spheres": 2, "placements": 1, "arm_seed": 1}
    return bc.simulate(effects="geometry", seed=seed, **options)


def record_of(found, kind: str) -> dict:
    record = gap_record(diagnosis(found.model.scene.dataset, kind))
    return record | {"rows": rows_record(found), "arm": arm_drawing(found.model.scene)}


def words(page: str) -> str:
    """The text of a page, without scripts and styles, with single blanks."""
    bare = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", bare)))


def test_the_verdict_is_said_once(found):
    text = words(run_page(Run("gap", record_of(found, "null"), "runs/x")))
    assert text.count("No effect above noise") == 1
    assert "No effect above noise The model explains these data" in text


def test_masses_that_do_not_fit_are_corrected_first(found):
    """The page said: calibrate with the model as it is."""
    gap = replace(diagnosis(found.model.scene.dataset, "null"), masses="the stated masses do not fit")
    record = record_of(found, "null") | gap_record(gap)
    doubt = "errors of the stated masses explain residuals (see the warning)"
    assert record["words"][0] == f"No effect found, but {doubt}"
    text = words(run_page(Run("gap", record, "runs/x")))
    assert "Calibrate with the model as it is." not in text
    assert "the model as it is, with errors of its masses, explains the data" in text
    assert text.index("What to do next") < text.index("Weigh the tool, find its centre of mass")


def test_a_diagnosis_shows_the_residuals_that_it_explains(found):
    """Drawings and tables of a page are of one model: that before the refit; the other is beside it."""
    record = record_of(found, "named")
    rows = record["rows"]
    rows["residual_before_um"] = [None if r is None else r + 1000.0 for r in rows["residual_um"]]
    rows["rejected_before"] = [False] * len(rows["id"])
    page = run_page(Run("gap", record, "runs/x"))
    first = max(range(len(rows["id"])), key=lambda k: rows["residual_before_um"][k] or -1.0)
    before, after = rows["residual_before_um"][first], rows["residual_um"][first]
    assert f"{rows['target'][first]} fitted {before:.1f} {after:.1f}" in words(page)
    drawn = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])
    assert drawn["rows"]["residual_um"] == rows["residual_before_um"]


def test_the_advice_to_calibrate_has_the_model_of_the_diagnosis(found):
    record = record_of(found, "null") | {"baseline": ["geometry"], "without": ["d4"]}
    assert "bayescal fit x/dataset --model geometry --without d4" in words(run_page(Run("gap", record, "x")))


@pytest.mark.parametrize("kind", SETS)
def test_every_verdict_has_a_page(found, kind):
    record = record_of(found, kind)
    page = run_page(Run("gap", record, "runs/x"))
    text = words(page)
    for line in record["words"]:
        assert line.rpartition(": ")[2].lower() in text.lower()
    assert len(page) < 3_000_000
    assert ("before the refit" in text) == bool(record["named"])
    assert ("On the shop floor" in text) == (kind != "null")
    unmodelled = kind in ("unknown", "named+unexplained")
    assert ("Inspect the location that is marked, correct it" in text) == unmodelled
    if unmodelled:  # its row of the table of effects states the location, as the first screen does
        place = next(w for w in record["where"] if not w["explained_by"])
        size = f"{length(place['rms_um'])} µm RMS"
        row = rf"{re.escape(size)} {re.escape(place['text'])} "
        assert re.search(rf"unmodelled effect (<|>|0)[ .\d]+ {row}", text)
    if "named" in kind:
        assert "Adjust the belt tension" in text
        assert "bayescal fit runs/x/dataset --model" in text


def test_the_page_states_what_an_unmodelled_error_does_and_the_members_of_a_class(found):
    record = record_of(found, "unknown")
    next(w for w in record["where"] if not w["explained_by"])["words"] = "the tool shifted at row 12 by 40 µm"
    assert "what happens the tool shifted at row 12 by 40 µm" in words(run_page(Run("gap", record, "x")))
    record = record_of(found, "class")
    record["class"]["members"] = {"backlash": 0.6, "hysteresis": 0.2, OTHER: 0.2}
    text = words(run_page(Run("gap", record, "x")))
    for name in ("hysteresis", "unmodelled effect"):
        assert f"possibly {name}" in text
    assert f"possibly {OTHER}" not in text


@pytest.mark.parametrize(("model", "to"), [(["geometry"], "urdf"), (["geometry", "compliance"], "mjcf")])
def test_the_format_that_is_advised_holds_the_model(saved, model, to):
    record = json.loads((saved[0] / "fit.json").read_text()) | {"model": model}
    record["use"] |= {"next": "use"}
    assert re.findall(r"bayescal export x --to (\S+)", words(run_page(Run("fit", record, "x")))) == [to]


def test_a_camera_session_is_exported_as_a_hand_eye_too(saved):
    record = json.loads((saved[0] / "fit.json").read_text())
    record["use"] |= {"next": "use"}
    hand_eye = "bayescal export x --to hand-eye"
    assert hand_eye not in words(run_page(Run("fit", record, "x")))
    part = {"side": "arm", "rms_px": 1.0, "u_px": 0.1, "max_px": 2.0, "max_mm": 1.0}
    record["images"] = [{"target": "board", "images": 20, "corners": 480, "noise_px": 0.2, "parts": [part]}]
    assert hand_eye in words(run_page(Run("fit", record, "x")))


def test_the_next_step_of_a_possible_effect_is_no_repair(found):
    """'Measure more before a part is replaced' stood above 'Repair the machine as described above'."""
    record = record_of(found, "named")
    assert "Repair the machine" in words(run_page(Run("gap", record, "runs/x")))
    record["named"] = [n | {"possible": True} for n in record["named"]]
    text = words(run_page(Run("gap", record, "runs/x")))
    assert "Measure more before a part is replaced" in text
    assert "Repair the machine" not in text
    assert "Measure more, and diagnose again" in text
    refit = "to fit with the effects that are named: bayescal fit"
    assert refit in text
    record["named"] = [n | {"confirmed": False} for n in record["named"]]
    text = words(run_page(Run("gap", record, "runs/x")))
    assert "diagnose again: the validation data do not confirm the effects that are named." in text
    assert refit not in text


def test_levels_without_validation_measurements_are_not_shown(saved):
    """A figure had an axis from -0.04 to 0.04 µm and no value, the table no column."""
    record = json.loads((saved[0] / "fit.json").read_text())
    assert "fit-levels.png" in undrawn(record)
    keys = [key for key in record["ladder"][0] if key != "model"]
    record["ladder"] = [step | dict.fromkeys(keys) for step in record["ladder"]]
    assert "fit-levels.png" not in undrawn(record)
    assert "Model levels" not in words(run_page(Run("fit", record, "x")))


def test_an_arm_is_not_said_to_be_marked_at_a_face(found):
    record = record_of(found, "named") | {"amplitudes": [], "marked": "cube.+y"}
    assert "Marked:" not in words(run_page(Run("gap", record, "runs/x")))
    assert "Marked: joint 3" in words(run_page(Run("gap", record | {"marked": "joint 3"}, "runs/x")))


def test_without_plotly_a_page_has_still_figures_and_no_scripts(found, monkeypatch):
    run = Run("gap", record_of(found, "named"), "runs/x")
    assert STILL not in words(run_page(run))
    monkeypatch.setattr(render, "files", Mock(side_effect=ModuleNotFoundError))
    render.plotly.cache_clear()
    page = run_page(run)
    render.plotly.cache_clear()
    assert "<script" not in page
    assert "script-src 'none'" in html.unescape(page)
    assert page.count("<svg") >= 2
    assert STILL in words(page)


def test_sizes_per_coordinate_are_labelled_so(found):
    record = record_of(found, "unknown")
    page = words(run_page(Run("gap", record, "x")))
    assert "per coordinate" not in page
    record["lengths"]["of"] = "validation points"
    page = words(run_page(Run("gap", record, "x")))
    assert page.count("RMS per coordinate (µm)") >= 2  # locations, groups
    place = next(w for w in record["where"] if not w["explained_by"])
    assert f"size {length(place['rms_um'])} µm RMS per coordinate" in page


def test_nothing_is_marked_where_nothing_is_significant(found):
    record = record_of(found, "null")
    assert marked_sites(Run("gap", record, "x")) == ()
    assert 'class="joint marked"' not in run_page(Run("gap", record, "x"))
    named = Run("gap", record_of(found, "named"), "x")
    assert [str(s) for s in marked_sites(named)] == ["joint 3"]
    assert run_page(named).count('class="joint marked"') == 2  # on the first screen, and with the contacts


def test_a_record_without_rows_has_a_page_without_scripts(found):
    record = {k: v for k, v in record_of(found, "named").items() if k not in ("rows", "arm")}
    page = run_page(Run("gap", record, "x"))
    assert "<script" not in page
    assert "script-src 'none'" in html.unescape(page)


def test_fit_writes_its_page(saved):
    folder, names = saved
    assert "report.html" in names
    record = json.loads((folder / "fit.json").read_text())
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert len(page) < 3_000_000
    text = words(page)
    expanded = record["predicted_distance"]["expanded_U_um"]
    assert f"U = {float(f'{expanded:.2g}'):g}" in text.replace(".0 ", " ")
    for d in record["validation"]["distances"]:
        assert f"{d['calibrated_error_um']:+.1f}" in text
    for p in record["parameters"]:
        assert p["name"] in text
    for f in record["iso9283"]["figures"]:
        assert f"{f['symbol']}: {f['name']} {f['count']} {length(f['mean_um'])} " in text
    for difference in record["iso9283"]["differs_from_norm"]:
        assert difference in text
    assert "with 1 cycle each" in text
    again = run_page(read_run(folder, str(folder)))
    assert again == page  # a page is a function of what the folder holds


def test_the_error_of_contacts_is_that_of_all_contacts_whatever_their_face(saved):
    """As of one face with the contacts of all: faces count by their contacts, not alike."""
    record = json.loads((saved[0] / "fit.json").read_text())
    face = record["validation"]["planes"][0]
    sizes = {"nominal_rms_um": np.array([900.0, 100.0]), "calibrated_rms_um": np.array([30.0, 2.0])}
    count = np.array([4, 36])
    of_face = [{key: float(x[k]) for key, x in sizes.items()} for k in range(len(count))]
    faces = [face | {"count": int(n)} | own for n, own in zip(count, of_face, strict=True)]
    before, after = (length(np.sqrt(np.mean(np.repeat(x, count) ** 2))) for x in sizes.values())
    record["validation"]["planes"] = faces
    text = words(run_page(Run("fit", record, "x")))
    assert f"Contact error, nominal → calibrated {before} → {after} µm RMS" in text
    assert "40 validation contacts" in text


def test_the_page_of_a_fit_embeds_its_figures_and_loads_nothing(saved):
    page = (saved[0] / "report.html").read_text(encoding="utf-8")
    pictures = re.findall(r'<img src="data:image/png;base64,([^"]+)" alt="[^"]{20,}">', page)
    files = [saved[0] / f"fit-{name}.png" for name in ("distances", "posterior")]
    assert list(map(base64.b64decode, pictures)) == [file.read_bytes() for file in files]
    # the page has a policy and loads nothing
    assert "default-src 'none'" in html.unescape(page)
    assert "unsafe-inline'; script-src 'sha256-" in html.unescape(page)
    bare = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"(?:src|href)=[\"'](?!#|data:)", bare)
    assert "@import" not in page
    assert "url(" not in bare
    # 'u includes ...' became 'U includes ...', which is the expanded uncertainty
    assert "value(u): standard uncertainty u in units of the last digits; band: prior" in page


def renamed(record: dict) -> dict:
    """The record with a name that is markup wherever a file of the user states a name."""
    out = copy.deepcopy(record)
    out["dataset"]["name"] = EVIL
    out["arm"]["robot"] = EVIL
    out["arm"]["joints"] = [EVIL] * len(out["arm"]["joints"])
    for key in ("id", "target"):
        out["rows"][key] = [EVIL] * len(out["rows"][key])
    for group in out["where_marginal"]["target"]:
        group["label"] = EVIL
    out["warnings"] = [EVIL]
    return out


def test_names_from_files_are_inert(found):
    page = run_page(Run("gap", renamed(record_of(found, "named")), EVIL))
    assert "alert(1)</script>" not in page
    assert "<!--" not in re.sub(r'<script type="application/gzip".*?</script>', "", page, flags=re.DOTALL)
    assert EVIL in words(page)
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert json.loads(data[1])["rows"]["target"][0] == EVIL


def test_runs_without_certified_centres_are_compared_too(found):
    """By the readings of their instrument and the lengths of the errors of points."""
    expected = {
        "over": "readings of the instrument", "count": 720, "predicted_rms_um": 22.2, "expanded_U_um": 44.4,
        "measured_rms_um": 20.1, "lengths_mm": [268, 1334],
    }  # fmt: skip
    record = {"predicted_distance": expected, "validation": {"distances": []}}
    record["ladder"] = [{"model": ["geometry"], "points_rms_um": 26.5}]
    diagnosis = record_of(found, "named")
    diagnosis["lengths"] |= {"of": "validation points"}
    diagnosis["ladder"] = [{"model": ["geometry"], "heldout_rms_um": 15.3, "point_length_rms_um": 26.6}]
    runs = [Run("fit", record, "a"), Run("gap", diagnosis, "b")]
    (table,) = build.distances(runs).context["blocks"]
    assert table.rows[0][1:] == ("readings of the instrument", "22", "44", "20.1", "-", "720")
    (table,) = build.levels(runs).context["blocks"]
    assert table.headings == ("points, 1", "points, 2")
    assert table.rows == (("geometry", "26.5", "26.6"),)  # 15.3 is per coordinate


def test_the_budget_is_shown_where_the_folder_has_one(found):
    part = {
        "name": "certificate", "type": "B", "distribution": "normal", "value": 0.0, "u": 3.0, "unit": "um",
        "sensitivity": 1.2, "sensitivity_unit": "mm/deg", "contribution": 3e-3, "contribution_um": 3.0,
    }  # fmt: skip
    budget = {
        "measurand": "a distance of 150 mm", "kind": "distance", "components": [part], "text": "U = 6.0 µm",
        "u": 3e-3, "unit": "mm", "u_um": 3.0, "U_um": 6.0, "k": 2.0, "coverage": 0.954, "prior_share": 0.1,
    }  # fmt: skip
    text = words(run_page(Run("gap", record_of(found, "null"), "x", {"budgets": [budget]})))
    assert "Uncertainty budget" in text
    assert "certificate 100 % 3 B normal 3 µm 1.2 mm/deg" in text
    assert "Uncertainty budget" not in words(run_page(Run("gap", record_of(found, "null"), "x")))


def test_the_labels_of_a_flat_drawing_are_within_it():
    """Of an arm on a rail, before a tracker: three metres wide, and seven joints with a name each."""
    found = calibrated(Scene(rail_session()), ("geometry",))
    drawn = str(draw_arm(Run("gap", record_of(found, "null"), "x"), contacts=True))
    height = float(re.search(r'viewBox="0 0 [\d.]+ ([\d.]+)"', drawn)[1])
    labels = [float(y) for y in re.findall(r'<text[^>]* y="([-\d.]+)"[^>]*>J\d<', drawn)]
    assert len(labels) == 7
    assert 12 < min(labels) <= max(labels) < height
    assert np.all(np.diff(labels) > 14)


def test_the_label_of_a_drawing_is_escaped_once(found):
    record = record_of(found, "null")
    record["arm"]["robot"] = 'A&B "1"'
    label = html.unescape(re.search(r'aria-label="([^"]*)"', str(draw_arm(Run("gap", record, "x"))))[1])
    assert label.startswith('The arm A&B "1" in a typical pose')


def test_the_page_poses_the_arm_like_the_chain(found):
    scene = found.model.scene
    expected = 1e3 * reference.frames(scene.chain, scene.q[:4])[:, :, :3, 3]
    for q, at in zip(scene.q[:4], expected, strict=True):
        assert posed(arm_drawing(scene), q)[0] == pytest.approx(at, abs=0.02)


@pytest.mark.parametrize("text", ["", "{", '{"schema": "bayescal-fit/9"}', "[]", None])
def test_damaged_and_missing_records_are_refused(tmp_path, text):
    if text is not None:
        (tmp_path / "fit.json").write_text(text)
    refused(r"no fit\.json or gap\.json" if text is None else r"fit\.json", lambda: read_run(tmp_path))


def test_ticks_are_round():
    assert ticks(-1.0, 1.0) == pytest.approx([-1, -0.5, 0, 0.5, 1])
    assert len(ticks(3.0, 3.0)) == 1
    assert "-0" not in [f"{v:g}" for low in (-0.3, -0.9, -1.0) for v in ticks(low, 1.0)]
    assert np.all(np.diff(ticks(0.0, 777.0)) == 200.0)


def test_lengths_of_errors_have_an_axis_from_zero_with_room_for_its_ticks(found):
    record = record_of(found, "null")
    rows = record["rows"]
    rows["residual_um"] = [r and 1e3 * abs(r) for r in rows["residual_um"]]
    page = run_page(Run("gap", record, "x"))
    drawing = re.search(r'<svg [^>]*aria-label="Residuals over J1.*?</svg>', page, re.DOTALL)[0]
    levels = re.findall(r'<text x="([.\d]+)" y="[-.\d]+" text-anchor="end">([^<]+)</text>', drawing)
    assert min(float(value) for _, value in levels) == 0
    assert all(float(x) - 6.2 * len(value) > 14 for x, value in levels)  # the label of the axis is left of it


# --- `bayescal report`: the page in the run folder, comparison of runs, files of the user.


@pytest.fixture(scope="module")
def runs(saved, tmp_path_factory):
    """Two fits, of two sessions of one arm."""
    folder = tmp_path_factory.mktemp("runs")
    shutil.copytree(saved[0], folder / "run1")
    bc.fit(simulated(2), "geometry", samples=0).save(folder / "run2", pictures=False)
    return folder


@pytest.fixture
def own(runs, tmp_path):
    shutil.copytree(runs / "run1", tmp_path / "run1")
    return tmp_path / "run1"


def test_the_page_is_written_into_the_run_folder(own):
    before = {p.name: p.read_bytes() for p in own.iterdir() if p.is_file()}
    assert bc.report(own) == (own / "report.html",)
    after = {p.name: p.read_bytes() for p in own.iterdir() if p.is_file()}
    assert after.keys() == before.keys()
    assert after["fit.json"] == before["fit.json"]
    listed = json.loads(after[".bayescal-files.json"])["files"]
    assert listed.keys() >= {"report.html", "dataset/dataset.yaml"}
    assert bc.report(own) == (own / "report.html",)  # an unchanged folder: again


def test_a_folder_with_files_of_the_user_is_not_touched(own):
    (own / "notes.txt").write_text("mine")
    refused(r"notes\.txt", lambda: bc.report(own))
    assert (own / "notes.txt").read_text() == "mine"
    page = own.parent / "page.html"
    assert bc.report(own, page) == (page,)
    assert bc.report(own, page) == (page,)  # a page of bayescal may be replaced


@pytest.mark.parametrize(("name", "beside"), [("mine.html", False), ("mine.pdf", False), ("mine.pdf", True)])
def test_files_of_the_user_are_kept(own, name, beside, monkeypatch):
    """A PDF of the user was replaced where our page of the same name lay beside it."""
    monkeypatch.setattr(build, "browser", lambda: "")
    path = own.parent / name
    if beside:
        bc.report(own, own.parent / "mine.html")
    path.write_text("mine")
    refused(f"{name}: a file that is no page", lambda: bc.report(own, own.parent / "mine.html", pdf=True))
    assert path.read_text() == "mine"


def test_a_pdf_of_the_user_is_no_matter_of_a_page_without_one(own):
    path = own.parent / "mine.pdf"
    path.write_text("mine")
    bc.report(own, own.parent / "mine.html")
    assert path.read_text() == "mine"


def test_runs_side_by_side(runs, tmp_path):
    (path,) = bc.report([runs / "run1", runs / "run2"], tmp_path / "both.html")
    text = words(path.read_text(encoding="utf-8"))
    records = [json.loads((runs / f"run{k}" / "fit.json").read_text()) for k in (1, 2)]
    a, b = ({p["name"]: p for p in r["parameters"]}["a2"] for r in records)
    u = (a["sd"] ** 2 + b["sd"] ** 2) ** 0.5
    assert f"{abs(b['estimate'] - a['estimate']) / u:.1f}" in text
    for record in records:
        assert record["verdict"]["words"] in text
        assert f"{float(format(record['predicted_distance']['expanded_U_um'], '.2g')):g}" in text
    assert "not independent" not in text


@pytest.mark.parametrize(("part", "value", "beside", "said", "unsaid"), [
    (("dataset", "sha256"), "0" * 64, "", "not independent", "different robots"),
    (("arm", "robot"), "another", "run2", "different robots: not compared", "difference / u"),
])  # fmt: skip
def test_runs_that_must_not_be_compared(runs, tmp_path, part, value, beside, said, unsaid):
    """Of the same dataset, whose differences have another u; of other robots."""
    record = json.loads((runs / "run1" / "fit.json").read_text())
    record[part[0]][part[1]] = value
    (tmp_path / "fit.json").write_text(json.dumps(record))
    (path,) = bc.report([runs / beside if beside else tmp_path, tmp_path], tmp_path / "both.html")
    text = words(path.read_text(encoding="utf-8"))
    assert said in text
    assert unsaid not in text


def test_the_command(own):
    done = CliRunner().invoke(app, ["report", str(own), "--out", str(own.parent / "x.html")])
    assert done.exit_code == 0, done.output
    assert "x.html" in done.output


def test_without_a_browser_nothing_is_written(own, monkeypatch):
    monkeypatch.setattr(build.shutil, "which", lambda name: None)
    out = own.parent / "x.html"
    refused("no Chromium or Chrome", lambda: bc.report(own, out, pdf=True))
    assert not out.exists()


def test_pdf(own, chromium, monkeypatch):
    page, printed = bc.report(own, own.parent / "x.html", pdf=True)
    assert printed.read_bytes().startswith(b"%PDF")
    assert page.is_file()
    monkeypatch.setattr(build, "pdf_of", lambda *_: b"%PDF again")
    assert bc.report(own, page, pdf=True) == (page, printed)  # a PDF of bayescal may be replaced


def test_a_link_in_a_run_folder_brings_no_file_into_the_page(tmp_path):
    secret = tmp_path / "secret.png"
    secret.write_bytes(b"\x89PNG secret")
    name = next(iter(FIGURES))
    (tmp_path / name).symlink_to(secret)
    assert _png(secret)
    assert _png(tmp_path / name) == b""
    (tmp_path / "other.png").write_bytes(b"no picture")
    assert _png(tmp_path / "other.png") == b""


def test_effects_of_several_runs_are_in_the_order_of_their_largest_probability():
    """Whichever run has it; those that no run holds for possible are left out."""
    first = {"backlash": 0.9, "lobing": 0.3, "payload": 0.001}
    both = (("x", first), ("y", {"backlash": 0.1, "lobing": None, "bending": 0.5, "payload": 0.002}))
    runs = [Run("gap", {"probability": p, "amplitudes": []}, name) for name, p in both]
    text = str(build.effects(runs))
    places = [text.index(name) for name in ("backlash", "bending", "lobing")]
    assert places == sorted(places)
    assert "payload" not in text


@pytest.mark.parametrize("sure", [0.56, 0.97])
def test_the_page_of_a_log_advises_to_measure_where_a_name_is_only_probable(sure):
    named = {"probability": sure, "relevant": True, "text": "joint 2: backlash", "remedy": "Adjust the gear."}
    record = {"words": ["An effect."], "verdict": "named", "named": [named], "next": [], "warnings": []}
    text = words(str(motion.first(Run("motion", record, "run"))))
    assert ("Adjust the gear." in text) == (sure > 0.9)
    assert ("probably joint 2: backlash" in text) == ("Measure more before" in text) == (sure < 0.9)


def test_the_band_of_residuals_is_twice_their_noise(saved, monkeypatch):
    run, bands = read_run(saved[0]), []
    monkeypatch.setattr(svg, "scatter", lambda dots, labels, band, *others: bands.append(band) or "")
    common.residuals(run)
    assert set(bands) == {2.0 * run.record["noise"]["estimated_um"]}
