"""Several sessions on the command line: one fit, one diagnosis, and whether they agree."""

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from bayescal.cli import app
from bayescal.dataset import read_dataset, write_dataset
from bayescal.errors import BayescalError
from bayescal.simulation import Options, simulate
from bayescal.simulation.record import write

LITTLE = {"contacts": 100, "later": 8, "repeats": 3, "placements": 1, "spheres": 2, "sphere_contacts": 8}
QUICK = ("--samples", "0", "--no-pictures")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two sessions of one arm, and one of another."""
    top = tmp_path_factory.mktemp("sessions")
    for name, seed, arm in (("may", 1, 1), ("june", 2, 1), ("twin", 3, 7)):
        write(simulate(Options(name=name, seed=seed, arm_seed=arm, **LITTLE)), top / name)
    return top


def run(*arguments):
    return CliRunner().invoke(
        app, [str(a) for a in arguments], env={"COLUMNS": "120"}, catch_exceptions=False
    )


@pytest.fixture(scope="module")
def together(folders):
    out = folders / "run"
    done = run("fit", folders / "may", folders / "june", *QUICK, "--out", out)
    assert done.exit_code == 0, done.output
    return done.output, json.loads((out / "fit.json").read_text()), out


def test_record_names_every_session(folders, together):
    _, record, out = together
    assert record["dataset"]["name"] == "may + june"
    sessions = record["dataset"]["sessions"]
    assert [(s["name"], s["sha256"]) for s in sessions] == [
        (name, read_dataset(folders / name).sha256) for name in ("may", "june")
    ]
    assert len({record["dataset"]["sha256"], *(s["sha256"] for s in sessions)}) == 3
    assert {p.name for p in out.iterdir()} >= {"fit.json", "posterior.nc", "robot.yaml"}
    planes = {p["target"].partition(":")[0] for p in record["validation"]["planes"]}
    assert planes == {"may", "june"}


def test_record_and_table_tell_how_the_sessions_agree(together):
    printed, record, _ = together
    found = record["agreement"]
    (pair,) = found["pairs"]
    assert pair["sessions"] == ["may", "june"]
    assert not pair["disagree"]
    assert set(pair["apart_sd"]) == {p["name"] for p in found["parameters"]}
    for p in found["parameters"]:
        assert p["together"]["sd"] <= 1.15 * min(s["sd"] for s in p["alone"].values())
    assert "difference" in printed
    assert "may and june: chi-squared" in printed


def test_sessions_of_two_arms_are_flagged(folders):
    out = folders / "mixed"
    done = run("fit", folders / "may", folders / "twin", *QUICK, "--out", out)
    assert done.exit_code == 0, done.output
    record = json.loads((out / "fit.json").read_text())
    assert record["agreement"]["pairs"][0]["disagree"]
    assert "may and twin disagree" in " ".join(done.output.split())
    assert any("may and twin disagree" in warning for warning in record["warnings"])


def test_another_drawing_is_refused_and_nothing_written(folders, tmp_path):
    june = read_dataset(folders / "june")
    longer = replace(june, robot=replace(june.robot, d=june.robot.d + 1e-3))
    write_dataset(longer, tmp_path / "longer")
    with pytest.raises(BayescalError, match=r"not the robot of may: d of J1 0\.001, not 0"):
        run("fit", folders / "may", tmp_path / "longer", *QUICK, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_gap_takes_several_sessions(folders):
    out = folders / "gap"
    done = run("gap", folders / "may", folders / "june", "--no-pictures", "--out", out)
    assert done.exit_code == 0, done.output
    record = json.loads((out / "gap.json").read_text())
    assert [s["name"] for s in record["dataset"]["sessions"]] == ["may", "june"]
    assert record["gap"]["heldout_rms_um"] < 12
    assert "may and june: chi-squared" in done.output


def test_the_joint_level_of_two_sessions_is_compared(folders, tmp_path):
    """`joint` is a level and no cause, and still a model whose sessions are compared."""
    out = tmp_path / "run"
    done = run("fit", folders / "may", folders / "june", "--model", "joint", *QUICK, "--out", out)
    assert done.exit_code == 0, done.output
    assert json.loads((out / "fit.json").read_text())["agreement"]["pairs"]
