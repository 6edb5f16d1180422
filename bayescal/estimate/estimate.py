"""The estimate: the most probable parameters, their covariance, row weights and outliers.

Solutions are refused without a known length, not converged, or beyond the range of the model; sessions with
too few rows to calibrate an arm.

Compliances through which an added mass acts, from fit to fit.

The deflection by a payload that was not stated is the product of its mass and a compliance. A fit takes the
compliance of the fit before. Where the tool alone loads a joint, both are confounded: the more compliance
is taken, the less is found, by the mass in units of the tool's. Fits alternate, and diverge for a payload
that is heavier than the tool. Anderson's acceleration (several secants at once) of this iteration converges
in a few fits: D. G. Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12 (1965)
547-560.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from bayescal.arm.kernel import MAX_ANGLE
from bayescal.dataset.consistency import contradictions
from bayescal.effects import MODELS, Parameter
from bayescal.errors import BayescalError
from bayescal.estimate.outliers import without_outliers
from bayescal.estimate.solver import (
    Evaluations,
    Linear,
    Weights,
    linearise,
    rescaled_weights,
    solve,
    unit_weights,
)
from bayescal.model.block import ARM, Block
from bayescal.model.equilibrium import STILL, by_name, moved, standing, tool_points
from bayescal.model.model import ORIENTATION, Model, build, with_parameters
from bayescal.model.options import USUAL, FitOptions
from bayescal.model.scene import Scene


def acts(parameters: Sequence[Parameter]) -> bool:
    """Whether a parameter is an added mass."""
    return any(p.driver.kind in ("mass", "load") for p in parameters)


@dataclass(frozen=True)
class Secants:
    """Compliances, SI, by parameter, that each fit took and found."""

    history: tuple[tuple[Mapping[str, float], Mapping[str, float]], ...] = ()

    def next(self, scene: Scene, took: Mapping[str, float]) -> tuple[Scene, Secants]:
        """The scene of a further fit, from the scene with the compliances that the last fit found.

        Parameters
        ----------
        scene : Scene
        took : mapping
            Compliances that the last fit took; none if it took typical ones.
        """
        compliances = scene.compliances
        every = (*self.history, (took, compliances))
        kept = [(a, b) for a, b in every if a.keys() >= compliances.keys() <= b.keys()]
        now = Secants(tuple(kept))
        if len(kept) < 2:
            return scene, now
        x, g = (np.array([[pair[k][name] for name in compliances] for pair in kept]) for k in (0, 1))
        size = np.max(np.abs(g), axis=0) + np.finfo(float).tiny
        residual = (g - x) / size
        share = np.linalg.lstsq(np.diff(residual, axis=0).T, residual[-1], rcond=1e-6)[0]
        mixed = g[-1] - share @ np.diff(g, axis=0)
        assert scene.stance is not None
        values = dict(zip(compliances, mixed.tolist(), strict=True))
        return scene.posed_at(scene.stance, values), now


ROUNDS = 25
"""Maximum number of reweightings."""
FITS = 20
"""Maximum number of fits with gravity moments at the pose of the fit before; usual are three or four."""
AT_REST, MOVES = 1e-3, 0.1
"""Displacements of the TCP by such a fit, in units of the smallest noise: at which the fits end, and
from which on their result after the last is refused (conventions)."""


@dataclass(frozen=True)
class Estimate:
    """The most probable parameters, their covariance, row weights and outliers."""

    model: Model
    z: np.ndarray  # (D,)
    covariance: np.ndarray  # (D, D), of z
    weights: Weights
    linear: Linear
    iterations: int
    rejected: np.ndarray  # rows of the session rejected as outliers
    dof: Mapping[str, float]  # residual degrees of freedom of each noise group
    held: tuple[str, ...] = ()  # parameters at their bound: see `bounds`
    least: Mapping[str, float] = field(default_factory=dict)  # smallest variances of a discrepancy, by family

    @property
    def arm(self) -> np.ndarray:
        """Deviations of the arm's parameters from nominal, (P,), SI."""
        return self.model.deviations(self.z[self.model.slices[ARM]])

    @property
    def sd(self) -> np.ndarray:
        """Posterior standard deviations of z, (D,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def from_free(self) -> np.ndarray:
        """Difference (D,) of z from the most probable one without bounds: minus a Newton step."""
        if not self.held:
            return np.zeros(len(self.z))
        return self.covariance @ (self.linear.jacobian.T @ self.linear.residual + self.z)

    def residuals(self, block: Block, z: np.ndarray | None = None) -> np.ndarray:
        """Residuals (..., rows, C), m, of a block, at the estimate or at other z (..., D)."""
        z = self.z if z is None else z
        slices = self.model.slices
        return block.residual(self.model.deviations(z[..., slices[ARM]]), z[..., slices[block.target]])


def fitted_level(scene: Scene, effects: tuple[str, ...], options: FitOptions) -> Estimate:
    """Fit a model level: as `calibrated`, and without effects the targets of the nominal arm alone."""
    if effects:
        return calibrated(scene, effects, options)
    return estimate(with_parameters(scene, (), ()), options.robust)


def calibrated(scene: Scene, effects: tuple[str, ...], options: FitOptions = USUAL) -> Estimate:
    """Fit a model with the gravity moments at the pose where the fitted arm stands.

    With nominal moments the error of a compliance is several standard deviations, and larger with a payload;
    the residuals do not show it. The model is therefore fitted again until moments at the fitted pose move no
    TCP by a thousandth of the noise; the first two fits search for outliers. A model that gravity does
    not act on is fitted once.

    Raises
    ------
    BayescalError
        As `estimate`, or if the poses of the fits do not converge.
    """
    fitted = estimate(build(scene, effects, options), options.robust)
    if not effects or scene.moments is None:
        return fitted
    secants = Secants()
    for fits in range(1, FITS):
        model, before, values = build(settled(fitted), effects, options), fitted.model, fitted.arm
        now = by_name(model, values, before)
        step, noise = moved(tool_points(before, values), tool_points(model, now)), smallest_noise(fitted)
        # a moment that is zero where the arm is nominal has a compliance where it stands
        rests = step < max(STILL, AT_REST * noise) and model.names == before.names
        if same_motion(before, model) or rests:
            return replace(fitted, model=model, linear=linearise(model, fitted.z, fitted.weights))
        if acts(model.parameters):
            there, secants = secants.next(model.scene, before.scene.compliances)
            model = build(there, effects, options)
        previous = dict(zip(before.names, fitted.z.tolist(), strict=True))
        start = np.array([previous.get(name, 0.0) for name in model.names])
        rejected = None if fits == 1 else fitted.rejected
        fitted = estimate(model, options.robust, start, rejected)
    if step < MOVES * noise:
        return fitted
    what = f"deflections by gravity still change by {1e6 * step:.3g} µm between fits, after {FITS} of them"
    raise BayescalError(what, "compliance", "check masses (kg), payload (kg) and gravity (m/s2)")


def at_solution(model: Model, z: np.ndarray, rejected: np.ndarray) -> Estimate:
    """The estimate of a model whose solution is known: noise scales and covariance follow from the residuals.

    Parameters
    ----------
    model : Model
    z : np.ndarray, shape (D,)
        Its most probable unknowns.
    rejected : np.ndarray of int
        Rows of the session that do not count.
    """
    weights = unit_weights(model, z)
    weights = replace(weights, row={b.name: (~np.isin(b.rows, rejected)).astype(float) for b in model.blocks})
    for _ in range(ROUNDS):
        linear = linearise(model, z, weights)
        covariance = np.linalg.inv(linear.jacobian.T @ linear.jacobian + np.eye(model.size))
        rescaled, dof = rescaled_weights(model, weights, linear, covariance)
        if max(abs(np.log(rescaled.scale[g] / weights.scale[g])) for g in weights.scale) < 1e-4:
            break
        weights = rescaled
    return Estimate(model, z, covariance, weights, linear, 0, np.unique(rejected), dof)


def unfitted(model: Model, z: np.ndarray, covariance: np.ndarray | None = None) -> Estimate:
    """A model at z (D,), with the stated noise, as if it were fitted; the covariance is that of the prior."""
    weights = unit_weights(model, z)
    covariance = np.eye(model.size) if covariance is None else covariance
    linear = linearise(model, z, weights)
    return Estimate(model, z, covariance, weights, linear, 0, np.zeros(0, int), {})


def smallest_noise(fitted: Estimate) -> float:
    """Smallest standard uncertainty of a fitted residual, m, of lengths."""
    w, lengths = fitted.weights, [b for b in fitted.model.blocks if b.group != ORIENTATION]
    return min(float(np.min(w.sigma[b.name])) * w.scale[b.group] for b in lengths)


def same_motion(a: Model, b: Model) -> bool:
    """Whether two models of the same rows have equal nominal angles, parameters and drivers."""
    alike = np.array_equal(a.scene.q, b.scene.q) and len(a.parameters) == len(b.parameters)
    return alike and all(p.same(q) for p, q in zip(a.parameters, b.parameters, strict=True))


def settled(fitted: Estimate) -> Scene:
    """The scene with its gravity moments at the fitted pose of the arm, including its deflection."""
    return standing(fitted.model, fitted.arm)


def estimate(
    model: Model, robust: bool = True, start: np.ndarray | None = None, left_out: np.ndarray | None = None
) -> Estimate:
    """Fit a model to its contacts.

    Parameters
    ----------
    model : Model
    robust : bool
        Reject outliers.
    start : np.ndarray, shape (D,), optional
        Initial z; default: the nominal robot.
    left_out : np.ndarray of int, optional
        Rows of the session to reject; if given, no other outliers are searched for.

    Outliers are searched for with Student t weights, row by row, and then rejected entirely, so that the
    covariance is that of the remaining contacts. The noise scale of each group is estimated with the
    fit; the stated noise has the weight of `STATED_WORTH` contacts.

    Raises
    ------
    BayescalError
        If no length is known, the fit did not converge, or the solution is beyond the range of the model.
    """
    check_length(model)
    z = np.zeros(model.size) if start is None else start
    weights, evaluations = unit_weights(model, z), Evaluations(model)
    z, covariance, iterations = solve(model, weights, z, evaluations)
    weights = replace(unit_weights(model, z), scale=weights.scale)
    if left_out is not None:
        row = {b.name: (~np.isin(b.rows, left_out)).astype(float) for b in model.blocks}
        weights = replace(weights, row=row)
    elif robust:
        z, weights, more = without_outliers(model, z, weights, evaluations)
        iterations += more
    for _ in range(ROUNDS):
        z, covariance, more = solve(model, weights, z, evaluations)
        iterations += more
        linear = linearise(model, z, weights, evaluations)
        cov = covariance()
        rescaled, dof = rescaled_weights(model, weights, linear, cov)
        if max(abs(np.log(rescaled.scale[g] / weights.scale[g])) for g in weights.scale) < 1e-4:
            break
        weights = rescaled
    check_converged(linear, cov, z, [f"{c.what} ({c.remedy})" for c in contradictions(model.scene.dataset)])
    check_within_reach(model, z)
    rejected = np.concatenate([b.rows[weights.row[b.name] == 0.0] for b in model.blocks])
    return Estimate(model, z, cov, weights, linear, iterations, np.unique(rejected), dof)


LARGEST_SCALE_SD = 5e-3
"""Relative standard deviation of the arm's size beyond which it counts as not identifiable."""
LARGEST_STEP = 0.1
"""Maximum distance of a converged solution from its optimum, in posterior standard deviations."""


