"""A complete calibration: the model levels, the posterior of the last one, and its predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from bayescal.assess.acceptance import Acceptance, acceptance, anew, discrepancy, not_physical, widened
from bayescal.assess.budget import Budget, of_distances, with_budgets
from bayescal.assess.conformance import Tolerance, check_tolerance, conformance
from bayescal.assess.findings import SEVERITIES, Assessed, Finding, findings, rests_on_priors
from bayescal.assess.identifiability import Directions, Identifiability, directions, identifiability
from bayescal.assess.inputs import Basis
from bayescal.assess.mistakes import judged, mistaken
from bayescal.assess.shared_causes import completed, judged_level, rejected_share
from bayescal.assess.undetermined import Undetermined, undetermined
from bayescal.dataset import Dataset
from bayescal.effects import BASELINE, levels_of, parameters_of, possible
from bayescal.estimate import Estimate, check_enough, fitted_level
from bayescal.estimate.bounds import UNCHANGED, Rigid, bounded, with_latent_readings
from bayescal.estimate.discrepancy import Stated, stated
from bayescal.estimate.scatter import scattered
from bayescal.estimate.unexplained import FaceCheck, Unexplained, unexplained
from bayescal.estimate.widths import Widened, Width, with_widths
from bayescal.model import USUAL, FitOptions
from bayescal.model.scene import Scene
from bayescal.posterior import Draws, approximate, gaussian
from bayescal.predict.forecast import Forecast, forecast
from bayescal.predict.targets import Prepared, check_located, leaving_out, prepared
from bayescal.predict.validation import Validation, validate
from bayescal.statistics import spawned
from bayescal.storage.stopping import Progress, silent

if TYPE_CHECKING:
    from bayescal.posterior.checkpoint import Checkpoint  # and emcee with it

VALIDATION_DRAWS = 2000
MOST_PREDICTED, FEWEST_VALIDATION_DRAWS = 1_000_000, 400
"""Predictions of single validation measurements, beyond which each has fewer draws: 500 rows (cost)."""
NOMINAL = ("nominal",)

GROSS = ("many_rejected", "not_flat", "far_from_nominal", "negative")
"""Findings behind which a gross mistake of a stated value is looked for, as behind every error."""


@dataclass(frozen=True)
class ModelLevel:
    """One model level: its estimate and its prediction of the validation measurements."""

    effects: tuple[str, ...]
    estimate: Estimate
    unexplained: Unexplained
    validation: Validation


@dataclass(frozen=True)
class Fit:
    """A calibration with all its results."""

    dataset: Dataset
    options: FitOptions
    levels: tuple[ModelLevel, ...]  # nominal first, the fitted model last
    stated: Stated  # the last level with its stated uncertainty
    sampled: Draws  # the posterior of the model
    draws: Draws  # the same with the stated uncertainty
    identifiability: Identifiability
    undetermined: tuple[Undetermined, ...]
    faces: tuple[FaceCheck, ...]
    forecast: Forecast
    directions: Directions
    acceptance: Acceptance
    findings: tuple[Finding, ...]
    basis: Basis  # the stated uncertainty, from which the budget of any quantity follows
    tolerance: Tolerance | None = None  # conformance decisions, where a tolerance was given
    rigid: Rigid = UNCHANGED  # parameters that the fit set to rigid
    widths: tuple[Width, ...] = ()  # families with wider priors than stated

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as text."""
        return tuple(f.text for f in self.findings)

    @cached_property
    def budgets(self) -> Mapping[tuple[str, str], Budget]:
        """The budget of the error of each certified distance, by its ends."""
        return of_distances(self.basis)

    @property
    def final(self) -> ModelLevel:
        """The requested model level."""
        return self.levels[-1]


def usual_model(dataset: Dataset) -> tuple[str, ...]:
    """The effects of `BASELINE` for which a session has what they need."""
    return possible(BASELINE, Scene(dataset).circumstances()) or BASELINE


