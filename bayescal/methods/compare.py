"""All methods on the same session, with the same calibration and validation measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from bayescal.dataset import Dataset
from bayescal.errors import BayescalError
from bayescal.estimate import check_enough
from bayescal.methods.inverse import INVERSE
from bayescal.methods.linear import LINEAR
from bayescal.methods.method import NOMINAL, Method, Solution
from bayescal.methods.normals import NORMALS
from bayescal.methods.open_loop import OPEN_LOOP
from bayescal.methods.ours import OURS
from bayescal.methods.planes import PLANES
from bayescal.methods.validated import predicted, validated
from bayescal.model import build, check_asked
from bayescal.model.scene import Scene
from bayescal.predict import Validation
from bayescal.storage.stopping import Progress, silent

METHODS = (NOMINAL, NORMALS, PLANES, LINEAR, INVERSE, OPEN_LOOP, OURS)


@dataclass(frozen=True)
class Result:
    """The solution of a method and its errors on validation measurements, SI."""

    solution: Solution
    seconds: float  # of the solution alone, not of its judgement
    validation: Validation
    predicted: Validation | None  # of a method with predicted uncertainty

    @property
    def distance_sd(self) -> float:
        """Predicted standard deviation of a distance, rms over all, m; nan where nothing is predicted."""
        if self.predicted is None or not self.predicted.distances:
            return float("nan")
        return float(np.sqrt(np.mean([np.var(d.predicted) for d in self.predicted.distances])))


@dataclass(frozen=True)
class Row:
    """A method and its result, or the reason why it does not apply."""

    method: Method
    result: Result | None
    why: str = ""


@dataclass(frozen=True)
class Comparison:
    """All methods on one session."""

    dataset: Dataset
    effects: tuple[str, ...]
    seed: int
    rows: tuple[Row, ...]


def compare(
    dataset: Dataset,
    effects: tuple[str, ...] = ("geometry", "compliance"),
    seed: int = 0,
    methods: Sequence[Method] = METHODS,
    progress: Progress = silent,
) -> Comparison:
    """Calibrate a session by every method that it allows.

    Parameters
    ----------
    dataset : Dataset
    effects : tuple of str
        The model of all methods: names of `effects.EFFECTS`.
    seed : int
        Of the draws behind a prediction.
    methods : sequence of Method
    progress : callable
        Called with the method and the fraction done.

    Raises
    ------
    BayescalError
        Where the session allows no model at all.
    """
    check_asked(effects, 1.0)
    scene = Scene(dataset)
    check_enough(scene)
    model = build(scene, effects)
    validated(NOMINAL.solve(scene, effects))  # compiles what is compiled: no method pays for it
    rows = []
    for k, method in enumerate(methods):
        progress(method.name, k / len(methods))
        why = method.missing(model)
        rows.append(Row(method, None, why) if why else _row(method, dataset, effects, seed))
    progress("done", 1.0)
    return Comparison(dataset, effects, seed, tuple(rows))


def _row(method: Method, dataset: Dataset, effects: tuple[str, ...], seed: int) -> Row:
    start = perf_counter()
    try:
        solution = method.solve(Scene(dataset), effects)
        seconds = perf_counter() - start
        return Row(method, Result(solution, seconds, validated(solution), predicted(solution, seed)))
    except BayescalError as error:
        return Row(method, None, error.what)
