"""Errors of a lens and of the clock of images that no effect of the list has, by other formulas."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import BOARD, CENTRE, FIXED, FOCAL, ON_FLANGE, SIZE, camera_session
from gap_problems import Bench

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.effects.location import CAMERA, TOOL, Driver
from bayescal.estimate.scatter import Scatter
from bayescal.gap import examine as examination
from bayescal.gap.outcome.where import beside
from bayescal.gap.search.beam import Member, Search
from bayescal.gap.search.makers import movers
from bayescal.model import USUAL
from bayescal.reporting.gap.causes import cause

NOISE = 0.2  # px


@pytest.fixture(scope="module")
def session():
    return camera_session(images=20, seed=3, noise=NOISE)


@pytest.fixture(scope="module")
def bench(session):
    return Bench.of(session)


def seen(session, readings):
    """Pixels of every row at other readings, by the drawing."""
    robot, m = session.robot, session.measurements
    camera = frames(chain_of(robot), link_angles(robot, readings))[:, -1] @ ON_FLANGE
    at = np.linalg.inv(camera) @ FIXED["flange"]
    points = np.einsum("nij,nj->ni", at[:, :3, :3], BOARD[m.pixel[:, 2].astype(int)]) + at[:, :3, 3]
    return points[:, :2] / points[:, 2:] * FOCAL + CENTRE


def refocused(session):
    """A focus that settles within the first images: all corners move from the middle of the image."""
    image = np.arange(len(session.measurements.ids)) // len(BOARD)
    return 2e-3 * np.exp(-image / 4)[:, None] * (session.measurements.pixel[:, :2] - CENTRE)


def rolling(session):
    """Lower rows of an image are read later, by 2 ms over its height."""
    m = session.measurements
    late = 2e-3 * (m.pixel[:, 1:2] - CENTRE[1]) / SIZE[1]
    return seen(session, m.readings + late * m.velocity) - seen(session, m.readings)


def rippled(session):
    """A distortion that no model of a lens has: a wave over the width of the image."""
    u = session.measurements.pixel[:, 0]
    return np.column_stack([np.zeros_like(u), 0.5 * np.cos(2 * np.pi * u / SIZE[0])])


def test_noise_of_images_is_no_effect(bench):
    assert bench.decision(5).kind == "null"


@pytest.mark.parametrize(("moved", "driver"), [(refocused, "time"), (rolling, "clock"), (rippled, "image")])
def test_what_a_lens_or_its_clock_does_is_unmodelled_at_the_camera(session, bench, moved, driver):
    p = bench.problem
    row = p.rows[p.contact[: p.count]]
    axis = np.arange(p.count) // len(session.measurements.ids)  # all u before all v
    contribution = np.zeros(len(p.residual))
    contribution[: p.count] = moved(session)[row, axis] / NOISE
    decision = bench.decision(5, contribution)
    assert decision.kind in ("unknown", "named+unexplained")
    assert decision.probability["unknown"] > 0.9
    first = bench.places(decision)[0]
    assert (first.site, first.driver.kind) == (CAMERA, driver)
    assert cause(first) is not None


def test_a_lens_is_a_site_of_sessions_with_a_camera_alone(session, bench, cube):
    assert CAMERA in movers(bench.circumstances)
    assert {cell.site for cell in bench.pool.cells} > {CAMERA, TOOL}
    assert Driver("clock", form="and another") in {cell.driver for cell in bench.pool.cells}
    assert CAMERA not in movers(Bench.of(cube().dataset).circumstances)


@pytest.mark.parametrize(("number", "sites"), [(2, ()), (5, (TOOL,)), (6, (TOOL,))])
def test_a_tool_yields_to_gravity_as_the_last_links_do(bench, number, sites):
    """A mount could not do what a bent link 2 does; all that a bent link 6 does."""
    (variant,) = (v for v in bench.known.variants["bending"] if v.site == f"link {number}")
    there = bench.visible(bench.problem.pool[:, variant.columns], 200.0, seed=number)
    member = Member(variant, 1.0, 0.0)
    h = Search(bench.made_up(7, there), bench.known).hypothesis([member])
    assert beside(member, h, bench.known.pool, bench.circumstances, bench.slopes) == sites


@pytest.mark.parametrize(
    ("kind", "nats", "weighed", "used"),
    [
        ("null", 9.0, "null", "weighed"), ("null", 9.0, "unknown", "plain"), ("named", 90.0, "null", "plain"),
        ("unknown", 9.0, "null", "plain"), ("unknown", 11.0, "null", "weighed"),
        ("unknown", 11.0, "unknown", "weighed"), ("unknown", 4.0, "null", "plain"),
    ],
)  # fmt: skip
def test_errors_of_images_stand_in_the_place_of_what_they_explain_better(
    kind, nats, weighed, used, monkeypatch
):
    @dataclass(frozen=True)
    class Examined:
        name: str
        decision: SimpleNamespace
        scatter: Scatter | None = None

    best = (SimpleNamespace(log_evidence=10.0),)
    of = {
        name: Examined(name, SimpleNamespace(kind=k, weighed=best))
        for name, k in (("plain", kind), ("weighed", weighed))
    }
    found = Scatter(1e-4, 0.0, nats)

    def scattered(*_, prior_only=False):
        return None, "plain" if prior_only else "weighed", found

    monkeypatch.setattr(examination, "scattered", scattered)
    monkeypatch.setattr(examination, "_of_baseline", lambda base, further: of[base])
    answer = examination.examine(None, ("geometry",), USUAL)
    assert answer.name == used
    assert answer.scatter == (found if used == "weighed" or (kind == "null" and nats > 5.0) else None)
