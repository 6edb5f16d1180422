"""Clusters of rows that share an error: one stop of the arm, repeats of one contact, equal joint readings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.dataset import Measurements


def poses(m: Measurements, rows: np.ndarray) -> np.ndarray:
    """Number (R,) of the pose of each of `rows` (R,), from 0; rows of one pose are not independent.

    Two rows are of one pose if they have the same `stop`, repeat the same contact, or have equal readings.
    """
    rows = np.asarray(rows, int)
    columns, found = list(_labels(m, rows)), np.arange(len(rows))
    while True:  # each row takes the least number of all that share a label with it
        before = found.copy()
        for at, label in columns:
            least = np.full(len(rows), len(rows))
            np.minimum.at(least, label, found[at])
            np.minimum.at(found, found[at], least[label])  # the row that stood for it follows: few rounds
            while not np.array_equal(further := found[found], found):
                found = further
        if np.array_equal(found, before):
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
