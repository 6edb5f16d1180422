"""A whole plan, of few candidates."""

import csv
import io
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from cases import EXAMPLE, cases, refused
from made_up_plans import made_up_plan
from sessions import of_targets, plain, with_columns

import bayescal as bc
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rpy_matrix
from bayescal.compensating import read_targets
from bayescal.dataset import Box, read_dataset, write_dataset
from bayescal.effects import UNITS
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.estimate.unexplained import unexplained
from bayescal.model import Scene
from bayescal.planning import separate
from bayescal.planning.plan import PlanOptions, plan
from bayescal.planning.pool import Setup
from bayescal.planning.projection import Projection
from bayescal.planning.result import BOTH, DISTANCES, GAP, REPEAT, VALIDATE, Plan
from bayescal.planning.setup import continued, read_setup
from bayescal.programs import PROGRAMS
from bayescal.programs.motions import guarded, motions, steps
from bayescal.programs.probing import FORMATS, Probe, formats_of
from bayescal.public.planning import _setup
from bayescal.public.planning import plan as planned
from bayescal.reporting.page.plan import write_plan


@cache
def example() -> Setup:
    """The set-up of the example, with the first placement of its spheres, and a mass of 2 kg."""
    dataset = read_setup(EXAMPLE).dataset
    names = (t.name for t in dataset.targets if t.name.partition("@")[2] in ("", "1"))
    return replace(continued(of_targets(dataset, *names)), payloads=(2.0,))


@pytest.fixture(scope="module")
def planned_example() -> Plan:
    """100 contacts for distances and for the gap, of 300 candidates."""
    return plan(example(), PlanOptions(100, candidates=300))


def test_rows(planned_example: Plan) -> None:
    """Half of the contacts are for distances; both of a repeat share name and pose, apart in time."""
    m, purpose = planned_example.session.measurements, np.array(planned_example.purpose)
    assert [int(np.sum(purpose == p)) for p in (DISTANCES, GAP, REPEAT)] == [45, 45, 10]
    assert np.all((m.role == "validate") == (purpose == VALIDATE))
    assert len(set(m.ids)) == len(m.ids)
    assert m.repeat is not None
    for name in set(m.repeat.tolist()) - {""}:
        a, b = np.flatnonzero(m.repeat == name)
        np.testing.assert_array_equal(m.readings[a], m.readings[b])
        assert b - a > 1
    assert np.all(np.diff(m.time) >= 0)  # type: ignore[arg-type]


def test_ways_between_contacts(planned_example: Plan) -> None:
    """Every row has a collision-free path, of which some pass further points."""
    numbers = [-1 if way is None else len(way) for way in planned_example.via]
    assert len(numbers) == len(planned_example.purpose)
    assert min(numbers) >= 0
    assert 0 < sum(n > 0 for n in numbers) < 0.6 * len(numbers)


def test_better_than_random(planned_example: Plan) -> None:
    """Distances and the detectability of effects are better than those of random selections."""
    assert all(e.u < e.u_random for e in planned_example.expected)
    assert planned_example.equals_random > 150
    finite = [d for d in planned_example.detectable if np.isfinite(d.smallest)]
    assert np.exp(np.nanmean([np.log(d.smallest / d.smallest_random) for d in finite])) < 0.75
    for e in planned_example.expected:
        assert sum(e.shares.values()) == pytest.approx(1.0)


def test_for_distances_is_more_accurate(planned_example: Plan, monkeypatch) -> None:
    """A plan for distances alone is more accurate than one for both, which shows effects better."""
    monkeypatch.setattr("bayescal.planning.plan.candidates", lambda *_: planned_example.pool)
    alone = plan(example(), PlanOptions(100, DISTANCES, candidates=300))
    assert planned_example.aim == BOTH
    assert set(alone.purpose) == {DISTANCES, VALIDATE}
    assert alone.expected[0].u < planned_example.expected[0].u
    own = {(d.effect, d.site): d.smallest for d in alone.detectable}
    finite = [d for d in planned_example.detectable if np.isfinite(d.smallest)]
    assert np.nanmean([np.log(d.smallest / own[d.effect, d.site]) for d in finite]) < 0


