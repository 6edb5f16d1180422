"""Sudden shifts: their rows with intervals, several of them, and a tool that only validation rows use."""

import json
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from cases import cases
from sessions import circumstances, plain, tracker, validating, wavy, with_columns

from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import Certificate, Dataset
from bayescal.dataset.contacts import bodies
from bayescal.effects import EFFECTS, parameters_of
from bayescal.effects.by_time import ROWS, beside, long_enough, moments
from bayescal.effects.location import ARM as WHOLE
from bayescal.effects.location import BASE, TOOL, Driver, face
from bayescal.effects.selection import Selection
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.estimate.discrepancy import stated
from bayescal.fitted.arm import of_gap
from bayescal.fitted.file import check_restored, read_arm, restored
from bayescal.gap.concluded import doubted, events_of
from bayescal.gap.diagnose import diagnose, explain
from bayescal.gap.examine import examine
from bayescal.gap.outcome.events import _between, _with_fitted, errors_with
from bayescal.gap.outcome.statements import Change, _together
from bayescal.gap.outcome.where import _sudden
from bayescal.gap.result import Event
from bayescal.gap.search.cells import cells
from bayescal.gap.search.unknown import CellFit
from bayescal.gap.settings import VERDICT
from bayescal.model.options import USUAL, FitOptions
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import validation_errors
from bayescal.preparing.missing import missing
from bayescal.reporting.gap.phrases import headline
from bayescal.reporting.gap.record import gap_record, write_gap

MODEL = ("geometry", "compliance")


def shifted(dataset: Dataset, events: dict[int, tuple[float, ...]]) -> Dataset:
    """A session whose instrument reads points shifted by a vector, m, from each row (from 1) on."""
    xyz = dataset.measurements.xyz.copy()
    for row, by in events.items():
        xyz[row - 1 :] += by
    return with_columns(dataset, xyz=xyz)


@pytest.fixture(scope="module")
def search():
    """Two shifts of the base, of 0.1 mm and 0.08 mm, in noise of 0.01 mm."""
    session = shifted(tracker(seed=3, count=110).dataset, {38: (1e-4, 0, 0), 80: (0, -8e-5, 2e-5)})
    return examine(Scene(plain(session), oriented=True), MODEL, USUAL)


@pytest.fixture(scope="module")
def several(search):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.gap.diagnose.examine", lambda *_: search)
        return diagnose(search.fitted.model.scene.dataset, MODEL)


def test_an_instrument_that_turned_is_named():
    """As a shift of the base it was too far for its prior, and further shifts were named beside it."""
    session, row, angle = tracker(seed=3, count=110).dataset, 60, 4e-4
    xyz = session.measurements.xyz.copy()
    xyz[row - 1 :] @= rpy_matrix(np.array([0.0, 0.0, angle]))  # what it reads turns back
    gap = diagnose(plain(with_columns(session, xyz=xyz)), MODEL)
    (named,) = gap.verdict.named
    assert (named.effect, [str(site) for site in named.sites]) == ("step", ["tracker"])
    low, high = named.events[0].interval95
    assert low <= row - 1 <= high
    (turn,) = [a for a in gap.amplitudes if a.effect == "step" and a.unit == "rad"]
    assert abs(turn.value) == pytest.approx(angle, rel=0.15)


def test_validation_rows_beside_an_event_count_with_its_most_probable_row():
    """They are as with the row that is true: the same rows were fitted before it and after it."""
    role = np.full(90, "calibrate", dtype=object)
    role[40:60] = "validate"
    session = shifted(with_columns(tracker(seed=3, count=90).dataset, role=role), {53: (4e-4, 0, 0)})
    fits = {row: calibrated(Scene(session), (*MODEL, f"step@{row} at base")) for row in (41, 53, 61)}
    wanted = validation_errors(fits[53])
    for row in (41, 61):
        assert not np.allclose(validation_errors(fits[row]).residual, wanted.residual, atol=1e-4)
        events = {"step": (Event(row - 1, (40, 60)),)}
        held = errors_with(fits[row], events)
        for name in ("residual", "noise", "by_parameters", "rows"):
            np.testing.assert_allclose(getattr(held, name), getattr(wanted, name), rtol=1e-3, atol=1e-7)
    for interval in ((40, 40), (45, 50)):  # no row is uncertain; of another change than that of the model
        unlike = errors_with(fits[41], {"step": (Event(interval[0], interval),)})
        assert np.array_equal(unlike.residual, validation_errors(fits[41]).residual)
    alone = calibrated(Scene(session), MODEL)  # a model without the change
    held = errors_with(alone, events)
    assert np.array_equal(held.residual, validation_errors(alone).residual)


