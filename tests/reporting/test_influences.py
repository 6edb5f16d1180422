"""Every number of a result reaches its record under its own name, and from there terminal and page."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cases import cases
from gap_diagnoses import BACKLASH, diagnosis
from influences import check_written, unseen
from planning.made_up_plans import made_up_plan

from bayescal.effects import UNITS as EFFECT_UNITS
from bayescal.effects.location import Driver, joint
from bayescal.fitted.gate import NOTHING
from bayescal.gap.result import Amplitude, BlindSpot, Event, NextContact, Pair, Suspect
from bayescal.reporting import exports, fleet, origin, watch
from bayescal.reporting.gap import record as gap_file
from bayescal.reporting.gap import summary
from bayescal.reporting.page import Run, build
from bayescal.reporting.page import fit as fit_page
from bayescal.reporting.page import plan as plan_page
from bayescal.watching import Complete, Contact

PARTS = ("magnitude", "where", "margins", "verdict", "shrinkage", "levels", "advice", "blind_spots")
PARTS += ("amplitudes", "undecided")
"""Of a diagnosis, with numbers; `residuals` has three arrays without names."""
NAMES = r".*(site|sites|neighbours)\.number|.*driver\.joint"
"""Numbers that are part of the name of a site or driver."""
CALLED = {
    "validation_rms": "rms", "delta_elpd": "", "delta_elpd_se": "se", "readings": "j", "velocity": "degps",
    "backlash J3": "value", "phase.second": "u_phase",
}  # fmt: skip
"""Words of the key of a number, where they are not its name."""
UNITS = {
    r"_um\.|_um$": lambda x: 1e6 * x,
    r"deg$|degps$|next\.poses": np.degrees,
    r"undecided|amplitudes\.(u|value)": np.degrees,  # `unit` beside it is deg
    r"blind_spots\..*value": lambda x: np.concatenate([1e6 * x, np.degrees(x)]),  # as `unit` beside states
    r"events": lambda x: x + 1,
}
"""What is written in a record, by the key."""


@pytest.fixture(scope="module", autouse=True)
def _quick():
    """A record without what is no number of a diagnosis: versions of libraries and the drawing of the arm."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(origin, "software", lambda libraries: {})
        patch.setattr(gap_file, "arm_drawing", lambda scene: {"robot": "arm"})
        yield


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=1, count=30).dataset


@pytest.fixture(scope="module")
def gap(session):
    """A diagnosis in which all is that a diagnosis may have."""
    made = diagnosis(session, "named+unexplained")
    what = ("wave", 2e-4, 3e-5, "rad", (0.5, 0.125), True)
    wave = Amplitude("backlash", joint(3), Driver("angle", 3), ("x",), *what)
    readings, speeds = tuple(np.linspace(0.1, 0.6, 6).tolist()), tuple(np.linspace(0.01, 0.06, 6).tolist())
    contact = NextContact("cube.+x", session.tools[0].name, readings, speeds, 2.5, "")
    sides = [Suspect("backlash", {"backlash J3": x}, {"backlash J3": "rad"}) for x in (1e-4, 3e-4, 5e-4)]
    named = (replace(BACKLASH, events=(Event(7, (5, 9)),)), *made.verdict.named[1:])
    advice = tuple(replace(a, contacts=(contact,)) for a in made.advice)
    undecided = (Pair(*((s,) for s in sides)),)
    verdict = replace(made.verdict, named=named)
    return replace(made, verdict=verdict, amplitudes=(wave,), advice=advice, undecided=undecided)


def test_every_number_of_a_diagnosis_is_in_its_record_under_its_name(gap):
    rows, before, after = gap.residuals
    given = {part: getattr(gap, part) for part in PARTS} | {"residuals": {"before": before, "after": after}}

    def record(given):
        residuals = (rows, *given["residuals"].values())
        return gap_file.gap_record(replace(gap, **given | {"residuals": residuals}))

    check_written(record, given, but=NAMES, called=CALLED, units=UNITS)


UNSHOWN = r"seed|curves\..*|residuals\..*|next\.poses|where\.(log_evidence|p_value)|lengths\.components"
"""Numbers of a record that figures draw, that files have, or of which another number is shown."""
UNSHOWN += r"|gap\.(heldout_rms_um|noise_um|excess_um\.value)|lengths\.shrinkage\..*"
"""Shown as lengths."""
UNSHOWN += r"|shrinkage\.distances\.after_rms_um"
"""Not claimed."""
ON_TERMINAL = rf"{UNSHOWN}|hypotheses\..*|named\..*|where_marginal\..*|probability\.latency"
ON_PAGE = rf"{UNSHOWN}|named\.log_evidence|where_marginal\.target\.p_value|gap\.measured\..*"
ON_PAGE += r"|gap\.noise_interval95.*|shrinkage\..*\.predicted_before_rms_um"


