"""Compliances that a next fit takes, from those that earlier fits took and found."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.estimate.estimate import Secants


def taken(matrix, shift, starts, scale=(1.0, 1.0)):
    """What is taken after fits that found `matrix @ taken + shift` (2,), in units of `scale`."""
    secants, known = Secants(), {}
    for start in starts:
        found = dict(zip("ab", ((matrix @ start + shift) / scale).tolist(), strict=True))
        scene = SimpleNamespace(compliances=found, stance="", posed_at=lambda _, mixed: known.update(mixed))
        _, secants = secants.next(scene, dict(zip("ab", (start / np.array(scale)).tolist(), strict=True)))
    return np.array([known["a"], known["b"]]) * scale


@pytest.mark.parametrize("scale", [(1.0, 1.0), (1e-6, 1.0), (1.0, 1e-9)])
def test_three_fits_that_find_linear_functions_tell_the_fixed_point(scale):
    matrix, shift = np.array([[0.4, 0.2], [-0.1, 0.3]]), np.array([1.0, 2.0])
    starts = [np.array(x) for x in ([0.0, 0.0], [1.0, 0.5], [0.3, 2.0])]
    fixed = np.linalg.solve(np.eye(2) - matrix, shift)
    assert taken(matrix, shift, starts, scale) == pytest.approx(fixed)


def test_units_have_no_part_in_what_two_fits_tell():
    """Two fits do not tell two numbers: what is left over is small relative to their sizes."""
    matrix, shift = np.array([[0.4, 0.2], [-0.1, 0.3]]), np.array([1.0, 2.0])
    starts = [np.array([0.0, 0.0]), np.array([1.0, 0.5])]
    plain = taken(matrix, shift, starts)
    assert taken(matrix, shift, starts, (1e-6, 10.0)) == pytest.approx(plain)
