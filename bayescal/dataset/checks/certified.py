"""Certified lengths that contradict the nominal places of their targets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bayescal.dataset.joins import nominal_length
from bayescal.dataset.target_kinds import LOOSE
from bayescal.dataset.types import Dataset

RATIOS = {25.4: "inches", 1e3: "m", 10.0: "cm", 1e-3: "µm", 39.37: "m taken for inches"}
"""Factor by which a length in mm must be multiplied, and the probable unit."""
NEAR = 0.05
"""Relative tolerance of such a factor: nominal places are rounded."""


@dataclass(frozen=True)
class Contradiction:
    """A certificate, by its number, and what is wrong with its length; the remedy names a probable unit."""

    certificate: int
    what: str
    remedy: str


def contradictions(dataset: Dataset) -> Iterator[Contradiction]:
    """Certified distances that no error of the nominal places explains."""
    by_name = {t.name: t for t in dataset.targets}
    for number, c in enumerate(dataset.certificates):
        if c.distance is None or len(c.targets) < 2:
            continue
        there = nominal_length([by_name[name] for name in c.targets], c.kind)
        known = [by_name[name].u for name in c.targets]
        loose = max(LOOSE if u is None else 5 * u for u in known)
        if there is None or abs(c.distance - there) <= max(loose, NEAR * c.distance):
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
        yield Contradiction(number, what, remedy)
