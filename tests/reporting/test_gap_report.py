"""Outputs of a diagnosis: gap.json by the contract, a summary of one screen, four figures."""

import html
import json
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from camera_sessions import camera_session
from cases import EXAMPLE, cases, drawn, terminal_text
from gap_diagnoses import SETS, bare, diagnosis, plane, seven
from hypothesis import given, settings
from hypothesis import strategies as st
from sessions import tracker as read_points
from sessions import with_columns
from typer.testing import CliRunner

from bayescal.effects import EFFECTS
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, Site, joint
from bayescal.estimate import calibrated
from bayescal.gap.concluded import settled
from bayescal.gap.result import (
    OTHER,
    VERDICTS,
    Amplitude,
    CauseClass,
    Curve,
    Event,
    Gap,
    Named,
    Shrinkage,
    Verdict,
)
from bayescal.gap.search.cells import cells
from bayescal.model import FitOptions, Scene
from bayescal.reporting.gap import effects_sheet, improved, pair_of, where_sheet, worse
from bayescal.reporting.gap.causes import CAUSES, sentence
from bayescal.reporting.gap.phrases import headline, named, place
from bayescal.reporting.gap.record import gap_record, write_gap
from bayescal.reporting.gap.summary import gap_summary
from bayescal.reporting.page import Run
from bayescal.reporting.page.build import run_page
from bayescal.reporting.page.gap import faults, further, verdict_of
from bayescal.reporting.text import reduction

PICTURES = {"gap-where.png", "gap-which.png", "gap-levels.png", "gap-residuals.png"}


def printed(gap: Gap) -> str:
    return terminal_text(gap_summary(gap, gap_record(gap)), 100)


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=1, count=80).dataset


@pytest.mark.parametrize("kind", VERDICTS)
def test_record_keeps_the_contract(session, kind):
    record = json.loads(json.dumps(gap_record(diagnosis(session, kind)), allow_nan=False))
    assert record["schema"] == "bayescal-gap/1"
    assert record["dataset"] == {"name": session.name, "sha256": session.sha256}
    assert record["seed"] == 3
    assert record["baseline"] == ["geometry", "compliance"]
    assert record["verdict"] == kind
    named = {"named": ["backlash"], "named+unexplained": ["backlash", "step"], "unknown": ["unknown"]}
    assert record["effects"] == named.get(kind, [])
    assert record["credible_set90"] == list(SETS[kind])
    assert {"null", "unknown"} <= set(record["probability"])
    assert record["gap"].keys() >= {"heldout_rms_um", "noise_um", "excess_um"}
    for w in record["where"]:
        assert w.keys() >= {"site", "driver", "rms_um", "share", "p_value", "family_p_value"}
    assert set(record["where_marginal"]) == {"target", "joint", "region", "time", "direction"}
    assert {"planes", "distances"} <= set(record["shrinkage"])
    for s in record["shrinkage"].values():
        assert (s is None) == (kind == "null")
        if s:
            assert {"before_rms_um", "after_rms_um", "floor_um", "removed", "removed_interval95"} <= set(s)
    for level in record["ladder"]:
        assert level.keys() >= {"heldout_rms_um", "distance_rms_um", "delta_elpd", "delta_elpd_se"}
    assert record["ladder"][0]["model"] == ["nominal"]
    assert record["next"][0]["separates"] == ["bending", "base-compliance"]
    lobing, backlash = record["blind_spots"]
    assert lobing["smallest_nameable"] == {"value": pytest.approx(4.0), "unit": "um"}
    assert backlash["smallest_nameable"] == {"value": pytest.approx(np.degrees(1e-5)), "unit": "deg"}
    assert backlash["distance_error_um"] is None
    curve = record["curves"][1]
    assert len(curve["x"]) == len(curve["residual_um"]) == len(curve["fitted_um"]) == len(curve["id"]) == 80
    assert len(record["residuals"]["before_um"]) == 80
    assert record["marked"] == (None if kind == "null" else "joint 3")


def test_a_null_does_not_explain_what_is_told_as_an_error(session):
    gap = diagnosis(session, "null")
    assert headline(gap)[0].endswith("the model explains these data")
    scattered = replace(gap, scatter=SimpleNamespace(words="every image has an error of its own"))
    first, said, *_ = headline(scattered)
    assert "explains" not in first
    assert scattered.scatter.words in said
    # Fit: "model does not explain the machine"; gap: "the model explains these data"
    noisy = replace(session, noise=replace(session.noise, contact=0.1 * session.noise.contact))
    words = headline(replace(gap, calibrated=calibrated(Scene(noisy), ("geometry",))))
    assert words[0] == "No effect found"
    assert words[1].startswith("But the fit leaves residuals of ")


def test_a_null_with_a_negative_compliance_explains_nothing(session):
    """It said that the model explains the data, above a warning that it is not to be used."""
    arm = calibrated(Scene(session), ("geometry", "compliance"))
    k = arm.model.names.index("compliance J2")
    z = arm.z - (20.0 + arm.z[k]) * (np.arange(len(arm.z)) == k)
    gap = replace(diagnosis(session, "null"), arm=replace(arm, z=z), covariance=1e-2 * np.eye(len(z)))
    first, said, *_ = headline(gap)
    assert "explains" not in first
    assert said.startswith("But values of the model are negative by more than")
    assert "compliance J2" in said
    assert "bayescal" not in said