def is_dimension(p: Parameter) -> bool:
    """Whether a parameter is a length or an angle of the arm."""
    return p.effect in MODELS and MODELS[p.effect].dimensions


def check_length(model: Model) -> None:
    """Refuse a model in which the arm's size is not identifiable: the fit would shrink the arm, unnoticed."""
    lengths = [p for p in model.parameters if p.unit == "m" and is_dimension(p) and p.nominal]
    if model.knows_length or not lengths:
        return
    # least squares of a common factor on the lengths, from their priors alone; a ball's radius does not count
    size = sum(p.nominal**2 for p in lengths)
    sd = float(np.sqrt(sum((p.nominal * p.sd) ** 2 for p in lengths)) / size)
    if not sd < LARGEST_SCALE_SD:
        raise BayescalError(
            f"no length is known: the priors leave the size of the arm uncertain to {100 * sd:.2g} %, "
            "and a fit would shrink it",
            "dataset.yaml",
            "certify a distance between two fitted targets (certificates: parallel or distance), "
            "or keep the priors (--prior-width 1)",
        )


def check_converged(
    linear: Linear, covariance: np.ndarray, z: np.ndarray, suspects: Sequence[str] = ()
) -> None:
    """Refuse a solution that a Newton step would still move by a tenth of a standard deviation.

    `suspects` are contradictions in the session, which the message then names as the probable reason.
    """
    step = covariance @ (linear.jacobian.T @ linear.residual + z)
    distance = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)), initial=0.0))
    if not distance < LARGEST_STEP:
        short = f"{distance:.2g} standard deviations short of its optimum"
        what = f"the fit stopped {short if np.isfinite(distance) else 'without a solution'}"
        reasons = "the robot file, the units of the readings and the nominal positions of the targets"
        raise BayescalError(what, "dataset.yaml", f"check {'; '.join(suspects[:1]) or reasons}")


