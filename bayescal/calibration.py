"""A complete calibration: the model levels, the posterior of the last one, and its predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np

from bayescal.assess.acceptance import (
    Acceptance,
    Tolerance,
    acceptance,
    check_tolerance,
    conformance,
    widened,
    with_bound,
)
from bayescal.assess.budget import Budget, of_distances, with_budgets
from bayescal.assess.findings import Assessed, Finding, findings, rests_on_priors
from bayescal.assess.identifiability import Directions, Identifiability, directions, identifiability
from bayescal.assess.inputs import Basis
from bayescal.assess.mistakes import judged, mistaken
from bayescal.assess.shared_causes import SharedCause, rejected_share, shared_causes, with_sharing_rows
from bayescal.assess.undetermined import Undetermined, undetermined
from bayescal.dataset import Dataset
from bayescal.effects import parameters_of
from bayescal.effects.geometry import GEOMETRY
from bayescal.effects.joint import JOINT
from bayescal.effects.selection import plain
from bayescal.estimate import Estimate, calibrated, check_enough, estimate
from bayescal.estimate.bounds import UNCHANGED, Rigid, bounded, with_latent_readings
from bayescal.estimate.discrepancy import Stated, stated
from bayescal.estimate.unexplained import FORM, FaceCheck, Unexplained, check_faces, unexplained, with_form
from bayescal.model import check_asked, with_parameters
from bayescal.model.block import parts_of
from bayescal.model.scene import Scene
from bayescal.posterior import Draws, approximate, gaussian
from bayescal.posterior.checkpoint import Checkpoint
from bayescal.predict import Forecast, Validation, forecast, validate
from bayescal.predict.targets import Prepared, check_located, prepared
from bayescal.statistics import spawned
from bayescal.storage.stopping import Progress, silent

VALIDATION_DRAWS = 2000
MOST_PREDICTED, FEWEST_VALIDATION_DRAWS = 4_000_000, 400
"""Predictions of single validation measurements, beyond which there are fewer draws of each: 2000 rows."""
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
    seed: int
    prior_width: float
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
    robust: bool = True  # whether outliers were excluded
    without: tuple[str, ...] = ()  # parts of the effects that stay nominal: "geometry at joint 4"
    rigid: Rigid = UNCHANGED  # parameters that the fit set to rigid

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


def fit(
    dataset: Dataset,
    effects: tuple[str, ...] = ("geometry", "compliance"),
    samples: int = 5000,
    seed: int = 0,
    robust: bool = True,
    prior_width: float = 1.0,
    latent_joints: bool = False,
    progress: Progress = silent,
    tolerance: float | None = None,
    without: Sequence[str] = (),
    checkpoint: Checkpoint | None = None,
) -> Fit:
    """Calibrate an arm from a session.

    Parameters
    ----------
    dataset : Dataset
    effects : tuple of str
        The model: names of `effects.MODELS`.
    samples : int
        Requested effective draws of every parameter; 0: Gaussian approximation only.
    seed : int
        The same seed gives the same result.
    robust : bool
        Exclude outliers.
    prior_width : float
        Factor on the prior standard deviations of the arm.
    latent_joints : bool
        Keep the joint readings as variables of the graph.
    progress : callable
        Called with the stage and its completed fraction.
    tolerance : float, optional
        m, of the error of a distance; conformance is decided by ISO 14253-1 (`assess.conformance`).
    without : sequence of str
        Parts of the effects that stay nominal: 'geometry at joint 4'; see `Part`.
    checkpoint : Checkpoint, optional
        Where the state of a long sampling is kept; an interrupted run continues.

    Raises
    ------
    BayescalError
        If the session cannot be fitted, or the model has no such part, with the reason.
    """
    check_asked(effects, prior_width)
    if tolerance is not None:
        check_tolerance(tolerance)
    scene = Scene(dataset, oriented=True)
    parts = parts_of(
        without,
        effects,
        parameters_of(effects, scene.circumstances(scene.rows("calibrate"))) if without else (),
    )
    check_enough(scene)
    check_located(scene)
    of_draws, of_sampler, of_causes, of_noise, of_forecast, of_discrepancy = spawned(seed, 6)
    steps = _steps(effects)
    levels: list[ModelLevel] = []
    faces: tuple[FaceCheck, ...] = ()
    causes: tuple[SharedCause, ...] = ()
    rigid = UNCHANGED
    for k, step in enumerate(steps):
        progress("estimate", k / len(steps))
        if step:
            found = calibrated(scene, step, prior_width, robust, parts)
        else:
            found = estimate(with_parameters(scene, (), ()), robust=robust)
        last = k == len(steps) - 1
        if last:
            faces = check_faces(found)
            uneven = tuple(f.target for f in faces if f.uneven)
            if uneven and effects and FORM not in map(plain, effects):
                found = with_form(found.model.scene, found, uneven, robust)
            causes = shared_causes(found, of_causes) if robust else ()
            if causes:
                found = with_sharing_rows(found, causes)
            if latent_joints:
                found = with_latent_readings(found)
            found, rigid = bounded(found)
        left = unexplained(found)
        if not last:
            z, kappa = approximate(found, of_draws, predicted_draws(dataset))
        else:
            if samples:
                progress("sample", 0.0)
                from bayescal.posterior.sample import sample

                draws = sample(
                    found,
                    samples,
                    of_sampler,
                    lambda fraction: progress("sample", fraction),
                    checkpoint=checkpoint,
                )
            else:
                draws = gaussian(found, of_draws, VALIDATION_DRAWS)
            progress("predict", 0.0)
            places = _places(draws, predicted_draws(dataset))
            z, kappa = draws.flat[places], draws.kappa[places]
        checked = validate(found, z, kappa, left.excess, of_noise, strict=last)
        if last:
            tests = acceptance(left, checked, causes, rejected_share(found), dataset)
            progress("predict", 0.2)
            wide = stated(found)
            every = wide.draws(draws.flat, np.random.default_rng(of_discrepancy))
            z = every[places]
            known = prepared(wide.wide, loose=True)
            left, checked, rest = _restated(wide, known, left, z, kappa, tests, of_noise)
        levels.append(ModelLevel(found.model.effects or NOMINAL, found, left, checked))
    progress("predict", 0.8)
    determined, seen = identifiability(found), directions(found.model)
    lacking = undetermined(found, determined)
    basis = _basis(wide, rest.excess, checked, known)
    expected = with_budgets(forecast(found, z, checked, rest.excess, of_forecast, wide.wide), basis)
    tests = replace(tests, determined=not rests_on_priors(expected, left))
    tests = with_bound(tests, found, wide.limited)
    told = findings(Assessed(found, left, checked, expected, lacking, seen, faces, tests, prior_width, rigid))
    if any(f.severity == "error" or f.code in GROSS for f in told):
        tested = judged(dataset)
        mistakes = () if tested is None else mistaken(tested)
        told = (*(Finding(m.code, "error", f"{m.what}; {m.remedy}") for m in mistakes), *told)
    decided = None
    if tolerance is not None:
        decided = conformance(tolerance, expected, checked, tests, of_distances(basis))
    progress("done", 1.0)
    return Fit(
        dataset, seed, prior_width, tuple(levels), wide, draws,
        replace(draws, z=wide.reported(every).reshape(draws.z.shape)), determined,
        lacking, faces, expected, seen, tests, told, basis, decided, robust, tuple(map(str, parts)), rigid,
    )  # fmt: skip


def _restated(
    wide: Stated, known: Prepared, left: Unexplained, z: np.ndarray, kappa: np.ndarray, tests: Acceptance,
    seed: int,
) -> tuple[Unexplained, Validation, Unexplained]:  # fmt: skip
    """What is unexplained in total, the validation with the stated uncertainty, and what it adds to points.

    A part of the residuals is explained by the discrepancy; errors that validation data show beyond all of
    it are added.
    """
    kappa = kappa * np.sqrt(wide.white)
    rest = wide.remaining(left)
    checked = validate(wide.wide, z, kappa, rest.excess, seed, known=known)
    wider = widened(rest, checked, tests)
    if wider.excess > rest.excess:
        checked = validate(wide.wide, z, kappa, wider.excess, seed, known=known)
        total = np.sqrt(left.excess**2 + wider.excess**2 - rest.excess**2)
        left = replace(left, excess=float(total))
    return left, checked, wider


def basis_of(found: Estimate, seed: int = 0) -> Basis:
    """What a fit states of an estimate, by the Gaussian approximation of its posterior.

    Parameters
    ----------
    found : Estimate
    seed : int
        Of the draws by which validation measurements are tested.
    """
    of_draws, of_noise, of_discrepancy = spawned(seed, 3)
    z, kappa = approximate(found, of_draws, predicted_draws(found.model.scene.dataset))
    left, wide = unexplained(found), stated(found)
    tests = acceptance(left, validate(found, z, kappa, left.excess, of_noise), (), rejected_share(found))
    every = wide.draws(z, np.random.default_rng(of_discrepancy))
    known = prepared(wide.wide, loose=True)
    _, checked, rest = _restated(wide, known, left, every, kappa, tests, of_noise)
    return _basis(wide, rest.excess, checked, known)


def _basis(wide: Stated, excess: float, checked: Validation, known: Prepared) -> Basis:
    """The basis of budgets; `excess`, m, of points, beyond the discrepancy."""
    left = unexplained(wide.plain)
    own = wide.remaining(left).excess
    beyond = max(excess**2 - own**2, 0.0)
    # beyond the residuals, the unexplained error was estimated from validation measurements
    rows = [len(c.residuals) for c in checked.planes] + [c.residuals.shape[1] for c in checked.points]
    shown = len(checked.distances) or sum(rows)
    below = own**4 / left.excess_dof + beyond**2 / max(shown, 1)
    return Basis(wide, excess, excess**4 / below if below > 0 else inf, known)


def _steps(effects: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Model levels: nominal, joint offsets where the whole geometry follows, then effect by effect."""
    joints = [(JOINT.name,)] if effects[:1] == (GEOMETRY.name,) else []
    return [(), *joints, *(effects[:k] for k in range(1, len(effects) + 1))]


def predicted_draws(dataset: Dataset) -> int:
    """Number of draws from which validation data are predicted: `VALIDATION_DRAWS`, fewer of many rows."""
    rows = int(np.sum(dataset.measurements.role == "validate"))
    return min(VALIDATION_DRAWS, max(MOST_PREDICTED // max(rows, 1), FEWEST_VALIDATION_DRAWS))


def _places(draws: Draws, count: int) -> np.ndarray:
    """Places of at most `count` draws, evenly spaced among all."""
    return np.linspace(0, len(draws.flat) - 1, min(count, len(draws.flat))).astype(int)