def test_levers() -> None:
    """Without its lever no contact has a payload; a volume that is partly out of reach is noted."""
    setup = replace(example(), volume=Box(np.array([0.9, 0.0, 0.4]), np.full(3, 0.5)))
    one = plan(setup, PlanOptions(40, GAP, ("geometry",), ("approach",), candidates=80))
    assert one.expected[1].over == "volume of interest"
    assert any("of the volume of interest" in w for w in one.warnings)
    payload = one.session.measurements.payload
    assert payload is None or not np.any(payload)


def test_a_plan_for_the_gap_is_no_worse_than_random_ones(monkeypatch) -> None:
    """What tells nothing alone is never added first: here a search that ends with contacts of one kind."""
    options = PlanOptions(40, GAP, ("geometry",), ("approach",), candidates=80)
    found = list[np.ndarray]()

    def poor(decide, count, *_, **__):
        found.append(np.arange(count))
        return found[-1]

    def spied(decide, selections):
        tried = list(selections)
        chosen = separate.best_of(decide, tried)
        worth = [float(decide.objective(decide.strengths(Projection(decide.columns, s)))) for s in tried]
        assert np.array_equal(chosen, tried[int(np.argmax(worth))])
        assert np.array_equal(tried[0], found[0])
        assert not np.array_equal(chosen, found[0])
        return chosen

    monkeypatch.setattr("bayescal.planning.plan.choose", poor)
    monkeypatch.setattr("bayescal.planning.plan.best_of", spied)
    made = plan(example(), options)
    assert int(np.sum(np.array(made.purpose) == GAP)) == len(found[0])


# --- `bayescal plan` and `bc.plan`: a folder that comes back, the same plan by seed, one-line refusals.

SMALL = {"contacts": 45, "candidates": 90}


@pytest.fixture(scope="module")
def session():
    return bc.simulate(effects="geometry", contacts=70, later=8, repeats=5, spheres=0, seed=1)


@pytest.fixture(scope="module")
def setup(session, tmp_path_factory):
    """A dataset folder without measurements."""
    folder = tmp_path_factory.mktemp("setup") / "cell"
    session.save(folder)
    (folder / "measurements.csv").unlink()
    return folder


@pytest.fixture(scope="module")
def result(setup):
    return bc.plan(setup, purpose="distances", model="geometry", **SMALL)


def test_the_folder_of_the_command_comes_back(setup, result, tmp_path, error_of, output_of):
    out = tmp_path / "run"
    options = ("--contacts", 45, "--candidates", 90, "--for", "distances", "--model", "geometry")
    said = output_of("plan", setup, *options, "--to", "csv", "--to", "poses", "--out", out)
    assert "Expected U = " in said
    assert "random contacts" in said
    there = {p.name for p in out.iterdir() if not p.name.startswith(".")}
    assert there >= {"plan.csv", "plan.json", "plan.html", "plan.png", "plan-joints.csv", "plan-poses.csv"}
    assert not there & {"measurements.csv", "truth.json"}
    saved = bc.load(out)
    assert repr(saved) == repr(result)
    assert len(saved.contacts) == 45
    for table in ("contacts", "distances", "parameters", "detectable", "confusable", "curve"):
        pd.testing.assert_frame_equal(getattr(saved, table), getattr(result, table))
    record = json.loads((out / "plan.json").read_text())
    assert record["dataset"]["sha256"] == read_setup(setup).dataset.sha256 != ""
    (out / "note.txt").write_text("a note of the user")
    assert "did not write: note.txt" in error_of("plan", setup, *options, "--out", out)


def test_a_result_prints_itself(result):
    assert repr(result).startswith("<plan of simulated: 45 contacts; expected U ")
    assert "Expected U = " in str(result)
    assert "<table" in result._repr_html_()
    assert (result.contacts["purpose"].isin(["distances", "repeat"])).all()
    assert result.parameters["u"].le(result.parameters["prior_u"] * (1 + 1e-9)).all()
    u = result.distances["distance_sd_um"].iloc[0]
    assert result.curve["plan"].dropna().iloc[-1] <= u <= result.curve["plan"].dropna().iloc[0]


def test_rows_in_memory_are_ignored(session, setup):
    """A measured session is planned as its folder without measurements."""
    memory, nothing = _setup(session, None, False)
    folder, _ = _setup(setup, None, False)
    assert nothing is None
    assert memory.dataset.measurements.ids == folder.dataset.measurements.ids == ()
    assert memory.regions.keys() == folder.regions.keys()
    for name, region in folder.regions.items():
        np.testing.assert_allclose(memory.regions[name].half, region.half)


