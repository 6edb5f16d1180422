"""A small run of the fuzzer (`make fuzz` makes 10,000 cases), and classes that once failed."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import cases

from analysis.fuzz.cases import FIT, Ran, case, judged, run
from analysis.fuzz.mutations import PLAUSIBLE
from analysis.fuzz.seeds import datasets
from bayescal import calibration
from bayescal.dataset import Dataset, read_dataset
from bayescal.dataset.consistency import contradictions
from bayescal.errors import BayescalError
from bayescal.estimate.estimate import check_converged
from bayescal.model.scene import Scene
from bayescal.predict.locate import AmbiguousPositionError, UnlocatedError
from bayescal.predict.targets import check_located, leaving_out
from bayescal.preparing.check import check

SEED = 0
CASES = 10


def written(files, folder):
    """The folder, with these files."""
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.mark.parametrize("number", range(7, 7 + CASES))
def test_damaged_input(tmp_path, number):
    verdict = case(number, SEED, tmp_path / "case")
    assert verdict.kind != "FAIL", verdict


def test_a_case_is_the_same_each_time(tmp_path):
    assert case(3, 1, tmp_path / "a") == case(3, 1, tmp_path / "a")


@pytest.mark.parametrize("name", sorted(datasets()))
def test_seeds_are_valid(tmp_path, name):
    written(datasets()[name], tmp_path)
    ran = run(["check", str(tmp_path)], 60)
    assert (ran.code, ran.error, ran.trouble) == (0, "", "")
    assert "refused by fit" not in ran.output


def test_two_noise_groups_are_recorded(tmp_path):
    """Points and orientations of a tracker have a noise scale each."""
    written(datasets()["rich"], tmp_path)
    ran = run(["fit", str(tmp_path), *FIT[1:], "--model", "joint", "--out", str(tmp_path / "run")], 60)
    assert (ran.code, ran.trouble) == (0, ""), ran.error
    record = json.loads((tmp_path / "run" / "fit.json").read_text())
    assert set(record["noise"]["scale"]) == {"point", "orientation"}
    assert record["sampler"]["monte_carlo_error"]["largest_over_sd"] > 0


@pytest.mark.parametrize(("change", "words"), [
    ("certificate x 25.4", "apart, as the rows on them are; the value was converted once too often"),
    ("certificate x 1000", "apart, as the rows on them are; the certified value looks like µm"),
    ("certificate in inches", "apart, as the rows on them are; the certified value looks like inches"),
])  # fmt: skip
def test_a_fit_names_a_certified_length_that_contradicts_the_places(tmp_path, change, words):
    written(PLAUSIBLE[change](datasets()["cube"]), tmp_path)
    ran = run(["fit", str(tmp_path), *FIT[1:], "--model", "joint", "--out", str(tmp_path / "run")], 60)
    said = " ".join((ran.output + ran.error).split())
    assert ran.trouble == ""
    assert "certified" in said
    assert words in said
    assert "nan" not in said


def test_a_smaller_contradiction_is_stated_by_the_fit(tmp_path):
    """15 % of 228.6 mm: the session is fitted, and a fit that does not converge names the certificate."""
    written(PLAUSIBLE["certificate 15 % off"](datasets()["cube"]), tmp_path)
    found = [c for c in contradictions(read_dataset(tmp_path)) if "cube.+y" in c.what]
    assert [c.impossible for c in found] == [False]
    assert "certified 262.89 mm, nominally 228.6 mm" in found[0].what
    linear = SimpleNamespace(jacobian=np.eye(2), residual=np.ones(2))
    for covariance, words in (
        (np.eye(2), "1 standard deviations short"),
        (np.full((2, 2), np.nan), "without a"),
    ):
        with pytest.raises(BayescalError, match=words) as caught:
            check_converged(linear, covariance, np.zeros(2), [found[0].what])
        assert "certified 262.89 mm" in caught.value.remedy
        assert "nan" not in str(caught.value)


def test_every_plausible_change_changes_a_seed():
    for name, change in PLAUSIBLE.items():
        assert any(change(files) != files for files in datasets().values()), name


def test_rows_that_fit_two_places_are_found_before_the_arm_is_fitted(tmp_path, monkeypatch):
    """A sphere of one contact, to which two places fit equally well: only the prior of its place decides."""
    session = read_dataset(written(datasets()["tiny"], tmp_path))
    monkeypatch.setattr(calibration, "leaving_out", lambda dataset, compute: (compute(dataset), {}))
    monkeypatch.setattr(calibration, "fitted_level", None)
    with pytest.raises(AmbiguousPositionError, match=r"target ball\.A .* two places .* mm apart"):
        calibration.fit(session)
    targets = tuple(replace(t, u=20e-6) if t.name == "ball.A" else t for t in session.targets)
    check_located(Scene(replace(session, targets=targets)))


def test_a_validation_target_that_cannot_be_located_is_left_out(tmp_path):
    """Rows that are fitted do not need it: they are, and check, fit and gap say what validates nothing."""
    session = read_dataset(written(datasets()["tiny"], tmp_path))
    words = "target ball.A cannot be located from its rows: two places"
    assert any(f.code == "not_located" and f.kind == "missing" for f in check(tmp_path).findings)
    fitted = calibration.fit(session, ("joint",), samples=0)
    (found,) = [f for f in fitted.findings if f.code == "not_located"]
    assert found.text.startswith(words)
    assert "it validates nothing" in found.text
    assert fitted.final.validation.planes
    row = int(np.flatnonzero(session.measurements.role == "calibrate")[0])
    needed = session.targets[session.measurements.target[row]].name

    def compute(_: Dataset) -> None:
        raise UnlocatedError(needed, "two places")

    with pytest.raises(UnlocatedError):
        leaving_out(session, compute)


@pytest.mark.parametrize(("name", "text", "kind"), cases("infinities"))
def test_infinity_in_an_output_is_a_failure_unless_it_is_a_name(tmp_path, name, text, kind):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / name).write_text(text)
    assert judged(Ran(0, "", "tools  inf (18 rows)", ""), tmp_path / "out", tmp_path)[0] == kind


@pytest.mark.parametrize(("output", "kind"), [("FAILED: geometry differs", "accepted"), ("", "FAIL")])
def test_an_exit_code_without_a_message_needs_a_verdict(tmp_path, output, kind):
    (tmp_path / "in").mkdir()
    assert judged(Ran(1, "", output, ""), tmp_path / "out", tmp_path)[0] == kind
