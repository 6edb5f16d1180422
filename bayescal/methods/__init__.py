"""Calibration methods of a published survey and of bayescal, compared on one session.

A method answers for the arm alone. Every target that has rows to calibrate with is found from those, with
the method's arm held; then validation planes, spheres and points are assessed as `validate` judges a fit's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import BASELINE
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, check_enough, linearise, unit_weights
from bayescal.estimate.unexplained import unexplained
from bayescal.methods import published
from bayescal.methods.normals import NORMALS
from bayescal.methods.published import Method
from bayescal.methods.solving import Solution
from bayescal.model import ARM, Model, build, check_asked, with_parameters
from bayescal.model.scene import Scene
from bayescal.posterior import gaussian
from bayescal.predict.locate import Rows, locate
from bayescal.predict.validation import Validation, validate
from bayescal.statistics import spawned
from bayescal.storage.stopping import Progress, silent

__all__ = ["METHODS", "Comparison", "Method", "Result", "Row", "Solution", "compare"]

DRAWS = 2000
METHODS = (
    published.NOMINAL, NORMALS, published.PLANES, published.LINEAR, published.INVERSE, published.OPEN_LOOP,
    published.OURS,
)  # fmt: skip


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
    effects: tuple[str, ...] = BASELINE,
    seed: int = 0,
    methods: Sequence[Method] = (),
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
        Default: `METHODS`, and hand-eye solvers for a session with a camera.
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
    validated(published.NOMINAL.solve(scene, effects))  # compiles what is compiled: no method pays for it
    cameras = any(kind.posed for kind in scene.declared)
    methods = methods or (*METHODS, *(published.CAMERA_METHODS if cameras else ()))
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


def located(model: Model, values: np.ndarray) -> np.ndarray:
    """The z of a model with its arm at deviations (P,), SI, and each target where its rows then say it is."""
    z = np.zeros(model.size)
    z[model.slices[ARM]] = (values - model.shift) / model.sd
    for block in model.states:
        kind, p = block.touched(values), block.seen(values)
        sigma = np.tile(block.sigma, (block.kind.rows, 1))
        states, _ = locate(block.target, Rows(kind, p, sigma))
        z[model.slices[block.target]] = states.x[0, block.free] / block.sd
    return z


def validated(solution: Solution) -> Validation:
    """Errors of a method on validation measurements; predicted uncertainties in it are void."""
    model = with_parameters(solution.model.scene, solution.model.effects, solution.model.parameters)
    z = located(model, solution.values)
    weights = unit_weights(model, z)
    unsaid = np.full((model.size, model.size), np.nan)
    estimate = Estimate(model, z, unsaid, weights, linearise(model, z, weights), 0, np.array([], int), {})
    return validate(estimate, z[None], np.ones((1, len(weights.scale))))


def predicted(solution: Solution, seed: int) -> Validation | None:
    """Predicted uncertainties of validation measurements, for a method that has them; else None."""
    estimate = solution.estimate
    if estimate is None:
        return None
    of_draws, of_noise = spawned(seed, 2)
    draws = gaussian(estimate, of_draws, DRAWS)
    return validate(estimate, draws.flat, draws.kappa, unexplained(estimate).excess, of_noise)