def test_a_named_verdict_says_what_its_arm_leaves(session):
    """Names beside residuals of twice the stated noise: they are not all, or the noise is larger."""
    gap = diagnosis(session, "named")
    words = "But the arm of this diagnosis leaves residuals of "
    noisy = replace(session, noise=replace(session.noise, contact=0.1 * session.noise.contact))
    arms = [calibrated(Scene(each), ("geometry", "compliance")) for each in (session, noisy)]
    told = [any(line.startswith(words) for line in headline(replace(gap, arm=arm))) for arm in arms]
    assert told == [False, True]


def test_only_a_significant_site_is_marked_and_stated(session):
    """No site is marked where no location is significant, whatever the verdict."""
    gap = diagnosis(session, "unknown")
    assert gap_record(gap)["marked"] == "joint 3"
    unclear = tuple(replace(w, family_p_value=0.2) for w in gap.where)
    assert gap_record(replace(gap, where=unclear))["marked"] is None
    # no location is stated that is not significant
    (clear,) = (line for line in headline(gap) if "at joint 3, direction" in line)
    unclear = replace(gap, where=tuple(replace(w, family_p_value=0.2) for w in gap.where))
    nowhere = clear.replace("joint 3, direction of motion of J3", "no location that is significant")
    assert nowhere in headline(unclear)


HEADLINES = {
    "null": "No effect above noise",
    "named": "Effect found: joint 3 has lost motion on reversal (backlash, probability 0.97)",
    "named+unexplained": "Also found: the base shifted suddenly, from row 41 on (step, probability 0.95)",
    "class": "Class of causes: an error at joint 3 that varies with direction of motion of J3",
    "unknown": "Unmodelled effect not in the list of known effects, at joint 3, direction of motion of J3",
    "ambiguous": "Ambiguous: these data do not distinguish the effects of the 90 % set",
}


@pytest.mark.parametrize(("times_noise", "times_limit", "said"), [
    (1.0, 0.9, "No effect above noise"),
    (100.0, 0.9, "No effect found: with these measurements the model is too uncertain to show any"),
    (1.0, 1.1, "No effect found, but errors of validation contacts are larger than the model predicts"),
    (100.0, 1.1, "than the model predicts; these measurements do not show why"),
])  # fmt: skip
def test_errors_beyond_the_prediction_are_said(session, times_noise, times_limit, said):
    """A wrong model of an arm was told to be too uncertain, with errors four times those it predicts."""
    gap = diagnosis(session, "null")
    size = gap.magnitude.measured[0]
    expected = times_noise * gap.magnitude.noise
    limit = max(2.0 * expected, 2.0 * size.rms)
    ends = (0.5 * expected, limit)
    size = replace(size, predicted_rms=expected, rms=times_limit * limit, predicted_interval95=ends)
    assert said in headline(replace(gap, magnitude=replace(gap.magnitude, measured=(size,))))[0]


def test_a_prior_width_in_a_model_is_explained(session):
    size = ("half-width", 1e-4, 1e-5, "rad", None, True)
    amplitude = Amplitude("backlash", joint(3), Driver("direction", 3), (), *size)
    gap = replace(diagnosis(session, "named"), amplitudes=(amplitude,))
    plain, wide = (("geometry", f"backlash at joint 3{width}") for width in ("", " x0.25"))
    said = printed(replace(gap, refit=wide))
    assert "--model 'geometry,backlash at joint 3 x0.25'" in said
    assert "x0.25: prior widths, over the usual ones" in said
    assert "prior widths" not in printed(replace(gap, refit=plain))
    unconfirmed = tuple(replace(n, confirmed=False) for n in gap.verdict.named)
    verdict = replace(gap.verdict, named=unconfirmed)
    assert "--model 'geometry" not in printed(replace(gap, refit=wide, verdict=verdict))


def test_several_shifts_are_said_in_the_order_of_time_with_their_sites(session):
    gap = diagnosis(session, "named")
    events = tuple(Event(row, (row, row)) for row in (40, 9, 20))
    (one, *_) = gap.verdict.named
    words = named(replace(one, effect="step", sites=(TOOL, TOOL, BASE), setting="", events=events), gap)
    assert [int(row) for row in re.findall(r"from row (\d+)", words)] == [10, 21, 41]
    assert [site in words for site in ("the tool from row 10 ", "the base from row 21 ")] == [True, True]


def test_an_effect_that_is_found_is_not_ambiguous(session):
    gap = diagnosis(session, "named")
    explained = tuple(replace(w, explained_by="backlash") for w in gap.where)
    both = replace(gap, verdict=replace(gap.verdict, kind="ambiguous"), where=explained)
    assert headline(both)[0].startswith("Effect found: joint 3")
    words = "Beside it, these data do not distinguish the further effects of the 90 % set"
    assert headline(both)[1] == words
    assert not [line for line in headline(both) if line.startswith("Largest location")]
    by_time = Driver("time", form="to and fro")
    swaying = replace(gap.where[0], site=BASE, driver=by_time, family_p_value=1e-9, explained_by="")
    verdict = replace(gap.verdict, kind="ambiguous", named=())
    _, largest, *further = headline(replace(gap, verdict=verdict, where=(swaying,)))
    assert largest == "Largest location without a name: base or artefact, time, oscillating"
    assert not any("sways" in line for line in further)
    assert verdict_of(gap_record(both))[2] == "Effect found, and others possible"
    assert verdict_of(gap_record(diagnosis(session, "ambiguous")))[2].startswith("Ambiguous")
    of_two = gap_record(both) | {"credible_set90": ["backlash", "hysteresis"]}
    shown = [str(fault) for fault in faults(of_two)]
    assert "possibly hysteresis" in shown[-1]
    assert "Measure more before a part is replaced" in shown[-1]
    assert not any("possibly backlash" in one for one in shown)


