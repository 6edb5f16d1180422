"""The mixed session of the benchmark is its parts put together, and no more work than they are."""

import numpy as np
import pytest
from cases import EXAMPLE

from analysis.benchmarks.mixed import EFFECTS, KINDS, mixed, over_parts, part
from bayescal.dataset import read_dataset
from bayescal.estimate import linearise, unit_weights
from bayescal.model import ARM, build
from bayescal.model.scene import Scene


@pytest.fixture(scope="module")
def whole():
    return mixed(read_dataset(EXAMPLE))


def test_mixed_is_its_parts(whole):
    """Block by block the same residuals and slopes by the arm, and no further ones but constraints."""
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
    assert len(linear.residual) == sum(b.residuals for b in model.blocks) + sum(
        t.rows for t in model.constraints
    )
    assert model.slices[ARM].stop == len(model.parameters)


def test_over_parts():
    cost = {"planes": 1.0, "spheres": 2.0, "tracker": 3.0, "mixed": 9.0}
    assert over_parts({k: {"solve_s": v} for k, v in cost.items()}, "solve_s") == pytest.approx(1.5)
