"""The notebooks run from top to bottom and draw what they promise."""

import ast
import inspect
import runpy
from dataclasses import replace
from types import ModuleType

import matplotlib
import numpy as np
import pytest
from cases import ROOT
from foreign import needs

from bayescal.motion import calibrate, possible
from bayescal.planning.candidates import candidates

FIGURES = dict.fromkeys(("first_fit", "first_gap", "first_plan"), 3) | {"correlations": 2, "first_log": 2}
FIGURES |= dict.fromkeys(("own_effect", "published_arm", "real_arm"), 1)


@pytest.fixture
def pyplot(monkeypatch):
    """A clean pyplot that draws into memory."""
    matplotlib.use("Agg", force=True)
    from matplotlib import pyplot as plt

    plt.close("all")
    monkeypatch.setattr(plt, "show", lambda *_: None)
    yield plt
    plt.close("all")


@pytest.fixture(autouse=True)
def small_plans(quick_search, monkeypatch):
    """Plans of as many candidates share them; draws of a log take few steps."""
    few = replace(possible.CALIBRATION, steps=10_000, burned=1_000)
    for module in (calibrate, possible):
        monkeypatch.setattr(module, "CALIBRATION", few)
    monkeypatch.setattr("bayescal.planning.search.EACH", 4)  # contacts that validate, of each sphere
    made = {}

    def once(setup, count, *more):
        count = min(count, 220)
        if count not in made:
            made[count] = candidates(setup, count, *more)
        return made[count]

    monkeypatch.setattr("bayescal.planning.plan.candidates", once)


LONG = {"correct_targets", "correlations", "first_fit", "first_gap", "first_log", "first_plan", "lost_motion"}
LONG |= {"own_effect", "plan", "published_arm", "real_arm", "sessions"}
"""They take two seconds or more, of what other tests hold: `make notebooks` runs them."""


def paths(*folders: str, every: bool = False):
    """Each notebook or example, as a parameter with its marks."""
    for path in sorted(p for folder in folders for p in (ROOT / "analysis" / folder).glob("*.py")):
        marks = [] if every or path.stem not in LONG else [pytest.mark.notebook]
        yield pytest.param(path, id=path.stem, marks=marks + [needs()] * (path.stem == "real_arm"))


@pytest.mark.parametrize("path", [*paths("notebooks", "examples", every=True)])
def test_what_it_calls_exists(path):
    """Imports, names of what is imported, and keywords of its functions."""
    tree, names = ast.parse(path.read_text(encoding="utf-8")), {}

    def value(node):
        if isinstance(node, ast.Name):
            return names.get(node.id)
        of = value(node.value) if isinstance(node, ast.Attribute) else None
        return getattr(of, node.attr) if isinstance(of, ModuleType | type) else None

    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            exec(compile(ast.Module([node], []), path, "exec"), names)
    calls = [(value(c.func), c.keywords) for c in ast.walk(tree) if isinstance(c, ast.Call)]
    assert any(inspect.isroutine(function) for function, _ in calls)
    for function, keywords in calls:
        if inspect.isfunction(function):
            known = inspect.signature(function).parameters
            every = any(p.kind is p.VAR_KEYWORD for p in known.values())
            assert every or {k.arg for k in keywords if k.arg} <= set(known), function


@pytest.mark.parametrize("path", [*paths("notebooks")])
def test_notebook(path, pyplot, monkeypatch, capsys):
    monkeypatch.chdir(path.parent)  # where a notebook's kernel starts
    for name, value in {"SAMPLES": 250, "CONTACTS": 120, "CANDIDATES": 220, "ARMS": 1, "MOTIONS": 4}.items():
        monkeypatch.setenv(f"BAYESCAL_NOTEBOOK_{name}", str(value))
    left = runpy.run_path(str(path))
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    assert len(figures) == FIGURES[path.stem]
    for figure in figures:
        figure.canvas.draw()
        drawn = [axes for axes in figure.axes if axes.has_data()]
        assert drawn
        assert any(axes.get_ylabel() for axes in drawn)
    CHECKS[path.stem](left, capsys.readouterr().out)


