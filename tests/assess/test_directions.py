"""Principal directions of the fitted data, as of their scatter matrix, in memory linear in the rows."""

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.assess.identifiability import directions


def model_of(normals: np.ndarray) -> SimpleNamespace:
    """A stand-in for a model whose rows look along given directions (N, 3)."""
    kind = SimpleNamespace(sd=np.zeros(0), linearise=lambda state, points: (None, normals.T[None], None))
    block = SimpleNamespace(kind=kind, rows=np.arange(len(normals)))
    return SimpleNamespace(states=(block,), scene=SimpleNamespace(points=np.zeros((len(normals), 3))))


@pytest.mark.parametrize("count", [1, 2, 3, 40])
def test_axes_of_the_scatter_matrix(count):
    normals = np.random.default_rng(count).normal(size=(count, 3)) * [3.0, 1.0, 0.2]
    found = directions(model_of(normals))
    values = np.linalg.eigvalsh(normals.T @ normals)[::-1]
    np.testing.assert_allclose(found.share, np.sqrt(np.maximum(values / values[0], 0.0)), atol=1e-7)
    np.testing.assert_allclose(found.axes @ found.axes.T, np.eye(3), atol=1e-12)
    along = np.linalg.norm(normals @ found.axes.T, axis=0)
    np.testing.assert_allclose(along, found.share * along[0], atol=1e-7 * along[0])


def test_memory_is_linear_in_the_rows():
    normals = np.random.default_rng(0).normal(size=(3000, 3))
    tracemalloc.start()
    directions(model_of(normals))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * normals.nbytes  # a square matrix of the rows would be 1000 times that
