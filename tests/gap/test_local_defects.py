"""A local defect looks like a few outliers: excluded contacts support what explains them."""

from dataclasses import replace

import numpy as np
import pytest
from gap_problems import Bench

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects import Parameter
from bayescal.effects.location import Driver, face
from bayescal.gap.linear.problem import without_nuisance
from bayescal.gap.linear.state import fit_state, limited
from bayescal.gap.outcome.where import places, visible

SPOT, WIDTH = np.array([0.22, -0.18]), 0.2
"""Half extents of a face: between the centres that are tried."""


@pytest.fixture(scope="module")
def bench(cube):
    return Bench.of(cube(seed=7, count=300).dataset)


def dent(bench, depth):
    """Contribution (R,) of a dent of so many times the noise in the second face."""
    own = bench.circumstances.faces[1]
    spot = np.exp(-0.5 * np.sum(((own.place - SPOT) / WIDTH) ** 2, axis=1)) * own.rows
    (column,) = bench.slopes.columns([Parameter("", "m", (Term(CONTACT, "normal", spot),), 1e-5)]).T
    return depth * column / np.max(np.abs(column)), own.name


@pytest.mark.parametrize("seed", [3, 4])
def test_a_dent_is_found_beside_larger_outliers(bench, seed):
    there, name = dent(bench, 12.0)
    p = bench.made_up(seed, there, gross=0.02)
    null = fit_state(p, (), ())
    hit = np.flatnonzero(np.abs(there[: p.count]) > 4.0)
    assert np.sum(null.weight[hit] == 0) >= 2
    decision, _ = bench.decided(p)
    assert decision.kind == "unknown"
    first = places(
        decision.hypothesis, bench.pool, bench.known.pool, bench.circumstances, 1e-10, p.jacobian.shape[1]
    )[0]
    assert (first.site, first.driver) == (face(name), Driver("face", form="one spot"))
    assert first.family_p_value < 1e-3
    # the contacts that it explains count in its size, as far as the model does not absorb it
    bare = fit_state(without_nuisance(p, p.jacobian.shape[1]), (), (), robust=False)
    assert first.rms == pytest.approx(np.sqrt(np.mean(visible(bare, there) ** 2)), rel=0.12)
    assert np.isin(p.rows[p.contact[hit]], first.curve.rows).all()
    assert np.all(bench.circumstances.faces[1].rows[first.curve.rows])  # its curve is that of the face


def test_an_outlier_of_any_size_counts_as_one_at_the_limit(bench):
    p = bench.made_up(5)
    found = []
    for size in (30.0, 3000.0):
        off = np.zeros(len(p.residual))
        off[40] = size
        state = fit_state(replace(p, residual=p.residual + off), (), ())
        assert state.gross == 1
        found.append(limited(state))
    for one in found:
        assert one.gross == 0
        assert one.kappa == pytest.approx(found[0].kappa, rel=1e-6)
        np.testing.assert_allclose(one.residual, found[0].residual, atol=1e-4)
        assert abs(one.residual[40]) == np.max(np.abs(one.residual[: p.count]))
        assert 3.0 < abs(one.residual[40]) < 5.0
