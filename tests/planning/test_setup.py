"""Setups of a session: regions of targets, what validates, refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayescal.dataset import Certificate, Patch, PlanSettings, Target, read_dataset
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene
from bayescal.planning.place import scene
from bayescal.planning.setup import EDGE, connected, continued, read_setup, regions_of

EXAMPLE = Path(__file__).parents[2] / "data" / "lrmate200ic-cube"
HALF = 0.1143  # m, of the cube's edge


@pytest.fixture(scope="module")
def example():
    return read_dataset(EXAMPLE)


def bare(dataset, **changes):
    """The session without rows."""
    setup = read_setup(EXAMPLE).dataset
    assert not setup.measurements.ids
    return replace(setup, **changes)


def only(dataset, *names):
    """The session without rows, with some of its targets and their certificates."""
    targets = tuple(t for t in dataset.targets if t.name in names)
    certificates = tuple(c for c in dataset.certificates if {*c.targets} <= {*names})
    return bare(dataset, targets=targets, certificates=certificates)


def test_regions_of_the_cube_are_its_faces():
    """A single face of an axis makes the cube as deep as its other edges: its centre is (450, 0, 150) mm."""
    setup = read_setup(EXAMPLE)
    for name, region in setup.regions.items():
        if not name.startswith("cube"):
            continue
        target = next(t for t in setup.dataset.targets if t.name == name)
        normal = np.asarray(target.values["normal"])
        assert np.allclose(region.centre, [0.45, 0, 0.15] + HALF * normal, atol=1e-9)
        assert np.allclose(region.half @ normal, 0)
        assert np.allclose(np.linalg.norm(region.half, axis=1), (1 - 2 * EDGE) * HALF, atol=1e-9)
        assert abs(region.half[0] @ region.half[1]) < 1e-12


def test_contacts_of_the_example_lie_in_their_regions(example):
    """An oracle of the inference: 680 contacts that were made without it."""
    points, m = Scene(example).points, example.measurements
    for k, target in enumerate(example.targets):
        if target.kind != "plane":
            continue
        region = continued(example).regions[target.name]
        away = points[m.target == k] - region.centre
        place = away @ region.half.T / np.sum(region.half**2, axis=1)
        assert np.abs(place).max() < 1.02  # the cube was out of place by some mm
        assert np.ptp(place, axis=0).min() > 1.5


def test_rows_of_a_setup_are_ignored_with_a_note():
    setup = read_setup(EXAMPLE)
    assert "745 rows" in setup.notes[0]
    assert "--after" in setup.notes[0]


def test_spheres_of_certified_distances_validate(example):
    assert continued(example).validated == read_setup(EXAMPLE).validated
    assert len(continued(example).validated) == 15


def test_of_spheres_alone_the_last_placements_validate(tmp_path, example):
    names = [f"ball.{ball}@{k}" for ball in "ABC" for k in range(1, 6)]
    dataset = only(example, *names)
    from bayescal.dataset.write import write_files

    write_files(dataset, tmp_path)
    (tmp_path / "measurements.csv").unlink()
    setup = read_setup(tmp_path)
    assert setup.validated == {"ball.A@5", "ball.B@5", "ball.C@5"}
    assert [note.partition(";")[0] for note in setup.notes] == ["no table is stated"]


def test_groups_that_pairs_connect():
    assert connected("abcde", [("d", "b"), ("b", "a")]) == [["d", "b", "a"], ["c"], ["e"]]


def test_a_face_without_an_extent_is_refused_and_can_be_stated(example):
    dataset = only(example, "cube.-x")
    with pytest.raises(BayescalError, match=r"`cube.-x` can be probed is not known.*size_mm: \[width, h"):
        regions_of(dataset)
    patch = Patch(np.array([0.3357, 0.02, 0.1]), np.array([0.2, 0.1]))
    region = regions_of(replace(dataset, plan=PlanSettings(regions={"cube.-x": patch})))["cube.-x"]
    assert np.allclose(region.centre, patch.centre)
    assert np.allclose(np.abs(region.half), [[0, 0.1, 0], [0, 0, 0.05]])  # width along y, height along z
    turned = replace(patch, along=np.array([0.0, 0.0, 1.0]))
    region = regions_of(replace(dataset, plan=PlanSettings(regions={"cube.-x": turned})))["cube.-x"]
    assert np.allclose(np.abs(region.half), [[0, 0, 0.1], [0, 0.05, 0]])


def test_a_probed_face_is_where_it_was_probed(example):
    """One face alone gives no box: its region is the rectangle of its contacts."""
    m, names = example.measurements, [t.name for t in example.targets]
    face = names.index("cube.-x")
    alone = tuple(
        t if t.kind != "plane" else replace(t, name=t.name.replace("cube", t.name)) for t in example.targets
    )
    region = regions_of(replace(example, targets=alone))[alone[face].name]
    points = Scene(example).points[m.target == face]
    assert np.allclose(region.centre[1:], 0.5 * (points.min(axis=0) + points.max(axis=0))[1:], atol=1e-6)
    assert np.allclose(np.abs(region.half).sum(axis=0)[1:], 0.5 * np.ptp(points, axis=0)[1:], atol=1e-6)
    assert abs(region.centre[0] - 0.3357) < 1e-9


@pytest.mark.parametrize(
    ("target", "centre", "half"),
    [
        (Target("seat", "fixed-point", {"centre": np.array([0.4, 0, 0.1])}), [0.4, 0, 0.1], None),
        (Target("bar", "distance", {"centre": np.array([0.4, 0, 0]), "length": 0.3}), [0.4, 0, 0], None),
    ],
)
def test_seats_and_ball_bars_need_no_extent(example, target, centre, half):
    region = regions_of(bare(example, targets=(target,), certificates=()))[target.name]
    assert np.allclose(region.centre, centre)
    assert region.half is half
    assert np.allclose(region.up, [0, 0, 1])


def test_a_hanging_arm_probes_spheres_from_above(example):
    dataset = bare(example, gravity=np.array([0.0, 0.0, 9.81]))
    assert np.allclose(regions_of(dataset)["ball.A@1"].up, [0, 0, -1])


def test_a_kind_without_a_plan_is_refused(example):
    strange = Target("knob", "knob", {"centre": np.zeros(3)})
    with pytest.raises(BayescalError, match="contacts on a target of kind knob cannot be planned"):
        regions_of(bare(example, targets=(strange,), certificates=()))


def test_a_missing_noise_or_ball_is_refused(tmp_path):
    text = (EXAMPLE / "dataset.yaml").read_text()
    (tmp_path / "dataset.yaml").write_text(text.replace("contact_mm: 0.005", "point_mm: 0.005"))
    with pytest.raises(BayescalError, match=r"no noise of a contact .*`noise: \{contact_mm"):
        read_setup(tmp_path)
    (tmp_path / "dataset.yaml").write_text(text.replace("ball_radius_mm: 3, ", ""))
    with pytest.raises(BayescalError, match="no tool has a ball"):
        read_setup(tmp_path)
    with pytest.raises(BayescalError, match="no such folder"):
        read_setup(tmp_path / "nowhere")
    with pytest.raises(BayescalError, match="give the folder"):
        read_setup(tmp_path / "dataset.yaml")


def test_distances_of_planes_do_not_validate(example):
    """A certified distance of a sphere from a face is calibrated on."""
    off = Certificate("distance", ("ball.A@1", "cube.+z"), 0.1, 1e-6)
    dataset = replace(only(example, "ball.A@1", "cube.+z"), certificates=(off,))
    patch = Patch(np.array([0.45, 0, 0.2643]), np.array([0.1, 0.1]))
    dataset = replace(dataset, plan=PlanSettings(regions={"cube.+z": patch}))
    assert continued(dataset).validated == frozenset()


def heights(setup):
    return [s.shapes[0].offset for s in scene(setup).solids if s.carries]


def test_the_table_is_the_stated_one_or_below_all_targets(example):
    dataset = only(example, "cube.+y", "cube.-y", "cube.-x", "cube.+z")
    assumed = continued(dataset)
    assert heights(assumed) == [pytest.approx(0.15 - HALF)]
    assert "`plan: {table_mm: 36}`" in assumed.notes[0]
    stated = continued(replace(dataset, plan=PlanSettings(table=-0.33)))
    assert heights(stated) == [-0.33]
    below = np.array([[0.45, 0.0, -0.2]])  # the cube stands on a pedestal: no arm passes under it
    assert min(shape.distance(below)[0] for shape in scene(stated).solids[0].shapes) < 0
    assert not stated.notes
    still = continued(replace(dataset, gravity=np.zeros(3)))
    assert heights(still) == heights(assumed)


def test_what_is_probed_is_an_obstacle(example):
    """A face that is stated alone is a wall, a seat has a post; a contact is on the surface of its solid."""
    seat = Target("seat", "fixed-point", {"centre": np.array([0.4, 0.2, 0.1])})
    patch = Patch(np.array([0.3357, 0.02, 0.1]), np.array([0.2, 0.1]))
    dataset = only(example, "cube.-x", "ball.A@1")
    targets = (*dataset.targets, seat)
    setup = continued(replace(dataset, targets=targets, plan=PlanSettings(regions={"cube.-x": patch})))
    around = scene(setup)
    assert set(around.of) == {"cube.-x", "ball.A@1", "seat"}
    assert {solid.placement for solid in around.solids} == {""}  # a single placement stays
    wall, region = around.solids[around.of["cube.-x"]].shapes[0], setup.regions["cube.-x"]
    corners = region.centre + np.array([[1, 1], [1, -1], [-1, 0.3]]) @ region.half
    assert np.allclose(wall.distance(corners), 0, atol=1e-12)
    assert np.allclose(wall.distance(corners - 0.02 * np.eye(3)[0]), 0.02)
    assert np.allclose(np.linalg.det(wall.pose[:3, :3]), 1)
    post = around.solids[around.of["seat"]].shapes[0]
    assert 0 < post.distance(seat.values["centre"]) < 0.02