def test_an_arm_is_without_names_that_increase_validation_errors(search, several, monkeypatch):
    """Also where each of them alone passes the tests."""
    assert several.arm.model.effects == several.refit != MODEL
    monkeypatch.setattr(Change, "refuted", True)
    monkeypatch.setattr("bayescal.gap.diagnose.examine", lambda *_: search)
    refuted = diagnose(several.dataset, MODEL)
    assert [n.effect for n in refuted.verdict.named] == [n.effect for n in several.verdict.named]
    assert not any(n.confirmed for n in refuted.verdict.named)
    assert refuted.arm.model.effects == MODEL
    assert not any(s.claimed for s in refuted.shrinkage)


def test_names_that_increase_validation_errors_are_none_beside_an_unmodelled_effect(
    search, several, monkeypatch
):
    names = [n.effect for n in several.verdict.named]
    probability = search.decision.probability | {"unknown": 0.99}
    d = replace(search.decision, kind="named+unexplained", probability=probability)
    monkeypatch.setattr(Change, "refuted", True)
    monkeypatch.setattr("bayescal.gap.diagnose.examine", lambda *_: replace(search, decision=d))
    refused = diagnose(several.dataset, MODEL)
    assert (refused.verdict.kind, refused.verdict.named, refused.shrinkage) == ("unknown", (), ())
    assert refused.refit == refused.arm.model.effects == MODEL
    assert all(refused.verdict.probability[n] <= VERDICT.not_admitted for n in names)
    notes = [note for note in refused.verdict.footnotes if "increase" in note]
    assert [note.partition(" ")[0] for note in notes] == sorted(names)
    words = headline(refused)
    assert words[0].startswith("Unmodelled effect")
    assert not any(n in line for n in names for line in words)


def test_a_statement_that_fails_is_left_out_with_a_sentence(search, several, monkeypatch):
    def failing(*_):
        raise ValueError("shapes differ")

    monkeypatch.setattr("bayescal.gap.concluded.beside", failing)
    monkeypatch.setattr("bayescal.gap.diagnose.examine", lambda *_: search)
    gap = diagnose(several.dataset, MODEL)
    assert [n.effect for n in gap.verdict.named] == [n.effect for n in several.verdict.named]
    (told,) = (note for note in gap.verdict.notes if "because it failed" in note)
    assert told.endswith("sites at which step would look the same (shapes differ)")


@pytest.mark.parametrize(("sites", "site"), [("base and base", BASE), ("base and tool", WHOLE)])
def test_shifts_that_are_clear_together_only_are_of_their_site(several, sites, site):
    final = calibrated(Scene(several.dataset), (*MODEL, f"step@38/80 at {sites}"))
    every = [k for k, p in enumerate(final.model.parameters) if p.effect == "step"]
    (together,) = _together(final, "step", every, np.full(len(every), 1e-4), 1e-12 * np.eye(len(every)))
    assert together.site == site


def test_two_shifts_are_found_at_their_rows(several):
    (named,) = several.verdict.named
    assert (several.verdict.kind, named.effect) == ("named", "step")
    assert set(named.sites) <= {BASE, face("tracker")}  # small shifts do not tell the centre of a rotation
    first, second = sorted(named.events, key=lambda event: event.row)
    for event, row in ((first, 38), (second, 80)):
        low, high = event.interval95
        assert low <= row - 1 <= high, (event, row)
        assert high - low <= 2, event
    settings = sorted(int(value) for value in named.model.partition("@")[2].split(" ")[0].split("/"))
    assert settings == [first.row + 1, second.row + 1]
    assert not len(several.arm.rejected)  # rows beside a shift are no outliers