def test_measured_rows_count(session, setup, tmp_path):
    """Continued, fewer contacts are enough, and the expected uncertainty is smaller than of them alone."""
    session.save(tmp_path / "measured")
    options = {"contacts": 10, "purpose": "distances", "model": "geometry", "candidates": 40}
    more = bc.plan(setup, after=tmp_path / "measured", **options)
    assert more.data.pool.measured == len(session.dataset.measurements.ids)
    assert len(more.contacts) == 10
    assert not set(more.contacts.index) & set(session.dataset.measurements.ids)
    refused("10 contacts are not more than", lambda: bc.plan(setup, **options))


def test_a_diagnosis_is_continued(session, setup, tmp_path):
    """Its model is taken; its dataset is SETUP."""
    write_dataset(plain(session.dataset), tmp_path / "measured")
    with (tmp_path / "measured" / "dataset.yaml").open("a") as file:
        file.write("# the copy in the run folder has no comment\n")
    gap = bc.diagnose(tmp_path / "measured", "geometry")
    gap.save(tmp_path / "gap", pictures=False)
    by_path, by_result = (_setup(tmp_path / "measured", own, False) for own in (tmp_path / "gap", gap))
    assert by_path[1] == by_result[1]
    assert by_path[1].effects == ("geometry",)
    (scale,) = by_path[1].noise_scale.values()
    assert scale == gap.data.arm.weights.scale["contact"] != 1.0
    more = bc.plan(tmp_path / "measured", 6, "gap", after=gap, candidates=30)
    assert "the noise of the diagnosis" in str(more)
    pool = more.data.pool
    assert pool.setup.dataset.noise == session.dataset.noise  # written as it was stated
    assert pool.session.noise.contact == pytest.approx(scale * session.dataset.noise.contact)
    copy = tmp_path / "gap" / "dataset"  # the page names it
    assert bc.read_dataset(copy).sha256 != gap.record["dataset"]["sha256"]
    assert _setup(copy, tmp_path / "gap", False)[1] == by_path[1]
    (copy / "measurements.csv").write_text((copy / "measurements.csv").read_text() + "\n")
    refused("was changed or removed after the run", lambda: _setup(copy, tmp_path / "gap", False))
    assert len(by_path[0].dataset.measurements.ids) == len(session.dataset.measurements.ids)
    assert by_path[0].dataset.measurements.ids == by_result[0].dataset.measurements.ids
    write_dataset(plain(session.dataset), tmp_path / "other")
    table = tmp_path / "other" / "measurements.csv"
    table.write_text("\n".join(table.read_text().splitlines()[:-1]) + "\n")
    with pytest.raises(bc.BayescalError, match="no diagnosis of the present files"):
        bc.plan(tmp_path / "other", 12, "gap", after=tmp_path / "gap")


