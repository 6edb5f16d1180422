"""`bayescal report`: the page in the run folder, comparison of runs, files of the user."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import bayescal as bc
from bayescal.cli import app
from bayescal.errors import BayescalError
from bayescal.reporting.page import build

sys.path.insert(0, str(Path(__file__).parent))
from test_pages import words


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two fits, of two sessions of one arm."""
    folder = tmp_path_factory.mktemp("runs")
    options = {"effects": "geometry", "contacts": 60, "later": 8, "repeats": 5, "spheres": 2, "arm_seed": 1}
    for seed in (1, 2):
        session = bc.simulate(seed=seed, **options)
        bc.fit(session, "geometry", samples=0).save(folder / f"run{seed}", pictures=False)
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
    assert json.loads(after[".bayescal-files.json"])["files"].keys() >= {
        "report.html",
        "dataset/dataset.yaml",
    }
    assert bc.report(own) == (own / "report.html",)  # an unchanged folder: again


def test_a_folder_with_files_of_the_user_is_not_touched(own):
    (own / "notes.txt").write_text("mine")
    with pytest.raises(BayescalError, match=r"notes\.txt"):
        bc.report(own)
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
    with pytest.raises(BayescalError, match=f"{name}: a file that is no page"):
        bc.report(own, own.parent / "mine.html", pdf=True)
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


def test_runs_of_the_same_dataset_are_not_independent(runs, tmp_path):
    record = json.loads((runs / "run1" / "fit.json").read_text())
    record["dataset"]["sha256"] = "0" * 64
    (tmp_path / "fit.json").write_text(json.dumps(record))
    (path,) = bc.report([tmp_path, tmp_path], tmp_path / "same.html")
    assert "not independent" in words(path.read_text(encoding="utf-8"))


def test_parameters_of_different_robots_are_not_compared(runs, tmp_path):
    record = json.loads((runs / "run1" / "fit.json").read_text())
    record["arm"]["robot"] = "another"
    (tmp_path / "fit.json").write_text(json.dumps(record))
    (path,) = bc.report([runs / "run2", tmp_path], tmp_path / "other.html")
    text = words(path.read_text(encoding="utf-8"))
    assert "different robots: not compared" in text
    assert "difference / u" not in text


def test_the_command(own):
    done = CliRunner().invoke(app, ["report", str(own), "--out", str(own.parent / "x.html")])
    assert done.exit_code == 0, done.output
    assert "x.html" in done.output


def test_without_a_browser_nothing_is_written(own, monkeypatch):
    monkeypatch.setattr(build.shutil, "which", lambda name: None)
    out = own.parent / "x.html"
    with pytest.raises(BayescalError, match="no Chromium or Chrome"):
        bc.report(own, out, pdf=True)
    assert not out.exists()


@pytest.mark.skipif(not any(map(shutil.which, build.BROWSERS)), reason="no Chromium or Chrome")
def test_pdf(own):
    page, printed = bc.report(own, own.parent / "x.html", pdf=True)
    assert printed.read_bytes().startswith(b"%PDF")
    assert page.is_file()
    assert bc.report(own, page, pdf=True) == (page, printed)  # a PDF of bayescal may be replaced


def test_a_link_in_a_run_folder_brings_no_file_into_the_page(tmp_path):
    from bayescal.reporting.page.section import FIGURES, _png

    secret = tmp_path / "secret.png"
    secret.write_bytes(b"\x89PNG secret")
    name = next(iter(FIGURES))
    (tmp_path / name).symlink_to(secret)
    assert _png(secret)
    assert _png(tmp_path / name) == b""
    (tmp_path / "other.png").write_bytes(b"no picture")
    assert _png(tmp_path / "other.png") == b""