def test_shifts_of_two_sites_have_their_rows_each():
    """The base has six displacements, the reflector three: each keeps its own."""
    d = shifted(tracker(seed=3, count=110).dataset, {38: (1.5e-4, 0, 0)})
    flange, since = Scene(d).flange, np.arange(110) >= 79
    moved = (flange @ [0.0, 1.5e-4, 1e-4]) @ rpy_matrix(np.asarray(d.targets[0].values["rpy"]))
    d = with_columns(d, xyz=d.measurements.xyz + moved * since[:, None])
    (named,) = explain(Scene(plain(d), oriented=True), MODEL).verdict.named
    assert set(named.sites) == {BASE, TOOL}
    rows = dict(zip(named.sites, named.events, strict=True))
    for site, row in ((BASE, 38), (TOOL, 80)):
        low, high = rows[site].interval95
        assert low <= row - 1 <= high <= low + 3, (site, rows[site])


def test_two_shifts_are_as_far_apart_as_a_shift_is_from_the_ends():
    """A row that is off is no pair of shifts: six displacements would explain it."""
    events = {38: (3e-4, 0, 0), 40: (0, 3e-4, 0), 80: (0, 1e-4, 0)}
    session = shifted(tracker(seed=3, count=110).dataset, events)
    e = examine(Scene(plain(session), oriented=True), MODEL, FitOptions())
    c = e.circumstances
    assert not long_enough(c, 38.0, 40.0)
    assert long_enough(c, 38.0, 41.0)
    assert long_enough(c, 41.0, 38.0)
    found = [v.setting for v in e.candidates.variants["step"] if isinstance(v.setting, tuple)]
    assert found
    for setting in found:
        rows = [value for site, value in setting if site in (BASE, face("tracker"))]
        assert all(long_enough(c, a, b) for a, b in combinations(rows, 2)), rows
    told = [event.row + 1 for event in events_of(e)["step"]]
    assert len(told) == 3
    assert all(long_enough(c, a, b) for a, b in combinations(told, 2)), told


def test_a_reader_finds_the_rows(several):
    line = headline(several)[0]
    ids = several.dataset.measurements.ids
    for row in (38, 80):
        assert f"from row {row} ({ids[row - 1]}" in line
    assert "base and the base" not in line
    (entry,) = gap_record(several)["named"]
    assert sorted(event["row"] for event in entry["events"]) == [38, 80]
    assert {event["id"] for event in entry["events"]} == {ids[37], ids[79]}


def test_a_model_names_several_shifts():
    text = "step@38/80/90 at base and base and tool"
    assert str(Selection.read(text)) == text
    c = circumstances(tracker(seed=3, count=110).dataset)
    own = [p for p in parameters_of((text,), c) if p.effect == "step"]
    assert [p.site for p in own] == [BASE] * 12 + [TOOL] * 3
    assert len({p.name for p in own}) == 15
    began = [int(np.argmax(np.asarray(p.terms[0].driver) > 0)) + 1 for p in own]
    assert began == [38] * 6 + [80] * 6 + [90] * 3


