"""Rows of a model as a system of equations without priors of the arm: what the peers solve.

The unknowns x are the arm's deviations from its drawing (SI), then the targets' parts of z. Certificates
and stated places are rows among others, each over its standard uncertainty: they are data. The tolerance
priors of the arm, and the loose ones of targets that state nothing, are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.model import ARM, Block, Model

Rows = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Residuals (R,), their gradients by the arm's deviations (R, P) and by the target's part of z (R, T)."""


def contacts(block: Block, values: np.ndarray, z: np.ndarray) -> Rows:
    """The residuals of a target's contacts, each over its stated noise."""
    r, by_arm, by_target = block.linearise(values, z)
    sigma = np.tile(block.sigma, block.kind.rows)
    return r / sigma, by_arm / sigma[:, None], by_target / sigma[:, None]


@dataclass(frozen=True)
class System:
    """A model's blocks as rows; with `known` targets stay where they are stated to be.

    `rows` makes those of a block.
    """

    model: Model
    rows: Callable[[Block, np.ndarray, np.ndarray], Rows] = contacts
    known: bool = False

    @property
    def arm(self) -> int:
        """Number of the arm's unknowns."""
        return len(self.model.parameters)

    @cached_property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.arm if self.known else self.model.size

    @cached_property
    def _stated(self) -> np.ndarray:
        """Unknowns of targets whose places are stated: indices of x."""
        scene = self.model.scene
        out: list[int] = []
        stated = {t.name for t in scene.dataset.targets if t.u is not None or t.u_angle is not None}
        for block in self.model.blocks:
            if block.target in stated:
                own = self.model.slices[block.target]
                out += range(own.start, own.stop)
        return np.array(out, int)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (R,) and their Jacobian (R, size) at x (size,)."""
        model, values = self.model, x[: self.arm]
        residuals, slopes = [], []
        for block in model.blocks:
            own = model.slices[block.target]
            r, by_arm, by_target = self.rows(block, values, np.zeros(block.size) if self.known else x[own])
            slope = np.zeros((len(r), self.size))
            slope[:, : self.arm] = by_arm
            if not self.known:
                slope[:, own] = by_target
            residuals.append(r)
            slopes.append(slope)
        if not self.known:
            for r, slope in (*self._certified(x), self._placed(x)):
                residuals.append(r)
                slopes.append(slope)
        return np.concatenate(residuals), np.concatenate(slopes)

    def _certified(self, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        model, out = self.model, []
        parts = {name: x[own] for name, own in model.slices.items()}
        parts[ARM] = (x[: self.arm] - model.shift) / model.sd
        for constraint in model.constraints:
            r, by = model.linearised(constraint, parts)
            slope = np.zeros((len(r), self.size))
            for name, columns in by.items():
                slope[:, model.slices[name]] = columns / model.sd if name == ARM else columns
            out.append((r, slope))
        return out

    def _placed(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[self._stated], np.eye(self.size)[self._stated]


def part(model: Model, wanted: Callable[[Block], bool]) -> Model:
    """A model with some of its blocks only, and the certificates between those."""
    blocks = tuple(block for block in model.blocks if wanted(block))
    names = {block.target for block in blocks}
    return replace(
        model, blocks=blocks, constraints=tuple(t for t in model.constraints if names.issuperset(t.targets))
    )
