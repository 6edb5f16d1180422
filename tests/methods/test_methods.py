"""Every method finds the true arm without noise, says what it lacks, and is validated like the others."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from cases import terminal_text

from analysis.methods import page, session
from analysis.pages import between
from bayescal.dataset import Dataset, write_dataset
from bayescal.dataset.contacts import connected
from bayescal.effects import UNITS
from bayescal.methods import METHODS, Comparison, compare, predicted, validated
from bayescal.methods.normals import in_normals, triplets
from bayescal.methods.published import OURS, PLANES, in_joints, is_plane, joint_change
from bayescal.methods.solving import System, contacts, estimable, part
from bayescal.model import Scene, build
from bayescal.predict.validation import Errors
from bayescal.reporting.comparison import COLUMNS, comparison_record, comparison_summary, write_comparison
from bayescal.simulation import Options

EFFECTS = ("geometry", "compliance")
LAYOUT = Options(seed=2, contacts=80, later=12, repeats=0, placements=1, sphere_contacts=8)
TOUCHING = ("normals", "known planes", "linear steps", "inverse", "bayescal")
READ = ("inverse", "open loop", "bayescal")
UM = 1e6


@cache
def touched() -> Dataset:
    """Probed without noise."""
    return session.touched(LAYOUT, 2)


@cache
def read_by_tracker() -> Dataset:
    """Points read without noise."""
    return session.tracked(LAYOUT)


@cache
def posed() -> Dataset:
    """Points and orientations read without noise."""
    return session.tracked(LAYOUT, poses=True)


@cache
def compared(which: str) -> Comparison:
    return compare({"touched": touched, "tracked": read_by_tracker, "posed": posed}[which](), EFFECTS)


def results(comparison: Comparison):
    return {row.method.name: row.result for row in comparison.rows if row.result is not None}


@pytest.mark.parametrize("name", TOUCHING)
def test_without_noise_distances_are_true(name):
    found = results(compared("touched"))
    assert UM * found["nominal"].validation.distance_errors.maximum > 300  # there is something to find
    assert UM * found[name].validation.distance_errors.maximum < 1
    assert UM * found[name].validation.contacts.maximum < 1


@pytest.mark.parametrize("name", READ)
@pytest.mark.parametrize("which", ["tracked", "posed"])
def test_without_noise_points_are_true(name, which):
    found = results(compared(which))
    assert UM * found["nominal"].validation.point_lengths.mean > 300
    assert UM * found[name].validation.point_lengths.maximum < 1


def test_what_a_session_lacks_is_said():
    rows = (*compared("touched").rows, *compared("tracked").rows)
    why = {row.method.name: row.why for row in rows if row.why}
    assert set(why) == {"open loop", "normals", "known planes", "linear steps"}
    assert "instrument" in why["open loop"]
    assert "no plane" in why["normals"]
    assert "no planes" in why["known planes"]
    assert "no contacts" in why["linear steps"]


def test_without_a_certified_length_the_peers_refuse():
    """They would shrink the arm; ours has its tolerances."""
    bare = replace(touched(), certificates=tuple(c for c in touched().certificates if c.kind == "distance"))
    why = {row.method.name: row.why for row in compare(bare, EFFECTS).rows if row.result is None}
    assert set(why) == {"normals", "known planes", "linear steps", "inverse", "open loop"}
    assert "scale of the arm is not identifiable" in why["linear steps"]
    assert "do not determine lengths" in why["normals"]
    assert "not stated" in why["known planes"]


def test_stated_planes_need_no_certificate():
    stated = tuple(replace(t, u=1e-5, u_angle=1e-5) if t.kind == "plane" else t for t in touched().targets)
    model = build(Scene(replace(touched(), certificates=(), targets=stated)), EFFECTS)
    assert next(m for m in METHODS if m.name == "known planes").missing(model) == ""


def test_known_planes_believe_what_is_stated():
    """A cube of another shape than stated spoils distances for those who hold it, as far as it is wrong."""
    found = results(compare(session.touched(LAYOUT, 2, shape_error=50e-6), EFFECTS, methods=(PLANES,)))
    assert UM * found["known planes"].validation.distance_errors.maximum > 10


@pytest.mark.parametrize("rows", ["contacts", "normals", "joints"])
def test_slopes_are_those_of_the_residuals(rows):
    model = part(build(Scene(touched()), EFFECTS), is_plane)
    made = {"contacts": lambda m: contacts, "normals": in_normals, "joints": in_joints}[rows](model)
    system = System(model, made)
    rng = np.random.default_rng(0)
    x = np.concatenate([0.3 * model.sd, np.full(model.size - system.arm, 1e-3)]) * rng.normal(size=model.size)
    _, jacobian = system(x)
    for _ in range(5):
        way = np.concatenate([model.sd, np.full(model.size - system.arm, 1e-3)]) * rng.normal(size=model.size)
        step = 1e-4 * way
        slope = (system(x + step)[0] - system(x - step)[0]) / 2
        assert np.linalg.norm(jacobian @ step - slope) < 1e-6 * np.linalg.norm(slope)


def test_joint_changes_are_the_least_that_close_a_row():
    scene = Scene(read_by_tracker())
    model = build(scene, EFFECTS)
    block = model.blocks[0]
    coupling = scene.dataset.robot.link_from_reading
    factor = joint_change(block, coupling)
    gradients = block.by_readings(np.zeros(len(model.parameters)), np.zeros(block.size), coupling)
    own = gradients.reshape(3, len(block.rows), -1).swapaxes(0, 1)
    size = np.linalg.svd(own, compute_uv=False)
    regular = size[:, -1] > 0.05 * size[:, 0]
    assert regular.sum() > 20
    r = np.random.default_rng(1).normal(size=(len(own), 3))
    least = np.einsum("cij,cj->ci", np.linalg.pinv(own), r)
    assert np.einsum("cij,cj->ci", own, least)[regular] == pytest.approx(r[regular])
    short = np.linalg.norm(np.einsum("cij,cj->ci", factor, r), axis=1)
    assert short[regular] == pytest.approx(np.linalg.norm(least, axis=1)[regular])


def test_redundant_parameters_are_held():
    """Axes 2 and 3 are parallel: d2 and d3 move the ball alike, and one of them is left as drawn."""
    model = build(Scene(touched()), EFFECTS)
    system = System(model)
    known = estimable(system, np.zeros(system.size))
    held = {p.name for k, p in enumerate(model.parameters) if k not in known.kept}
    assert len(held & {"d2", "d3"}) == 1
    assert len(held) == 1
    assert 1 < known.condition < 100


def test_triplets_are_wide_and_use_every_contact():
    place = np.random.default_rng(3).uniform(-0.1, 0.1, (30, 2))
    dealt = triplets(place)
    assert set(dealt.ravel()) == set(range(30))
    assert all(len(set(t)) == 3 for t in dealt.tolist())
    first, second = (place[dealt[:, k]] - place[dealt[:, 0]] for k in (1, 2))
    area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    shuffled = np.random.default_rng(4).permutation(30).reshape(-1, 3)
    first, second = (place[shuffled[:, k]] - place[shuffled[:, 0]] for k in (1, 2))
    assert np.median(area) > 1.2 * np.median(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]))


def test_names_are_bound_by_a_chain_of_pairs():
    assert len(connected("abc", [("b", "c"), ("a", "b")])) == 1
    assert len(connected("abc", [("a", "b")])) == 2


def distance_errors(dataset: Dataset, names: tuple[str, ...] = TOUCHING) -> dict[str, float]:
    """Rms of all distance errors by method, um."""
    out = {}
    for method in METHODS:
        if method.name in names:
            errors = [d.error for d in validated(method.solve(Scene(dataset), EFFECTS)).distances]
            out[method.name] = UM * float(np.sqrt(np.mean(np.square(errors))))
    return out


def test_with_noise_ours_is_not_worse_on_average():
    found = [distance_errors(session.touched(LAYOUT, arm, noise=5e-6)) for arm in (10, 11)]
    rms = {name: np.sqrt(np.mean([f[name] ** 2 for f in found])) for name in TOUCHING}
    assert all(rms["bayescal"] < 1.1 * value for value in rms.values()), rms


def test_outliers_spoil_the_peers_not_ours():
    found = distance_errors(session.touched(LAYOUT, 20, noise=5e-6, outliers=0.04))
    assert all(found["bayescal"] < 0.7 * value for name, value in found.items() if name != "bayescal"), found


def test_the_judge_agrees_with_a_fits_own_validation():
    solution = OURS.solve(Scene(session.touched(LAYOUT, 36, noise=5e-6)), EFFECTS)
    own, common = predicted(solution, 0), validated(solution)
    assert own is not None
    for mine, theirs in zip(own.distances, common.distances, strict=True):
        assert UM * mine.error == pytest.approx(UM * theirs.error, abs=0.5)
    for mine, theirs in zip(own.planes, common.planes, strict=True):
        assert np.sqrt(np.mean((mine.residuals - theirs.residuals) ** 2)) < 2e-6


def test_report_says_all(tmp_path):
    comparison = compared("touched")
    write_comparison(comparison, tmp_path / "run")
    record = json.loads((tmp_path / "run" / "compare.json").read_text())
    assert record == json.loads(json.dumps(comparison_record(comparison)))
    assert [m["name"] for m in record["methods"]] == [m.name for m in METHODS]
    for row, method in zip(comparison.rows, record["methods"], strict=True):
        if row.result:
            s = row.result.solution
            pairs = zip(s.model.parameters, s.values, strict=True)
            values = [UNITS[p.unit][1] * (p.nominal + v) for p, v in pairs]
            assert [p["estimate"] for p in method["parameters"]] == pytest.approx(values)
    for method in (m for m in record["methods"] if m["applies"]):  # each size is that of its name
        errors, of = [d["error_um"] for d in method["distances"]], method["heldout"]
        if errors:
            assert of["distances_rms_um"] == pytest.approx(np.sqrt(np.mean(np.square(errors))))
            assert of["distances_max_um"] == pytest.approx(np.max(np.abs(errors)))
        if of["points"]:
            assert of["points_mean_um"] < of["points_max_um"]
    ours = record["methods"][-1]
    assert set(COLUMNS) <= set(ours["heldout"])
    assert ours["heldout"]["predicted_distance_sd_um"] > 0
    assert len(ours["distances"]) == ours["heldout"]["distances"]
    assert next(m for m in record["methods"] if m["name"] == "open loop")["why"]
    text = terminal_text(comparison_summary(comparison), 140)
    assert all(m.name in text for m in METHODS)
    assert "no calibration row is measured by an instrument" in text


def test_each_column_is_the_figure_of_its_heading():
    """Of errors with other figures for each kind of measurement."""
    rng = np.random.default_rng(0)
    kinds = ("contacts", "distance_errors", "point_lengths")
    values = {kind: np.abs(rng.standard_normal(9)) for kind in kinds}
    checked = SimpleNamespace(**{kind: Errors(v, np.zeros((2, 9))) for kind, v in values.items()})
    of = dict(zip(("planes", "distances", "points"), values.values(), strict=True))
    figures = {"rms": lambda v: np.sqrt(np.mean(v**2)), "mean": np.mean, "max": np.max}
    for key, (_, value) in COLUMNS.items():
        if not key.startswith("predicted"):
            kind, figure, _ = key.split("_")
            assert value(SimpleNamespace(validation=checked)) == pytest.approx(figures[figure](of[kind])), key


# --- The study's page and the command line of a comparison.

HELD = {"points": 0, "plane_contacts": 40, "planes_rms_um": 5.0, "points_mean_um": None}


def record(sort: str, **distances: float | None):
    methods = []
    for name, rms in distances.items():
        predicted = 6.0 if name == "bayescal" else None
        held = {**HELD, "distances_rms_um": rms, "predicted_distance_sd_um": predicted}
        methods.append({"name": name, "applies": rms is not None, "why": "", "seconds": 0.1, "heldout": held})
    return {"sort": sort, "methods": methods}


def test_page_pools_sessions_and_keeps_the_rest(renewed):
    done = [record("clean", normals=3.0, bayescal=3.0), record("clean", normals=None, bayescal=4.0)]
    done += [{"sort": "clean", "seed": 3, "refused": "no place"}]
    text = renewed(page, lambda path: between(path, (page.BEGIN, page.END), page.tables(done)))
    assert "clean (2)" in text
    assert "| normals | 3.0 |" in text
    assert "| bayescal | 3.5 |" in text  # root of the mean of 9 and 16


def test_command_line(tmp_path, error_of, output_of):
    out, mine = tmp_path / "out", tmp_path / "mine" / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("mine")
    write_dataset(read_by_tracker(), tmp_path / "session")
    error = error_of("compare", tmp_path / "session", "--out", mine.parent)
    assert "the folder contains files that bayescal did not write: mine.txt" in error
    assert list(mine.parent.iterdir()) == [mine]
    assert "open loop" in output_of("compare", tmp_path / "session", "--out", out)
    assert json.loads((out / "compare.json").read_text())["schema"] == "bayescal-compare/1"