def test_each_rigid_body_of_targets_may_shift():
    """A plate that was placed twice, and a wall; each body needs rows before its shift, and after it."""
    names = ("ball.A@1", "ball.B@1", "ball.A@2", "ball.B@2", "wall", "post")
    tied = SimpleNamespace(certificates=(Certificate("distance", ("wall", "post"), 0.3, 1e-6),))
    groups = bodies(tied, names)
    assert groups == {"ball@1": [*names[:2]], "ball@2": [*names[2:4]], "wall+post": ["wall", "post"]}
    c = circumstances(tracker(seed=3, count=90).dataset)
    place = np.array([0.4, 0.2, 0.1])
    on = [(np.arange(90) % 3 == k).astype(float) for k in range(3)]
    sites = [(name, rows, place) for name, rows in zip(groups, on, strict=True)]
    c = replace(c, instruments=(), artefacts=tuple(sites))
    shifts = [p for p in parameters_of(("step@61 at ball@2",), c) if p.effect == "step"]
    assert len(shifts) == 6
    for p in shifts:
        np.testing.assert_array_equal(p.terms[0].driver, on[1] * (np.arange(90) >= 60))
    assert {p.site for p in EFFECTS["step"].at(c, 61.0)} == {BASE, TOOL, *map(face, groups)}
    assert {p.site for p in EFFECTS["step"].at(c, 5.0)} == {BASE, TOOL}
    alone = replace(c, artefacts=(("cube", np.ones(90), place),))
    assert {p.site for p in EFFECTS["step"].at(alone, 61.0)} == {BASE, TOOL}
    cell = {cell.site for cell in cells(c) if cell.driver.kind == "event" and cell.of_known_effect}
    assert cell == {BASE, TOOL, *map(face, groups)}


def test_a_shift_that_explains_nearly_all_of_a_drift_is_stated():
    where = (TOOL, "time"), (BASE, "event"), (TOOL, "event")
    pool = SimpleNamespace(cells=[SimpleNamespace(site=s, driver=Driver(kind)) for s, kind in where])
    for gain, said_too in ((41.0, True), (39.0, False)):
        ranked = [CellFit(k, g, 0, 1.0) for k, g in ((0, 50.0), (1, 49.0), (2, gain))]
        assert (_sudden(ranked, pool) is ranked[2]) == said_too


def test_rows_of_a_long_session_are_searched_twice():
    """Rows that the first search leaves out are near those that it tries."""
    short = circumstances(tracker(seed=3, count=110).dataset)
    c = replace(short, fitted=np.arange(1000), readings=np.resize(short.readings, (1000, 6)))
    tried = moments(c)
    assert len(tried) == ROWS
    reached = np.concatenate([beside(c, row) for row in tried])
    low, high = int(tried[0]), int(tried[-1])
    assert set(range(low, high + 1)) <= set(reached.astype(int).tolist())


def two_tools(count, off=0.0):
    """A session with a second reflector, stated to 1.5 mm; a role and an index for every third row."""
    d = tracker(seed=5, count=count).dataset
    other = replace(d.tools[0], name="other", centre=d.tools[0].centre + np.array([0, off, 0]), u=1.5e-3)
    validate = np.arange(count) % 3 == 0
    role = np.where(validate, "validate", "calibrate")
    return replace(d, tools=(*d.tools, other)), role, validate.astype(int)


@pytest.mark.parametrize("off", [2e-3, 0.0])
def test_a_tool_of_validation_rows_keeps_its_prior(off):
    """A reflector that no fitted row uses is as uncertain in the prediction as stated, 1.5 mm."""
    d, role, second = two_tools(90, off)
    d = with_columns(d, role=role, tool=second)
    errors = validation_errors(calibrated(Scene(d), MODEL))
    sd = np.sqrt(errors.noise**2 + np.sum(errors.by_parameters**2, axis=1))
    assert np.all(np.abs(errors.residual) < 1.96 * sd)
    assert np.median(sd) == pytest.approx(1.5e-3, rel=0.05)


def said(dataset, **columns):
    """What `check` finds missing in a session with other columns: words by code."""
    return {f.code: f.what for f in missing(Scene(with_columns(dataset, **columns)), None, None)}


