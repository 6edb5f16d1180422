"""Certified lengths that contradict the nominal places of their targets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from bayescal.dataset.checks.misfit import FEWEST, OFF, contacts, nominal
from bayescal.dataset.contacts import residual
from bayescal.dataset.joins import nominal_length
from bayescal.dataset.target_kinds import KINDS, LOOSE
from bayescal.dataset.types import Dataset

RATIOS = {25.4: "inches", 1e3: "m", 10.0: "cm", 1e-3: "µm", 39.37: "m taken for inches"}
"""Factor by which a length in mm must be multiplied, and the probable unit."""
NEAR = 0.05
"""Relative tolerance of such a factor: nominal places are rounded."""


FINE = 5e-3
"""m: a nominal arm places surfaces no better than this."""


@dataclass(frozen=True)
class Contradiction:
    """A certificate by its place in dataset.yaml, what is wrong with its length, and a remedy.

    `impossible`: the rows on its targets contradict it too, by more than any error of an arm.
    """

    place: tuple[str | int, ...]
    what: str
    remedy: str
    impossible: bool


def contradictions(dataset: Dataset) -> Iterator[Contradiction]:
    """Certified distances that no error of the nominal places explains.

    Places are believed within their standard uncertainty, or, where rows were taken on both targets, within
    three times the typical distance of these rows from them.
    """
    by_name, off = {t.name: t for t in dataset.targets}, cache(lambda name: _off(dataset, name))
    for number, c in enumerate(dataset.certificates):
        if c.distance is None or len(c.targets) < 2:
            continue
        there = nominal_length([by_name[name] for name in c.targets], c.kind)
        if there is None or abs(c.distance - there) <= NEAR * c.distance:
            continue
        known = [by_name[name].u for name in c.targets]
        loose = max(LOOSE if u is None else 5 * u for u in known)
        seen = [off(name) for name in c.targets]
        rows = max(FINE, 3 * sum(seen))
        if abs(c.distance - there) <= min(loose, rows):
            continue
        like = next((unit for f, unit in RATIOS.items() if abs(c.distance * f - there) < NEAR * there), "")
        back = next(
            (unit for f, unit in RATIOS.items() if abs(c.distance - there * f) < NEAR * there * f), ""
        )
        names = " and ".join(f"`{name}`" for name in c.targets)
        what = f"{names}: certified {1e3 * c.distance:.6g} mm, nominally {1e3 * there:.6g} mm apart"
        remedy = (
            f"the certified value looks like {like}: write it in mm"
            if like
            else f"the value was converted once too often, or the nominal places are in {back}"
            if back
            else "check the certificate, the names and the nominal places"
        )
        place = ("artefact",) if c.derived else ("certificates", number)
        yield Contradiction(place, what, remedy, abs(c.distance - there) > OFF + rows)


def _off(dataset: Dataset, name: str) -> float:
    """Median distance, m, of the rows of a target from its nominal place; infinite if few rows say it."""
    index = next(k for k, t in enumerate(dataset.targets) if t.name == name)
    at = np.flatnonzero(dataset.measurements.target == index)
    if len(at) < FEWEST or not KINDS[dataset.targets[index].kind].placed:
        return float("inf")
    p = nominal(dataset, dataset.measurements.readings)
    return float(np.median(np.linalg.norm(residual(contacts(dataset, index, p, at))[0], axis=1)))