@pytest.mark.parametrize(("options", "words"), cases("plan_refusals"))
def test_refusals_are_one_line(setup, options, words, tmp_path, error_of, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "run"
    assert words in error_of("plan", setup, "--candidates", 40, *options, "--out", out)
    assert not out.exists()


def test_another_setup_is_not_continued(session, setup):
    other = replace(session.dataset, targets=session.dataset.targets[1:])
    refused("it has no target", lambda: planned(setup, after=other))
    robot = replace(session.dataset, robot=bc.robots.load_robot("universal-robots-ur5")[0])
    refused("its robot is", lambda: planned(setup, after=robot))


# --- A plan for a controller: every motion, in order, where the nominal arm has it; other readers agree.

CYCLE = ("approach", "contact", "retract")


@pytest.fixture(scope="module")
def exported_plan(cube):
    return made_up_plan(cube(seed=1).dataset, count=14, validation=2)


def text_of(plan, name, probe=None):
    """All files of a format, one behind the other."""
    return "".join(FORMATS[name].files(plan, probe or Probe()).values())


def table(plan, name):
    return list(csv.DictReader(io.StringIO(text_of(plan, name))))


def expected_readings(plan):
    """Approach, contact, retract of every row, (3 N, n), rad."""
    at = plan.session.measurements.readings
    return np.stack([plan.approach, at, plan.approach], axis=1).reshape(-1, at.shape[1])


def test_readings_of_the_controller(exported_plan):
    rows = table(exported_plan, "csv")
    assert [r["motion"] for r in rows] == list(CYCLE) * len(exported_plan.purpose)
    assert [r["id"] for r in rows[::3]] == list(exported_plan.session.measurements.ids)
    read = [[float(r[f"j{k}_deg"]) for k in range(1, 7)] for r in rows]
    np.testing.assert_allclose(read, np.degrees(expected_readings(exported_plan)), atol=6e-6)
    assert [float(r["payload_kg"]) for r in rows[1::3]] == exported_plan.session.measurements.payload.tolist()
    assert {r["tool"] for r in rows} == {"ball"}


def test_compensate_reads_the_programs_back(exported_plan):
    """The readers of robot programs find the joints of the same motions."""
    slots = PROGRAMS["robodk"].read(text_of(exported_plan, "robodk"), 6).slots
    read = np.array([slot.target.readings for slot in slots])
    np.testing.assert_allclose(read, expected_readings(exported_plan), atol=1.1e-7)
    for name in ("fanuc", "kuka", "abb"):
        program = PROGRAMS[name].read(text_of(exported_plan, name), 6)
        read = np.array([slot.target.readings for slot in program.slots])
        far = np.abs(exported_plan.approach[:, None] - read).max(axis=2).min(axis=1)
        assert far.max() < 1.1e-7, name
        assert not program.elsewhere


@pytest.mark.parametrize("name", ["urscript", "fanuc", "kuka", "abb"])
def test_programs_say_what_they_are_and_stop_for_changes(exported_plan, name):
    count, stay = len(exported_plan.purpose), np.empty((0, 6))
    leave, ways, words, changes = [stay] * count, [stay] * count, [""] * count, [""] * count
    leave[0], leave[3], ways[6] = exported_plan.approach[:1], exported_plan.approach[3:4], None
    words[6] = "jog manually to p007"
    changes[3], changes[5] = 'remove "it"; [all]', "attach 0.5 kg"  # the second without a pose to wait
    text = text_of(replace(exported_plan, leave=leave, via=ways, changes=changes, by_hand=words), name)
    assert "not run on a" in " ".join(text.lower().replace("not been run", "not run").split())
    assert "<<" not in text
    assert text.count("attach 0.5 kg") == text.count("jog manually to") == 1
    assert text.index("attach 0.5 kg") < text.index("jog manually to")
    assert '"it"' not in text


@pytest.mark.parametrize(("name", "probe", "words"), [
    ("urscript", Probe("tool:1"), "return get_tool_digital_in(1)"),
    ("urscript", Probe(force=7.5), "return bc_force() > 7.5"),
    ("fanuc", Probe("tool:2"), "SKIP CONDITION RI[2]=ON"),
    ("kuka", Probe("measure:1"), "WHEN $MEAS_PULSE[1]==TRUE DO"),
    ("abb", Probe("di_touch"), "SearchL\\Stop,di_touch,found"),
])  # fmt: skip
def test_the_probe_of_a_program(exported_plan, name, probe, words):
    assert words in text_of(exported_plan, name, probe)


@pytest.mark.parametrize(("name", "options", "words"), cases("probe_refusals"))
def test_a_probe_that_cannot_be_is_refused_before_a_plan_is_made(name, options, words):
    error = refused(words, lambda: formats_of([name], Probe(**options)))
    assert error.where.startswith("--probe-")
    assert error.remedy


def test_a_search_ends_where_the_arm_can_reach(exported_plan):
    """Along the line of the approach; less beyond the surface at a limit of a joint."""
    guard = guarded(exported_plan, 5e-3)
    arm = NominalArm(exported_plan.session.robot, exported_plan.session.tools[0].centre)
    m = exported_plan.session.measurements
    readings = (m.readings, exported_plan.approach, guard.end, guard.begin)
    at, away, end, begin = (arm.ball(arm.frames(q)) for q in readings)
    way = (at - away) / np.linalg.norm(at - away, axis=1)[:, None]
    np.testing.assert_allclose(end - at, guard.beyond[:, None] * way, atol=2e-8)
    ahead = np.minimum(10e-3, np.linalg.norm(at - away, axis=1))
    found = np.any(guard.begin != exported_plan.approach, axis=1)
    assert found.mean() > 0.8  # of the others the line leaves the limits: the search begins at the approach
    np.testing.assert_allclose((at - begin)[found], (ahead[:, None] * way)[found], atol=2e-8)
    limits = np.stack([m.readings.min(axis=0), guard.end.max(axis=0)], axis=1)
    narrow = replace(exported_plan.session.robot, limits=limits, link_from_reading=np.eye(6))
    short = guarded(replace(exported_plan, session=replace(exported_plan.session, robot=narrow)), 5e-3)
    assert short.beyond.min() < 5e-3
    arm = NominalArm(narrow, exported_plan.session.tools[0].centre)
    m = exported_plan.session.measurements
    at, away, end = (arm.ball(arm.frames(q)) for q in (m.readings, exported_plan.approach, short.end))
    way = (at - away) / np.linalg.norm(at - away, axis=1)[:, None]
    np.testing.assert_allclose(end - at, short.beyond[:, None] * way, atol=2e-8)
    told = [s.texts["short"] for s in steps(exported_plan, short) if s.kind == "contact"]
    less = [f", search to {1e3 * m:g} mm beyond" if m < short.beyond.max() else "" for m in short.beyond]
    assert told == less


def test_points_that_are_passed_come_before_the_approach(exported_plan):
    """A motion without a free way stops the program."""
    ways = [np.empty((0, 6))] * len(exported_plan.purpose)
    ways[2], ways[4] = exported_plan.approach[:2] + 0.1, None
    words = tuple("move by hand: J1 first" if k == 4 else "" for k in range(len(ways)))
    around = replace(exported_plan, via=tuple(ways), by_hand=words)
    rows = table(around, "csv")
    cycles = [*CYCLE * 2, "pass", "pass", *CYCLE * (len(exported_plan.purpose) - 2)]
    assert [r["motion"] for r in rows] == cycles
    assert {r["id"] for r in rows if r["motion"] == "pass"} == {"p003"}
    assert text_of(around, "urscript").count("move by hand: J1 first") == 1


def test_names_do_not_leave_their_comment_or_string(exported_plan):
    ids = ('a"\n  movej([0,0,0,0,0,0])', *exported_plan.session.measurements.ids[1:])
    hostile = replace(exported_plan, session=with_columns(exported_plan.session, ids=ids))
    for name in ("urscript", "fanuc", "kuka", "abb"):
        text, plain = text_of(hostile, name), text_of(exported_plan, name)
        assert text.count("\n") == plain.count("\n")
        assert text.count('"') == plain.count('"')


def test_poses_are_those_of_the_nominal_arm(exported_plan, tmp_path):
    """In F0, of the tool's frame with its stated orientation; `compensate` reads the table."""
    turned = replace(exported_plan.session.tools[0], rpy=np.array([0.3, -0.2, 1.1]))
    exported_plan = replace(exported_plan, session=replace(exported_plan.session, tools=(turned,)))
    path = tmp_path / "poses.csv"
    path.write_text(text_of(exported_plan, "poses"))
    targets = read_targets(path, exported_plan.session.robot).targets
    arm = NominalArm(exported_plan.session.robot, turned.centre, rpy_matrix(turned.rpy))
    poses = arm.tool_poses(arm.frames(expected_readings(exported_plan)))
    read = np.array([t.pose for t in targets])
    np.testing.assert_allclose(read[:, :3, 3], poses[:, :3, 3], atol=6e-8)
    np.testing.assert_allclose(read[:, :3, :3], poses[:, :3, :3], atol=3e-7)
    np.testing.assert_allclose([t.readings for t in targets], expected_readings(exported_plan), atol=1.1e-7)


def test_nothing_is_approached_where_nothing_is_touched(tracker):
    plan = made_up_plan(tracker(seed=1).dataset)
    plan = replace(plan, approach=plan.session.measurements.readings)
    assert [m.kind for m in motions(plan)] == ["measure"] * len(plan.purpose)
    text = text_of(plan, "urscript")
    assert "bc_contact([" not in text
    assert "press and release" not in text
    assert text.count("sleep(2.00)") == len(plan.purpose)  # the instrument reads an arm at rest


def test_an_arm_that_a_format_does_not_know_is_refused_before_the_plan(exported_plan, monkeypatch):
    session = exported_plan.session
    short = replace(session, robot=replace(session.robot, joint_names=("J1", "J2")))
    monkeypatch.setattr("bayescal.planning.plan.plan", lambda *_: pytest.fail("a plan was made"))
    refused("arms of 6 joints", lambda: bc.plan(short, to=("csv", "kuka")))


def test_formats_are_written_beside_the_plan(exported_plan, tmp_path):
    names = write_plan(exported_plan, tmp_path / "run", ("poses", "csv", "poses"))
    assert {"plan-poses.csv", "plan-joints.csv"} <= set(names)
    assert (tmp_path / "run" / "plan-joints.csv").read_text() == text_of(exported_plan, "csv")
    refused("there is no format `rapid`", lambda: formats_of(["csv", "rapid"]))
    refused("there is no format", lambda: write_plan(exported_plan, tmp_path / "other", ("rapid",)))
    assert not (tmp_path / "other").exists()


# --- Practice sessions of set-ups: what `init` writes can be simulated, fitted, and compared with its truth.

OPTIONS = {"contacts": 60, "later": 8, "repeats": 2, "seed": 1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Maker of the set-up of an artefact, as `init` writes it, once for each."""

    @cache
    def made(artefact):
        path = tmp_path_factory.mktemp("setups") / artefact.replace(",", "-")
        bc.init(path, "lrmate200ic", artefact, tool="60 0 120 mm")
        return path

    return made


@pytest.mark.parametrize("artefact", ["cube", "bar", "tracker"])
def test_a_fit_finds_the_true_arm(folder, artefact, tmp_path):
    simulated = bc.simulate(setup=folder(artefact), **OPTIONS)
    simulated.save(tmp_path / "session")
    session = read_dataset(tmp_path / "session")
    assert not session.unfilled
    estimate = calibrated(Scene(session), ("geometry", "compliance"))
    left = unexplained(estimate)
    assert 0.6 < left.fitted / left.stated < 1.5
    values = dict(zip(estimate.model.names, estimate.model.physical(estimate.z), strict=True))
    off = []
    for k, p in enumerate(estimate.model.parameters):
        entry = next(t for t in simulated.truth["parameters"] if t["name"] == p.name)
        true = next(v for key, v in entry.items() if key.startswith("value")) / UNITS[p.unit][1]
        off.append((values[p.name] - true) / (estimate.sd[k] * p.sd))
    assert np.sqrt(np.mean(np.square(off))) < 1.5
    assert max(map(abs, off)) < 4.0


def test_the_same_seed_is_the_same_session(folder):
    path, few = folder("tracker"), OPTIONS | {"contacts": 20, "later": 2}
    one, same = (bc.simulate(setup=path, **few).dataset.measurements for _ in range(2))
    other = bc.simulate(setup=path, **few | {"seed": 2}).dataset.measurements
    np.testing.assert_array_equal(one.xyz, same.xyz)
    assert not np.allclose(one.readings, other.readings)
    later = one.role == "validate"  # other poses than those of the fit
    assert np.abs(one.readings[later][:, None] - one.readings[~later]).max(axis=2).min() > 1e-2


def test_an_arm_without_masses_names_the_option_that_is_wrong(tmp_path):
    bc.init(tmp_path / "setup", "fanuc-m20ia", "tracker")
    with pytest.raises(BayescalError, match="--effects: compliance cannot be judged"):
        bc.simulate(setup=tmp_path / "setup", **OPTIONS)
    few = OPTIONS | {"contacts": 20}
    assert bc.simulate(setup=tmp_path / "setup", effects="geometry", **few).dataset.measurements.ids


def test_what_a_setup_states_is_refused_as_an_option(folder, tmp_path, error_of, output_of):
    path = folder("cube")
    refused("a set-up states noise itself", lambda: bc.simulate(setup=path, noise=1e-6))
    error = error_of("simulate", "--setup", path, "--spheres", 2, "--out", tmp_path / "x")
    assert error.startswith("bayescal: --spheres: a set-up states it itself")
    assert not (tmp_path / "x").exists()
    few = ("--contacts", 16, "--repeats", 0, "--later", 4)
    out = output_of("simulate", "--setup", path, *few, "--out", tmp_path / "y")
    assert (tmp_path / "y" / "truth.json").is_file()
    assert "cube.+z: 4 contacts to calibrate, 1 to validate" in out
