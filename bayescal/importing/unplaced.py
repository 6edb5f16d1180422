"""Positions of instruments and reflectors that are not stated, estimated with the nominal arm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.transforms import rpy_of
from bayescal.dataset import Dataset, Target
from bayescal.errors import BayescalError
from bayescal.importing.frame import Sightings, fit, flanges

FEWEST = {False: 4, True: 6}
"""Rows of one instrument needed to place it, and to place a reflector with it."""


@dataclass(frozen=True)
class Loose:
    """Names of the instruments and tools that are found from the rows themselves."""

    targets: tuple[str, ...] = ()
    tools: tuple[str, ...] = ()

    def check(self, dataset: Dataset) -> None:
        """Refuse too few rows to find these from."""
        rows = dataset.measurements
        fewest = FEWEST[bool(self.tools)]
        for index, target in enumerate(dataset.targets):
            count = int((rows.target == index).sum())
            if target.name in self.targets and count < fewest:
                what = f"{count} points of `{target.name}` do not determine its position"
                raise BayescalError(what, "", f"give at least {fewest}, or a --template with its position")

    def settled(self, dataset: Dataset) -> Dataset:
        """The dataset with these where its rows and the nominal arm put them."""
        rows = dataset.measurements
        if not self.targets or rows.xyz is None:
            return dataset
        mine = np.array([t.name in self.targets for t in dataset.targets])[rows.target]
        mine &= np.isfinite(rows.xyz).all(axis=1)
        used, station = np.unique(rows.target[mine], return_inverse=True)
        known = np.array([t.name not in self.tools for t in dataset.tools])
        sightings = Sightings(
            flanges(dataset.robot, rows.readings[mine]), rows.xyz[mine], station.ravel(), rows.tool[mine]
        )
        frames, centres = fit(sightings, np.array([t.centre for t in dataset.tools]), known)
        targets = list(dataset.targets)
        for index, frame in zip(used, frames, strict=True):
            place: dict[str, np.ndarray | float] = {"xyz": frame[:3, 3], "rpy": rpy_of(frame[:3, :3])}
            targets[index] = Target(targets[index].name, "instrument", place)
        tools = tuple(replace(t, centre=c) for t, c in zip(dataset.tools, centres, strict=True))
        return replace(dataset, targets=tuple(targets), tools=tools)