def test_a_null_that_is_not_the_likeliest_says_so(session):
    gap = diagnosis(session, "null")
    size = replace(gap.magnitude.measured[0], rms=1e-4)
    verdict = replace(gap.verdict, probability={"null": 0.2, "unknown": 0.3})
    (words, *_) = headline(replace(gap, verdict=verdict, magnitude=replace(gap.magnitude, measured=(size,))))
    assert words.startswith("No effect found: noise only has probability 0.20")
    assert words.endswith("errors of validation contacts are larger than the model predicts")
    verdict = replace(gap.verdict, probability=dict(gap.verdict.probability) | {"null": 0.22, "unknown": 0.3})
    doubtful = replace(gap, verdict=verdict)
    wanted = "No effect found: noise only has probability 0.22, and nothing else is established"
    assert headline(doubtful)[0] == wanted
    assert verdict_of(gap_record(doubtful))[2] == "No effect found"


@pytest.mark.parametrize("kind", VERDICTS)
def test_summary_is_one_screen_that_names_the_verdict(session, kind):
    text = printed(diagnosis(session, kind))
    assert HEADLINES[kind] in text
    assert len(text.splitlines()) <= 46
    for text_of in ("noise", "6.0 µm", "nominal", "measure next", "may be missed", "beware", "no time_s"):
        assert text_of in text
    if kind == "null":
        assert "largest, not significant: joint 3, direction of motion of J3" in text
        assert "%" not in text.replace("95 %", "")
        assert "claimed" not in text
    else:
        assert "not claimed" in text
        assert "96 %" in text


def test_summary_of_empty_tables_and_shares_in_percent(session):
    gap = replace(bare(session), verdict=diagnosis(session, "unknown").verdict)
    assert "at no location that is significant" in printed(gap)
    # shares of locations are in percent
    lines = printed(diagnosis(session, "named")).splitlines()
    for words, share in (("direction of motion of J3", "70 %"), ("joint 1", "10 %")):
        assert any(words in line and f" {share} " in line for line in lines), words


CASES = {
    "named": lambda cube, tracker: diagnosis(cube),
    "null": lambda cube, tracker: diagnosis(cube, "null"),
    "unexplained": lambda cube, tracker: diagnosis(cube, "named+unexplained"),
    "no distances": lambda cube, tracker: diagnosis(cube, "unknown", distances=False),
    "single plane, no time": lambda cube, tracker: diagnosis(plane(cube), "ambiguous", distances=False),
    "points": lambda cube, tracker: diagnosis(tracker, "named", distances=False),
    "seven joints": lambda cube, tracker: diagnosis(seven(cube)),
    "empty tables": lambda cube, tracker: bare(cube),
}


DRAWN = ("single plane, no time",)
"""Cases whose pictures are drawn here; `test_figures` draws the others."""


@pytest.mark.parametrize("case", CASES)
def test_folder_holds_all(case, session, tracker, tmp_path):
    gap = CASES[case](session, tracker(seed=1, count=40).dataset)
    with drawn(case in DRAWN):
        names = write_gap(gap, tmp_path / "run", gap_record(gap))
    pictures = PICTURES - ({"gap-levels.png"} if case == "empty tables" else set())
    assert set(names) == pictures | {"gap.json", "gap.html"}
    assert {p.name for p in (tmp_path / "run").glob("[!.]*")} == set(names)
    for name in pictures:
        picture = (tmp_path / "run" / name).read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) > 10_000 or case not in DRAWN
    json.loads((tmp_path / "run" / "gap.json").read_text(), parse_constant=pytest.fail)


def test_without_pictures_and_into_an_earlier_result(session, tmp_path):
    for gap in (diagnosis(session), diagnosis(session, "null")):
        assert write_gap(gap, tmp_path / "run", gap_record(gap), pictures=False) == ("gap.json", "gap.html")
    assert json.loads((tmp_path / "run" / "gap.json").read_text())["verdict"] == "null"


def test_modules_that_take_long_to_import_are_not_where_they_are_not_used():
    """`--help` draws nothing, a check of contacts reads no joint log, workers of a fleet test no arm."""
    program = (
        "import sys, bayescal.reporting.figures.figures, bayescal.reporting.check, bayescal.calibration\n"
        "import bayescal.public.fleet\n"
        "print(*{'matplotlib', 'emcee', 'scipy.signal', 'scipy.stats'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_command_hands_over_and_prints(session, tmp_path, monkeypatch):
    """The command around a diagnosis that is invented."""
    from bayescal.cli import app

    asked = []

    def diagnose(dataset, effects, options, *, without, progress):
        asked.append((dataset.name, effects, options, without))
        progress("search", 0.5)
        return diagnosis(session, "named")

    monkeypatch.setitem(sys.modules, "bayescal.gap.diagnose", SimpleNamespace(diagnose=diagnose))
    arguments = ["gap", str(EXAMPLE), "--model", "geometry", "--seed", "7", "--no-robust", "--no-pictures"]
    arguments += ["--without", "geometry at joint 4, geometry at link 2"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "run")])
    assert done.exit_code == 0, done.output
    options, parts = FitOptions(robust=False, seed=7), ("geometry at joint 4", "geometry at link 2")
    assert asked == [("lrmate200ic-cube", ("geometry",), options, parts)]
    assert "joint 3 has lost motion on reversal" in done.output
    assert "gap.json" in done.output
    assert {p.name for p in (tmp_path / "run").glob("[!.]*")} == {"gap.json", "gap.html"}