@pytest.mark.parametrize("kind", ["null", "named+unexplained", "unknown"])
def test_every_number_of_a_diagnosis_is_shown(session, kind, monkeypatch):
    gap = diagnosis(session, kind)
    record = gap_file.gap_record(gap)
    monkeypatch.setattr(summary, "screen", lambda *parts: parts)
    assert not unseen(lambda record: summary.gap_summary(gap, record), record, ON_TERMINAL)
    assert not unseen(lambda r: [of(Run("gap", r, "run")) for of in build.KINDS["gap"][2]], record, ON_PAGE)


def test_every_number_of_a_fleet_is_shown():
    def shown(record):
        tables = (fleet.arms, fleet.effects, fleet.sessions, fleet.findings)
        each = [(fleet.parameters(m), fleet.learnt(m)) for m in record["models"]]
        return [[table(record) for table in tables], each, fleet.counted(record)]

    record = cases("fleet")
    assert not unseen(shown, record, "")
    (said,) = fleet.findings(record)["changed"]
    assert "changed before session t" in said
    assert said.endswith("(26 comparisons)")


def test_an_arm_of_a_fleet_is_that_of_its_last_session():
    def session(arm, u, value):
        effect = {"effect": "backlash", "site": "joint 3", "value": value}
        fit = {"expanded_U_um": u, "measured_rms_um": 0.5 * u}
        return {"session": f"{arm}{u:g}", "arm": arm, "robot": "ur5e", "fit": fit, "effects": [effect]}

    model = SimpleNamespace(robot="ur5e", arms=("a", "b"), unlike=(), changed=(), gains={"a": 1.5, "b": -2.5})
    every = [session("a", 51.0, 0.1), session("b", 30.0, 0.3), session("a", 52.0, 0.2)]
    a, b = fleet._arms(every, [model])
    assert (a["sessions"], b["sessions"]) == (["a51", "a52"], ["b30"])
    for arm, last, gain in ((a, every[2], 1.5), (b, every[1], -2.5)):
        assert last["fit"] == {key: arm[key] for key in last["fit"]}
        assert (arm["effects"], arm["log_score_nats"]) == (last["effects"], gain)


# --- The page of a fit.

ERRORS = {"certified_mm": 200.1, "nominal_error_um": 310.0, "calibrated_error_um": 12.5}
ERRORS |= {"predicted_interval95_um": [-21.5, 17.5], "inside95": True}
FACE = {"target": "cube.+x", "role": "validate", "count": 8}
FACE |= {"nominal_rms_um": 410.0, "calibrated_rms_um": 9.5}
FACE |= {"calibrated_max_um": 19.0, "predicted_rms_um": 7.25, "inside95_fraction": 0.875}
EXPECTED = {"over": "the probed volume", "count": 1000, "lengths_mm": [51.0, 702.0], "predicted_rms_um": 11.0}
EXPECTED |= {"expanded_U_um": 22.0, "k": 2.0, "predicted_interval95_um": [-23.5, 24.5]}
EXPECTED |= {"measured_rms_um": 13.0}
DISTANCE = ERRORS | {"between": ["ball.A", "ball.B"], "predicted_sd_um": 10.5}
CHECKED = {"planes": [FACE], "distances": [DISTANCE], "diameters": [ERRORS | {"target": "ball.A"}]}
OF_FIT = {"validation": CHECKED, "predicted_distance": {"all": [EXPECTED]}}


def test_every_validated_number_of_a_fit_is_on_its_page():
    """Errors of certified diameters were in fit.json alone."""
    share = r"validation\.planes\.inside95_fraction"  # of each the errors themselves are shown
    assert not unseen(lambda record: fit_page.distances(Run("fit", record, "run")), OF_FIT, share)


# --- Records of plans, of verifications and of the priors of fleets.


def test_every_number_of_a_plan_is_in_its_record_under_its_name(session, cube, monkeypatch):
    plan = made_up_plan(cube(seed=1, count=60).dataset)
    plan = replace(plan, clearance=np.linspace(0.01, 0.02, len(plan.purpose)))
    monkeypatch.setattr(plan_page, "origin", lambda *given: {})
    scalars = {key: getattr(plan, key) for key in ("equals_random", "next_u", "travel", "seconds")}
    parts = {key: getattr(plan, key) for key in ("expected", "parameters", "detectable", "confusable")}
    parts |= {key: getattr(plan, key) for key in ("observability", "observability_random", "clearance")}
    kinds = ("curve", "curve_random")
    curves = {key: [{"contacts": n, "sd": u} for n, u in getattr(plan, key)] for key in kinds}

    def record(given):
        points = {key: tuple((p["contacts"], p["sd"]) for p in given[key]) for key in curves}
        return plan_page.plan_record(replace(plan, **given | points))

    called = {
        "expected.u": "distance_sd", "expected.u_random": "distance_sd_random", "next_u": "next_distance_sd",
        "parameters.prior": "prior_u", "confusable.before": "lambda_before",
        "confusable.after": "lambda_after", "noise": "shares_noise",
    }  # fmt: skip
    units = {r"_mm": lambda x: 1e3 * x, r"_um": lambda x: 1e6 * x}
    units[r"^detectable"] = lambda x: np.concatenate([factor * x for _, factor in UNITS_OF_FILES])
    check_written(record, scalars | parts | curves, but=NAMES, called=called, units=units)