def fit(
    dataset: Dataset,
    effects: tuple[str, ...] = BASELINE,
    options: FitOptions = USUAL,
    *,
    without: Sequence[str] = (),
    samples: int = 5000,
    progress: Progress = silent,
    checkpoint: Checkpoint | None = None,
) -> Fit:
    """Calibrate an arm from a session.

    Parameters
    ----------
    dataset : Dataset
    effects : tuple of str
        The model: names of `effects.MODELS`.
    options : FitOptions
        Of the fit; prior widths by family are told by the data.
    without : sequence of str
        Parts of the effects that stay nominal: 'geometry at joint 4'; see `Part`.
    samples : int
        Requested effective draws of every parameter; 0: Gaussian approximation only.
    progress : callable
        Called with the stage and its completed fraction.
    checkpoint : Checkpoint, optional
        Where the state of a long sampling is kept; an interrupted run continues.

    Raises
    ------
    BayescalError
        If the session cannot be fitted, or the model has no such part, with the reason.
    """

    def compute(some: Dataset) -> Fit:
        return _fit(some, effects, options, without, samples, progress, checkpoint)

    result, reasons = leaving_out(dataset, compute)
    every = (*result.findings, *(Finding("not_located", "warning", words) for words in reasons.values()))
    return replace(result, findings=tuple(sorted(every, key=lambda f: SEVERITIES.index(f.severity))))


def _fit(
    dataset: Dataset, effects: tuple[str, ...], options: FitOptions, without: Sequence[str], samples: int,
    progress: Progress, checkpoint: Checkpoint | None,
) -> Fit:  # fmt: skip
    """A calibration of a session whose validation targets can all be located."""
    scene = Scene(dataset, oriented=True)
    options = replace(options.omitting(without, scene, effects), widths={})
    if options.tolerance is not None:
        check_tolerance(options.tolerance)
    check_enough(scene)
    check_located(scene)
    parameters_of(effects, scene.circumstances(scene.rows("calibrate")))  # before a level is fitted in vain
    of_draws, of_sampler, of_causes, of_noise, of_forecast, of_discrepancy = spawned(options.seed, 6)
    count = predicted_draws(dataset)
    *simpler, full = levels_of(effects)
    progress("estimate", 0.0)

    def fitted(some: Scene, as_stated: FitOptions = options) -> Widened:
        return with_widths(fitted_level(some, full, as_stated), some, full, as_stated)

    scene, (level, options, widths), scatter = scattered(scene, fitted)
    levels: list[ModelLevel] = []
    for k, step in enumerate(simpler, 1):
        progress("estimate", k / (len(simpler) + 1))
        estimated = judged_level(scene, step, options, of_causes)
        excess_error, (z, kappa) = unexplained(estimated), approximate(estimated, of_draws, count)
        checked = validate(estimated, z, kappa, excess_error.excess, of_noise, strict=False)
        levels.append(ModelLevel(estimated.model.effects or NOMINAL, estimated, excess_error, checked))
    # with the form of uneven faces, rejected rows that share a cause, and bounds
    result = completed(level, options.robust, of_causes)
    faces, causes = result.faces, result.causes
    complete, rigid = bounded(with_latent_readings(result.fitted) if options.latent_joints else result.fitted)
    excess_error = unexplained(complete)
    draws = _sampled(complete, samples, of_draws, of_sampler, progress, checkpoint)
    progress("predict", 0.0)
    places = np.linspace(0, len(draws.flat) - 1, min(count, len(draws.flat))).astype(int)
    kappa = draws.kappa[places]
    plain = draws.flat[places]
    checked = validate(complete, plain, kappa, excess_error.excess, of_noise, strict=True)
    tests = acceptance(excess_error, checked, causes, rejected_share(complete), dataset)
    progress("predict", 0.2)
    wide = stated(complete)
    every = wide.draws(draws.flat, np.random.default_rng(of_discrepancy))
    z, located = every[places], prepared(wide.wide, loose=True)
    excess_error, checked, remaining = _restated(wide, located, excess_error, z, kappa, tests, of_noise)
    levels.append(ModelLevel(complete.model.effects or NOMINAL, complete, excess_error, checked))
    progress("predict", 0.8)
    determined, seen = identifiability(complete, wide.limited), directions(complete.model)
    lacking = undetermined(complete, determined)
    basis = _basis(wide, remaining.excess, checked, located)
    expected = with_budgets(forecast(complete, z, checked, remaining.excess, of_forecast, wide.wide), basis)
    checks = (*tests.checks, *not_physical(complete, wide.limited))
    doubts = (*tests.doubts, *discrepancy(wide))
    if (check := anew(scatter, complete)) is not None:
        failed = check.value > check.limit
        checks, doubts = ((*checks, check), doubts) if failed else (checks, (check, *doubts))
    by_data = not rests_on_priors(expected, excess_error)
    tests = replace(tests, checks=checks, doubts=doubts, determined=by_data)
    sd = np.sqrt(np.diag(wide.limited))
    results = Assessed(
        complete, excess_error, checked, expected, lacking, seen, faces, tests, options, rigid, widths, sd
    )
    limitations = findings(results)
    if any(f.severity == "error" or f.code in GROSS for f in limitations):
        tested = judged(dataset)
        mistakes = () if tested is None else mistaken(tested)
        limitations = (*(Finding(m.code, "error", f"{m.what}; {m.remedy}") for m in mistakes), *limitations)
    decided = None
    if options.tolerance is not None:
        decided = conformance(options.tolerance, expected, checked, tests, of_distances(basis))
    progress("done", 1.0)
    return Fit(
        dataset, options, tuple(levels), wide, draws,
        replace(draws, z=wide.reported(every).reshape(draws.z.shape)), determined,
        lacking, faces, expected, seen, tests, limitations, basis, decided, rigid, widths,
    )  # fmt: skip