def test_an_undecided_diagnosis_prints_the_command_that_plans_what_decides(session, tmp_path, monkeypatch):
    from bayescal.cli import app

    out = tmp_path / "a run"
    lines = {}
    for kind in ("ambiguous", "named"):
        found = diagnosis(session, kind)
        module = SimpleNamespace(diagnose=lambda *_, found=found, **options: found)
        monkeypatch.setitem(sys.modules, "bayescal.gap.diagnose", module)
        done = CliRunner().invoke(app, ["gap", str(EXAMPLE), "--no-pictures", "--out", str(out)])
        assert done.exit_code == 0, done.output
        lines[kind] = [line for line in done.output.splitlines() if line.startswith("to discriminate")]
    assert lines["named"] == []
    (line,) = lines["ambiguous"]
    program, command, *arguments = shlex.split(line.removeprefix("to discriminate"))
    assert (program, command) == ("bayescal", "plan")
    asked = typer.main.get_command(app).commands["plan"].make_context("plan", arguments).params
    assert (asked["setup"], asked["after"], asked["for_"]) == (EXAMPLE, out, "gap")
    assert (out / "gap.json").is_file()


def test_command_leaves_a_foreign_folder_alone(tmp_path, error_of):
    (tmp_path / "thesis.txt").write_text("mine")
    errors = error_of("gap", EXAMPLE, "--out", tmp_path)
    assert "the folder contains files that bayescal did not write: thesis.txt" in errors
    assert len(errors.strip().splitlines()) == 1


# --- Unmodelled locations that show what happens: the sentence, the row and size, and what to inspect.


@pytest.fixture(scope="module")
def causes_session(cube):
    return cube(seed=7, count=240).dataset


def shifted(dataset, family_p_value: float = 1e-9, *, explained_by: str = "", kind: str = "unknown") -> Gap:
    """A gap whose first location is a tool that shifts at the 13th row."""
    gap = diagnosis(dataset, kind)
    values = zip("xyz", (10e-6, -4.6e-6, 120e-6), (1.4e-6, 2.1e-6, 3e-6), strict=True)
    moved = tuple(
        Amplitude("unknown", TOOL, Driver("event"), (), f"shift {a}", v, u, "m", None, v > 5e-6)
        for a, v, u in values
    )
    place = replace(
        gap.where[0], site=TOOL, driver=Driver("event"), family_p_value=family_p_value,
        explained_by=explained_by, event=Event(12, (11, 13)), amplitudes=moved,
    )  # fmt: skip
    return replace(gap, where=(place, *gap.where[1:]))


def test_an_unmodelled_location_says_what_happens_and_what_to_inspect(causes_session):
    gap = shifted(causes_session)
    name = causes_session.measurements.ids[12]
    of = f"row 13 ({name}; rows 12 to 14 at 95 %)"
    says = f"the tool shifted at {of} by (x, y, z) = (10.0(1.4), -4.6(2.1), 120.0(3.0)) µm"
    flat = " ".join(printed(gap).split())
    assert f"T{says[1:]}" in flat
    assert "inspect Look at the log at this row: a tool (stylus" in flat
    place = gap_record(gap)["where"][0]
    assert place["words"] == says
    assert place["event"] == {"row": 13, "id": name, "interval95": [12, 14]}
    assert place["amplitudes"][2] == {
        "what": "shift z", "value": pytest.approx(120.0), "u": pytest.approx(3.0), "unit": "um",
        "significant": True,
    }  # fmt: skip
    assert "another tool" in place["remedy"]


@pytest.mark.parametrize("kind", SETS)
def test_a_sudden_change_has_its_row_size_and_remedy_whatever_the_verdict(causes_session, kind):
    gap = shifted(causes_session, kind=kind)
    flat, record = " ".join(printed(gap).split()), gap_record(gap)
    shift = f"he tool shifted at row 13 ({causes_session.measurements.ids[12]}; rows 12 to 14 at 95 %) by"
    assert shift in flat
    assert "inspect Look at the log at this row: a tool (stylus" in flat
    (fault,) = [f for f in faults(record) if "a tool (stylus" in f.remedy]
    assert "shifted at row 13" in dict(fault.facts)["what happens"]


def test_a_drift_that_a_sudden_change_explains_has_its_row(causes_session):
    gap = shifted(causes_session)
    drifts = replace(gap.where[0], driver=Driver("activity"))
    lines = headline(replace(gap, where=(drifts, *gap.where[1:])))
    assert "at tool, earlier motion of the arm" in lines[0]
    assert lines[1].startswith("A sudden change alone explains most of it: the tool shifted at row 13")


def test_nothing_is_listed_that_validation_does_not_show(session):
    gap = diagnosis(session, "named")
    spot = gap.blind_spots[0].effect
    missing = {spot: "not detectable", "latency": "not detectable"}
    text = " ".join(printed(replace(gap, verdict=replace(gap.verdict, missing=missing))).split())
    assert "latency: not detectable" in text
    assert text.count(f"{spot},") == 1
    # no share of an excess that is not significant
    assert gap_record(gap)["where"][0]["share"] is not None
    doubtful = 0.0, gap.magnitude.excess_interval95[1]
    none = replace(gap, magnitude=replace(gap.magnitude, excess_interval95=doubtful))
    assert {w["share"] for w in gap_record(none)["where"]} == {None}


@pytest.mark.parametrize("place", [{"family_p_value": 0.2}, {"explained_by": "step"}])
def test_no_cause_of_a_location_that_is_not_significant_or_has_a_name(causes_session, place):
    gap = shifted(causes_session, **place)
    assert "words" not in gap_record(gap)["where"][0]
    assert "shifted at row" not in printed(gap)


