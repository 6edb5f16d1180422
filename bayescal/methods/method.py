"""What all methods share: a session goes in, corrected parameters of the arm come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.methods.solving import RowsOf, Solution, System, contacts, levenberg, part
from bayescal.model import Block, Model, build, standing
from bayescal.model.scene import Scene


@dataclass(frozen=True)
class Method:
    """A way to calibrate: some blocks of the model, their rows, and how these are solved.

    Attributes
    ----------
    name, source, idea : str
        Whose idea it is, and the idea in a line.
    missing : callable
        What a model of a session lacks for it, or "".
    uses : callable
        Whether a block's rows are used.
    rows : callable
        For a model, the equations of a block's rows.
    search : callable
        Solves the system of these equations.
    solver : callable, optional
        Fits a scene with some effects in another way, in place of `rows` and `search`.
    """

    name: str
    source: str
    idea: str
    missing: Callable[[Model], str] = lambda model: ""
    uses: Callable[[Block], bool] = lambda block: True
    rows: Callable[[Model], RowsOf] = lambda model: contacts
    search: Callable[[System], Solution] = levenberg
    solver: Callable[[Scene, tuple[str, ...]], Solution] | None = None

    def solve(self, scene: Scene, effects: tuple[str, ...]) -> Solution:
        """Fit a scene, and again with the gravity moments at the fitted poses: see `calibrated`."""
        solver = self.solver or self._solved
        first = solver(scene, effects)
        if first.settled or scene.moments is None or not effects:
            return first
        return solver(standing(first.model, first.values), effects)

    def _solved(self, scene: Scene, effects: tuple[str, ...]) -> Solution:
        model = part(build(scene, effects), self.uses)
        return self.search(System(model, self.rows(model)))


def nominal(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """The nominal arm."""
    model = build(scene, effects)
    names = tuple(p.name for p in model.parameters)
    return Solution(model, np.zeros(len(names)), names, settled=True)


NOMINAL = Method("nominal", "", "the robot file without calibration", solver=nominal)
