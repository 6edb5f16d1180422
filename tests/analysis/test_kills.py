"""The kills of `analysis.kills` in small, and what its judgement sees."""

import json
import subprocess
import sys

import numpy as np
import pytest

from analysis.kills import COMMANDS, SIDECAR, contents, killed, kills, state
from analysis.separation import evidence, right
from bayescal.storage.folders import whole


def test_kills_continue_where_they_stopped(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr("analysis.kills.prepared", lambda *_: {"init": 1.0})
    monkeypatch.setattr("analysis.kills.attempt", lambda *call: made.append(call[3:]) or ("new", "killed"))
    whole = kills(["init"], 9, 1, tmp_path)
    for path in tmp_path.glob("*.jsonl"):
        path.write_text("".join(path.read_text().splitlines(True)[:5]) + '["in')
    assert kills(["init"], 9, 1, tmp_path) == whole
    assert kills(["init"], 9, 1, tmp_path) == whole
    assert made[9:] == made[5:9]


def test_what_a_killed_command_started_must_end(tmp_path, monkeypatch):
    command = (
        "import pathlib, subprocess, time; subprocess.Popen(['sleep', '60']);"
        "pathlib.Path('.fit.part').touch(); time.sleep(60)"
    )
    line = [sys.executable, "-c", command]
    monkeypatch.setattr("analysis.kills.ENDING", 0.1)
    monkeypatch.setattr(
        "analysis.kills.call", lambda *_: subprocess.Popen(line, cwd=tmp_path, start_new_session=True)
    )
    with pytest.raises(SystemExit, match="does not end"):
        killed(COMMANDS["fit"], tmp_path, 0.0, True)


def written(folder, text):
    with whole(folder / "fit", "fit.json") as stage:
        (stage / "fit.json").write_text(text)


def test_what_is_incomplete_is_seen(tmp_path):
    fit, out = COMMANDS["fit"], tmp_path / "fit"
    assert state(fit, tmp_path, {}) == "nothing"
    written(tmp_path, "first")
    before = contents(out)
    assert state(fit, tmp_path, before) == "earlier"
    written(tmp_path, "second")
    assert state(fit, tmp_path, before) == "new"
    (out / "fit.json").write_text("sec")
    assert state(fit, tmp_path, before) == "DAMAGED"
    (out / "fit.json").unlink()
    assert state(fit, tmp_path, before) == "DAMAGED"


@pytest.mark.parametrize(("sha256", "found"), [("", "DAMAGED"), (None, "new")])
def test_a_file_and_its_sidecar_are_of_one_export(tmp_path, sha256, found):
    out = tmp_path / "arm.urdf"
    out.write_text("<robot/>")
    record = {"sha256": contents(out)["arm.urdf"] if sha256 is None else sha256}
    out.with_name(out.name + SIDECAR).write_text(json.dumps(record))
    assert state(COMMANDS["export"], tmp_path, {}) == found


# --- The share of correct answers of the study of plans for the gap, against its limits and a simulation.

A, B = np.array([0]), np.array([1])


def test_equal_columns_are_guessed_and_different_ones_are_known() -> None:
    rng = np.random.default_rng(0)
    assert right(400.0 * np.ones((2, 2)), A, B, 1.0, rng, fixed=True) == pytest.approx(0.5, abs=0.03)
    assert right(400.0 * np.eye(2), A, B, 1.0, rng, fixed=True) > 0.999
    assert right(1e-6 * np.eye(2), A, B, 1.0, rng) == pytest.approx(0.5, abs=0.03)


def test_evidence_is_that_of_normal_amplitudes(monkeypatch) -> None:
    """Of residuals with the covariance 1 + s^2 x x'."""
    import analysis.separation as study

    monkeypatch.setattr(study, "SCALES", np.array([2.0]))
    monkeypatch.setattr(study, "SCALE_PRIOR", np.array([0.0]))
    rng = np.random.default_rng(1)
    x, r = rng.normal(size=(30, 2)), rng.normal(size=(5, 30)) * 1.5
    covariance = np.eye(30) + 4.0 * x @ x.T
    inverse = np.linalg.inv(covariance)
    expected = 0.5 * (np.sum(r**2, axis=1) - np.einsum("ni,ij,nj->n", r, inverse, r))
    expected -= 0.5 * np.linalg.slogdet(covariance)[1]
    np.testing.assert_allclose(evidence(r @ x, x.T @ x), expected, rtol=1e-9)
