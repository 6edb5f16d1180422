"""Clusters of rows that share an error: one stop of the arm, repeats of one contact, equal joint readings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.dataset import Measurements


def poses(m: Measurements, rows: np.ndarray) -> np.ndarray:
    """Number (R,) of the pose of each of `rows` (R,), from 0; rows of one pose are not independent.

    Two rows are of one pose if they have the same `stop`, repeat the same contact, or have equal readings.
    """
    from scipy.sparse import coo_array  # slow to import, and not every command needs it
    from scipy.sparse.csgraph import connected_components

    rows = np.asarray(rows, int)
    columns = list(_labels(m, rows))
    label = np.concatenate([own + len(rows) * k for k, (_, own) in enumerate(columns, start=1)])
    at = np.concatenate([member for member, _ in columns])
    size = len(rows) * (len(columns) + 1)
    joined = coo_array((np.ones(len(at)), (at, label)), shape=(size, size))
    found = connected_components(joined, directed=False)[1][: len(rows)]
    return np.unique(found, return_inverse=True)[1]


def _labels(m: Measurements, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Places (K,) in `rows`, and numbers (K,) below R that are equal for rows of one pose."""
    yield np.arange(len(rows)), _numbers(m.readings[rows])
    for given in (m.stop, m.repeat):
        if given is not None:
            own = given[rows].astype(str)
            has = np.flatnonzero(own != "")
            # one label of a repeat is of one target and of one stop of the arm alike
            yield has, _numbers(own[has])


def _numbers(values: np.ndarray) -> np.ndarray:
    return np.unique(values, axis=0, return_inverse=True)[1].ravel()