UNITS_OF_FILES = (*EFFECT_UNITS.values(), ("um", 1e6))
"""Of amplitudes: their unit is beside them."""


def test_every_number_of_a_watched_session_is_in_its_record_under_its_name(monkeypatch):
    monkeypatch.setattr(watch, "origin", lambda *given: {})
    spots = [{"smallest": 2e-3, "plausible": 3e-4, "distance_error": 5e-5}]
    contacts = [{"residual": 1e-6 * k, "u": 1e-7 * k, "p_value": 0.01 * k, "U": 3e-5 * k} for k in (11, 13)]
    fits = [{"moved": 0.7 + k, "seconds": 1.5 + k, "k": 2.25 + k} for k in (0, 1)]
    fits = [fit | {"expanded": 5e-5 + 1e-6 * k} for k, fit in enumerate(fits)]
    rows = SimpleNamespace(measurements=SimpleNamespace(ids=("a", "b", "c", "d")))
    left_out = SimpleNamespace(estimate=SimpleNamespace(rejected=np.array([1, 3])))
    options = SimpleNamespace(effects=("geometry",), enough=7e-5, planned=60, fit=SimpleNamespace(seed=0))

    def complete(spots, k, expanded, **own):
        space = SimpleNamespace(workspace=SimpleNamespace(k=k, expanded=expanded))
        fit = SimpleNamespace(dataset=rows, final=left_out, forecast=space)
        return Complete(fit, tuple(BlindSpot("backlash", joint(3), unit="rad", **s) for s in spots), **own)

    def record(given):
        events = [complete(given["spots"], **own) for own in given["fits"]]
        judged = [Contact(k, "ab"[k], "cube", "calibrate", **own) for k, own in enumerate(given["contacts"])]
        return watch.watch_record(events, judged, options)

    given = {"contacts": contacts, "fits": fits, "spots": spots}
    called = {"moved": "largest_change", "expanded": "U"}
    units = {r"_um$": lambda x: 1e6 * x, r"smallest|plausible": np.degrees}
    check_written(record, given, but="", called=called, units=units)
    assert [fit["rejected"] for fit in record(given)["fits"]] == [["b", "d"]] * 2


def test_every_number_of_a_verification_is_in_its_record_under_its_name():
    kinds = ("planes", "distances")
    given = {
        "levels": [
            {"name": name, "rms": 1e-7 * k, "maximum": 3e-7 * k, "limit": 7e-7 * k}
            for k, name in enumerate(("nominal", "geometry"), start=1)
        ],
        "missing": {"backlash": 2.5e-6},
        "before": {kind: 11e-6 + 1e-6 * k for k, kind in enumerate(kinds)},
        "after": {kind: 5e-6 + 1e-6 * k for k, kind in enumerate(kinds)},
        "predicted": {kind: [21e-6 + 1e-6 * k, 31e-6 + 1e-6 * k] for k, kind in enumerate(kinds)},
        "count": {kind: 13 + k for k, kind in enumerate(kinds)},
    }

    def record(given):
        parts = {key: given[key] for key in ("before", "after", "predicted", "count")}
        session = SimpleNamespace(measurements=SimpleNamespace(ids=("a",)))
        arm = SimpleNamespace(effects=("geometry",), use=NOTHING, dataset=session)
        levels = [SimpleNamespace(differences=[0], **level) for level in given["levels"]]
        about = {"format": "urdf", "path": Path("arm.urdf"), "software": "MuJoCo", "state": 0, "passed": True}
        gap = SimpleNamespace(before_is="nominal", **parts)
        result = SimpleNamespace(arm=arm, levels=levels, missing=given["missing"], gap=gap, **about)
        return exports.record(result)

    called = {"maximum": "max_difference", "rms": "rms_difference", "backlash": "not_in_file_backlash"}
    for kind in kinds:
        called |= {f"{of}.{kind}": f"{of}_{kind}_rms" for of in ("before", "after")}
        called |= {f"count.{kind}": f"{kind}_count"}
        called |= {f"{kind}.first": f"{kind}_predicted_before", f"{kind}.second": f"{kind}_predicted_after"}
    check_written(record, given, but="", called=called, units={r"_um": lambda x: 1e6 * x})
