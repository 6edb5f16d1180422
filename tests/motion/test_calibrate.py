"""Calibration from a log: draws of arms that could be built, truth within the intervals."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
from cases import refused, terminal_text
from influences import check_written, unseen
from motion.made import verified

import bayescal as bc
from bayescal.logs import read_log
from bayescal.logs.read import written_out
from bayescal.logs.schema import Arm, arm_text
from bayescal.logs.types import PAIRS, inertial, with_bodies
from bayescal.motion import calibrate as calibration
from bayescal.motion import possible
from bayescal.motion.calibrate import calibrate
from bayescal.motion.estimate import of_role
from bayescal.motion.linear import Normal, fitted, tabulated
from bayescal.motion.possible import ABOUT, NOT_NEGATIVE, Possible, draws_within, pseudo_inertia, spread
from bayescal.motion.settings import BASELINE
from bayescal.motion.signals import where_moving
from bayescal.motion.terms import BODY, Term, nominal
from bayescal.public.motions import MotionFitResult
from bayescal.reporting.motion import size_text
from bayescal.reporting.motion.fit import fit_record, fit_summary
from bayescal.robots.schema import SIX


@pytest.fixture(scope="module")
def result(null_log):
    return bc.fit(null_log, samples=1000, seed=3)


def test_withheld_errors_are_as_expected(result):
    low, high = np.array(result.withheld.expected_interval95_Nm.to_list()).T
    assert np.all((low < result.withheld.rms_Nm) & (result.withheld.rms_Nm < high))
    assert np.all(result.withheld.nominal_rms_Nm.iloc[1:] > 2.0 * result.withheld.rms_Nm.iloc[1:])


def test_expected_errors_are_noise_and_what_uncertain_parameters_add(null_estimate):
    """In the mean over the withheld motions, which are as fast: more of them change the interval alone."""
    fit, at = null_estimate.fit(), null_estimate.model
    fitted_rows, held = (of_role(null_estimate.parts, role) for role in ("calibrate", "validate"))
    left = [where_moving(s.unfiltered(at.measured(s) - at.shown(s)), s) for s in fitted_rows]
    noise = np.sqrt(np.nanmean(np.concatenate(left) ** 2, axis=0))
    table = tabulated(held, null_estimate.columns, null_estimate.residual)
    added = [[np.mean(np.sum(x**2, axis=1)) for x in channels[:3]] for channels in fit.followed(table)]
    expected = np.sqrt(noise**2 + np.mean(added, axis=0))
    widths = []
    for times in (1, 2):
        more = replace(null_estimate, parts=(*fitted_rows, *held * times))
        found = calibration._withheld(more, fit, at, at)
        assert [w.expected for w in found] == pytest.approx(expected, rel=0.08)
        widths.append(np.array([np.ptp(w.interval95) / w.expected for w in found]))
    most = np.sqrt((1 / 6 + 1 / 2) / (1 / 6 + 1 / 4))  # of six fitted motions and two withheld, or four
    assert widths[0] / widths[1] == pytest.approx(np.full(3, most), rel=0.05)


def test_every_number_of_a_fit_is_in_its_record_under_its_name_and_is_printed(result, monkeypatch):
    monkeypatch.setattr("bayescal.reporting.motion.record.software", lambda libraries: {})
    fit, record = result.data, result.record
    given = {key: getattr(fit, key) for key in ("parameters", "withheld", "determined", "shift")}
    called = {"withheld.fitted": "rms", "shift": "torque_shift"}
    units = {"_ms$": lambda x: 1e3 * x}
    check_written(lambda given: fit_record(replace(fit, **given)), given, but="", called=called, units=units)
    monkeypatch.setattr("bayescal.reporting.motion.fit.screen", lambda *parts: parts)
    parts = {key: record[key] for key in ("parameters", "withheld", "determined", "torque_shift_ms")}
    unprinted = r"parameters\.(interval95.*|prior_sd)"
    assert not unseen(lambda parts: fit_summary(record | parts, verbose=True), parts, unprinted)


def test_what_the_record_says_of_torque_and_parameters(result):
    """Its time in ms; and joints whose withheld error is beyond what is expected, alone."""
    fit = result.data
    assert fit.shift != 0.0
    assert result.record["torque_shift_ms"] == pytest.approx(1e3 * fit.shift)
    assert result.record["words"] == []
    first, *others = fit.withheld

    def record_of(**changes):
        return fit_record(replace(fit, withheld=(replace(first, **changes), *others)))

    large = 1.01 * first.interval95[1]
    (text,) = record_of(fitted=large, nominal=9.0 * first.nominal)["words"]
    assert "more error than is expected" in text
    assert f"({first.joint} {large:.3g} for {first.expected:.3g} N m)" in text
    # a fit that predicts worse than the nominal arm says so first
    record = record_of(nominal=0.85 * first.fitted)
    (text,) = record["words"]
    assert text.startswith("the fit does not explain the torque of withheld motions: more error than the nom")
    assert f"({first.joint} " in text
    assert record["warnings"][0] == text
    shown = terminal_text(fit_summary(record)).splitlines()
    assert shown[1].startswith("The fit does not explain the torque")
    assert sum("does not explain" in line for line in shown) == 1
    assert record_of(nominal=0.95 * first.fitted)["words"] == []
    # Its estimate is pulled by the prior. On either side of nominal, and no other parameter
    assert not any("prior standard deviations" in text for text in result.record["warnings"])
    for sign in (1, -1):
        parameters = tuple(
            replace(p, estimate=p.nominal + sign * 4.1 * p.prior_sd) if p.name == "alignment" else p
            for p in fit.parameters
        )
        warnings = fit_record(replace(fit, parameters=parameters))["warnings"]
        (text,) = (t for t in warnings if "prior standard" in t)
        assert text.startswith("alignment: more than 4")


def test_known_parameters_are_within_their_uncertainty(result):
    p = result.parameters
    for name in ("armature 1", "coulomb 2", "viscous 3"):
        assert p.identifiable[name] == "yes"
        assert abs(p.estimate[name] - p.nominal[name]) < 3.5 * p.u[name]
    assert p.identifiable["inertia xx of link 1"] == "no"
    assert p.u["inertia xx of link 1"] == pytest.approx(p.prior_sd["inertia xx of link 1"], rel=0.15)
    assert 0 < result.record["determined"] < len(p)


def test_the_reversal_of_friction_is_a_speed(result):
    """The logarithm of its ratio to the nominal one may be below -1; a speed is positive."""
    p, draws = result.parameters, result.data.draws
    names = list(p.index)
    for name in ("transition", "transition 1", "transition 2", "transition 3"):
        assert p.unit[name] == "rad/s"
        assert np.min(draws[..., names.index(name)]) > 0.0
        assert p.nominal[name] == pytest.approx(np.deg2rad(1.719))
        assert p.estimate[name] == pytest.approx(0.03, abs=max(3.5 * p.u[name], 2e-3))
    log = result.data.log
    every, own = log.mechanism.u.transition, np.hypot(log.mechanism.u.transition, BASELINE.transition)
    for name, share in (("transition", every), ("transition 2", own)):  # the logarithm of a speed
        assert p.prior_sd[name] == pytest.approx(share * p.nominal[name])
    terms = SimpleNamespace(terms=[SimpleNamespace(unit="1")] * 2)
    fit = SimpleNamespace(names=["transition", "transition 2"], sd=np.ones(2), normal=terms)
    start = SimpleNamespace(transition=np.array([0.02, 0.03]))
    values, *_ = calibration._speeds(np.array([[[0.3, 0.1]]]), np.zeros(2), fit, start)
    assert values[0, 0] == pytest.approx([0.02 * np.exp(0.3), 0.03 * np.exp(0.3 + 0.1)])
    joints = [p.estimate[f"transition {j}"] for j in (1, 2, 3)]
    assert result.data.mechanism.transition == pytest.approx(np.exp(np.mean(np.log(joints))), rel=0.02)
    assert size_text(0.03, 0.001, "rad/s") == "1.719(57) deg/s"


def test_chains_that_disagree_are_sampled_longer_and_then_stated(null_estimate, monkeypatch):
    monkeypatch.setattr(calibration, "draws_within", spy := Mock(wraps=calibration.draws_within))
    monkeypatch.setattr(calibration, "spread", Mock(side_effect=[3.0, 1.0]))
    fit = calibration.calibrated(null_estimate, null_estimate.fit(), 0, 0)
    longer = calibration.CALIBRATION.further * calibration.CALIBRATION.steps
    assert [call.args[4:] for call in spy.call_args_list] == [(), (longer,)]
    assert not any("chains" in text for text in fit_record(fit)["warnings"])
    assert any("chains" in text for text in fit_record(replace(fit, r_hat=1.2))["warnings"])
    assert not any("--samples" in text for text in fit_record(replace(fit, r_hat=1.2))["warnings"])


def test_every_draw_could_be_built(result):
    data = result.data
    names = [q.name for q in data.parameters]
    draws = data.draws.reshape(-1, len(names))
    for stem in NOT_NEGATIVE:
        assert np.min(draws[:, [k for k, n in enumerate(names) if n.startswith(stem)]]) >= 0.0
    m = data.mechanism
    for k, body in enumerate(bodies(dict(zip(names, draws.T, strict=True)))):
        of_arm = np.array([m.mass[k], *m.centre[k], *(m.inertia[k][p] for p in PAIRS)])
        assert all(np.linalg.eigvalsh(pseudo_inertia(ABOUT * b))[0] > 0 for b in (of_arm, *body.T[::50]))


def bodies(values):
    """Mass, centre and inertia of each link."""
    return [np.array([values[f"{part} of link {k}"] for part in BODY]) for k in (1, 2, 3)]


def test_estimates_of_bodies_are_those_of_the_arm(result):
    m = result.data.mechanism
    estimates = bodies({p.name: p.estimate for p in result.data.parameters})
    assert np.array([b[0] for b in estimates]) == pytest.approx(m.mass)
    assert np.array([b[1:4] for b in estimates]) == pytest.approx(m.centre)
    assert np.array([b[4 + SIX] for b in estimates]) == pytest.approx(m.inertia)
    flat = result.data.draws.reshape(-1, len(result.data.parameters))
    for p, mean in zip(result.data.parameters, flat.mean(axis=0), strict=True):
        assert p.estimate == pytest.approx(mean, abs=1e-9), p.name
    # an arm is written and read back
    again = written_out(Arm.model_validate(yaml.safe_load(arm_text(m))), m.name)
    for name in ("place", "axis", "mass", "centre", "inertia", "armature", "coulomb", "viscous"):
        assert getattr(again, name) == pytest.approx(getattr(m, name), abs=1e-7), name
    assert again.transition == pytest.approx(m.transition)


def test_bodies_are_found_where_centres_of_mass_are_far_from_stated_ones(tmp_path, null_log):
    """The inertia about an origin is quadratic in the centre of mass: here by more than u of an inertia."""
    stated = yaml.safe_load((null_log / "dataset.yaml").read_text())
    last = stated["robot"]["joints"][2]
    true = last["mass_kg"], last["centre_of_mass_mm"], last["inertia_kgm2"]
    off = [60, -30, 30]
    last["mass_kg"], last["centre_of_mass_mm"] = 1.7, [c + d for c, d in zip(true[1], off, strict=True)]
    stated["robot"]["u"] = {"centre_of_mass_mm": 30}
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(stated))
    (tmp_path / "motion.csv.gz").write_bytes((null_log / "motion.csv.gz").read_bytes())
    fit = calibrate(read_log(tmp_path), 1000, 1)
    assert fit.r_hat < 1.1
    values = {p.name: (p.estimate, p.u) for p in fit.parameters}
    share = 1.0 + 0.08 * np.random.default_rng(1000).standard_normal(3)[2]  # as `made.truth`
    known = [true[0] * share, *(1e-3 * c for c in true[1]), *(share * np.array(true[2]))]
    for part, value in zip(BODY, known, strict=True):
        estimate, u = values[f"{part} of link 3"]
        assert abs(estimate - value) < 3.5 * u, part


def test_an_arm_has_what_named_effects_add(null_estimate, monkeypatch):
    added = {"armature joint 2 acceleration": 0.1, "inertia joint 1 motion of the link mass": 0.2}
    monkeypatch.setattr(possible, "constrained", lambda fit, _: np.array([added[n] for n in fit.names]))
    monkeypatch.setattr(possible.Possible, "of", lambda *_: None)
    fits = (SimpleNamespace(names=list(names), sd=np.ones(len(names))) for names in ((), added))
    plain, wider = (possible.named_arm(null_estimate, fit, None).mechanism for fit in fits)
    assert wider.armature - plain.armature == pytest.approx([0.0, 0.1, 0.0])
    assert wider.mass - plain.mass == pytest.approx([0.2, 0.0, 0.0])


def possible_of(estimate, fit):
    log = estimate.parts[0].log
    return Possible.of(fit, nominal(log, estimate.rms), log), fit.names


def test_a_body_with_too_little_inertia_is_not_possible(null_estimate):
    possible, names = possible_of(null_estimate, null_estimate.fit())
    z = np.zeros(len(names))
    assert possible(z)
    z[names.index("inertia zz of link 2")] = 20.0  # more than the sum of the others
    assert not possible(z)
    z = np.zeros(len(names))
    z[names.index("coulomb 1")] = possible.least[names.index("coulomb 1")] - 1e-9
    assert not possible(z)


def test_draws_within_a_set_are_those_of_the_normal_distribution_that_lie_in_it():
    # a body of which mass, first moment and one inertia vary, its mean near the border; friction not negative
    terms = tuple(Term(name, "", 1.0) for name in ("mass", "centre x", "inertia yy", "coulomb 1"))
    by = np.zeros((1, 4, 4, 4))
    by[0, 3, 3, 0] = by[0, 0, 3, 1] = by[0, 3, 0, 1] = by[0, 0, 0, 2] = 1.0
    least = np.array([-np.inf, -np.inf, -np.inf, -0.5])
    possible = Possible(np.eye(4)[None], by, least)
    root = np.array([[1.0, 0, 0, 0], [0.5, 0.8, 0, 0], [-0.3, 0.2, 0.7, 0], [0.2, 0.1, 0.4, 0.9]])
    gram = np.linalg.inv(root @ root.T) - np.eye(4)
    mean = np.array([0.3, 0.4, -0.8, -0.3])
    fit = fitted(Normal(terms, gram, (gram + np.eye(4)) @ mean, np.zeros(1)), np.arange(4))
    assert np.allclose(fit.z, mean)
    z = mean + np.random.default_rng(0).standard_normal((100_000, 4)) @ root.T
    inside = np.linalg.eigvalsh(possible.pseudo + (z @ by.reshape(16, 4).T).reshape(-1, 4, 4))[:, 0] > 0
    z = z[inside & (z[:, 3] >= -0.5)]
    assert 5_000 < len(z) < 60_000
    draws = draws_within(fit, possible, 3_000, 1, 200_000)
    flat = draws.reshape(-1, 4)
    assert spread(draws) < 1.02
    assert np.abs(flat.mean(axis=0) - z.mean(axis=0)).max() < 0.05
    assert np.abs(flat.std(axis=0) / z.std(axis=0) - 1.0).max() < 0.05


def test_draws_of_an_estimate_beyond_the_set_forget_where_they_began(null_estimate):
    fit = null_estimate.fit()
    possible, names = possible_of(null_estimate, fit)
    k = names.index("inertia zz of link 2")
    beyond = replace(fit, z=fit.z + 3.0 * fit.covariance[k] / np.sqrt(fit.covariance[k, k]))
    assert not possible(beyond.z)
    draws = draws_within(beyond, possible, 250, 0, 200_000)
    assert spread(draws) < 1.1
    j = names.index("coulomb 1")  # determined by the log, and nothing to do with the inertia of link 2
    assert draws[..., j].mean() == pytest.approx(beyond.z[j], abs=0.3 * np.sqrt(fit.covariance[j, j]))
    assert draws[..., j].std() == pytest.approx(np.sqrt(fit.covariance[j, j]), rel=0.15)


@pytest.mark.parametrize(
    ("changes", "no_body"),
    [
        ({"[0.02, 0.1, 0.1, 0, 0, 0]": "[0.02, 0.1, 0.13, 0, 0, 0]"}, True),
        ({"mass_kg: 4": "mass_kg: 0", "[0.03, 0.03, 0.02, 0, 0, 0]": "[0, 0, 0, 0, 0, 0]"}, False),
    ],
)
def test_a_stated_link_that_is_no_body_does_not_hold_the_fit(null_log, tmp_path, changes, no_body):
    """One moment larger than the sum of the others, as in many a URDF; two joints of one body."""
    folder = Path(shutil.copytree(null_log, tmp_path / "log"))
    text = (folder / "dataset.yaml").read_text()
    for old, new in changes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    (folder / "dataset.yaml").write_text(text)
    fit = bc.fit(folder, samples=0)
    assert any("no body has the inertia that is stated of B" in text for text in fit.warnings) == no_body
    assert any(name.endswith("of link 1") for name in fit.parameters.index) == no_body
    assert np.all(fit.withheld.rms_Nm[1:] < 0.5 * fit.withheld.nominal_rms_Nm[1:])
    assert fit.parameters.estimate["mass of link 2"] != pytest.approx(5.0, rel=1e-6)
    fit.save(tmp_path / "run")
    assert verified(tmp_path / "run", tmp_path)[1].passed


def test_every_link_is_a_body_that_there_can_be(null_log):
    m = read_log(null_log).mechanism
    assert with_bodies(m) == (m, ())
    inertia = m.inertia.copy()
    inertia[0], inertia[1] = np.diag([0.0, 0.4, 0.4]), 0.0  # a rod of no thickness, and nothing stated
    found, notes = with_bodies(replace(m, inertia=inertia))
    for body in found.inertia:
        assert np.all(np.linalg.eigvalsh(0.5 * np.trace(body) * np.eye(3) - body) > 0.0)
    assert found.inertia[0] == pytest.approx(inertia[0], abs=1e-4)
    assert np.array_equal(found.inertia[2], m.inertia[2])
    assert found.inertia[1] == pytest.approx(m.mass[1] * (0.3 * 0.3) ** 2 * np.eye(3))  # 300 mm to joint C
    assert ["A" in notes[1], "B" in notes[0]] == [True, True]


def test_pseudo_inertia_is_the_second_moment_of_the_mass():
    points = np.random.default_rng(0).normal(size=(9, 3))
    ten = sum(inertial(0.5, x, np.zeros((3, 3))) for x in points)
    wide = np.column_stack([points, np.ones(9)])
    assert pseudo_inertia(ten) == pytest.approx(0.5 * wide.T @ wide)


def test_a_run_folder_is_read_back(result, tmp_path):
    written = result.save(tmp_path / "run")
    assert written == ("fit.json", "report.html", "posterior.nc", "arm.yaml", "dataset")
    refitted = bc.fit(tmp_path / "run" / "dataset", samples=1000, seed=3)
    assert refitted.record["parameters"] == result.record["parameters"]
    assert np.array_equal(refitted.data.draws, result.data.draws)  # of one seed
    again = bc.load(tmp_path / "run")
    assert again.record == json.loads(json.dumps(result.record))
    values = again.inference_data()["posterior"]["parameter_value"]
    assert values.shape == result.data.draws.shape
    assert "armature 1" in str(result)


def test_a_log_without_withheld_motions_or_with_coupled_joints_is_saved(result, tmp_path):
    coupled = replace(result.data.mechanism, coupling=np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]]))
    bare = MotionFitResult(replace(result.data, withheld=(), mechanism=coupled))
    assert "arm.yaml" not in bare.save(tmp_path / "run")
    assert any("coupled" in text for text in bare.warnings)
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "No motion was withheld" in page
    assert "as expected" not in page
    refused("the joints of its arm are coupled", lambda: bc.export(tmp_path / "run", "mjcf"))
