"""Readings that explain the session only when they are taken for another unit's.

Degrees taken for radians are 57 times too large, metres taken for millimetres 1000 times too small:
either way all rows are hundreds of millimetres off at nominal geometry, and none once the numbers are
read as what they are. No arm is nominally wrong by that much, and no other error falls by that factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from bayescal.dataset.checks.misfit import FEWEST, away, nominal
from bayescal.dataset.types import Dataset

SUSPECT = 0.02
"""m: a session whose typical misfit is less is not suspected."""

FALLS = 3.0
"""A misfit that falls by this factor, to less than `FITS`, is another unit's."""

FITS = 0.1
"""m: what loosely known tools and targets may leave, in the right unit."""

TURNS = 4 * np.pi
"""rad: no joint shows more; readings that do are not in the unit that was said."""

ANGLES = tuple(sorted({k for f in (180 / np.pi, 1e3, np.pi / 0.18) for k in (f, 1 / f)}))
"""Ratios of units of angle: deg, rad and mrad."""

LENGTHS = tuple(sorted({k for f in (1e3, 10.0, 25.4, 1e6, 39.37007874015748, 100.0) for k in (f, 1 / f)}))
"""Ratios of units of length: m, cm, mm, µm and in."""


@dataclass(frozen=True)
class Suspicion:
    """Quantities (``j1`` ..., ``x``, ``length``) that fit once multiplied by `factor`: typical misfits, m."""

    quantities: tuple[str, ...]
    factor: float
    stated: float
    other: float


def suspicion(
    dataset: Dataset, settled: Callable[[Dataset], Dataset] = lambda dataset: dataset
) -> Suspicion | None:
    """The quantities that are most plainly in another unit than was said, or None.

    Judged by the median over the rows concerned of how far they are off their nominal targets (after
    a rigid fit, of an instrument's), and among several by that over how far the arm then moved: an arm
    that hardly moves fits any points that are shrunk. Costs one forward kinematics where nothing is wrong.
    What is nominal only for these very readings (a tool found from them) is found again by `settled`.
    """
    rows = dataset.measurements
    if len(rows.ids) < FEWEST:
        return None
    stated = away(dataset, rows.readings)
    others = chain(_angles(dataset), _lengths(dataset))
    found: list[tuple[float, Suspicion]] = []
    for quantities, factor, concerned, other in others:
        before = float(np.median(stated[concerned]))
        if before <= SUSPECT:
            continue
        other = settled(other)
        after = float(np.median(away(other, other.measurements.readings)[concerned]))
        if after < min(before / FALLS, FITS):
            p = nominal(other, other.measurements.readings)[concerned]
            moved = float(np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)))
            found.append((after / max(moved, 1e-9), Suspicion(quantities, factor, before, after)))
    return min(found, key=lambda f: f[0])[1] if found else None


Other = tuple[tuple[str, ...], float, np.ndarray, Dataset]
"""Quantities taken times a factor: they, it, the rows concerned (N,), and the dataset that then holds."""


def _angles(dataset: Dataset) -> Iterator[Other]:
    """All joints, and each alone, in every other unit; smaller only where they are too large to be angles."""
    rows, n = dataset.measurements, dataset.robot.n
    every = np.ones(len(rows.ids), bool)
    largest = np.abs(rows.readings).max(axis=0)
    for joints in (list(range(n)), *([j] for j in range(n))):
        size = largest[joints].max()
        for factor in ANGLES:
            if size > TURNS if factor < 1 else 0 < size <= TURNS / factor:
                readings = rows.readings.copy()
                readings[:, joints] *= factor
                other = replace(dataset, measurements=replace(rows, readings=readings))
                yield tuple(f"j{j + 1}" for j in joints), factor, every, other


def _lengths(dataset: Dataset) -> Iterator[Other]:
    """An instrument's points, and lengths of bars and wires, in every other unit."""
    rows = dataset.measurements
    for field, quantities in (("xyz", ("x", "y", "z")), ("length", ("length",))):
        values = getattr(rows, field)
        if values is None:
            continue
        concerned = np.isfinite(values.reshape(len(values), -1)).any(axis=1)
        for factor in LENGTHS if concerned.sum() >= FEWEST else ():
            changed = replace(rows, **{field: values * factor})
            yield quantities, factor, concerned, replace(dataset, measurements=changed)
