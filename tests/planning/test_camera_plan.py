"""Plans of images: the board in view, by a projection of its own; better than random images."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from camera_sessions import BOARD, CENTRE, FOCAL, SIZE, camera_session
from cases import refused

import bayescal as bc
from analysis.planning.ways import against
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.shapes import HalfSpace
from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import PlanSettings, write_dataset
from bayescal.dataset.cameras import PIXEL
from bayescal.errors import BayescalError
from bayescal.planning.candidates import Possible, candidates, session_of, usual_count
from bayescal.planning.exchange import select
from bayescal.planning.goals import goals
from bayescal.planning.order import Transits, ordered
from bayescal.planning.plan import PlanOptions, plan
from bayescal.planning.pool import condensed, linearised
from bayescal.planning.result import Random
from bayescal.planning.setup import continued
from bayescal.preparing.practice import practice
from bayescal.probing.clearance import Clearance
from bayescal.probing.scene import Solid, held_by
from bayescal.probing.sweep import signed_distances
from bayescal.public.planning import PlanResult
from bayescal.reporting.page.plan import table_of_plan
from bayescal.reporting.plan_sheets import title
from bayescal.simulation import Options

STEEPEST = 50.0


@cache
def setup(mount="flange"):
    return continued(camera_session(mount, images=6, velocity=False))


@cache
def pool(mount="flange"):
    return candidates(setup(mount), 264)


def pose(rpy, xyz):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rpy_matrix(rpy), xyz
    return out


@pytest.mark.parametrize(("stated", "expected"), [(0.3, 0.45), (None, 1.5 * PIXEL)])
def test_the_noise_that_was_found_is_that_which_is_stated_or_assumed_times_its_scale(stated, expected):
    found = replace(setup(), noise_scale={"pixel": 1.5})
    noise = replace(found.dataset.noise, pixel=stated)
    table = replace(found.dataset.measurements, u=np.full(len(found.dataset.measurements.ids), 0.2))
    there = replace(found, dataset=replace(found.dataset, noise=noise, measurements=table)).at_its_noise
    assert there.noise == replace(noise, pixel=pytest.approx(expected))
    assert np.allclose(there.measurements.u, 0.3)


@pytest.mark.parametrize("mount", ["flange", "fixed"])
def test_board_in_view(mount):
    some = pool(mount)
    m, d = some.session.measurements, some.session
    robot, tool, values = d.robot, d.tools[0], d.targets[0].values
    assert len(some.candidates) > 40
    rows = some.candidates
    held = frames(chain_of(robot), link_angles(robot, m.readings[rows]))[:, -1] @ pose(tool.rpy, tool.centre)
    fixed = pose(values["rpy"], values["xyz"])
    seen = np.linalg.inv(held) @ fixed if mount == "flange" else np.linalg.inv(fixed) @ held
    at = np.einsum("nij,kj->nki", seen[:, :3, :3], BOARD) + seen[:, None, :3, 3]
    uv = at[..., :2] / at[..., 2:] * FOCAL + CENTRE
    assert np.all((uv > 0.04 * SIZE) & (uv < 0.96 * SIZE))
    assert np.all(at[..., 2] > 0)
    middle = at.mean(axis=1)
    angle = np.degrees(np.arccos(np.sum(seen[:, :3, 2] * middle, axis=1) / np.linalg.norm(middle, axis=1)))
    assert angle.max() < STEEPEST + 0.1
    assert angle.max() > 40
    # both signs of the tilt about both axes of the board (the reach of the arm favours some), and all rolls
    across = np.einsum("nji,nj->ni", seen[:, :3, :3], -middle)[:, :2]
    for k in range(2):
        assert 0.03 < np.mean(across[:, k] > 0) < 0.97
    roll = np.arctan2(seen[:, 1, 0], seen[:, 0, 0])
    assert np.abs(np.exp(1j * roll).mean()) < 0.6
    low, high = robot.limits.T
    assert np.all((m.readings[rows] > low) & (m.readings[rows] < high))


def test_image_is_a_candidate():
    some, count = pool(), len(BOARD)
    new = np.arange(some.measured, len(some.session.measurements.ids))
    assert len(new) == count * len(some.candidates)
    assert np.array_equal(some.numbers(new), np.repeat(np.arange(len(some.candidates)), count))
    assert np.array_equal(some.rows_of([1]), some.candidates[1] + np.arange(count))
    assert np.all(some.numbers(np.arange(some.measured)) == -1)


def test_condensed_has_the_same_information():
    rows, number = np.random.default_rng(0).normal(size=(31, 9)), np.repeat([0, 1, 2], [20, 1, 10])
    fewer, of = condensed(rows, number)
    assert np.array_equal(np.bincount(of), [9, 1, 9])
    for k in range(3):
        a, b = rows[number == k], fewer[of == k]
        np.testing.assert_allclose(a.T @ a, b.T @ b, atol=1e-9)


def test_better_than_random():
    some = pool()
    linear = linearised(some, ("geometry",))
    at = [k for k, p in enumerate(linear.model.parameters) if p.name.startswith("on-flange")]
    assert len(at) == 6
    chosen = select(linear, goals(some, linear), 10, np.random.default_rng(0), starts=1)

    def u(images):
        return np.sqrt(np.diag(linear.covariance(images)))[at]

    by_chance = np.median([u(s) for s in Random(some).selections(10, 15)], axis=0)
    assert np.exp(np.mean(np.log(u(chosen) / by_chance))) < 0.9


def test_plan_has_a_row_for_each_image():
    options = PlanOptions(contacts=8, aim="distances", effects=("geometry",), candidates=120)
    made = plan(setup(), options)
    lines = table_of_plan(made).splitlines()
    assert len(lines) == 9
    assert "u_px" not in lines[0]
    assert "j6_deg" in lines[0]
    assert len(made.approach) == len(made.purpose) == 8
    assert title(made).startswith("plan of 8 images for distances")
    assert usual_count(setup()) == 33
    said = " ".join(str(PlanResult(made)).split())
    assert "distances in the region of the poses" in said
    assert "20 images more: U = " in said
    assert "contacts" not in said.partition("detectable")[0]


def test_refusals():
    d = setup().dataset
    values = dict(d.targets[0].values) | {"xyz": np.full(3, np.nan)}
    with pytest.raises(BayescalError, match="where the board of `cam` is cannot be told"):
        continued(replace(d, targets=(replace(d.targets[0], values=values),)))
    refused("images cannot be simulated", lambda: practice(setup(), Options()))


def test_a_folder_of_images_is_continued(tmp_path):
    cell, few = tmp_path / "cell", {"contacts": 3, "candidates": 60, "purpose": "distances"}
    write_dataset(camera_session(images=6, placed=False, velocity=False), cell)
    assert len(bc.plan(cell, after=cell, **few).contacts) == 3
    refused("where the board of `cam` is cannot be told", lambda: bc.plan(cell, **few))


def test_capsules_contain_the_carried_board():
    d = setup("fixed").dataset
    held = held_by(d, 0)
    rng = np.random.default_rng(0)
    low, high = BOARD.min(axis=0), BOARD.max(axis=0)
    points = rng.uniform(low, high, (4000, 3))
    assert np.min([signed_distances(c, points) for c in held], axis=0).max() <= 1e-9
    # and little more: a square and the thickness of the plate around it, and the radius
    beyond = 0.05 + max(c.radius for c in held)
    off = rng.uniform(low - 0.3, high + 0.3, (4000, 3))
    away = np.linalg.norm(np.maximum(np.maximum(low - off, off - high), 0.0), axis=1)
    assert np.all(np.min([signed_distances(c, off[away > beyond]) for c in held], axis=0) > 0)
    (camera,) = held_by(setup("flange").dataset, 0)
    assert camera.radius == 0.04
    # By a check of its own: where corners of the board are below the table, and nothing else is
    table = [Solid("table", (HalfSpace(np.array([0.0, 0.0, 1.0]), 0.0),), carries=True)]
    bare = Clearance.of(d.robot, d.tools[0], table)
    whole = Clearance.of(d.robot, d.tools[0], table, held=held_by(d, 0))
    low, high = d.robot.limits.T
    readings = np.random.default_rng(0).uniform(low, high, (3000, d.robot.n))
    dips = np.min(board_corners(d, readings)[..., 2], axis=1) < 0.0
    unseen = readings[dips & (bare.collides(readings) == 0)]
    assert len(unseen) > 20
    assert np.all(whole.collides(unseen) > 0)


def test_a_plan_keeps_the_carried_board_above_the_table():
    d = setup("fixed").dataset
    height = 0.02 + float(np.min(board_corners(d, d.measurements.readings)[..., 2]))
    given = continued(replace(d, plan=PlanSettings(table=height)))
    made = plan(given, PlanOptions(contacts=5, aim="distances", effects=("geometry",), candidates=120))
    assert np.min(board_corners(d, made.session.measurements.readings)[..., 2]) > height


def board_corners(d, readings):
    """Corners of the carried board in F0, (N, K, 3), m."""
    tool = d.tools[0]
    at = frames(chain_of(d.robot), link_angles(d.robot, readings))[:, -1] @ pose(tool.rpy, tool.centre)
    return np.einsum("nij,kj->nki", at[:, :3, :3], BOARD) + at[:, None, :3, 3]


@pytest.mark.parametrize("mount", ["flange", "fixed"])
def test_motions_between_images_are_free_by_fine_sampling(mount):
    some, rng = pool(mount), np.random.default_rng(0)
    moves, drawn = Transits(some), rng.permutation(some.candidates)[:6]
    rows = drawn[ordered(some, drawn, "sweeps", rng, moves.blocked)]
    found = against(some, rows, moves.ways(rows))
    assert found["motions"] >= 5
    assert found["nearest_mm"] > 5.0
    assert found["overstated_mm"] < 0.1


@pytest.mark.parametrize("velocity", [False, True])
def test_corners_of_an_image_are_of_one_stop(velocity):
    """Of images that are possible, behind measured rows with velocities or without."""
    d = camera_session("flange", images=6, velocity=velocity)
    points, rng = np.array([4, 2, 4]), np.random.default_rng(0)
    readings = d.measurements.readings[:1] + 0.1 * rng.standard_normal((3, 6))
    target = np.zeros(3, int)
    speeds = rng.standard_normal((3, 6))
    possible = Possible(np.full(3, "calibrate"), target, target, readings, speeds, np.zeros(3), points)
    made = session_of(d, possible, rng).measurements
    new = slice(len(d.measurements.ids), None)
    stop, of = made.stop[new], np.repeat(np.arange(3), points)
    assert "" not in stop
    assert len({*stop}) == len({*zip(stop, of, strict=True)}) == 3
    assert (made.velocity is not None) == velocity
    if velocity:
        assert made.velocity[new] == pytest.approx(possible.velocity[of])