def test_check_tells_a_tool_and_an_instrument_of_validation_rows():
    d, role, second = two_tools(30)
    told = said(d, role=role, tool=second).values()
    assert any("only validation rows use the tool other" in what and "1.5 mm" in what for what in told)
    assert not any("tool other" in what for what in said(d, tool=second).values())
    # With its reflector, which is not fitted either; no fitted target has rows of it
    d = replace(d, targets=(*d.targets, replace(d.targets[0], name="second", u=5e-4)))
    told = said(d, role=role, target=second)
    words = "only validation rows are of the instrument second: its pose, uncertain by 0.5 mm"
    assert words in told["predicted_instrument"]
    assert "predicted_tool" not in told
    told = said(d, role=role, target=second, tool=second)
    assert {"predicted_tool", "predicted_instrument"} <= told.keys()
    assert "predicted_instrument" not in said(d, target=second)
    half = np.where(np.cumsum(second) % 2, "locate", role)
    told = said(d, role=np.where(second == 1, half, role), target=second, tool=second)
    assert not {"predicted_tool", "predicted_instrument"} & told.keys()  # rows locate both


def failing(error: Exception):
    """A function that raises an error, whatever it is given."""
    return Mock(side_effect=error)


def test_time_constants_have_three_digits():
    c = circumstances(tracker(seed=3, count=110).dataset)
    time = np.linspace(0.0, 1925.64, 110)  # four times that are 7702.56 s
    assert EFFECTS["thermal-drift"].scan.values(replace(c, time=time))[-1] == 7700.0
    # A session of two days has no time constant of days
    for hours, longest in ((48.0, 4.0), (0.5, 2.0)):
        slow = replace(c, time=np.linspace(0.0, 3600.0 * hours, 110))
        assert EFFECTS["thermal-drift"].scan.values(slow)[-1] == pytest.approx(3600 * longest)


@pytest.fixture(scope="module")
def waved():
    """A session with a second harmonic of joint 5, and rows that validate."""
    return validating(plain(wavy(tracker(seed=3, count=80).dataset)), 4)


@pytest.fixture(scope="module")
def explained(waved):
    """The session with its names."""
    return explain(Scene(waved, oriented=True), MODEL)


@pytest.mark.parametrize("stages", cases("failing_stages"), ids=lambda stages: next(iter(stages)))
def test_a_stage_that_fails_is_left_out(stages, waved, explained, monkeypatch, tmp_path):
    """The files are there, with a sentence; a singular matrix is as bad as a fit that is refused."""
    for stage in stages:
        monkeypatch.setattr(f"bayescal.gap.diagnose.{stage}", failing(np.linalg.LinAlgError("singular")))
    earlier = ("examine", explained.first) if "refit" in stages else ("explain", explained)
    monkeypatch.setattr(f"bayescal.gap.diagnose.{earlier[0]}", lambda *_: earlier[1])
    gap = diagnose(waved, MODEL)
    write_gap(gap, tmp_path / "out", gap_record(gap), pictures=False)
    filed = json.loads((tmp_path / "out" / "gap.json").read_text(encoding="utf-8"))
    for stage, words in stages.items():
        said = [w for w in (*filed["warnings"], *filed["footnotes"]) if words in w]
        assert said, stage
        assert "singular" in said[0]
    levels = [step.model for step in gap.levels]
    assert MODEL in levels
    assert (("nominal",) in levels) is ("judged_level" not in stages)  # the other levels are there
    assert (tmp_path / "out" / "gap.html").exists()
    assert (tmp_path / "out" / "arm.json").exists() is ("stated" not in stages)
    assert filed["verdict"] == ("class" if "refit" in stages else "named")


def test_a_search_that_fails_with_compliance_is_left_out(waved, explained, monkeypatch):
    """The search without it is stated."""

    def fails(scene, effects, options, further=False):
        if further:
            raise BayescalError("the fit does not converge")
        return explained.first

    monkeypatch.setattr("bayescal.gap.diagnose.examine", fails)
    monkeypatch.setattr("bayescal.gap.diagnose._promoted", lambda first: True)
    found = explain(Scene(waved), ("geometry",))
    assert (found.promoted, found.last.fitted) == (False, found.first.fitted)
    (words,) = found.lost
    assert "the search with compliance in the model (the fit does not converge)" in words


