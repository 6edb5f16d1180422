"""A session while it is measured: its rows, the estimate after each, odd contacts, the end."""

import json
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from camera_sessions import camera_session
from cases import refused
from sessions import little, with_rows

import bayescal as bc
from bayescal.calibration import fit, usual_model
from bayescal.dataset import read_dataset, write_dataset
from bayescal.errors import BayescalError
from bayescal.model import ARM, Scene, with_parameters
from bayescal.model.parts import continued
from bayescal.reporting.figures.figures import drawn
from bayescal.reporting.watch import watch_content
from bayescal.watching import (
    ENOUGH,
    PLANNED,
    QUIET,
    SHIFTED,
    Complete,
    Notice,
    Watch,
    WatchOptions,
    begun,
    followed,
    update,
    watched,
)
from bayescal.watching.update import Contact

MODEL = ("geometry", "compliance")
TABLE = "measurements.csv"


@pytest.fixture
def folder(tmp_path):
    """A written session, and its lines; the table is empty."""
    write_dataset(little().dataset, tmp_path / "cell")
    path = tmp_path / "cell" / TABLE
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(lines[0])
    return tmp_path / "cell", lines


def put(folder, *lines):
    with (folder / TABLE).open("a") as table:
        table.writelines(lines)


def shifted_line(line, joint, by):
    """A line of the table with another reading of a joint, deg."""
    cells = line.split(",")
    place = 4 + joint  # id, role, target, tool come first
    cells[place] = f"{float(cells[place]) + by:.6f}"
    return ",".join(cells)


def test_rows_are_those_of_the_whole_table(folder):
    cell, lines = folder
    written = begun(cell)
    for some in (lines[1:2], [], lines[2:30], lines[30:]):
        put(cell, *some)
        written = followed(written, cell)
        assert written.fault == ""
    whole, read = read_dataset(cell).measurements, written.dataset.measurements
    for f in fields(whole):
        here, there = getattr(read, f.name), getattr(whole, f.name)
        assert (here is None) == (there is None), f.name
        if here is not None:
            assert np.array_equal(here, there), f.name


def test_a_line_counts_when_it_ends(folder):
    cell, lines = folder
    put(cell, lines[1], lines[2][:25])
    written = followed(begun(cell), cell)
    assert len(written.dataset.measurements.ids) == 1
    put(cell, lines[2][25:])
    assert len(followed(written, cell).dataset.measurements.ids) == 2


def test_a_faulty_line_is_stated_with_its_line_and_read_when_it_is_corrected(folder):
    cell, lines = folder
    put(cell, *lines[1:4])
    written = followed(begun(cell), cell)
    put(cell, "nonsense\n")
    faulty = followed(written, cell)
    assert f"{TABLE}:5: 1 cells" in faulty.fault
    assert len(faulty.dataset.measurements.ids) == 3
    (cell / TABLE).write_text("".join(lines[:6]))
    right = followed(faulty, cell)
    assert (right.fault, right.again, len(right.dataset.measurements.ids)) == ("", False, 5)
    put(cell, lines[3])
    assert f"{TABLE}:7: id" in followed(right, cell).fault


def test_rows_that_were_changed_are_read_again(folder):
    cell, lines = folder
    put(cell, *lines[1:9])
    written = followed(begun(cell), cell)
    (cell / TABLE).write_text("".join([lines[0], *lines[3:8]]))
    again = followed(written, cell)
    assert again.again
    assert again.dataset.measurements.ids == read_dataset(cell).measurements.ids


def test_after_a_change_of_rows_all_are_contacts_again(folder):
    cell, lines = folder
    watch, _ = events_of(cell, lines[:43])
    (cell / TABLE).write_text("".join([lines[0], *lines[3:41]]))
    events = list(watch.look())
    ids = list(read_dataset(cell).measurements.ids)
    assert [e.id for e in events] == [c.id for c in watch.contacts] == ids
    assert (watch.last, watch.estimate, watch.odd) == (None, None, set())