def _sampled(
    complete: Estimate, samples: int, of_draws: int, of_sampler: int, progress: Progress,
    checkpoint: Checkpoint | None,
) -> Draws:  # fmt: skip
    """Draws of the posterior, or of its Gaussian approximation without `samples`."""
    if not samples:
        return gaussian(complete, of_draws, VALIDATION_DRAWS)
    from bayescal.posterior.sample import sample

    progress("sample", 0.0)
    return sample(complete, samples, of_sampler, partial(progress, "sample"), checkpoint=checkpoint)


def _restated(
    wide: Stated, linearised: Prepared, excess_error: Unexplained, z: np.ndarray, kappa: np.ndarray,
    tests: Acceptance, seed: int,
) -> tuple[Unexplained, Validation, Unexplained]:  # fmt: skip
    """What is unexplained in total, the validation with the stated uncertainty, and what it adds to points.

    A part of the residuals is explained by the discrepancy; errors that validation data show beyond all of
    it are added.
    """
    kappa = kappa * np.sqrt(wide.white)
    remaining = wide.remaining(excess_error)
    checked = validate(wide.wide, z, kappa, remaining.excess, seed, linearised=linearised)
    wider = widened(remaining, checked, tests)
    if wider.excess > remaining.excess:
        checked = validate(wide.wide, z, kappa, wider.excess, seed, linearised=linearised)
        total = np.sqrt(excess_error.excess**2 + wider.excess**2 - remaining.excess**2)
        excess_error = replace(excess_error, excess=float(total))
    return excess_error, checked, wider


def basis_of(estimate: Estimate, seed: int = 0) -> Basis:
    """What a fit states of an estimate, by the Gaussian approximation of its posterior.

    Parameters
    ----------
    estimate : Estimate
    seed : int
        Of the draws by which validation measurements are tested.
    """
    of_draws, of_noise, of_discrepancy = spawned(seed, 3)
    z, kappa = approximate(estimate, of_draws, predicted_draws(estimate.model.scene.dataset))
    excess_error, wide = unexplained(estimate), stated(estimate)
    checked = validate(estimate, z, kappa, excess_error.excess, of_noise)
    tests = acceptance(excess_error, checked, (), rejected_share(estimate))
    every = wide.draws(z, np.random.default_rng(of_discrepancy))
    linearised = prepared(wide.wide, loose=True)
    _, checked, remaining = _restated(wide, linearised, excess_error, every, kappa, tests, of_noise)
    return _basis(wide, remaining.excess, checked, linearised)


def _basis(wide: Stated, excess: float, checked: Validation, linearised: Prepared) -> Basis:
    """The basis of budgets; `excess`, m, of points, beyond the discrepancy."""
    excess_error = unexplained(wide.plain)
    of_residuals = wide.remaining(excess_error).excess
    beyond = max(excess**2 - of_residuals**2, 0.0)
    # beyond the residuals, the unexplained error was estimated from validation measurements
    rows = [len(c.residuals) for c in checked.planes] + [c.residuals.shape[1] for c in checked.points]
    shown = len(checked.distances) or sum(rows)
    below = of_residuals**4 / excess_error.excess_dof + beyond**2 / max(shown, 1)
    return Basis(wide, excess, excess**4 / below if below > 0 else inf, linearised)


def predicted_draws(dataset: Dataset) -> int:
    """Number of draws from which validation data are predicted: `VALIDATION_DRAWS`, fewer of many rows."""
    rows = int(np.sum(dataset.measurements.role == "validate"))
    return min(VALIDATION_DRAWS, max(MOST_PREDICTED // max(rows, 1), FEWEST_VALIDATION_DRAWS))
