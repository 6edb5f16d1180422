"""`bayescal plan` and `bc.plan`: a folder that comes back, the same plan by seed, one-line refusals."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from cases import cases

import bayescal as bc
from bayescal.planning.setup import read_setup
from bayescal.public.planning import _setup
from bayescal.public.planning import plan as planned

SMALL = {"contacts": 60, "candidates": 200}


@pytest.fixture(scope="module")
def session():
    return bc.simulate(effects="geometry", contacts=70, later=8, repeats=5, spheres=0, seed=1)


@pytest.fixture(scope="module")
def setup(session, tmp_path_factory):
    """A dataset folder without measurements."""
    folder = tmp_path_factory.mktemp("setup") / "cell"
    session.save(folder)
    (folder / "measurements.csv").unlink()
    return folder


@pytest.fixture(scope="module")
def result(setup):
    return bc.plan(setup, purpose="distances", model="geometry", **SMALL)


def test_the_folder_of_the_command_comes_back(setup, result, tmp_path, command):
    out = tmp_path / "run"
    options = ("--contacts", 60, "--candidates", 200, "--for", "distances", "--model", "geometry")
    code, said, error = command("plan", setup, *options, "--to", "csv", "--to", "poses", "--out", out)
    assert code == 0, error
    assert "Expected U = " in said
    assert "random contacts" in said
    there = {p.name for p in out.iterdir() if not p.name.startswith(".")}
    assert there >= {"plan.csv", "plan.json", "plan.html", "plan.png", "plan-joints.csv", "plan-poses.csv"}
    assert not there & {"measurements.csv", "truth.json"}
    saved = bc.load(out)
    assert repr(saved) == repr(result)
    assert len(saved.contacts) == 60
    for table in ("contacts", "distances", "parameters", "detectable", "confusable", "curve"):
        pd.testing.assert_frame_equal(getattr(saved, table), getattr(result, table))
    record = json.loads((out / "plan.json").read_text())
    assert record["dataset"]["sha256"] == read_setup(setup).dataset.sha256 != ""
    (out / "note.txt").write_text("a note of the user")
    code, _, error = command("plan", setup, *options, "--out", out)
    assert code == 1
    assert "did not write: note.txt" in error


def test_a_result_prints_itself(result):
    assert repr(result).startswith("<plan of simulated: 60 contacts; expected U ")
    assert "Expected U = " in str(result)
    assert "<table" in result._repr_html_()
    assert (result.contacts["purpose"].isin(["distances", "repeat"])).all()
    assert result.parameters["u"].le(result.parameters["prior_u"] * (1 + 1e-9)).all()
    u = result.distances["distance_sd_um"].iloc[0]
    assert result.curve["plan"].dropna().iloc[-1] <= u <= result.curve["plan"].dropna().iloc[0]


def test_rows_in_memory_are_ignored(session, setup):
    """A measured session is planned as its folder without measurements."""
    memory, nothing = _setup(session, None, False)
    folder, _ = _setup(setup, None, False)
    assert nothing is None
    assert memory.dataset.measurements.ids == folder.dataset.measurements.ids == ()
    assert memory.regions.keys() == folder.regions.keys()
    for name, region in folder.regions.items():
        np.testing.assert_allclose(memory.regions[name].half, region.half)


def test_measured_rows_count(session, setup, tmp_path):
    """Continued, fewer contacts are enough, and the expected uncertainty is smaller than of them alone."""
    session.save(tmp_path / "measured")
    options = {"contacts": 20, "purpose": "distances", "model": "geometry", "candidates": 150}
    more = bc.plan(setup, after=tmp_path / "measured", **options)
    assert more.data.pool.measured == len(session.dataset.measurements.ids)
    assert len(more.contacts) == 20
    assert not set(more.contacts.index) & set(session.dataset.measurements.ids)
    with pytest.raises(bc.BayescalError, match="20 contacts are not more than"):
        bc.plan(setup, **options)


def test_a_diagnosis_is_continued(session, setup, tmp_path):
    """Its model is taken; its dataset is SETUP."""
    session.save(tmp_path / "measured")
    gap = bc.diagnose(tmp_path / "measured", "geometry")
    gap.save(tmp_path / "gap", pictures=False)
    by_path, by_result = (_setup(tmp_path / "measured", own, False) for own in (tmp_path / "gap", gap))
    assert by_path[1] == by_result[1]
    assert by_path[1].effects == ("geometry",)
    assert len(by_path[0].dataset.measurements.ids) == len(session.dataset.measurements.ids)
    assert by_path[0].dataset.measurements.ids == by_result[0].dataset.measurements.ids
    session.save(tmp_path / "other")
    table = tmp_path / "other" / "measurements.csv"
    table.write_text("\n".join(table.read_text().splitlines()[:-1]) + "\n")
    with pytest.raises(bc.BayescalError, match="no diagnosis of the present files"):
        bc.plan(tmp_path / "other", 12, "gap", after=tmp_path / "gap")


@pytest.mark.parametrize(
    ("options", "words"),
    cases("plan_refusals"),
)
def test_refusals_are_one_line(setup, options, words, tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "run"
    code, _, error = command("plan", setup, "--candidates", 120, *options, "--out", out)
    assert code == 1
    assert words in error
    assert "\n" not in error.strip()
    assert not out.exists()


def test_another_setup_is_not_continued(session, setup):
    other = replace(session.dataset, targets=session.dataset.targets[1:])
    with pytest.raises(bc.BayescalError, match="it has no target"):
        planned(setup, after=other)
    robot = replace(session.dataset, robot=bc.robots.load_robot("universal-robots-ur5")[0])
    with pytest.raises(bc.BayescalError, match="its robot is"):
        planned(setup, after=robot)
