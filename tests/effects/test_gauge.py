"""Which parameters exist, and that what is left of them the contacts can tell."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.chain import Robot, chain_of
from bayescal.effects import EFFECTS, Circumstances, parameters_of
from bayescal.estimate import linearise, unit_weights
from bayescal.model import build
from bayescal.model.scene import Scene

LOOSE = {
    *(f"a{i}" for i in range(1, 6)), *(f"alpha{i}" for i in range(1, 6)), *(f"theta{i}" for i in range(2, 6)),
    *(f"d{i}" for i in range(2, 6)), "beta2",
}  # fmt: skip
BASE = {"base x", "base y", "base z", "base rx", "base ry", "base rz"}
WRIST = {"theta6", "d6"}
TOOL = {"ball x", "ball y", "ball z"}


def stating(dataset, target=None, angle=None, tool=None):
    """The session with a stated uncertainty of its first target and of its tool."""
    first = replace(dataset.targets[0], u=target, u_angle=angle)
    return replace(
        dataset, targets=(first, *dataset.targets[1:]), tools=tuple(replace(t, u=tool) for t in dataset.tools)
    )


def names_of(dataset, effects=("geometry",)):
    scene = Scene(dataset)
    return {p.name for p in parameters_of(effects, scene.circumstances(scene.rows("calibrate")))}


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ({}, LOOSE | TOOL),
        ({"target": 1e-3}, LOOSE | TOOL | BASE),
        ({"angle": 1e-3}, LOOSE | TOOL | BASE),
        ({"target": 0.0, "angle": 0.0}, LOOSE | TOOL | BASE),
        ({"tool": 1e-3}, LOOSE | TOOL | WRIST),
        ({"tool": 0.0}, LOOSE | WRIST),
        ({"target": 1e-3, "tool": 1e-3}, LOOSE | TOOL | BASE | WRIST),
    ],
)
def test_lrmate(cube, stated, expected):
    assert names_of(stating(cube(seed=1).dataset, **stated)) == expected
    assert len(LOOSE) == 19  # eighteen, and d3 beside d2


def test_stated_width_is_the_prior(cube):
    scene = Scene(stating(cube(seed=1).dataset, target=2e-4, angle=3e-4, tool=1e-4))
    model = build(scene, ("geometry",))
    sd = {p.name: p.sd for p in model.parameters}
    assert sd["ball x"] == 1e-4
    assert (sd["a1"], sd["alpha1"], sd["theta2"], sd["d2"], sd["beta2"]) == (3e-4, 1e-3, 2e-3, 3e-4, 1e-3)
    np.testing.assert_array_equal(model.blocks[0].kind.sd, [3e-4, 3e-4, 2e-4])
    np.testing.assert_array_equal(model.blocks[1].kind.sd, [0.2, 0.2, 0.05])
    wide = build(scene, ("geometry",), prior_width=10.0)
    assert {p.name: p.sd for p in wide.parameters}["a1"] == pytest.approx(3e-3)
    np.testing.assert_array_equal(wide.blocks[0].kind.sd, [3e-4, 3e-4, 2e-4])


def test_a_target_or_tool_that_is_not_fitted_ties_nothing(cube):
    """Stated by `validate` rows alone, a place says nothing of the base."""
    dataset = stating(cube(seed=1).dataset, target=1e-3)
    role = np.where(dataset.measurements.target == 0, "validate", "calibrate")
    assert names_of(replace(dataset, measurements=replace(dataset.measurements, role=role))) == LOOSE | TOOL


def test_one_direction_is_left_to_the_prior(cube):
    """Of a LR Mate by four loose planes: d2 and d3 are told only as a sum, all else is told."""
    model = build(Scene(cube(seed=1, count=300).dataset), ("geometry", "compliance"))
    z = np.zeros(model.size)
    _, size, directions = np.linalg.svd(
        linearise(model, z, unit_weights(model, z)).jacobian, full_matrices=False
    )
    assert size[-1] < 1e-9 * size[0]
    assert size[-2] > 1.0  # one standard deviation of the prior or better
    left = dict(zip(model.names, directions[-1], strict=True))
    assert abs(left["d2"]) == pytest.approx(np.sqrt(0.5))
    assert left["d2"] == pytest.approx(-left["d3"])


def test_beta_where_axes_are_parallel():
    """A UR-like table, in standard DH: axes 2, 3 and 4 are parallel, 1 and 2 are not."""
    robot = Robot(
        "ur", "dh", tuple(f"J{i}" for i in range(1, 7)), np.radians([90.0, 0, 0, 90, -90, 0]),
        np.array([0, -0.425, -0.392, 0, 0, 0]), np.array([0.089, 0, 0, 0.109, 0.095, 0.082]), np.zeros(6),
        np.zeros(6), np.tile([-6.0, 6.0], (6, 1)), np.eye(6),
    )  # fmt: skip
    circumstances = Circumstances(
        robot, chain_of(robot), np.zeros((1, 6)), None, np.zeros(1, int), ("t",), np.zeros((1, 3)), (None,),
        (0,), np.zeros(1, int), False, False, np.zeros((1, 6)), np.zeros(3), np.zeros(1), np.zeros((1, 3)),
        np.full((1, 3), np.nan), (None,),
    )  # fmt: skip
    found = {p.name: p.nominal for p in EFFECTS["geometry"].parameters(circumstances)}
    assert {name for name in found if name.startswith("beta")} == {"beta2", "beta3"}
    # named by the link that joint i moves, whatever the convention
    assert (found["a2"], found["a3"], found["d4"], found["alpha1"]) == (-0.425, -0.392, 0.109, np.pi / 2)


def test_craig_names(cube):
    """In modified DH a_i and alpha_i stand in row i + 1: the LR Mate's upper arm of 300 mm is a2."""
    model = build(Scene(cube(seed=1).dataset), ("geometry",))
    nominal = {p.name: p.nominal for p in model.parameters}
    assert [nominal[f"a{i}"] for i in range(1, 6)] == pytest.approx([0.075, 0.3, 0.075, 0, 0])
    assert [nominal[f"alpha{i}"] for i in range(1, 6)] == pytest.approx(np.radians([-90, 0, -90, 90, -90]))
    assert [nominal[f"d{i}"] for i in range(2, 6)] == pytest.approx([0, 0, 0.32, 0])
    assert nominal["theta2"] == pytest.approx(-np.pi / 2)
