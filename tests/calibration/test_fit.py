"""The calibration end to end, in memory and on the command line."""

import json
import re
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import foreign
import numpy as np
import pytest
from cases import EXAMPLE, ROOT, refused, terminal_text
from sessions import bulging, plain, validating, with_columns, with_rows
from typer.testing import CliRunner

from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.assess.acceptance import EXPLAINED
from bayescal.assess.identifiability import identifiability
from bayescal.assess.shared_causes import completed
from bayescal.calibration import fit
from bayescal.cli import app
from bayescal.dataset import Certificate, read_dataset
from bayescal.effects.probe import GRANITE, TABLE
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated, estimate, linearise
from bayescal.estimate.bounds import with_latent_readings
from bayescal.estimate.estimate import check_converged
from bayescal.estimate.unexplained import check_faces, unexplained, with_uneven_faces
from bayescal.exporting.robot import calibrated_robot
from bayescal.gap.diagnose import diagnose
from bayescal.gap.examine import Baseline, Examined, examine
from bayescal.gap.search.refit import refit
from bayescal.model import ARM, FitOptions, Scene, build, check_asked
from bayescal.posterior.inference import load
from bayescal.reporting.fit.record import fit_record
from bayescal.reporting.fit.summary import fit_summary

FULL = ("geometry", "compliance")
LEVELS = ("nominal", "joint offsets", "geometry", "geometry + compliance")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """One run of the command on the dataset that comes with the project."""
    folder = tmp_path_factory.mktemp("run") / "fit"
    arguments = ["fit", str(EXAMPLE), "--samples", "600", "--out", str(folder)]
    done = CliRunner().invoke(app, arguments, env={"COLUMNS": "100"}, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder, done.stdout, json.loads((folder / "fit.json").read_text())


def test_the_readme_shows_this_session(written):
    """Its levels, errors and estimates are those that the command prints (u is of another sampling)."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = readme[readme.index("$ bayescal fit data/lrmate200ic-cube") : readme.index("    ...\n")]
    errors = r"^ *({}) {{2,}}([\d.]+) +([\d.]+) +([\d.]+) "
    for name in map(re.escape, LEVELS):
        (there,) = re.findall(errors.format(name), shown, re.MULTILINE)
        assert there == re.search(errors.format(name), written[1], re.MULTILINE).groups()
    for error in re.findall(r"maximum [a-z]+ error .*", shown):
        assert error in " ".join(written[1].split())
    values = re.findall(r"^ +(\w+(?: J\d)?) +[-.\d]+ +([-.\d]+)\(", shown, re.MULTILINE)
    assert len(values) > 3
    for name, value in values:
        estimate = next(p["estimate"] for p in written[2]["parameters"] if p["name"] == name)
        assert float(value) == pytest.approx(estimate, abs=0.6 * 10.0 ** -len(value.partition(".")[2]))


def test_command_writes_the_contract(written):
    folder, _, record = written
    pictures = {f"fit-{name}.png" for name in ("levels", "distances", "residuals", "parameters", "posterior")}
    files = "fit.json report.html posterior.nc budget.json budget.csv robot.yaml arm.json dataset"
    assert {p.name for p in folder.glob("[!.]*")} == pictures | set(files.split())
    keys = "schema dataset software seed model parameters noise residuals identifiability sampler validation"
    assert set(keys.split()) <= set(record)
    assert record["schema"] == "bayescal-fit/1"
    assert record["model"] == list(FULL)
    for p in record["parameters"]:
        assert {"name", "unit", "nominal", "estimate", "sd", "prior_sd", "contraction"} <= p.keys()
        assert p["interval95"][0] <= p["estimate"] + p["sd"]
        assert p["sd"] <= 1.1 * p["prior_sd"]
    assert record["sampler"]["ess"]["min"] >= 600
    assert record["validation"]["worst_distance_um"]["nominal"] > 1000


def test_distances_come_down_to_the_noise_and_parameters_agree_with_the_truth(written):
    _, _, record = written
    distances = record["validation"]["distances"]
    errors = np.array([d["calibrated_error_um"] for d in distances])
    sd = np.array([d["predicted_sd_um"] for d in distances])
    assert np.max(np.abs(errors)) < 25
    assert np.mean((errors / sd) ** 2) < 4
    for d in distances:
        low, high = d["predicted_interval95_um"]
        assert d["inside95"] == (low <= d["calibrated_error_um"] <= high)
        assert low < 0 < high
    # The simulated truth that came with the dataset, which the command never opened
    true = {p["name"]: p for p in json.loads((EXAMPLE / "truth.json").read_text())["parameters"]}
    scores = []
    for p in record["parameters"]:
        if p["name"] in true and p["effect"] != "target" and p["contraction"] > 0.9:
            key = next(k for k in true[p["name"]] if k.startswith("value"))
            scores.append((p["estimate"] - true[p["name"]][key]) / p["sd"])
    assert len(scores) > 20
    assert np.max(np.abs(scores)) < 4.5


def test_posterior_file_has_its_groups(written):
    folder, _, _ = written
    data = load(folder / "posterior.nc")
    for group in ("posterior", "sample_stats", "posterior_predictive", "observed_data", "constant_data"):
        assert group in (data.groups() if callable(getattr(data, "groups", None)) else list(data.children))
    assert data["posterior"]["a2"].attrs["units"] == "mm"
    assert data["posterior"]["compliance_J2"].attrs["units"] == "urad/(N m)"
    assert data["posterior_predictive"]["distance_mm"].sizes["pair"] == 15


def test_calibrated_robot_is_a_robot_file(written, tmp_path):
    """A dataset with the calibrated robot needs no more correction: nominal then is as good as fitted."""
    folder, _, _ = written
    session = tmp_path / "again"
    session.mkdir()
    for name in ("dataset.yaml", "measurements.csv"):
        (session / name).write_text((EXAMPLE / name).read_text())
    text = (session / "dataset.yaml").read_text()
    (session / "dataset.yaml").write_text(text.replace("robot: fanuc-lrmate200ic", "robot: robot.yaml"))
    (session / "robot.yaml").write_text((folder / "robot.yaml").read_text())
    found = calibrated(Scene(read_dataset(session), oriented=True), FULL)
    parameters = found.model.parameters
    off = {name: [] for name in (*FULL, "tool")}
    for p, z in zip(parameters, found.z[: len(parameters)], strict=True):
        off[p.effect].append(abs(z))
    assert max(off["geometry"]) < 0.2
    assert max(off["tool"]) > 0.05  # it still is nominal


def test_summary_reads_in_ten_seconds(written):
    _, out, record = written
    assert out.splitlines()[1].split() == ["verdict", *EXPLAINED.split()]
    for words in ("distance error", "µm RMS, maximum", "U = ", "next", "parameter", "weakly"):
        assert words in out
    shown = re.search(r"^a2 +300\.\d+ +(\d+\.\d+)\((\d\d)\) +mm", out, re.MULTILINE)
    a2 = next(p for p in record["parameters"] if p["name"] == "a2")
    decimals = len(shown[1].partition(".")[2])
    assert float(shown[1]) == pytest.approx(a2["estimate"], abs=0.6 * 10.0**-decimals)
    assert int(shown[2]) == pytest.approx(a2["sd"] * 10.0**decimals, abs=0.6)


@pytest.mark.parametrize(("arguments", "words"), [
    (["nowhere"], "no such folder"),
    ([str(EXAMPLE), "--model", "geometry,elasticity"], "no effect is called `elasticity`"),
    ([str(EXAMPLE), "--model", "geometry@3"], "--model geometry@3: geometry has no setting"),
    ([str(EXAMPLE), "--model", "geometry,step@x"], "--model step@x: 'x' is not a number"),
    ([str(EXAMPLE), "--model", "nonsense@1"], "no effect is called `nonsense`"),
    ([str(EXAMPLE), "--model", "hysteresis@0.02,hysteresis@0.06"], "an effect is named twice"),
    ([str(EXAMPLE), "--model", "geometry,gear-mesh"], "no reductions in the robot file"),
    ([str(EXAMPLE), "--prior-width", "0"], "without priors"),
    ([str(EXAMPLE), "--latent-joints"], "joint_deg"),
])  # fmt: skip
def test_bad_input_is_one_line(arguments, words, tmp_path, error_of, monkeypatch):
    """What is wrong in a model is said before any level is fitted."""
    monkeypatch.setattr("bayescal.calibration.levels_of", lambda effects: (effects,))
    if "--model" in arguments:
        monkeypatch.setattr("bayescal.calibration.fitted_level", lambda *_: pytest.fail("a level was fitted"))
    assert words in error_of("fit", *arguments, "--samples", "0", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_foreign_folder_is_left_alone(tmp_path, error_of):
    (tmp_path / "thesis.txt").write_text("mine")
    assert "thesis.txt" in error_of("fit", EXAMPLE, "--samples", "0", "--out", tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_no_known_length_is_refused(cube):
    session = replace(cube(seed=1, count=120).dataset, certificates=())
    refused("no length is known", lambda: fit(session, FULL, FitOptions(prior_width=1000.0), samples=0))
    assert any("no certified length" in w for w in fit(session, FULL, samples=0).warnings)


def test_latent_readings_agree_with_folded_in_noise(cube):
    """Readings as variables of the graph and readings' noise through the Jacobian: one answer."""
    folded = estimate(build(Scene(cube(seed=3, count=60, joint=np.radians(1e-3)).dataset), FULL))
    latent = with_latent_readings(folded)
    assert np.max(np.abs(latent.z - folded.z) / folded.sd) < 0.02
    np.testing.assert_allclose(latent.sd, folded.sd, rtol=0.01)
    assert np.max(np.abs(latent.z - folded.z)) > 0  # it did solve again


def test_a_fit_short_of_its_optimum_is_refused_and_what_it_lacks_has_words(cube):
    found = estimate(build(Scene(cube(seed=1, count=120).dataset), FULL))
    check_converged(found.linear, found.covariance, found.z)
    z = found.z + 0.2 * found.covariance[:, 5] / found.sd[5]  # a fifth of a standard deviation off
    with pytest.raises(BayescalError, match="short of its optimum"):
        check_converged(linearise(found.model, z, found.weights), found.covariance, z)
    # words for what is not identifiable
    known = identifiability(found)
    assert "only the combination d2 + d3 is identifiable" in [d.words for d in known.weak]
    assert {"a2", "theta3", "ball x"} <= set(known.determined)
    assert known.singular_values[0] ** 2 <= np.linalg.eigvalsh(np.linalg.inv(found.covariance))[-1]


def test_a_bulging_face_is_seen_and_fitted(cube):
    clean = cube(seed=6, count=200).dataset
    assert not any(f.uneven for f in check_faces(estimate(build(Scene(clean), FULL))))
    found = estimate(build(Scene(bulging(clean, 60e-6)), FULL))
    checks = {f.target: f for f in check_faces(found)}
    assert checks["cube.+y"].uneven
    better = with_uneven_faces(found, [checks["cube.+y"]])
    assert better.weights.scale["contact"] < 1.3
    assert better.weights.scale["contact"] < 0.7 * found.weights.scale["contact"]


def test_refits_of_a_diagnosis_are_completed_as_a_fit(cube, monkeypatch):
    """The baseline and a refit without names are the fit; the search has flat faces: the form is a name."""
    session = plain(bulging(cube(seed=6, count=90).dataset, 60e-6))
    found = fit(session, FULL, samples=0).final.estimate
    assert found.model.effects == (*FULL, "plane-form")
    nothing = *[None] * 4, SimpleNamespace(kind="null", members=())
    unsearched = lambda b, _: Examined(b.fitted, b.circumstances, b.candidates, *nothing)  # noqa: E731
    monkeypatch.setattr(Baseline, "weighed", unsearched)
    e = examine(Scene(session, oriented=True), FULL, FitOptions())
    assert e.fitted.model.effects == FULL
    for same in (e.complete, refit(e.fitted, e.candidates, [], e.options)):
        assert same.model.effects == found.model.effects
        assert same.z == pytest.approx(found.z, abs=1e-4)
    assert refit(e.fitted, e.candidates, [], e.options, flat=True).z == pytest.approx(e.fitted.z, abs=1e-4)
    assert [f.target for f in completed(e.fitted).faces if f.uneven] == ["cube.+y"]
    assert completed(e.fitted, flat=True).fitted.model.effects == FULL


def test_a_plane_without_a_certificate_may_be_a_table(cube):
    """Its form has the prior of a table, and that of a face of an artefact the prior of granite."""
    session = cube(seed=6, count=60).dataset
    bare = replace(session, certificates=())
    parameters = (build(Scene(d), (*FULL, "plane-form")).parameters for d in (session, bare))
    sds = [{p.name: p.sd for p in own if p.effect == "plane-form"} for own in parameters]
    assert all(sds[1][name] == pytest.approx(sd * TABLE / GRANITE) for name, sd in sds[0].items())


def test_certified_flatness_keeps_the_form_small(cube):
    session = cube(seed=6, count=120).dataset
    flat = Certificate("flat", ("cube.-x",), u_form=1e-6)
    certified = replace(session, certificates=(*session.certificates, flat))
    model = build(Scene(certified), (*FULL, "plane-form"))
    form = {p.name: p.sd for p in model.parameters if p.effect == "plane-form"}
    assert len(form) == 4 * 12
    for name, sd in form.items():  # the others are taken for granite, three times as uneven
        face, shape = name.split(" form ")
        assert sd == pytest.approx(form[f"cube.+z form {shape}"] / (3 if face == "cube.-x" else 1))


def test_excess_over_repeats_is_told(cube):
    """Repeats at the noise and residuals far above it: what is left is unexplained."""
    session = cube(seed=7, count=160).dataset
    order = np.concatenate([np.arange(160), np.repeat(np.arange(0, 40, 4), 3)])
    again = with_rows(session, order, tuple(f"c{k}" for k in range(190)))
    readings = again.measurements.readings.copy()
    readings[:, 3] += 3e-4 * np.sin(3 * readings[:, 3])  # a wavy joint
    readings[160:, 0] += 5e-6 / 0.45 * np.random.default_rng(0).standard_normal(30)
    repeat = np.array([f"r{k}" if k < 40 and k % 4 == 0 else "" for k in order])
    again = with_columns(again, readings=readings, repeat=repeat, time=10.0 * np.arange(190))
    left = unexplained(estimate(build(Scene(again), FULL)))
    assert left.repeats is not None
    assert left.repeats < 12e-6
    assert left.excess > 2 * left.repeats
    assert unexplained(estimate(build(Scene(session), FULL))).excess == 0.0


@foreign.needs()
def test_simulated_session_of_another_author(monkeypatch):
    """Another simulator's arm: distances as small as its own fair floor allows."""
    monkeypatch.setattr("bayescal.calibration.levels_of", lambda effects: (effects,))
    name = "000"
    truth = json.loads((foreign.WORLDS / "truth" / f"{name}.json").read_text())
    found = fit(read_dataset(foreign.WORLDS / name), FULL, samples=0)
    errors = np.array([d.error for d in found.final.validation.distances]) * 1e6
    assert np.sqrt(np.mean(errors**2)) < 1.3 * truth["distance_rms_um"]["fit_without_effect"]
    assert not found.warnings


# --- Model levels of a calibration: joint offsets, geometry, compliance; and the validation errors of each.

ZEROS = np.array([0.0, 2e-3, -1.5e-3, 1e-3, -2.5e-3, 0.0])
SCALES = np.array([1e-4, -8e-5, 1.2e-4, 6e-5, -1e-4, 5e-5])


@pytest.fixture(scope="module")
def split(cube):
    """Contacts of an arm with errors, a quarter of them validation measurements."""
    return validating(cube(seed=11, count=100).dataset, 4)


def test_every_level_reduces_validation_errors(split):
    """Nominal, joint offsets, geometry, compliance."""
    result = fit(split, FULL, samples=0)
    assert [r.effects for r in result.levels] == [("nominal",), ("joint",), ("geometry",), FULL]
    residuals = [np.concatenate([p.residuals for p in r.validation.planes]) for r in result.levels]
    rms = [np.sqrt(np.mean(r**2)) for r in residuals]
    assert rms[0] > 1.5 * rms[1] > 3 * rms[2] > 3 * rms[3]
    assert rms[3] < 10e-6


def test_a_model_without_geometry_has_no_level_of_joints(split):
    """The level of the joints is only before the geometry, of which it is a part."""
    assert [r.effects for r in fit(split, ("joint",), samples=0).levels] == [("nominal",), ("joint",)]


def test_zeros_and_scales_are_found(cube):
    """The first level estimates them, and the robot file contains them."""
    # a nominal arm with errors of the joint readings alone: zeros and scales
    dataset = cube(seed=12, count=280, spread=0.0).dataset
    rows, coupling = dataset.measurements, dataset.robot.link_from_reading
    links = rows.readings @ coupling.T - ZEROS
    misread = with_columns(dataset, readings=links @ np.linalg.inv(coupling).T / (1.0 + SCALES))
    found = calibrated(Scene(misread), ("joint", "compliance"))
    model = found.model
    names = dict(zip(model.names, zip(model.physical(found.z), found.sd, strict=True), strict=True))
    sd = {p.name: p.sd for p in model.parameters}
    assert not {n for n in sd if n[0] in "ad" and n[1:].isdigit()}, "no length, no twist"
    for i in range(2, 6):
        value, z_sd = names[f"theta{i}"]
        expected = model.scene.dataset.robot.offset[i - 1] + ZEROS[i - 1]
        assert abs(value - expected) < 4 * z_sd * sd[f"theta{i}"]
    for i, true in enumerate(SCALES, start=1):
        value, z_sd = names[f"encoder-scale J{i}"]
        assert abs(value - true) < 4 * z_sd * sd[f"encoder-scale J{i}"]
    assert found.sd[model.names.index("encoder-scale J2")] < 0.7
    stiff = replace(calibrated_robot(found.model, found.arm), compliance=None)
    values = model.deviations(found.z[model.slices[ARM]]).copy()
    values[[p.effect in ("compliance", "tool") for p in model.parameters]] = 0.0
    rows = np.arange(len(misread.measurements.ids))
    q = link_angles(stiff, misread.measurements.readings)
    p = points(chain_of(stiff), q, model.scene.tools)
    np.testing.assert_allclose(p, model.motion(rows).points(values).T, atol=1e-9)


@pytest.mark.parametrize(("effects", "whole"), [
    (("joint", "geometry"), ("geometry", "encoder-scale")),
    (("geometry", "joint"), ("geometry", "encoder-scale")),
    (("encoder-scale", "joint"), ("joint",)),
])  # fmt: skip
def test_a_parameter_of_two_effects_is_in_the_model_once(split, effects, whole):
    """Twice it would have twice the variance, and which of the two a fit means would be open."""
    check_asked(effects, 1.0)
    names = build(Scene(split), effects).names
    assert len(set(names)) == len(names)
    assert set(names) == set(build(Scene(split), whole).names)


def test_gap_takes_the_first_level(cube):
    """Joint offsets leave the errors of the geometry; the level itself is no cause to name."""
    found = diagnose(plain(validating(cube(seed=11, count=60).dataset, 4)), ("joint", "compliance"))
    assert found.baseline == ("joint", "compliance")
    assert "encoder-scale" not in {*found.verdict.probability, *found.verdict.missing}
    check_asked(found.refit, 1.0)
    assert "joint" not in found.verdict.probability
    assert [n.effect for n in found.verdict.named][:1] == ["geometry"]


# --- The summary of a fit at the width of a terminal: every figure of the wide one is in the narrow one.

FIGURE = re.compile(r"[+-]?\d+(?:\.\d+)?(?:\(\d+(?:\.\d+)?\))?")
NOT_SAID = ("as drawn", "held out", "worst", "data decide", " um ", "ladder")


def printed(found, width: int, verbose: bool = False) -> str:
    return terminal_text(fit_summary(found, fit_record(found), verbose), width)


@pytest.fixture(scope="module")
def fits(cube, tracker):
    made = {
        "faces": fit(
            validating(cube(seed=6, count=80).dataset, 4), FULL, FitOptions(tolerance=2e-5), samples=0
        ),
        "tracker": fit(validating(tracker(seed=2, count=60).dataset, 4), FULL, samples=0),
        "long names": fit(
            cube(seed=6, count=70).dataset, (*FULL, "eccentricity", "second-harmonic"), samples=0
        ),
    }
    return made


@pytest.mark.parametrize(("width", "verbose"), [(60, True), (60, False)])
def test_no_figure_is_lost(fits, width, verbose):
    for name, found in fits.items():
        wide, narrow = printed(found, 300, verbose), printed(found, width, verbose)
        assert "…" not in narrow, name
        assert max(map(len, narrow.splitlines())) <= width
        lost = Counter(FIGURE.findall(wide)) - Counter(FIGURE.findall(narrow))
        assert not lost, (name, lost)


def test_the_words_are_those_of_the_field(fits):
    for found in fits.values():
        text = printed(found, 120, True)
        for words in NOT_SAID:
            assert words not in text
        assert "µm" in text


def test_the_first_lines_say_what_to_know(fits):
    for found in fits.values():
        lines = printed(found, 80).splitlines()
        heads = [line.split("  ")[0] for line in lines[:20]]
        assert heads[1] == "verdict"
        assert heads.index("distance error") < heads.index("validation") < heads.index("next")
        assert found.acceptance.verdict in lines[1]


def test_every_parameter_of_the_arm_has_its_uncertainty(fits):
    found = fits["faces"]
    text = printed(found, 80)
    for name in found.final.estimate.model.names[: len(found.final.estimate.model.parameters)]:
        assert re.search(rf"^{re.escape(name)} +-?\d+(\.\d+)? +-?\d+(\.\d+)?\(\d+(\.\d+)?\) ", text, re.M)


def test_a_simpler_level_is_the_fit_with_its_model_alone(tracker):
    """It left out the rows before an event, which a fit of that model keeps: they share a cause."""
    d = tracker(seed=3, count=110).dataset
    xyz = d.measurements.xyz + np.where(np.arange(110) >= 74, 3e-3, 0.0)[:, None] * [1.0, 0.0, 0.0]
    d = with_columns(d, xyz=xyz, role=np.where(np.arange(110) % 4 == 3, "validate", "calibrate"))
    level = fit(d, ("geometry", "step@75 x20"), samples=0).levels[2]
    alone = fit(d, ("geometry",), samples=0).final
    assert (level.effects, alone.estimate.rejected.size) == (("geometry",), 0)
    np.testing.assert_allclose(level.estimate.z, alone.estimate.z, atol=1e-6)
