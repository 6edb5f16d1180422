"""What all methods share: a session goes in, corrected parameters of the arm come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.estimate import Estimate
from bayescal.model import Model, build, standing
from bayescal.model.scene import Scene


@dataclass(frozen=True)
class Solution:
    """What a method makes of a session, in the parameters of a model.

    `values` (P,) are deviations from nominal, SI. `held` names the parameters kept nominal because the
    rows do not tell them, `condition` is that of the scaled Jacobian of all others. `estimate` is there where
    the method predicts uncertainties.
    """

    model: Model
    values: np.ndarray
    held: tuple[str, ...] = ()
    condition: float | None = None
    estimate: Estimate | None = None

    @property
    def free(self) -> int:
        """Number of the arm's parameters that the method moved."""
        return len(self.values) - len(self.held)


Solve = Callable[[Scene, tuple[str, ...]], Solution]


@dataclass(frozen=True)
class Method:
    """A way to calibrate.

    `missing` states what a session lacks for it, or ""; `solve` fits a scene with some effects.
    """

    name: str
    source: str  # whose idea it is
    idea: str  # in a line
    missing: Callable[[Model], str]
    solve: Solve


def where_it_stands(solve: Solve) -> Solve:
    """The same, done again with the gravity moments at the fitted poses: see `calibrated`."""

    def twice(scene: Scene, effects: tuple[str, ...]) -> Solution:
        first = solve(scene, effects)
        if scene.moments is None or not effects:
            return first
        return solve(standing(first.model, first.values), effects)

    return twice


def nominal(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """The nominal arm."""
    model = build(scene, effects)
    return Solution(model, np.zeros(len(model.parameters)), tuple(p.name for p in model.parameters))


NOMINAL = Method("nominal", "", "the robot file without calibration", lambda model: "", nominal)
