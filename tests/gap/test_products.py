"""Cells of two quantities and of earlier contacts, their prior, and rows that do not count."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_problems import bench_of
from sessions import with_columns

from bayescal.arm.motion import CONTACT
from bayescal.assess.shared_causes import Completed
from bayescal.effects.common import tilts
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, joint, link
from bayescal.estimate import calibrated
from bayescal.gap import examine
from bayescal.gap.outcome.events import _between
from bayescal.gap.result import Event
from bayescal.gap.settings import CELLS, UNKNOWN
from bayescal.model import USUAL
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import LEFT_OUT, validation_errors
from bayescal.predict.errors import without_rows


@pytest.fixture(scope="module")
def dataset(cube):
    return cube(seed=7, count=180).dataset


@pytest.fixture(scope="module")
def bench(cube):
    return bench_of(cube, 7, 180)


def test_a_quantity_of_a_joint_is_multiplied_by_any_other(bench):
    """Errors that are written down here, of a speed or direction and of another quantity."""
    c = bench.circumstances
    fitted = c.fitted
    low, span = c.readings[fitted].min(axis=0), np.ptp(c.readings[fitted], axis=0)
    angle = np.clip((c.readings - low) / span, 0.0, 1.0)
    speed = c.velocity[:, 2]
    way = speed / np.hypot(speed, np.radians(0.03))
    tired = way * (1.0 + 0.5 * np.cos(2 * np.pi * angle[:, 4]))
    lag = speed * (0.2 + np.cos(np.pi * angle[:, 0]))
    by_way, by_speed = (Driver(kind, 3, form="and another") for kind in ("direction", "joint speed"))
    assert bench.left_by(joint(3), by_way, "rz", tired) < 1e-6
    assert bench.left_by(joint(3), by_speed, "rz", lag) < 1e-6
    assert bench.left_by(joint(3), by_speed, "rz", tired) > 1e-2
    assert bench.left_by(link(2), Driver("angle", 1), "ry", np.cos(np.pi * angle[:, 0])) < 1e-6


def test_a_base_stays_where_its_clearance_lets_it(bench):
    """Its position within the clearance follows the moment only at its ends."""
    c = bench.circumstances
    (by, *_) = tilts(c)
    width = CELLS.clearance[2] * np.std(by.moment[c.fitted])
    order = np.arange(len(c.q)) if c.time is None else np.argsort(c.time, kind="stable")
    place, state = np.zeros(len(order)), 0.0
    last = by.moment[order[0]]
    for row in order:
        state = float(np.clip(state + 2 * (by.moment[row] - last) / width, -1.0, 1.0))
        place[row], last = state, by.moment[row]
    axis = "rx" if abs(by.axis[0]) > 0.5 else "ry"
    assert bench.left_by(BASE, Driver("base moment", form="past"), axis, place) < 1e-6


def test_a_contact_pushes_the_tool_aside_for_the_next_ones(bench):
    c = bench.circumstances
    order = np.arange(len(c.q)) if c.time is None else np.argsort(c.time, kind="stable")
    aside, state = np.zeros(len(order)), 0.0
    for row in order:
        aside[row] = state
        state = CELLS.kept[1] * state + np.nan_to_num(c.approach)[row, 0]
    assert bench.left_by(TOOL, Driver("contact direction", form="past"), "tx", aside) < 1e-9


def test_a_trigger_that_hangs_errs_by_contact_direction_and_gravity(bench):
    cell = bench.pool.cells[bench.number(PROBE, Driver("contact direction", form="and another"))]
    assert {t.frame for own in cell.sets for q in own for t in q.terms} == {CONTACT}


def test_a_kind_of_site_keeps_its_prior_whatever_its_cells_weigh(bench):
    prior = np.exp(bench.pool.log_prior)
    kinds = np.array([q.site.kind for q in bench.pool.cells])
    whole = [q.site == joint(1) and q.weight >= 1 and not q.of_known_effect for q in bench.pool.cells]
    of_joints = prior[np.array(whole)]
    assert np.max(of_joints) == pytest.approx(CELLS.paired * np.min(of_joints))
    ratio = np.sum(prior[kinds == "link"]) / np.sum(prior[kinds == "probe"])
    known = [q.of_known_effect for q in bench.pool.cells if q.site.kind in ("link", "probe")]
    assert not any(known)
    assert ratio == pytest.approx(UNKNOWN.sites["link"] / UNKNOWN.sites["probe"])


@pytest.mark.parametrize(
    ("interval", "rows"), [((5, 5), [3, 4]), ((5, 9), [3, 4, 5, 6, 7, 8]), ((2, 2), []), ((0, 0), [])]
)
def test_rows_between_fitted_ones_may_be_before_an_event_or_after_it(interval, rows):
    fitted = np.array([0, 1, 2, 5, 9])
    assert list(_between(Event(interval[0], interval), fitted)) == rows


def test_rows_that_are_not_scored_leave_the_others_as_they_are(dataset):
    every = validation_errors(calibrated(Scene(dataset), ("geometry",), USUAL), without=LEFT_OUT)
    some = without_rows(every, [int(every.rows[0]), 10**6])
    assert len(some.residual) == len(every.residual) - np.sum(every.rows == every.rows[0])
    assert np.array_equal(some.residual, every.residual[every.rows != every.rows[0]])
    assert len(some.by_parameters) == len(some.noise) == len(some.block) == len(some.rows)
    assert without_rows(every, []) is every


@pytest.mark.parametrize(
    ("causes", "kinds", "which", "calls"),
    [(("c",), ("null", "unknown"), 1, 2), (("c",), ("null", "null"), 0, 2),
     (("c",), ("class",), 0, 1), ((), ("null",), 0, 1)],
)  # fmt: skip
def test_outliers_that_nothing_explains_are_left_out_after_all(monkeypatch, causes, kinds, which, calls):
    """Where that shows an unmodelled effect: a few true outliers may share a cause by chance."""
    nothing = dict.fromkeys(("fitted", "circumstances", "candidates", "slopes", "problem", "pool", "search"))
    found = [examine.Examined(**nothing, decision=SimpleNamespace(kind=k)) for k in kinds]
    asked = []

    def examined(fitted, of, options, further):
        asked.append((fitted, of))
        return found[len(asked) - 1]

    plain, every = (SimpleNamespace(model=SimpleNamespace(effects=("geometry",))) for _ in range(2))
    monkeypatch.setattr(examine, "completed", lambda *_: Completed(every, (), causes))
    monkeypatch.setattr(examine, "_examined", examined)
    result = examine._of_baseline((plain, replace(USUAL, robust=True), ("told",)), False)
    assert (result.decision, result.widths) == (found[which].decision, ("told",))
    assert asked == [(every, causes), (plain, ())][:calls]


def test_repeated_contacts_of_a_surface_are_independent(dataset, monkeypatch):
    """What they share is lack of fit, which has a cell."""
    seen = []

    def variance(_, gradient, poses):
        seen.append(poses)
        raise RuntimeError("enough")

    rows = np.arange(len(dataset.measurements.ids)) // 3
    monkeypatch.setattr(examine, "shared_variance", variance)
    with pytest.raises(RuntimeError, match="enough"):
        examine.examine(Scene(with_columns(dataset, stop=rows)), ("geometry",), replace(USUAL, robust=False))
    assert len(np.unique(seen[0])) == len(seen[0])