def check_within_reach(model: Model, z: np.ndarray) -> None:
    """Refuse a solution with rotations beyond the range of the chain's series, or of any plausible error."""
    values = model.deviations(z[model.slices[ARM]])
    for value, p in zip(values, model.parameters, strict=True):
        if p.unit == "rad" and abs(value) > MAX_ANGLE and is_dimension(p):
            what = f"the fit changes {p.name} by {np.degrees(value):.0f} deg from its nominal value"
            remedy = "check offset_deg, the signs of link_from_reading and the units of the readings"
            raise BayescalError(what, "robot", remedy)


def check_enough(scene: Scene) -> None:
    """Refuse a session whose rows determine hardly more than the positions of its targets.

    Rows locate the targets first. With the singular values s of the whitened Jacobian of the targets alone,
    sum s^2 / (1 + s^2) of their unknowns are located by rows and certificates, and the same sum over the
    certificates' part by these alone. The difference is the number of rows that the targets need: one for
    each unknown of a target without stated uncertainty, none for a known target (`u_mm: 0`). At least one
    further row per joint is required, for the joint offsets, the minimum of a calibration. The other
    parameters have tolerance priors, so a session may have fewer rows than parameters.

    Raises
    ------
    BayescalError
        With the required number of rows.
    """
    model = with_parameters(scene, (), ())
    numbers = sum(b.residuals for b in model.blocks)  # of the rows; the certificates' residuals follow
    joints = scene.dataset.robot.n
    if numbers - model.size > joints:
        return
    z = np.zeros(model.size)
    jacobian = linearise(model, z, unit_weights(model, z)).jacobian
    located = _determined(jacobian)
    spare = numbers - (located - _determined(jacobian[numbers:]))
    if spare > joints - 0.5:
        return
    rows = len(scene.rows("calibrate"))
    needed = rows + ceil((joints - spare + model.size - located) * rows / numbers - 1e-3)
    word = "row has" if rows == 1 else "rows have"
    raise BayescalError(
        f"{rows} {word} the role calibrate: too few for {joints} joints and {len(model.states)} targets "
        f"({model.size} unknowns)",
        "measurements.csv",
        f"measure {needed} or more: at least one per joint, in addition to those that locate the targets",
    )


def _determined(jacobian: np.ndarray) -> float:
    """Number of unknowns that whitened residuals determine beyond their priors; Jacobian (R, D)."""
    square = np.maximum(np.linalg.eigvalsh(jacobian.T @ jacobian), 0.0)
    return float(np.sum(square / (1.0 + square)))
