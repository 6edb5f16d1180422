"""Planned motions by a sampling of 0.05 degrees that shares no code with the check; own solids."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from analysis.planning import ways as study
from analysis.planning.sampled import Cell, Table
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import read_dataset
from bayescal.dataset.read import read_settings
from bayescal.dataset.solids import hull_stl
from bayescal.dataset.write import write_dataset
from bayescal.errors import BayescalError
from bayescal.planning.place import scene
from bayescal.planning.setup import continued, read_setup
from bayescal.probing.clearance import Clearance
from bayescal.probing.scene import Solid
from bayescal.probing.shapes import Box, Cylinder, Hull
from bayescal.probing.sweep import distances

EXAMPLE = Path(__file__).parents[2] / "data" / "lrmate200ic-cube"
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def test_sampled_motions_are_as_free_as_stated(monkeypatch):
    """Spheres that are moved on the way; two probes would take twice the time."""
    monkeypatch.setattr(study, "CONTACTS", 5)
    monkeypatch.setattr(study, "CANDIDATES", 16)
    found = study.checked(13)
    assert found["motions"] > 9
    assert found["by_hand"] == 0
    assert found["nearest_mm"] > 1.9
    assert found["overstated_mm"] < 1e3 * study.ROUNDING


def test_bounds_hold_on_random_motions():
    """Free by the bound: nothing nearer in the samples. Not free: something nearer than a little more."""
    setup = study.setup_of(0)
    cell, solids = study.cell_of(setup, 0, "1"), scene(setup).solids
    there = [replace(s, placement="", shapes=s.shapes if s.placement in ("", "1") else ()) for s in solids]
    check = Clearance.of(setup.dataset.robot, setup.dataset.tools[0], there)
    rng = np.random.default_rng(1)
    limits = setup.dataset.robot.limits
    begin = check.arm.readings_of(rng.uniform(*(0.7 * limits.T), (400, 6)))
    begin = begin[check.distances(begin) > 0.005]
    end = begin + rng.normal(0, 0.8, begin.shape)
    floor, number = 0.005, 40
    free = check.hits(begin, end, floor) == 0
    bound = check.closest(begin, end, 1e-3)
    sampled = np.array([cell.motion(a, b) for a, b in zip(begin[:number], end[:number], strict=True)])
    free, bound = free[:number], bound[:number]
    assert 5 < free.sum() < number - 5
    assert sampled[free].min() > floor - 1e-6
    assert sampled[~free].max() < floor + 1e-3
    near = sampled < 0.05  # the sampler does not look farther
    assert np.all(bound[near] <= sampled[near] + 1e-6)
    assert np.all(sampled[near] - bound[near] < np.maximum(1.2e-3, 0.12 * np.abs(sampled[near])))


def test_solids_by_their_points():
    """Cylinder and hull against points inside and on them; the hull of a box is the box."""
    rng = np.random.default_rng(0)
    turn = rpy_matrix(rng.uniform(-3, 3, 3))
    box = Box(rigid(turn, np.array([0.1, 0.2, 0.3])), np.array([0.2, 0.1, 0.05]))
    hull = Hull((CORNERS * box.half) @ turn.T + box.pose[:3, 3])
    a, b = rng.uniform(-1, 1, (2, 200, 3))
    far, near = distances(box, a, b), distances(hull, a, b)
    assert np.all(near <= far + 1e-6)
    assert np.all(near[far > 0] > 0.85 * far[far > 0] - 1e-6)
    assert np.array_equal(near < 0, far < 0)
    axis = turn[:, 2]
    rod = Cylinder(np.array([0.1, 0.2, 0.3]), axis, 0.3, 0.1)
    angle, high = rng.uniform(0, 2 * np.pi, 40_000), rng.uniform(-0.3, 0.3, 40_000)
    size = 0.1 * np.sqrt(rng.uniform(0, 1, 40_000))
    inside = rod.centre + np.stack([size * np.cos(angle), size * np.sin(angle), high], axis=1) @ turn.T
    assert rod.distance(inside).max() < 1e-12
    for start in a[:20]:
        cloud = np.linalg.norm(inside - start, axis=1).min()
        assert distances(rod, start[None], start[None])[0] == pytest.approx(cloud, abs=0.02)
    assert rod.lowest(axis) == pytest.approx(rod.centre @ axis - 0.3)
    assert hull.lowest(axis) == pytest.approx(box.lowest(axis))


def stated(tmp_path, text):
    """The example's set-up with own solids."""
    lines = (EXAMPLE / "dataset.yaml").read_text().replace("temperature_of: arm\n", text)
    (tmp_path / "dataset.yaml").write_text(lines)
    return read_settings(tmp_path / "dataset.yaml")[0]


