"""The notebooks run from top to bottom and draw what they promise."""

import runpy
from pathlib import Path

import numpy as np
import pytest

matplotlib = pytest.importorskip("matplotlib")
ROOT = Path(__file__).parents[2]
FIGURES = {"first_fit": 3, "first_gap": 3, "first_plan": 3}


@pytest.fixture
def pyplot(monkeypatch):
    """A clean pyplot that draws into memory."""
    matplotlib.use("Agg", force=True)
    from matplotlib import pyplot as plt

    plt.close("all")
    monkeypatch.setattr(plt, "show", lambda *_: None)
    yield plt
    plt.close("all")


@pytest.mark.parametrize("path", sorted((ROOT / "analysis" / "notebooks").glob("*.py")), ids=lambda p: p.stem)
def test_notebook(path, pyplot, monkeypatch, capsys):
    monkeypatch.chdir(path.parent)  # where a notebook's kernel starts
    monkeypatch.setenv("BAYESCAL_NOTEBOOK_SAMPLES", "500")
    monkeypatch.setenv("BAYESCAL_NOTEBOOK_CANDIDATES", "250")
    left = runpy.run_path(str(path))
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    assert len(figures) == FIGURES[path.stem]
    for figure in figures:
        figure.canvas.draw()
        drawn = [axes for axes in figure.axes if axes.has_data()]
        assert drawn
        assert any(axes.get_ylabel() for axes in drawn)
    CHECKS[path.stem](left, capsys.readouterr().out)


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


def planned(left, said):
    """A certified distance matters most, chosen contacts beat random ones, and `both` shows more."""
    by_faces = left["by_faces"]
    pair = {"cube.+y", "cube.-y"}
    assert max(u for some, u in by_faces.items() if pair <= set(some)) < 0.5 * min(
        u for some, u in by_faces.items() if not pair <= set(some)
    )
    for chosen, chance in left["every"].values():
        assert np.all(np.less(chosen, chance))
    assert left["shown"] < 1.0 < left["cost"]


CHECKS = {"first_fit": fitted, "first_gap": diagnosed, "first_plan": planned}
