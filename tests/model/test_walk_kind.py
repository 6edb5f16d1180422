"""The walk of CONTRIBUTING, 'A measurement kind': a file and a declaration; fit, gap and plan take it."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from cases import file_text, refused
from kind_sessions import MIDDLE, Piece, of_pieces
from sessions import plain

import bayescal as bc
from bayescal.calibration import fit
from bayescal.dataset import Patch, PlanSettings, Target, read_dataset, write_dataset
from bayescal.dataset.contacts import reason_against
from bayescal.dataset.read import no_rows
from bayescal.dataset.regions import Probing, face
from bayescal.dataset.target_kinds import KINDS, TargetKind, place_sd
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene
from bayescal.planning.plan import PlanOptions, plan
from bayescal.planning.setup import continued, regions_of
from bayescal.storage.files import Number, Vector

UP, HEIGHT, OFF = np.array([0.0, 0.0, 1.0]), 0.3, 2e-3
CENTRE, SIZE = np.array([0.4, 0.0, HEIGHT]), np.array([0.3, 0.4])
GAUGE = Target("gauge", "gauge", {"direction": UP, "height": HEIGHT}, 5e-3)


def region(target, session):
    """The stated rectangle: what a plane does with its `normal` and `offset`."""
    return face(replace(target, values={"normal": UP, "offset": target.values["height"]}), session)


def places(target, region, radius, count, rng):
    return region.centre + rng.uniform(-1, 1, (count, 2)) @ region.half, np.full((count, 3), np.nan)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("kind")


@pytest.fixture(scope="module")
def made_up(folder):
    """The kind, made of a file in a temporary folder and of one declaration."""
    (folder / "height_gauge.py").write_text(file_text("walks/height_gauge.txt"))
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.delitem(sys.modules, "height_gauge", raising=False)
        from height_gauge import Gauge

    return TargetKind(
        "gauge",
        "a height along a known direction",
        {"direction": Vector, "height_mm": Number},
        lambda t, seen: Gauge(
            np.asarray(t.values["direction"], float), float(t.values["height"]), np.array([place_sd(t)])
        ),
        form="plane",
        place=lambda t: t.values["height"] * np.asarray(t.values["direction"]),
        direction="direction",
        planned=Probing(region, places, sizes=("width", "height")),
    )


@pytest.fixture
def declared(made_up, monkeypatch):
    monkeypatch.setitem(KINDS, made_up.name, made_up)
    return made_up


@pytest.fixture(scope="module")
def written(made_up, cube, folder):
    """A session on a cube and of the gauge, whose height is not the nominal one: its folder, and as read."""
    true = made_up.build(replace(GAUGE, values={"direction": UP, "height": HEIGHT + OFF}), None)
    piece = Piece(GAUGE, true, count=32, held=8, about=MIDDLE)
    made = of_pieces(cube(seed=3, count=40), [piece], seed=1).dataset
    made = replace(made, plan=PlanSettings(regions={"gauge": Patch(CENTRE, SIZE)}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(KINDS, made_up.name, made_up)
        write_dataset(made, folder / "s")
        text = (folder / "s/dataset.yaml").read_text()
        assert "gauge: {kind: gauge, direction: [0, 0, 1], height_mm: 300, u_mm: 5}" in text
        assert "gauge: {centre_mm: [400, 0, 300], size_mm: [300, 400]}" in text
        return folder / "s", read_dataset(folder / "s")


@pytest.fixture
def dataset(declared, written):
    return written[1]


def test_fit_takes_it(dataset):
    final = fit(dataset, samples=0).final
    estimate, state = final.estimate, final.estimate.model.slices["gauge"]
    block = estimate.model.block_of["gauge"]
    assert abs(block.state(estimate.z[state])[0] - OFF) < 4.5 * estimate.sd[state][0] * block.sd[0]
    (check,) = (c for c in final.validation.planes if c.target == "gauge")
    assert check.residuals.size == 8
    assert np.sqrt(np.mean(check.residuals**2)) < 15e-6


@pytest.mark.parametrize(("wrong", "words"), [
    ({"height_mm: 300": "height: 300"}, "key `height` has no unit in its name; write `height_mm`"),
    ({"height_mm: 300, ": ""}, "missing `height_mm`"),
    ({"[0, 0, 1], height": "[0, 0, 2], height"}, "the direction of `gauge` has length 2, not 1"),
    ({"kind: gauge": "kind: gage"}, "unknown kind 'gage'"),
    ({"height_mm: 300": "height_mm: 900", "[400, 0, 300]": "[400, 0, 900]"},
     "all contacts of `gauge` are nominally"),
])  # fmt: skip
def test_its_mistakes_are_told_like_those_of_any_kind(declared, written, tmp_path, wrong, words):
    file = Path(copytree(written[0], tmp_path / "s")) / "dataset.yaml"
    text = file.read_text()
    for old, new in wrong.items():
        assert old in text
        text = text.replace(old, new)
    file.write_text(text)
    refused(words, lambda: read_dataset(tmp_path / "s"))


def test_without_its_declaration_it_is_unknown(written):
    refused(r"unknown kind 'gauge'.*'plane', 'sphere'", lambda: read_dataset(written[0]))


def test_gap_takes_it(dataset):
    """All errors of the arm are in the model: nothing is named."""
    assert bc.diagnose(plain(dataset)).data.verdict.kind == "null"


def test_plan_takes_it(dataset, quick_search):
    setup = continued(replace(dataset, measurements=no_rows(dataset.robot.n)))
    made = plan(setup, PlanOptions(50, "distances", candidates=80))
    session, m = made.session, made.session.measurements
    rows = np.flatnonzero(m.target == [t.name for t in session.targets].index("gauge"))
    assert len(rows) >= 5
    p = Scene(session).points[rows]
    np.testing.assert_allclose(p[:, 2], HEIGHT, atol=1e-7)
    assert np.abs((p - CENTRE)[:, :2]).max(axis=0) == pytest.approx(SIZE / 2, rel=0.5)
    assert np.all(np.abs((p - CENTRE)[:, :2]) <= SIZE / 2 + 1e-6)
    assert np.array_equal(made.approach[rows], m.readings[rows])  # nothing is touched


def test_a_plan_needs_its_places_and_its_extent(dataset, declared, monkeypatch):
    with pytest.raises(BayescalError, match=r"`gauge` can be probed is not known.*\[width, height\]"):
        regions_of(replace(dataset, plan=None, measurements=no_rows(dataset.robot.n)))
    monkeypatch.setitem(KINDS, "gauge", replace(declared, planned=None))
    refused(r"kind gauge cannot be planned.*kinds: plane, .*instrument", lambda: regions_of(dataset))


@pytest.mark.parametrize(("centre", "size", "words"), [
    (CENTRE, SIZE[:1], r"has 1 entries in `size_mm`; a gauge needs \[width, height\]"),
    (CENTRE + 0.01 * UP, SIZE, r"has its centre 10\.0 mm off the face"),
])  # fmt: skip
def test_a_wrong_region_is_refused(dataset, centre, size, words):
    assert re.search(words, "; ".join(reason_against(GAUGE, Patch(np.asarray(centre), size))))