def test_a_continued_scene_is_that_of_all_rows():
    whole = little().dataset
    first = Scene(with_rows(whole, np.arange(len(whole.measurements.ids) - 5)), oriented=True)
    quantities = ("tools", "q", "points", "flange", "_approach", "_speed", "moments")
    for name in quantities:
        getattr(first, name)
    out, reference = continued(first, whole, lambda scene: None), Scene(whole, oriented=True)
    assert len(out.parts[1].q) == 5
    for name in quantities:
        np.testing.assert_allclose(getattr(out, name), getattr(reference, name), atol=1e-15)


@cache
def complete():
    return fit(little().dataset, MODEL, samples=0)


@cache
def before():
    """The fit of the first rows of its session."""
    return fit(rows(50), MODEL, samples=0)


def rows(count):
    return with_rows(complete().dataset, np.arange(count))


def continued_from(count, skipped=()):
    """The estimate of the first rows and its continuation with one more."""
    first = update.begun(before().final.estimate, MODEL, before().options)
    return update.followed(first, rows(count), MODEL, before().options, skipped)


def test_the_estimate_is_that_of_the_complete_solver():
    assert update.begun(before().final.estimate, MODEL, before().options).iterations <= 6
    estimate = continued_from(51)
    for count in range(52, 58):
        estimate = update.followed(estimate, rows(count), MODEL, before().options, ())
    reference = fit(rows(57), MODEL, before().options, samples=0).final.estimate
    assert reference.model.names == estimate.model.names
    arm = estimate.model.slices[ARM]
    assert np.max(np.abs(estimate.z - reference.z)[arm] / reference.sd[arm]) < 0.02
    np.testing.assert_allclose(estimate.sd, reference.sd, rtol=0.01)


def test_a_contact_is_judged_by_the_prediction_without_it():
    residual, u, p = update.judged(continued_from(51), 50)
    without, dataset = continued_from(51, (50,)), rows(51)
    name = dataset.targets[dataset.measurements.target[50]].name
    block = next(b for b in without.model.blocks if b.name == name)
    mine = int(np.flatnonzero(block.rows == 50)[0])
    predicted = without.residuals(block).ravel()[mine]
    slopes = without.linear.jacobian[without.linear.of_block[name].start + mine]  # of weight zero
    _, by_arm, by_target = block.linearise(without.arm, without.z[without.model.slices[name]])
    by = np.zeros(without.model.size)
    by[without.model.slices[ARM]] = by_arm[mine] * without.model.sd
    by[without.model.slices[name]] = by_target[mine]
    noise = without.weights.sigma[name][mine] * without.weights.scale[block.group]
    assert not slopes.any()
    assert residual == pytest.approx(predicted, abs=0.02 * u)
    assert u == pytest.approx(np.sqrt(by @ without.covariance @ by + noise**2), rel=0.02)
    assert 1e-3 < p <= 1.0


def test_a_wider_model_error_makes_a_contact_less_odd():
    judged = [update.judged(continued_from(51), 50, factor) for factor in (1.0, 2.0, 5.0)]
    residual, u, p = map(np.array, zip(*judged, strict=True))
    assert np.ptp(residual) == 0.0
    assert np.all(np.diff(p) > 0.0)
    # the factor is on the standard uncertainty of the prediction: the noise stays
    variance = np.diff(u**2)
    assert np.all(variance > 0.0)
    assert variance[1] / variance[0] == pytest.approx((25.0 - 4.0) / (4.0 - 1.0))


def events_of(cell, lines, first=40):
    """Events of a session whose lines come one by one after a complete fit of the first ones."""
    put(cell, *lines[1 : first + 1])
    watch = Watch(cell)
    out = [*watch.look(), *watch.complete()]
    for line in lines[first + 1 :]:
        put(cell, line)
        out += watch.look()
    return watch, out


def test_odd_contacts_are_set_aside(folder):
    cell, lines = folder
    wrong = (50, 52, 58)  # three, but never three of the last five
    some = [shifted_line(line, 2, 0.3) if k in wrong else line for k, line in enumerate(lines[:60])]
    watch, events = events_of(cell, some)
    judged = [e for e in events if isinstance(e, Contact) and np.isfinite(e.p_value)]
    assert [e.id for e in judged if e.odd] == [lines[k].split(",")[0] for k in wrong]
    assert watch.odd == {49, 51, 57}
    assert pytest.approx(watch.last.U, rel=0.15) == judged[0].U
    assert all(e.U < 1.1 * watch.last.U for e in judged)
    assert not any(isinstance(e, Notice) for e in events)