def test_a_singular_event_is_left_out(waved, explained, monkeypatch):
    monkeypatch.setattr("bayescal.gap.diagnose.examine", lambda *_: explained.first)
    singular = failing(np.linalg.LinAlgError("singular matrix"))
    monkeypatch.setattr("bayescal.gap.concluded.named_events", singular)
    found = explain(Scene(waved), MODEL)
    assert "rows of sudden changes (singular matrix)" in found.lost[0]
    assert found.verdict.kind == "named"


def test_files_that_fail_are_left_out(waved, explained, monkeypatch, tmp_path):
    monkeypatch.setattr("bayescal.gap.diagnose.explain", lambda *_: explained)
    gap = diagnose(waved, MODEL)
    for stage in ("gap.record.of_gap", "figures.figures_of"):
        monkeypatch.setattr(f"bayescal.reporting.{stage}", failing(RuntimeError("no canvas")))
    files = write_gap(gap, tmp_path / "out", gap_record(gap))
    assert files == ("gap.json", "gap.html")
    filed = json.loads((tmp_path / "out" / "gap.json").read_text(encoding="utf-8"))
    lost = [w for w in filed["warnings"] if "no canvas" in w]
    assert [w.split(": ")[1].split(" (")[0] for w in lost] == ["the file of the arm", "figures"]


def test_a_refit_keeps_what_its_names_may_not_explain(explained):
    """All of the discrepancy of the baseline beside an unmodelled effect, else as much as is improbable."""
    first, verdict = explained.first.fitted, explained.verdict
    before, after = stated(first), stated(explained.final)
    assert before.families
    (name,) = verdict.named
    for kind, share in (("named", 1.0 - name.probability), ("named+unexplained", 1.0)):
        kept = doubted(explained.final, first, replace(verdict, kind=kind))
        assert kept.least == pytest.approx({f: share * before.variances[f] for f in before.families})
        wide = stated(kept)
        for family in before.families:
            expected = max(kept.least[family], after.variances[family])
            assert wide.variances[family] == pytest.approx(expected)
        assert np.all(wide.sd >= after.sd - 1e-12)
    assert np.any(wide.sd > 1.05 * after.sd)


def test_an_arm_of_a_diagnosis_is_as_uncertain_when_it_is_read(waved, explained, monkeypatch, tmp_path):
    sure = explained.last.decision
    last = replace(explained.last, decision=replace(sure, kind="named+unexplained"))
    doubtful = replace(explained, last=last)
    monkeypatch.setattr("bayescal.gap.diagnose.explain", lambda *_: doubtful)
    gap = diagnose(waved, MODEL)
    assert gap.arm.least
    write_gap(gap, tmp_path / "out", gap_record(gap), pictures=False)
    arm = read_arm(tmp_path / "out")
    np.testing.assert_allclose(np.diag(arm.covariance), np.diag(of_gap(gap).covariance), rtol=1e-9)
    again = restored(arm)
    assert again.least == pytest.approx({**arm.beyond.variances})
    check_restored(arm, stated(again).limited)


@pytest.mark.parametrize(
    ("setting", "number", "interval"),
    [
        (((TOOL, 127.0), (TOOL, 306.0)), 1, (305, 320)),
        (312.0, 0, (309, 320)),
        (330.0, 0, (309, 329)),
        (None, 0, (309, 320)),
    ],
)
def test_the_interval_of_an_event_holds_the_row_that_is_fitted(setting, number, interval):
    """The printed model has the row of the search, which is not always the most probable one."""
    event = _with_fitted(Event(317, (309, 320)), SimpleNamespace(setting=setting), number)
    assert (event.row, event.interval95) == (317, interval)


@pytest.mark.parametrize(
    ("interval", "rows"), [((5, 5), [3, 4]), ((5, 9), [3, 4, 5, 6, 7, 8]), ((2, 2), []), ((0, 0), [])]
)
def test_rows_between_fitted_ones_may_be_before_an_event_or_after_it(interval, rows):
    fitted = np.array([0, 1, 2, 5, 9])
    assert list(_between(Event(interval[0], interval), fitted)) == rows
