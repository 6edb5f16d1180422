"""Halves of a log: what the comparison counts."""

import numpy as np
import pytest
from motion.made import write

from analysis.log_halves import Half, compared, fitted
from bayescal.logs import read_log

NAMES = ("coulomb 1", "mass of link 2", "viscous 1", "offset 1", "armature 1", "x")


def halves(rng, excess):
    """Estimates of 6 parameters from rows of two halves, of which one direction is not determined."""
    sd = np.array([1.0, 0.1, 5.0, 1.0, 2.0, 1.0])
    truth = sd * rng.standard_normal(6)
    out = []
    for _ in range(2):
        x = rng.standard_normal((60, 6)) * [3.0, 30.0, 0.6, 2.0, 1.5, 0.0]
        y = x @ truth + excess * rng.standard_normal(60)
        data, prior = x.T @ x, np.diag(1.0 / sd**2)
        values = np.linalg.solve(data + prior, x.T @ y)
        out.append(Half(NAMES, values, data, prior))
    return out


@pytest.mark.parametrize(("excess", "ratio"), [(1.0, 1.0), (2.0, 4.0)])
def test_chi_square_is_that_of_halves_that_agree_within_their_u(excess, ratio):
    rng = np.random.default_rng(2)
    results = [compared(*halves(rng, excess)) for _ in range(300)]
    assert {dof for _, dof, _ in results} == {5}
    assert np.mean([chi2 / dof for chi2, dof, _ in results]) == pytest.approx(ratio, rel=0.12)
    assert set(results[0][2]) == {"coulomb", "mass", "viscous", "offset", "armature"}


def test_halves_of_a_log_are_fitted(tmp_path):
    log = read_log(write(tmp_path / "log"))
    one, other = (fitted(log, first) for first in (0, 1))
    chi2, dof, kinds = compared(one, other)
    assert one.names == other.names
    assert {"viscous", "coulomb"} <= set(kinds)
    assert 0.3 < chi2 / dof < 3.0