def test_own_solids_are_read_written_and_avoided(tmp_path):
    mesh = hull_stl(0.05 * CORNERS)
    (tmp_path / "block.stl").write_bytes(mesh)
    text = (
        "solids:\n"
        "  vice: {kind: box, centre_mm: [450, 200, -40], size_mm: [120, 80, 60], rpy_deg: [0, 0, 30]}\n"
        "  post: {kind: cylinder, centre_mm: [300, -350, 100], diameter_mm: 60, length_mm: 400}\n"
        '  block: {kind: mesh, file: block.stl, xyz_mm: [400, 0, 500], placement: "2"}\n'
    )
    dataset = stated(tmp_path, text)
    assert [s.kind for s in dataset.solids] == ["box", "cylinder", "mesh"]
    np.testing.assert_allclose(np.ptp(dataset.solids[2].points, axis=0), 0.1, atol=1e-9)
    session = replace(read_dataset(EXAMPLE), solids=dataset.solids)
    write_dataset(session, tmp_path / "copy")
    again = read_dataset(tmp_path / "copy")
    for one, other in zip(dataset.solids, again.solids, strict=True):
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-9)
        np.testing.assert_allclose(one.size, other.size)
        assert (one.name, one.placement, one.file) == (other.name, other.placement, other.file)
    around = scene(continued(replace(read_setup(EXAMPLE).dataset, solids=dataset.solids)))
    assert [s.placement for s in around.solids[-3:]] == ["", "", "2"]
    hit = Clearance.of(dataset.robot, dataset.tools[0], [replace(around.solids[-1], placement="")])
    arm = hit.arm
    inside = arm.readings_of(np.random.default_rng(0).uniform(*arm.robot.limits.T, (60_000, 6)))
    deep = np.linalg.norm(arm.ball(arm.frames(inside)) - [0.4, 0, 0.5], axis=1) < 0.05
    assert deep.any()
    assert np.all(hit.collides(inside[deep]) > 0)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{kind: mesh, file: none.stl}", "there is no file none.stl"),
        ("{kind: mesh, file: ../x.stl}", "outside"),
        ("{kind: mesh, file: dataset.yaml}", "has no body"),
        ("{kind: box, centre_mm: [0, 0, 0], size_mm: [1, 1, 0]}", "size_mm"),
        (
            '{kind: box, centre_mm: [0, 0, 0], size_mm: [1, 1, 1], placement: "9"}',
            "no target has the placement `9`",
        ),
    ],
)
def test_solids_that_are_refused(entry, words, tmp_path):
    with pytest.raises(BayescalError) as error:
        stated(tmp_path, f"solids:\n  a: {entry}\n")
    assert words in str(error.value)


def test_the_sampler_sees_an_overlap():
    """A point arm of one joint that turns through a thin wall."""
    table = Table(np.array([[0.0, 0.0, 0.0, 0.0]]), "mdh", np.eye(1), np.eye(4), np.eye(4))
    tip = np.array([1.0, 0, 0])
    wall = ("box", np.eye(3), np.array([0.7, 0.7, 0.0]), np.array([0.01, 0.01, 0.5]))
    cell = Cell(table, [(1, tip, tip, 0.05, False)], [], {(0, 0)}, [[wall]])
    assert cell.motion(np.array([0.0]), np.array([1.5])) < -0.03
    assert cell.motion(np.array([0.0]), np.array([0.6])) > 0.05
    solid = Solid("wall", (Box(rigid(None, wall[2]), wall[3]),))
    assert solid.shapes[0].distance(tip) > 0.5