def test_rows_that_a_complete_fit_rejects_do_not_count(folder):
    cell, lines = folder
    watch, _ = events_of(cell, [*lines[:20], shifted_line(lines[20], 2, 1.0), *lines[21:59]], first=56)
    assert watch.odd == {19} == {*watch.estimate.rejected.tolist()}


def test_a_parameter_that_further_rows_bring_is_added():
    estimate = update.begun(before().final.estimate, MODEL, before().options)
    model = estimate.model
    less = with_parameters(model.scene, model.effects, model.parameters[:-1])
    found = update.refined(less, np.delete(estimate.z, len(model.parameters) - 1), (), estimate)
    assert update.followed(found, rows(51), MODEL, before().options, ()).model.names == model.names


def test_a_shift_is_told_once(folder):
    cell, lines = folder
    after = [shifted_line(line, 1, 0.2) for line in lines[46:56]]
    _, events = events_of(cell, [*lines[:46], *after], first=44)
    told = [e for e in events if isinstance(e, Notice)]
    assert [e.kind for e in told] == [SHIFTED]
    assert lines[46].split(",")[0] in told[0].text


def fake_time():
    now = [0.0]

    def wait(seconds):
        now[0] += seconds

    return wait, lambda: now[0]


def run(cell, **options):
    wait, clock = fake_time()
    watch = Watch(cell, WatchOptions(**options))
    return watch, list(watched(watch, wait, clock))


def test_it_ends_when_it_is_enough(folder):
    cell, lines = folder
    put(cell, *lines[1:])
    u = complete().forecast.workspace.expanded
    assert run(cell, enough=1.01 * u, idle=60.0)[1][-1].kind == ENOUGH
    _, events = run(cell, enough=0.99 * u, idle=3.0)
    assert events[-1].kind == QUIET
    last = [e for e in events if isinstance(e, Complete)][-1]
    assert {s.effect for s in last.spots} >= {"backlash", "step", "gear-mesh"}


def test_the_command_of_a_session_without_rows_says_what_is_missing(folder):
    cell, lines = folder
    refused("no rows below the header", lambda: bc.watch(cell, idle_s=0.0))
    put(cell, *lines[1:3])
    refused("too few", lambda: bc.watch(cell, idle_s=0.0))
    put(cell, "nonsense\n")
    refused(f"{TABLE}:4", lambda: bc.watch(cell, idle_s=0.0))


def test_the_result_is_a_run_folder_of_fit(folder, tmp_path):
    """The last line has no end: `fit` reads it, and so it counts when nothing more is written."""
    cell, lines = folder
    put(cell, *lines[1:-1], lines[-1].rstrip())
    said = []
    result = bc.watch(cell, "", idle_s=0.0, say=said.append)  # as of a command without --model
    assert {type(e) for e in said} == {Contact, Complete, Notice}
    assert result.fit.data.final.effects == MODEL
    robot = replace(result.fit.data.dataset.robot, masses=None)
    assert usual_model(replace(result.fit.data.dataset, robot=robot)) == ("geometry",)
    assert {"fit.json", "watch.json", "watch.csv"} <= {*result.save(tmp_path / "run", pictures=False)}
    record = json.loads((tmp_path / "run" / "watch.json").read_text())
    assert [c["id"] for c in record["contacts"]] == [line.split(",")[0] for line in lines[1:]]
    fitted = bc.fit(cell, samples=0)
    assert record["fits"][-1]["U_um"] == pytest.approx(1e6 * fitted.data.forecast.workspace.expanded)
    assert bc.load(tmp_path / "run").parameters["estimate"].equals(result.fit.parameters["estimate"])
    judged = sum(c["p_value"] is not None for c in record["contacts"])
    assert f"{len(lines) - 1} rows watched, {judged} of them judged by the others" in str(result)
    fitted.save(tmp_path / "fitted", pictures=False)
    watched_, whole = (json.loads((tmp_path / k / "fit.json").read_text()) for k in ("run", "fitted"))
    assert watched_ == whole
    assert len(watched_["dataset"]["sha256"]) == 64


