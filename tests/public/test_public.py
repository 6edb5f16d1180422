"""The public API: its examples run, results print and come back, and a user's own effect is taken."""

import csv
import doctest
import inspect
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from cases import EXAMPLE, ROOT, refused
from gap_diagnoses import diagnosis

import bayescal as bc
from bayescal.errors import BayescalError
from bayescal.fitted.arm import of_fit
from bayescal.fitted.gate import NOTHING, Use
from bayescal.public import GapResult, budgets
from bayescal.public.budgets import certificate

PUBLIC = (f for f in sorted(Path(bc.__file__).parent.glob("public/*.py")) if ">>>" in f.read_text())
FUNCTIONS = (f"bayescal.public.{f.stem}" for f in PUBLIC)
DOCUMENTED = ("bayescal", "bayescal.effects", "bayescal.robots", *FUNCTIONS)


@pytest.fixture(scope="module")
def remembered():
    """`bc.simulate` and `bc.fit`, which compute once what several examples or tests ask for."""
    known = {}

    def of(function):
        def call(*given, **named):
            what = [id(g) if hasattr(g, "dataset") else g for g in given]
            asked = function.__name__, repr(what), repr(named)
            if asked not in known:
                known[asked] = function(*given, **named), given  # what is given lives on, and so its id
            return known[asked][0]

        return call

    return {name: of(getattr(bc, name)) for name in ("simulate", "fit")}


@pytest.fixture
def once(remembered, monkeypatch):
    """Examples call these two in place of those of the package."""
    for name, function in remembered.items():
        monkeypatch.setattr(bc, name, function)


@pytest.mark.parametrize("module", DOCUMENTED)
def test_examples_of_docstrings(module, once, quick_search):
    found = doctest.testmod(import_module(module))
    assert found.attempted
    assert not found.failed


def test_examples_of_the_page(once):
    found = doctest.testfile(str(ROOT / "docs" / "api.md"), module_relative=False)
    assert found.attempted > 5
    assert not found.failed