@pytest.mark.parametrize("path", [*paths("examples")])
def test_example(path, pyplot, monkeypatch):
    """Every example of the gallery has one figure, with a label of its values."""
    monkeypatch.chdir(path.parent)
    runpy.run_path(str(path))
    (number,) = pyplot.get_fignums()
    assert any(axes.has_data() and axes.get_xlabel() for axes in pyplot.figure(number).axes)


def fitted(left, said):
    assert "compliance_J2" in said
    assert "only the combination d2 + d3 is identifiable" in said
    errors = left["errors"]
    assert (
        errors["geometry + compliance"].max() < 0.1 * errors["geometry"].max() < 0.1 * errors["nominal"].max()
    )
    assert left["inside"].mean() > 0.7


def diagnosed(left, said):
    """What was hidden is found, at a joint that has it, and the distances are the better for it."""
    assert left["named"] == {left["HIDDEN"]}
    assert left["first"].driver.kind == "direction"
    assert f"90 % set: {left['HIDDEN']}" in said
    distances = next(s for s in left["gap"].shrinkage if s.what == "distances")
    assert distances.after < 0.5 * distances.before


def logged(left, said):
    """What was hidden is named, at its joint, and the withheld torque error there shrinks."""
    truth = left["made"].truth
    assert set(left["gap"].effects) == set(truth["effects"])
    assert left["gap"].amplitudes.iloc[0].site == truth["where"][0]["site"]
    joint = int(truth["where"][0]["site"].removeprefix("joint ")) - 1
    s = left["shrinkage"]
    assert s.after_rms_Nm.iloc[joint] < 0.97 * s.before_rms_Nm.iloc[joint]
    assert len(left["planned"].motions) > 1
    assert "larger than expected" in said


def planned(left, said):
    """A certified distance matters most, chosen contacts beat random ones, and `both` shows more."""
    by_faces = left["by_faces"]
    pair = {"cube.+y", "cube.-y"}
    with_pair, without = (
        [u for some, u in by_faces.items() if (pair <= set(some)) == held] for held in (True, False)
    )
    assert max(with_pair) < 0.8 * min(without)
    for chosen, chance in left["every"].values():
        assert np.all(np.less(chosen, chance))
    assert left["shown"] < 1.0 < left["cost"]


def correlated(left, said):
    """The sum of two parameters is known far better than each, and correlations matter for a point."""
    assert np.std(left["total"]) < 0.05 * np.std(left["draws"]["d2"])
    assert left["pairs"][0][1:] == ("d3", "d2")
    assert left["factor"] > 2.0
    assert max(map(abs, left["moved"].values())) > 10.0


def registered(left, said):
    """The effect reduces the validation errors, is estimated within its uncertainty, and leaves no trace."""
    assert left["rms"]["with"] < 0.8 * left["rms"]["without"]
    assert all(abs(value) < 3.5 for value in left["score"].values())
    assert "cable" not in left["bc"].effects.names()


def published(left, said):
    """Errors of the model only: a hundredth of a millimetre; with further errors: the published size."""
    own, further = (levels["geometry + compliance"] for levels in left["groups"].values())
    assert np.max(own) < 0.05
    assert 0.1 < np.median(further) < 0.6
    assert "published 0.274" in said


def measured(left, said):
    """Each model level reduces the mean error of validation points, down to that of the session's README."""
    mean = {name: np.mean(errors) for name, errors in left["errors"].items()}
    assert mean["nominal"] > mean["joint offsets"] > mean["geometry"]
    assert mean["geometry + compliance"] < 0.36
    assert "model does not explain the machine" in said


CHECKS = {
    "correlations": correlated,
    "first_fit": fitted,
    "first_gap": diagnosed,
    "first_log": logged,
    "first_plan": planned,
    "own_effect": registered,
    "published_arm": published,
    "real_arm": measured,
}
