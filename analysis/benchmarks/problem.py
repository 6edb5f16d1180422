"""The one problem that all are timed on: the contacts of a session with a cube's faces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from analysis.benchmarks.walls import Walls
from bayescal.arm.motion import Motion
from bayescal.dataset import Dataset, read_dataset
from bayescal.estimate import Estimate, Weights, estimate, unit_weights
from bayescal.model import Block, Model, build
from bayescal.model.scene import Scene
from factors.contacts import Plane

EFFECTS = ("geometry", "compliance")
MOST = 500  # contacts


@dataclass(frozen=True)
class Problem:
    """A model whose targets are all planes, at its stated noise, and what follows from it."""

    model: Model

    @cached_property
    def start(self) -> np.ndarray:
        """The nominal values, (D,)."""
        return np.zeros(self.model.size)

    @cached_property
    def weights(self) -> Weights:
        """Every contact at its stated noise."""
        return unit_weights(self.model, self.start)

    @cached_property
    def estimate(self) -> Estimate:
        """Of all contacts."""
        return estimate(self.model, robust=False)

    @cached_property
    def rows(self) -> np.ndarray:
        """Rows of the session, face after face."""
        return np.concatenate([block.rows for block in self.model.blocks])

    @cached_property
    def motion(self) -> Motion:
        """Of all contacts, face after face."""
        return self.model.motion(self.rows)

    @property
    def contacts(self) -> int:
        """Their number."""
        return len(self.rows)

    def faces_of(self, z: np.ndarray) -> np.ndarray:
        """The faces' part (F, 3) of z (D,)."""
        return np.stack([z[self.model.slices[block.target]] for block in self.model.blocks])

    def walls(self, sigma: np.ndarray) -> Walls:
        """Faces and certificates as plain arrays, contacts whitened by sigma (C,), m."""
        model = self.model
        planes = [_plane(block) for block in model.blocks]
        counts = [len(block.rows) for block in model.blocks]
        at = {block.target: k for k, block in enumerate(model.blocks)}
        parallel, perpendicular = [], []
        for entry in model.scene.dataset.certificates:
            faces = [float(at[name]) for name in entry.targets if name in at]
            if len(faces) == 2 and entry.kind == "parallel":
                parallel.append([*faces, entry.distance, entry.u_distance, entry.u_angle])
            elif len(faces) == 2 and entry.kind == "perpendicular":
                perpendicular.append([*faces, entry.u_angle])
        assert len(parallel) + len(perpendicular) == len(model.constraints), (
            "a certificate that no peer knows"
        )
        return Walls(
            first=np.concatenate([[0], np.cumsum(counts)]),
            normal=np.stack([p.normal for p in planes]),
            basis=np.stack([p.tangents for p in planes]),
            pivot=np.stack([p.pivot for p in planes]),
            sd=np.stack([p.sd for p in planes]),
            radius=np.concatenate([p.radius for p in planes]),
            sigma=sigma,
            parallel=np.array(parallel, float).reshape(-1, 5),
            perpendicular=np.array(perpendicular, float).reshape(-1, 3),
        )

    @cached_property
    def sigma(self) -> np.ndarray:
        """Stated noise of each contact, (C,), m, face after face."""
        return np.concatenate([self.weights.sigma[block.target] for block in self.model.blocks])


def _plane(block: Block) -> Plane:
    assert isinstance(block.kind, Plane), "the peers know planes only"
    assert block.size == 3, "the peers know no face that is wholly given"
    return block.kind


def of_dataset(dataset: Dataset, most: int = MOST) -> Problem:
    """The first `most` contacts with which a session's planes are calibrated, each face its share."""
    m = dataset.measurements
    planes = [k for k, target in enumerate(dataset.targets) if target.kind == "plane"]
    mine = np.isin(m.target, planes) & (m.role == "calibrate")
    faces = [np.flatnonzero(mine & (m.target == k)) for k in planes]
    faces = [rows for rows in faces if len(rows)]
    total = sum(len(rows) for rows in faces)
    if total > most:
        ends = np.round(np.cumsum([len(rows) for rows in faces]) * most / total).astype(int)
        faces = [rows[:count] for rows, count in zip(faces, np.diff(ends, prepend=0), strict=True)]
    role = np.full(len(m.role), "locate", dtype=m.role.dtype)
    role[np.concatenate(faces)] = "calibrate"
    return Problem(build(Scene(replace(dataset, measurements=replace(m, role=role))), EFFECTS))


def load(folder: Path) -> Problem:
    """The problem of a session's folder."""
    return of_dataset(read_dataset(folder))