def test_every_name_is_documented_and_there():
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    for name in bc.__all__:
        assert getattr(bc, name) is not None
        assert name.startswith("_") or f"`{name}" in page or f"`bc.{name}" in page
    assert set(dir(bc)) == set(bc.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = bc.nothing


def test_import_alone_imports_nothing():
    """What is heavy is imported by the first call."""
    heavy = {"numpy", "scipy", "pydantic", "yaml"}
    code = f"import sys, bayescal; print([m for m in sys.modules if m.split('.')[0] in {heavy}])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


@pytest.fixture(scope="module")
def session(remembered):
    return remembered["simulate"](contacts=80, later=8, repeats=5, spheres=2, placements=1, seed=1)


@pytest.fixture(scope="module")
def result(session, remembered):
    return remembered["fit"](session, samples=0)


def test_a_fit_prints_itself(result):
    words = "<calibration of simulated: geometry, compliance; predicted distance error"
    assert repr(result).startswith(words)
    assert "\n" not in repr(result)
    assert "model explains validation data" in str(result)
    assert "<table" in result._repr_html_()
    assert "&lt;calibration" in result._repr_html_()


def test_parameters_are_those_of_the_estimate(result):
    table, found = result.parameters, result.data.final.estimate
    model = found.model
    _, factor = model.in_file_units()
    np.testing.assert_allclose(table["estimate"], model.physical(found.z) * factor)
    assert list(table.index) == list(model.names)
    assert table.loc["a2", "unit"] == "mm"
    assert table.loc["a2", "identifiable"] == "yes"
    assert table.loc["d2", "identifiable"] != "yes"
    assert set(table["identifiable"]) <= {"yes", "weakly", "no", ""}


def test_a_fit_comes_back(result, tmp_path):
    names = result.save(tmp_path / "run", pictures=False)
    assert {p.name for p in (tmp_path / "run").iterdir() if not p.name.startswith(".")} >= set(names)
    saved = bc.load(tmp_path / "run")
    for table in ("parameters", "levels", "distances"):
        pd.testing.assert_frame_equal(getattr(saved, table), getattr(result, table))
    assert saved.warnings == result.warnings
    assert repr(saved) == repr(result)
    assert "a2" in str(saved)
    a2 = np.asarray(saved.inference_data()["posterior"]["a2"])
    assert a2.std() == pytest.approx(saved.parameters.loc["a2", "u"], rel=1e-6)


def test_a_budget_of_a_parameter_states_what_the_verdict_says_against_the_model(result, monkeypatch):
    """Points and distances have the unexplained error; the u of a parameter has no part of it."""
    arm, *others = budgets.stated(result)
    for warnings in ((), ("verdict of the fit: it explains nothing",)):
        doubted = replace(arm, use=Use(warnings=warnings))
        monkeypatch.setattr(budgets, "stated", lambda run, arm=doubted: (arm, *others))
        found = bc.budget(result, parameter="a2")
        text = " ".join(str(found).split())
        assert ("it explains nothing; u of a parameter" in text) is bool(warnings)
        assert found.record["warnings"] == list(found.warnings)
        assert bc.budget(result).warnings == ()


@pytest.mark.parametrize("asked", [{"parameter": "theta2"}, {}, {"parameter": "compliance J3"}])
def test_every_row_of_a_budget_as_csv_is_that_of_its_record(result, asked):
    found = bc.budget(result, **asked)
    *parts, of_u, of_U = csv.DictReader(StringIO(found.csv))
    for row, stated in zip(parts, found.record["components"], strict=True):
        assert row.keys() - {"measurand"} <= stated.keys()
        for key in row.keys() - {"measurand"}:
            value = row[key] if isinstance(stated[key], str) else float(row[key]) if row[key] else None
            assert value == (stated[key] if isinstance(stated[key], str) else pytest.approx(stated[key])), key
    assert {row["measurand"] for row in (*parts, of_u, of_U)} == {found.record["measurand"]}
    assert of_u["unit"] == of_U["unit"] == found.record["unit"]
    # U = k u, by the numbers of the file alone; k is the sensitivity of U to u
    for key in ("contribution", "contribution_um"):
        u, expanded = of_u[key], of_U[key]
        assert bool(u) == bool(expanded) == (key == "contribution" or found.record["u_um"] is not None)
        if u:
            assert float(u) == pytest.approx(np.linalg.norm([float(row[key]) for row in parts]))
            assert float(expanded) == pytest.approx(float(of_U["sensitivity"]) * float(u))


def test_a_folder_and_a_dataset_give_the_same(remembered, tmp_path):
    """A path as text, and in memory except for the readings' rounding in the file."""
    few = {"contacts": 60, "later": 8, "repeats": 5, "spheres": 0, "seed": 1}
    session = remembered["simulate"](effects="geometry", **few)
    session.save(tmp_path / "session")
    by_text = bc.fit(str(tmp_path / "session"), ("geometry",), samples=0).parameters["estimate"]
    in_memory = remembered["fit"](session, "geometry", samples=0).parameters["estimate"]
    pd.testing.assert_series_equal(by_text, in_memory, rtol=1e-6, atol=1e-6)


def test_what_is_no_dataset_or_no_result_is_refused(tmp_path):
    refused("int is no dataset", lambda: bc.fit(3))
    refused("there is no option contact", lambda: bc.simulate(contact=3))
    refused(r"there is no fit\.json or gap\.json", lambda: bc.load(tmp_path))
    (tmp_path / "fit.json").write_text('{"schema": "bayescal-fit/9"}', encoding="utf-8")
    refused("the schema is bayescal-fit/9", lambda: bc.load(tmp_path))
    (tmp_path / "fit.json").write_text("{", encoding="utf-8")
    refused("invalid JSON", lambda: bc.load(tmp_path))


def test_a_diagnosis_comes_back(cube, tmp_path):
    gap = GapResult(data=diagnosis(cube(seed=1, count=80).dataset))
    assert gap.effects
    gap.save(tmp_path / "gap", pictures=False)
    saved = bc.load(tmp_path / "gap")
    assert saved.effects == gap.effects
    pd.testing.assert_frame_equal(saved.probability, gap.probability)
    assert repr(saved) == repr(gap)


def test_a_diagnosis_is_undecided_with_open_pairs_or_an_unexplained_error() -> None:
    def gap(verdict, undecided=(), plannable=True):
        content = {"verdict": verdict, "undecided": list(undecided), "plannable": plannable}
        return GapResult(folder=Path(), content=content)

    assert [gap(v).undecided for v in ("null", "named", "ambiguous", "unknown")] == [False, False, True, True]
    assert gap("named", [{"a": [], "b": [], "common": []}]).undecided
    assert not gap("unknown", plannable=False).undecided  # `plan` refuses cameras


def test_without_masses_the_default_model_is_geometry_and_says_so(tracker):
    """Half of the built-in robots state no masses: the default model was refused, a stated one still is."""
    d = tracker(seed=3, count=40).dataset
    light = replace(d, robot=replace(d.robot, masses=None, centres_of_mass=None, compliance=None))
    result = bc.fit(light, samples=0)
    assert set(result.parameters["effect"]) <= {"geometry", "tool", "target"}
    (said,) = [f for f in result.data.findings if f.code == "not_modelled"]
    assert "mass_kg" in said.text
    assert not any(f.code == "not_modelled" for f in bc.fit(d, samples=0).data.findings)
    refused("compliance cannot be judged", lambda: bc.fit(light, "geometry,compliance", samples=0))


# --- Every option of a public function reaches what computes, with its value and in its unit.


class Called(Exception):
    """In place of the work of a function: the arguments with which it was called."""


def spied(path, call):
    """Arguments, by name, with which `call` calls the function at a path."""
    module, _, name = path.rpartition(".")
    signature = inspect.signature(getattr(import_module(module), name))

    def stop(*given, **named):
        found = signature.bind(*given, **named)
        found.apply_defaults()
        raise Called(found.arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(path, stop)
        with pytest.raises(Called) as caught:
            call()
    return caught.value.args[0]


def attributes(of, *names):
    return tuple(getattr(of, name) for name in names)


USE = ("robust", "prior_width", "seed")


@pytest.mark.parametrize(("latent", "seed"), [(True, 7), (False, 8)])
def test_options_of_a_calibration_and_of_a_diagnosis_arrive(latent, seed):
    session = bc.read_dataset(EXAMPLE)
    usual = {"robust": False, "prior_width": 2.5, "seed": seed, "without": "compliance J3, d4"}
    own = {"latent_joints": latent, "tolerance_mm": 0.25, "samples": 11}
    got = spied("bayescal.calibration.fit", lambda: bc.fit(session, "geometry, step", **own, **usual))
    assert attributes(got["options"], *USE, "latent_joints") == (False, 2.5, seed, latent)
    assert got["options"].tolerance == pytest.approx(0.25e-3)
    assert (got["effects"], got["samples"]) == (("geometry", "step"), 11)
    assert got["without"] == ("compliance J3", "d4")
    got = spied("bayescal.gap.diagnose.diagnose", lambda: bc.diagnose(session, ["geometry"], **usual))
    assert attributes(got["options"], *USE) == (False, 2.5, seed)
    assert (got["effects"], got["without"]) == (("geometry",), ("compliance J3", "d4"))


def test_options_of_a_calibration_from_a_log_arrive(tmp_path):
    (tmp_path / "dataset.yaml").write_text("schema: bayescal-motion/1\n")
    got = spied("bayescal.public.motions.fit_log", lambda: bc.fit(tmp_path, samples=11, seed=7))
    assert (got["samples"], got["seed"]) == (11, 7)


@pytest.mark.parametrize("remounted", [True, False])
@pytest.mark.parametrize(("command", "own_noise"), [(bc.fit, True), (bc.diagnose, False)])
def test_sessions_are_joined_as_they_are_asked_for(command, own_noise, remounted):
    session = bc.read_dataset(EXAMPLE)
    got = spied("bayescal.dataset.join.joined", lambda: command([session, session], remounted=remounted))
    assert (len(got["sessions"]), got["remounted"], got["own_noise"]) == (2, remounted, own_noise)


@pytest.mark.parametrize(("remounted", "robust"), [(True, False), (False, True), (True, True)])
def test_options_of_changes_arrive(tmp_path, remounted, robust):
    session = bc.read_dataset(EXAMPLE)
    (tmp_path / "at.csv").write_text("id,j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg\ngrasp,0,10,-20,0,30,0\n")
    options = {"remounted": remounted, "robust": robust, "at": tmp_path / "at.csv"}
    got = spied("bayescal.changes.changed", lambda: bc.changed([session] * 2, "geometry, step", **options))
    assert (got["remounted"], got["robust"]) == (remounted, robust)
    assert got["effects"] == ("geometry", "step")
    assert [t.id for t in got["targets"]] == ["grasp"]


def test_options_of_a_history_arrive(tmp_path):
    got = spied("bayescal.changes.history.history", lambda: bc.history(tmp_path, order="b, a", limit_mm=0.25))
    assert (got["folder"], got["order"]) == (tmp_path, ("b", "a"))
    assert got["limit"] == pytest.approx(0.25e-3)


@pytest.mark.parametrize("validation", [True, False])
def test_options_of_a_plan_arrive(validation):
    options = {"purpose": "gap", "levers": "payload", "order": "random", "candidates": 123, "seed": 9}
    options |= {"model": "geometry", "validation": validation}
    session = bc.read_dataset(EXAMPLE)
    got = spied("bayescal.planning.plan.plan", lambda: bc.plan(session, 77, **options))["options"]
    names = ("contacts", "aim", "effects", "levers", "order", "candidates", "seed", "validation")
    wanted = 77, "gap", ("geometry",), ("payload",), "random", 123, 9, validation
    assert attributes(got, *names) == wanted


def test_options_of_what_uses_an_arm_arrive(monkeypatch):
    asked = []
    arm = SimpleNamespace(use=NOTHING, dataset=SimpleNamespace(robot=SimpleNamespace(name="arm")))
    monkeypatch.setattr("bayescal.public.arms.arm_of", lambda *given: asked.append(given) or arm)
    state = {"with_": "backlash, step", "without": "compliance", "at_time": 3.5, "at_row": "c7"}
    got = spied(
        "bayescal.compensating.compensate_file",
        lambda: bc.compensate(
            "run", "a.src", format="kuka", frame="cube", tool="ball", tcp=[0.1, 0.2, 0.3, 1.0, 2.0, 3.0],
            payload_kg=1.5, **state,
        ),
    )  # fmt: skip
    keys = ("format_", "frame", "tool", "payload", "time", "row")
    assert [got[key] for key in keys] == ["kuka", "cube", "ball", 1.5, 3.5, "c7"]
    assert got["tcp"].tolist() == [0.1, 0.2, 0.3, 1.0, 2.0, 3.0]
    given = {"into": "a.xml", "readings": "script", "force": True, **state}
    got = spied("bayescal.exporting.export.export", lambda: bc.export(Path("run"), "mjcf", **given))
    keys = ("to", "into", "readings", "time", "row", "force")
    assert [got[key] for key in keys] == ["mjcf", "a.xml", "script", 3.5, "c7", True]
    assert asked == [("run", ("backlash", "step"), ("compliance",)), (Path("run"), *asked[0][1:])]


USES = {
    "export": lambda **force: bc.export("run", "urdf", **force),
    "compensate": lambda **force: bc.compensate("run", "a.src", **force),
    "certificate": lambda **force: certificate("run", "given.yaml", **force),
}
"""Everything that has the option `force`."""


def test_all_that_can_be_forced_is_tested():
    files = Path(bc.__file__).parent.glob("public/*.py")
    public = [import_module(f"bayescal.public.{f.stem}") for f in files]
    functions = [f for module in public for f in vars(module).values() if inspect.isfunction(f)]
    forced = [f for f in functions if "force" in inspect.signature(f).parameters]
    assert {f.__name__ for f in forced if f.__module__.startswith("bayescal.public")} == USES.keys()


@pytest.mark.parametrize("name", USES)
def test_an_arm_is_not_used_in_spite_of_reasons_against_it_unless_forced(name, monkeypatch, result):
    """And with all of them in the refusal."""
    use, done = Use(("it did not converge", "priors decide")), []
    arm = replace(of_fit(result.data), use=use)
    monkeypatch.setattr("bayescal.public.arms.arm_of", lambda *given: arm)
    monkeypatch.setattr("bayescal.public.budgets.stated", lambda run: (arm, None, 0))
    monkeypatch.setattr("bayescal.public.budgets.read_entries", lambda path: None)
    works = {"certificate": "public.budgets.dcc", "compensate": "compensating.compensate_file"}
    for work, place in works.items():
        monkeypatch.setattr(f"bayescal.{place}", lambda *_, work=work, **__: done.append(work) or "")
    with pytest.raises(BayescalError) as refused:
        USES[name]()
    assert all(reason in str(refused.value) for reason in use.against)
    assert not done
    assert USES[name](force=True) is not None
    assert done == [name] or name == "export"
