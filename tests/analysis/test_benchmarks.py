"""The benchmark's own sums: flops counted by hand, and peers that compute the same thing."""

import numpy as np
import pytest
from cases import EXAMPLE

from analysis.benchmarks import flops, peer_scipy, problem
from analysis.benchmarks.mixed import EFFECTS, KINDS, mixed, part
from bayescal.arm.chain import Chain
from bayescal.arm.motion import Motion, Term
from bayescal.dataset import read_dataset
from bayescal.estimate import linearise, solve, unit_weights
from bayescal.model import ARM, Scene, build


@pytest.fixture(scope="module")
def small(cube) -> problem.Problem:
    return problem.of_dataset(cube(seed=3, count=72).dataset, most=48)


def test_faces_keep_their_share(small):
    assert small.contacts == 48
    assert [len(block.rows) for block in small.model.blocks] == [12, 12, 12, 12]


@pytest.mark.parametrize(("terms", "more"), [
    ([], 0),
    ([Term(1, "rz"), Term(2, "tz"), Term(1, "rx"), Term(3, "tx")], 0),  # constants are folded
    ([Term(1, "rz", np.array([0.5, 1.0]))], 2 + 16),  # term; sine and cosine
    ([Term(1, "rz", np.array([0.5, 1.0])), Term(1, "rz", np.array([0.3, 1.0]))], 4 + 16),
    ([Term(0, "rx")], 6),  # a turn of the base
    ([Term(0, "ty", np.array([0.5, 1.0]))], 2),
    ([Term(2, "tx", np.array([0.5, 1.0]))], 2 + 2 + 1),  # term; slides along x, y; z on its own
])  # fmt: skip
def test_flops_by_hand(terms, more):
    chain = Chain(np.eye(4), np.tile(np.eye(4), (3, 1, 1)), np.zeros(2))
    motion = Motion(chain, np.zeros((2, 2)), np.zeros((2, 3)), list(enumerate(terms)), len(terms))
    # tool 3; two joints of 18 + 6 + 6; first link 18; slides of the base 3; base 18
    assert flops.kernel_flops(motion) == 3 + 2 * 30 + 18 + 3 + 18 + more


def test_residuals_of_the_reference(small):
    z = np.random.default_rng(0).normal(size=small.model.size)
    ours = linearise(small.model, z, small.weights).residual
    theirs = peer_scipy.residual_function(small)(z)
    np.testing.assert_allclose(theirs[:48], ours[:48], rtol=0, atol=1e-8)
    # the order of the certificates is theirs
    np.testing.assert_allclose(np.sort(theirs[48 : -len(z)]), np.sort(ours[48:]), rtol=1e-10)
    np.testing.assert_array_equal(theirs[-len(z) :], z)


def test_scipy_finds_our_optimum(small):
    found = peer_scipy.measure(small, rounds=1)
    assert abs(found["scipy_excess"]) < peer_scipy.NEAR
    assert found["ours_s"] < found["scipy_s"] <= found["scipy_whole_s"]


def test_same_start_same_end(small):
    """The solver that is timed is the one whose optimum is compared."""
    z, covariance, _ = solve(small.model, small.weights, small.start)
    linear = linearise(small.model, z, small.weights)
    information = linear.jacobian.T @ linear.jacobian + np.eye(small.model.size)
    np.testing.assert_allclose(covariance() @ information, np.eye(small.model.size), atol=1e-5)


# --- The mixed session of the benchmark is its parts put together, and no more work than they are.


def test_mixed_is_its_parts():
    """Block by block the same residuals and slopes by the arm, and no further ones but constraints."""
    whole = mixed(read_dataset(EXAMPLE))
    model = build(Scene(whole), EFFECTS)
    values = model.deviations(np.full(len(model.parameters), 0.1))
    blocks = 0
    for kind in KINDS.values():
        alone = build(Scene(part(whole, kind)), EFFECTS)
        names = {p.name: k for k, p in enumerate(model.parameters)}
        index = [names[p.name] for p in alone.parameters]
        for block in alone.blocks:
            z = np.zeros(block.size)
            r, by_arm, _ = block.linearise(values[index], z)
            same, by_same, _ = model.block_of[block.target].linearise(values, z)
            np.testing.assert_allclose(r, same, atol=1e-15)
            np.testing.assert_allclose(by_arm, by_same[:, index], atol=1e-13)
            blocks += 1
    assert blocks == len(model.blocks)
    z = np.zeros(model.size)
    linear = linearise(model, z, unit_weights(model, z))
    rows = sum(b.residuals for b in model.blocks) + sum(t.rows for t in model.constraints)
    assert len(linear.residual) == rows
    assert model.slices[ARM].stop == len(model.parameters)


# --- Sessions of any size are what they claim to be, and costs are those of the process that was run.