def test_a_base_that_rocks_is_told_with_its_half_angle(causes_session):
    gap = diagnosis(causes_session, "unknown")
    driver = Driver("base moment", form="sign")
    what = "half-angle about the horizontal axis at 45 deg from x"
    angle = Amplitude("unknown", BASE, driver, (), what, 4e-4, 1e-5, "rad", None, True)
    where = (replace(gap.where[0], site=BASE, driver=driver, amplitudes=(angle,)), *gap.where[1:])
    flat = " ".join(printed(replace(gap, where=where)).split())
    assert f"The base rocks with the sign of the base moment ({what} 0.02292(57) deg)" in flat
    assert "clearance below the mounting plate" in flat


@pytest.mark.parametrize("key", CAUSES, ids=", ".join)
def test_every_cause_is_a_sentence_with_its_site_and_joint(causes_session, key):
    site, driver, form = key
    gap = diagnosis(causes_session, "unknown")
    shown = replace(
        gap.where[0], site=Site(site, 2), driver=Driver(driver, 3, form=form), family_p_value=1e-9,
        explained_by="", amplitudes=(), event=None,
    )  # fmt: skip
    said, template = sentence(shown, causes_session), CAUSES[key][0]
    assert not set("{}") & set(said)
    assert (shown.site.text + " or the artefact" * (site == "base") in said) == ("{site}" in template)
    assert ("J3" in said) == ("{joint}" in template)