def test_a_session_that_fit_refuses_is_refused(folder):
    """Readings of the other sign keep the format, and cannot have been measured."""
    cell, lines = folder
    cells = [line.split(",") for line in lines[1:]]
    turned = [",".join([*c[:4], *(f"{-float(x):.6f}" for x in c[4:10]), *c[10:]]) for c in cells]
    put(cell, *turned)
    with pytest.raises(BayescalError) as told:
        bc.fit(cell, samples=0)
    with pytest.raises(BayescalError) as mine:
        bc.watch(cell, idle_s=0.0)
    assert str(mine.value) == str(told.value)


def test_a_table_that_leads_elsewhere_is_not_read(folder, tmp_path):
    cell, lines = folder
    (tmp_path / "other.csv").write_text("".join(lines))
    (cell / TABLE).unlink()
    (cell / TABLE).symlink_to(tmp_path / "other.csv")
    written = followed(begun(cell), cell)
    assert "outside the dataset folder" in written.fault
    assert not written.dataset.measurements.ids


def test_settings_that_are_changed_are_read_again(folder):
    cell, lines = folder
    watch, _ = events_of(cell, lines[:43])
    (cell / "dataset.yaml").write_text((cell / "dataset.yaml").read_text().replace("name: ", "name: other-"))
    assert len(list(watch.look())) == 42
    assert watch.last is None
    assert watch.written.dataset.name.startswith("other-")
    (cell / "dataset.yaml").write_text("name: [")
    assert any("dataset.yaml" in e.text for e in watch.look() if isinstance(e, Notice))


def test_a_plan_states_the_aim(folder, tmp_path):
    cell, lines = folder
    put(cell, *lines[1:])
    plan = {
        "schema": "bayescal-plan/1", "rows": len(lines) - 5, "measured": 4,
        "expected": {"distances": [{"over": "certified distances", "distance_sd_um": 1.0},
                                   {"over": "region of the contacts", "distance_sd_um": 0.5}]},
    }  # fmt: skip
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    result = bc.watch(cell, plan=tmp_path, idle_s=30.0)
    assert result.record["aim"] == {"U_um": pytest.approx(1.0), "planned": len(lines) - 1}
    assert result.record["notices"][-1]["kind"] == PLANNED
    (tmp_path / "plan.json").write_text(json.dumps({"schema": "bayescal-plan/1"}))
    refused("incomplete", lambda: bc.watch(cell, plan=tmp_path))


def test_corners_of_images_are_fitted_in_the_pauses(tmp_path):
    write_dataset(camera_session(images=6, velocity=False), tmp_path / "cell")
    lines = (tmp_path / "cell" / TABLE).read_text().splitlines(keepends=True)
    (tmp_path / "cell" / TABLE).write_text(lines[0])
    watch = Watch(tmp_path / "cell")
    for first, last in ((1, 2), (2, 25), (25, 97)):
        put(tmp_path / "cell", *lines[first:last])
        assert all(isinstance(e, Contact | Notice) for e in watch.look())
    assert [type(e) for e in watch.complete()] == [Complete]
    put(tmp_path / "cell", *lines[97:])
    assert not any(e.odd or np.isfinite(e.p_value) for e in watch.look())


def test_the_picture_shows_what_is_finite():
    widths = (np.inf, 2e-4, 1e-4)
    contacts = [
        Contact(k, f"c{k}", "cube.+x", "calibrate", 1e-6 * k, 5e-6, 0.5, U) for k, U in enumerate(widths)
    ]
    figure = drawn(watch_content([Complete(complete(), (), np.nan, 0.0)], contacts))
    above, below = figure.axes
    assert above.get_yscale() == "log"
    assert np.all(np.isfinite(above.get_ylim()))
    # also where the table was begun anew, with fewer rows than the first fit had
    fitted = above.lines[1].get_xdata()[0]
    assert fitted > len(contacts)
    for axes in (above, below):
        low, high = axes.get_xlim()
        assert low < 1 < fitted < high
    assert below.lines[0].get_ydata().tolist() == pytest.approx([0.0, 0.2, 0.4])
