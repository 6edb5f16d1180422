"""The study's page and the command line of a comparison."""

import json
import subprocess
import sys

import pytest
from cases import ROOT

from analysis.methods import page, session
from bayescal.dataset import write_dataset
from bayescal.simulation import Options

HELD = {"points": 0, "plane_contacts": 40, "planes_rms_um": 5.0, "points_mean_um": None}


def record(sort: str, **distances: float | None):
    methods = []
    for name, rms in distances.items():
        held = {
            **HELD,
            "distances_rms_um": rms,
            "predicted_distance_sd_um": 6.0 if name == "bayescal" else None,
        }
        methods.append({"name": name, "applies": rms is not None, "why": "", "seconds": 0.1, "heldout": held})
    return {"sort": sort, "methods": methods}


def test_page_pools_sessions_and_keeps_the_rest(renewed):
    done = [
        record("clean", normals=3.0, bayescal=3.0),
        record("clean", normals=None, bayescal=4.0),
        {"sort": "clean", "seed": 3, "refused": "no place"},
    ]
    text = renewed(page, lambda path: page.update(path, done))
    assert "clean (2)" in text
    assert "| normals | 3.0 |" in text
    assert "| bayescal | 3.5 |" in text  # root of the mean of 9 and 16


def test_page_has_a_column_for_a_real_session():
    text = page.tables([record("motoman", normals=None, bayescal=4.0)])
    assert "| normals | - |" in text
    assert "planes RMS 5" in text


@pytest.mark.parametrize("holds", ["nothing", "something"])
def test_command_line(tmp_path, holds):
    out = tmp_path / "out"
    if holds == "something":
        out.mkdir()
        (out / "mine.txt").write_text("mine")
    layout = Options(seed=2, contacts=160, later=12, repeats=0, placements=2, sphere_contacts=8)
    write_dataset(session.tracked(layout), tmp_path / "session")
    command = [sys.executable, "-m", "bayescal.cli", "compare", str(tmp_path / "session"), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if holds == "something":
        assert done.returncode == 1
        assert "the folder contains files that bayescal did not write: mine.txt" in done.stderr
        assert [p.name for p in out.iterdir()] == ["mine.txt"]
        return
    assert done.returncode == 0, done.stderr
    assert "open loop" in done.stdout
    assert json.loads((out / "compare.json").read_text())["schema"] == "bayescal-compare/1"