def test_every_cause_is_of_a_cell_of_a_session(causes_session):
    """No sentence for a location that no diagnosis finds, of contacts, of images or of instruments."""
    found, images = set(), camera_session(images=8, seed=1)
    minutes = np.arange(len(images.measurements.ids), dtype=float)
    warming = with_columns(images, time=60.0 * minutes, temperature=20.0 + np.sqrt(minutes))
    rows, tracked = np.arange(len(causes_session.measurements.ids)), read_points(count=120).dataset
    pairs = (rows // 2).astype(str)
    loaded = with_columns(causes_session, payload=rows % 3.0, repeat=pairs, time=20.0 * rows)
    for scene in map(Scene, (loaded, warming, tracked)):
        c = scene.circumstances(scene.rows("calibrate"))
        piece = "ball.A", (np.arange(len(c.q)) % 3 == 0).astype(float), np.zeros(3)
        loads = c.loads if scene.dataset is not tracked else None
        of_session = cells(replace(c, pieces=(piece,), loads=loads))
        found |= {(x.site.kind, x.driver.kind, x.driver.form) for x in of_session}
    assert set(CAUSES) - found == set()


# --- The headline, its footnotes, `effects` and the table of probabilities follow from one rule.

NAMES = tuple(EFFECTS)
LABEL = {"unmodelled effect": "unknown"}


def stated(record):
    """Effects that the headline or a footnote states; the latter begin with their effect."""
    found = set()
    for line in record["words"]:
        found |= set(re.findall(r"\(([a-z-]+), probability", line))
        found |= set(re.findall(r"found: ([a-z-]+) in .*; probability", line))
        found |= {LABEL.get(n, n) for n in re.findall(r"not named: (.+?) \(probability", line)}
        if line.startswith("Class of causes"):
            members = re.findall(r"([a-z-]+) \(probability", line)
            found |= {n for n in members if n in NAMES and record["probability"][n] >= 0.5}
        if line.startswith(("Ambiguous", "Also: ", "No effect")):
            assert not any(re.search(rf"\b{name}\b", line) for name in NAMES), line
    found |= {note.partition(" ")[0].rstrip(":") for note in record["footnotes"]} & set(NAMES)
    return found


def check(record):
    """The rule, for a record of any diagnosis."""
    p, kind = record["probability"], record["verdict"]
    likely = {n for n in p if p[n] >= 0.5 and n not in ("null", "unknown")}
    assert stated(record) - {"unknown"} == likely
    assert set(record["effects"]) <= {n for n in p if p[n] >= 0.5}
    assert bool(record["named"]) or not kind.startswith("named")
    assert record["effects"] == (["unknown"] if kind == "unknown" else [n["effect"] for n in record["named"]])
    if p["unknown"] >= 0.5:
        words = " ".join(record["words"])
        assert any(text in words for text in ("nmodelled effect", "further effect", "not in the list"))
    assert kind != "unknown" or p["unknown"] >= 0.5
    assert (kind == "class") == bool(record["class"])
    for n in record["named"]:
        assert n["probability"] == pytest.approx(p[n["effect"]])


@pytest.mark.parametrize(
    ("nats", "significant", "confirmed", "word"),
    [
        (40.0, True, True, "Effect found: "), (1.0, True, True, "Possible effect: "),
        (float("nan"), True, True, "Effect found: "), (40.0, False, True, "Effect found: "),
        (17.0, False, True, "Possible effect: "), (40.0, True, False, "Possible effect: "),
    ],
)  # fmt: skip
def test_a_name_that_nothing_else_supports_is_possible(session, nats, significant, confirmed, word):
    """Validation gains within its standard error, no clear amplitude, or a refusal: no part is replaced."""
    gap = diagnosis(session, "named")
    (named_effect,) = gap.verdict.named
    by, size = Driver("direction", 3), ("half-width", 1e-4, 1e-5, "rad", None, significant)
    amplitudes = (Amplitude("backlash", joint(3), by, (), *size),)
    levels = (*gap.levels[:-1], replace(gap.levels[-1], delta_elpd=nats, delta_elpd_se=6.0))
    verdict = replace(gap.verdict, named=(replace(named_effect, confirmed=confirmed),))
    unchanged = {"amplitudes": amplitudes, "levels": levels, "shrinkage": ()}
    record = gap_record(replace(gap, **unchanged, verdict=verdict))
    assert record["words"][0].startswith(word)
    assert record["named"][0]["possible"] == word.startswith("Possible") == (", but " in record["words"][0])
    terms = replace(verdict, named=(replace(verdict.named[0], terms_with=("gear-mesh", "bending")),))
    first, *_ = gap_record(replace(gap, **unchanged, verdict=terms))["words"]
    doubt = "with gear-mesh and bending it fits any function of its coordinate"
    assert first.startswith("Possible effect: ")
    assert f", but {doubt}" in first


def of_targets(kinds, target):
    named = tuple(SimpleNamespace(name=f"{kind} {k}", kind=kind) for k, kind in enumerate(kinds))
    target = np.asarray(target)
    measurements = SimpleNamespace(target=target, role=np.full(len(target), "calibrate"))
    return SimpleNamespace(targets=named, measurements=measurements)


@pytest.mark.parametrize(
    ("kinds", "text"),
    [
        (("instrument",), "base or instrument, time"), (("instrument", "instrument"), "base, time"),
        (("sphere", "fixed-point"), "base or artefact, time"), (("sphere", "instrument"), "base, time"),
    ],
)  # fmt: skip
def test_a_single_instrument_is_not_distinguishable_from_the_base(session, kinds, text):
    where = replace(diagnosis(session, "unknown").where[0], site=BASE, driver=Driver("time"))
    assert place(where, of_targets(kinds, np.arange(8) % len(kinds))) == text


def test_a_shift_of_the_base_is_one_of_the_artefact(session):
    """Where the arm touches its targets; what is not distinguishable stands beside the base."""
    gap = diagnosis(session, "named+unexplained")
    step = next(n for n in gap.verdict.named if n.effect == "step")
    where = replace(gap.where[0], site=BASE, driver=Driver("event"), explained_by="step")
    gap = replace(gap, where=(where, *gap.where))
    one, two = (named(replace(step, sites=sites), gap) for sites in ((), (BASE, TOOL)))
    assert one.startswith("the base or the artefact (these data do not distinguish them) shifted suddenly, ")
    alike = "(these data do not distinguish the base and the artefact)"
    assert two.startswith(f"step in the base or the artefact and the tool {alike} (each shifted suddenly, ")


def test_every_site_that_looks_the_same_is_stated_with_what_to_inspect(session):
    gap = diagnosis(session, "unknown")
    where = replace(
        gap.where[0], site=joint(6), driver=Driver("event"), explained_by="", family_p_value=1e-9,
        neighbours=(BASE, TOOL), amplitudes=(), event=Event(4, (4, 4)),
    )  # fmt: skip
    record = gap_record(replace(gap, where=(where,)))
    (place,) = record["where"]
    assert place["text"] == "joint 6, base, artefact or tool, row of the event"
    assert place["neighbours"] == ["base", "tool"]
    assert place["words"].startswith("the zero of joint 6 changed at row 5 (")
    others = "the same at the base or the artefact or the tool shifted (these data do not distinguish them)"
    assert place["words"].endswith(f", or {others}")
    parts = [place["remedy"].index(f"{x}: ") for x in ("The base or the artefact", "The tool", "Joint 6")]
    assert parts == sorted(parts)
    found = diagnosis(session, "named")
    first = replace(found.verdict.named[0], sites=(joint(6),), neighbours=(TOOL,))
    found = replace(found, verdict=replace(found.verdict, named=(first,)))
    words = "joint 6 or the tool (these data do not distinguish them) has lost motion on reversal"
    assert named(first, found).startswith(words)
    (fault, *_) = faults(record := gap_record(found))
    assert fault.remedy.startswith("Check the tool too: ")
    assert dict(fault.facts)["location"] == "joint 6 or the tool"
    cells = effects_sheet(record).items
    assert next(row[3] for row in cells if row[0] == "backlash") == "joint 6 or the tool"


@pytest.mark.parametrize(("other", "said"), [(0.1, True), (1.0, False)])
def test_an_error_in_a_region_that_one_target_has_is_of_the_target_or_the_probe(session, other, said):
    dataset = of_targets(("sphere", "sphere"), np.arange(8) // 4)
    fitted = np.where(np.arange(8) < 4, 1.0, other)
    curve = Curve("", np.arange(8.0), fitted, fitted, np.arange(8))
    where = replace(diagnosis(session, "unknown").where[0], explained_by="", family_p_value=1e-6, curve=curve)
    where = replace(where, site=PROBE, driver=Driver("workspace", form="one region"))
    assert ("most of it is on sphere 0" in sentence(where, dataset)) == said


def test_a_location_is_listed_once_and_its_share_only_where_it_is_significant(session):
    record = gap_record(diagnosis(session, "named"))
    first, second = record["where"][:2]
    small = second | {"family_p_value": 0.6}
    sheet = where_sheet(record | {"where": [first, small, {**first, "rms_um": 1.0}]})
    assert sheet.items == [first, small]
    assert [sheet.columns[2].value(w) is None for w in sheet.items] == [False, True]


def test_advice_and_reductions_beside_names(session):
    pair = ["noise only", "second-harmonic"]
    named, null = (gap_record(diagnosis(session, kind)) for kind in ("named", "null"))
    assert pair_of(named, pair) == ["no further effect", "second-harmonic"]
    assert pair_of(null, pair) == pair
    # kinds and shares of a reduction
    assert [s["what"] for s in improved(gap_record(diagnosis(session, "named")))] == ["contacts", "distances"]
    assert reduction(1.0, (0.996, 1.0), True) == ("> 99 %", "> 99 %")
    assert reduction(0.8, (0.4, 1.0), True) == ("80 %", "40 to 100 %")


@pytest.mark.parametrize(("after", "advised"), [(31.0, True), (60.0, False)])
def test_no_advice_to_fit_with_effects_that_make_distances_worse(session, after, advised):
    record = gap_record(diagnosis(session, "named"))
    distances = record["shrinkage"]["distances"] | {"after_rms_um": after}
    size = {"what": "sphere distances", "predicted_interval95_um": [10.0, 45.0], "predicted_rms_um": 30.0}
    record |= {"shrinkage": record["shrinkage"] | {"distances": distances}, "gap": {"measured": [size]}}
    assert worse(record) == ([] if advised else ["distances"])


@pytest.mark.parametrize(("low", "advised"), [(0.0, True), (3.0, False)])
def test_a_model_is_used_as_it_is_only_without_a_significant_excess(session, low, advised):
    record = gap_record(diagnosis(session, "null"))
    excess = record["gap"]["excess_um"] | {"interval95": [low, 9.0]}
    record |= {"gap": record["gap"] | {"excess_um": excess}}
    said = run_page(Run("gap", record, "runs/x"))
    assert ("Calibrate with the model as it is" in said) == advised
    assert ("Find what makes errors larger than the noise" in said) != advised


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("low", [-0.2, 0.4])
def test_an_insignificant_gain_is_stated_with_what_improves_all_the_same(session, low, several):
    """What improves by a single effect confirms it."""
    gap = diagnosis(session, "named")
    levels = (*gap.levels[:-1], *[replace(gap.levels[-1], delta_elpd=1.0, delta_elpd_se=6.0)] * (1 + several))
    fall = Shrinkage("distances", 6, 90e-6, 49e-6, 27e-6, 0.8, (low, 1.0), 50e-6, 27e-6, True)
    named = (*gap.verdict.named, *[replace(gap.verdict.named[0], effect="eccentricity")] * several)
    verdict = replace(gap.verdict, named=named)
    said = gap_record(replace(gap, levels=levels, shrinkage=(fall,), verdict=verdict))["words"][0]
    assert ("not significant (+1.0 ± 6.0 nats)" in said) == (low < 0 or several)
    assert ("although errors of distances fall significantly" in said) == (low > 0 and several)


@pytest.mark.parametrize(("p", "word"), [(0.9, "Effect found"), (0.89, "Probable effect")])
def test_a_name_below_nine_tenths_is_probable(session, p, word):
    gap = diagnosis(session, "named")
    (one,) = gap.verdict.named
    record = gap_record(replace(gap, verdict=replace(gap.verdict, named=(replace(one, probability=p),))))
    assert record["words"][0].startswith(f"{word}: joint 3")
    assert verdict_of(record)[2] == word


@pytest.fixture(scope="module")
def headline_session(cube):
    return cube(seed=1, count=40).dataset


probabilities = st.dictionaries(st.sampled_from(NAMES), st.floats(0.001, 0.999), min_size=1, max_size=6)


@settings(deadline=None, max_examples=80)
@given(probabilities, st.floats(0.001, 0.999), st.sampled_from(VERDICTS), st.data())
def test_headline_effects_and_probabilities_are_of_one_rule(headline_session, p, unknown, kind, data):
    likely = sorted(n for n in p if p[n] >= 0.5)
    some = data.draw(st.lists(st.sampled_from(likely), unique=True)) if likely else []
    names = [] if kind in ("null", "unknown") else some
    small = [] if kind == "null" else [n for n in likely if n not in some][:1]
    p = {"null": 0.2, "unknown": unknown, **p}
    kind = settled(kind, bool(names), p)
    members = {OTHER: unknown} | {n: p[n] for n in sorted(set(p) - {"null", "unknown", *small})}
    causes = CauseClass((joint(3),), (Driver("torque", 3),), members)
    verdict = Verdict(
        kind, tuple(Named(n, n, (), "", p[n], 9.0) for n in names), p, (*p,), (),
        tuple(f"{n}: RMS 1.0 µm, 2 % of the explained variance" for n in small), {}, (),
        causes if kind == "class" else None,
    )  # fmt: skip
    check(gap_record(replace(diagnosis(headline_session, kind), verdict=verdict)))


@pytest.mark.parametrize(("kind", "named", "unknown", "expected"), cases("verdicts"))
def test_a_verdict_is_one_that_its_probabilities_support(kind, named, unknown, expected):
    assert settled(kind, named, {"unknown": unknown}) == expected


# --- The further effect of a verdict `named+unexplained`: one of the vocabulary, or one outside it.


@pytest.mark.parametrize(("least", "unknown", "names"), [
    (0.13, 0.03, ("hardening", "hysteresis")),
    (0.13, 0.4, ("hardening", "hysteresis")),
    (0.13, 0.5, ()),
    (0.33, 0.6, ()),  # together more, but the unmodelled effect is likely
    (0.04, 0.03, ("hardening",)),
])  # fmt: skip
def test_the_further_effect_is_stated_by_name_where_names_are_more_probable(least, unknown, names):
    """Improbable effects are not proposed for inspection."""
    probability = {"latency": 0.99, "hardening": 0.33, "hysteresis": least, "null": 0.0, "unknown": unknown}
    credible = ("latency", "hardening", "hysteresis", "unknown", "null")
    record = {"verdict": "named+unexplained", "effects": ("latency",), "credible_set90": credible}
    assert further(record | {"probability": probability}) == names


def test_an_improbable_member_of_a_class_is_not_in_its_headline(session):
    gap = diagnosis(session, "class")
    members = {"backlash": 0.5, "hysteresis": 0.049, "unsettled": 0.05, OTHER: 0.4}
    causes = replace(gap.verdict.causes, members=members)
    record = gap_record(replace(gap, verdict=replace(gap.verdict, causes=causes)))
    assert record["class"]["members"].keys() == members.keys()
    (line,) = [w for w in record["words"] if w.startswith("Class of causes")]
    for name, said in (("backlash", True), ("hysteresis", False), ("unsettled", True)):
        assert (f"{name} (probability" in line) == said
    assert "a cause not in the list of known effects (probability 0.40)" in line


@pytest.mark.parametrize(("kind", "what", "shown"), [
    ("distances", "sphere distances", "(8.0 µm RMS, 4.0 expected)"),
    ("points", "validation points", "(13.9 µm RMS, 6.9 expected)"),
])  # fmt: skip
@pytest.mark.parametrize(("rms", "after", "said"), [(8.0, 8.0, True), (8.0, 5.9, False), (5.9, 8.0, False)])
def test_errors_that_a_named_effect_leaves_are_in_the_headline(
    session, rms, after, said, kind, what, shown
):  # fmt: skip
    """Beyond the interval that is predicted, before and after: 4 um, at most 6 um; of points as lengths."""
    gap = diagnosis(session, "named")
    size = replace(
        gap.magnitude.measured[0], what=what, rms=1e-6 * rms, predicted_rms=4e-6,
        predicted_interval95=(2e-6, 6e-6),
    )  # fmt: skip
    less = replace(gap.shrinkage[0], what=kind, after=1e-6 * after, predicted=4e-6)
    words = headline(replace(gap, magnitude=replace(gap.magnitude, measured=(size,)), shrinkage=(less,)))
    line = f"But errors of {what} {shown} stay larger"
    assert any(w.startswith(line) for w in words) == said


def test_a_column_that_would_show_another_cause_is_in_the_headline(session):
    """And in what to measure next; without an effect there is nothing that it could explain."""
    reasons = {
        "backlash": "no j1_degps ...: the session records no joint velocities",
        "latency": "no j1_degps ...: the session records no joint velocities",
        "thermal-drift": "no temperature_c of the arm or the air, and no time_s, that varies",
        "plane-form": "no plane is fitted",
    }
    for kind in ("named", "unknown"):
        gap = diagnosis(session, kind)
        gap = replace(gap, verdict=replace(gap.verdict, missing=reasons))
        record = gap_record(gap)
        (line,) = [w for w in record["words"] if w.startswith("Not excluded")]
        assert "backlash and latency (no j1_degps ...)" in line
        assert "thermal-drift (no temperature_c or time_s)" in line
        assert "plane-form" not in line
        assert record["not_excluded"]["j1_degps ..."] == ["backlash", "latency"]
        text = " ".join(printed(gap).split())
        assert "to show backlash or latency: record j1_degps ..." in text
        assert "plane-form" not in text  # no plane is not a lack of a record: only the page states it
        page = html.unescape(run_page(Run("gap", record | {"next": [], "undecided": []}, "x")))
        assert "To show backlash or latency: record j1_degps ..." in page
        assert "No further measurements" not in page
        plans = [words in page for words in ("are those of bayescal plan", "bayescal plan x/dataset")]
        assert plans == 2 * [kind != "named"]
    gap = diagnosis(session, "null")
    gap = replace(gap, verdict=replace(gap.verdict, missing=reasons))
    assert not any(w.startswith("Not excluded") for w in gap_record(gap)["words"])


@pytest.mark.parametrize(("factor", "says"), [(1.19, False), (1.21, True), (3.0, True)])
def test_noise_above_the_stated_one_is_in_the_headline_of_a_null(session, factor, says):
    """What no quantity explains is called noise: a reader must see that it is more than the probe's."""
    gap = diagnosis(session, "null")
    low = factor * gap.dataset.noise.contact
    size = replace(gap.magnitude, noise=1.3 * low, noise_interval95=(low, 2 * low))
    words = gap_record(replace(gap, magnitude=size))["words"]
    assert any("larger than stated" in line for line in words[1:]) == says
    assert words[0] == gap_record(gap)["words"][0]


@pytest.mark.parametrize(("probability", "value", "nats", "word", "proof"), [
    (0.995, 1e-4, 1.0, "Effect found by the calibration rows alone: ", "amplitude 10 u"),
    (0.95, 1e-4, 1.0, "Possible effect: ", ""),
    (0.995, 3e-5, 1.0, "Possible effect: ", ""),
    (0.95, 3e-5, 20.0, "Effect found: ", "log density +20 ± 6 nats"),
    (0.95, 1e-5, 20.0, "Possible effect: ", ""),  # by wider predictions
])  # fmt: skip
def test_an_effect_that_calibration_rows_establish_is_found(session, probability, value, nats, word, proof):
    """Few validation rows show no gain, or no change of RMS: what establishes the effect is stated."""
    gap = diagnosis(session, "named")
    (named_effect,) = gap.verdict.named
    size = ("half", value, 1e-5, "rad", None, value > 4e-5)
    amplitude = Amplitude("backlash", joint(3), Driver("direction", 3), (), *size)
    levels = (*gap.levels[:-1], replace(gap.levels[-1], delta_elpd=nats, delta_elpd_se=6.0))
    verdict = replace(gap.verdict, named=(replace(named_effect, probability=probability, confirmed=True),))
    same = tuple(replace(s, removed_interval95=(-0.2, 0.2)) for s in gap.shrinkage)
    gap = replace(gap, amplitudes=(amplitude,), levels=levels, verdict=verdict, shrinkage=same)
    record = gap_record(gap)
    assert record["words"][0].startswith(word)
    established = record["named"][0]["established"]
    assert proof in established
    assert bool(proof) == bool(established)
