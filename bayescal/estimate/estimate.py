"""The estimate: the most probable parameters, their covariance, row weights and outliers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.chain import link_angles
from bayescal.effects import compliances
from bayescal.estimate.checks import check_converged, check_length, check_within_reach
from bayescal.estimate.linear import Linear, linearise
from bayescal.estimate.noise import rescaled_weights
from bayescal.estimate.outliers import without_outliers
from bayescal.estimate.solver import solve
from bayescal.estimate.weights import Weights, unit_weights
from bayescal.model.block import ARM, Block
from bayescal.model.model import Model, build
from bayescal.model.parts import Part
from bayescal.model.scene import Scene

ROUNDS = 25
"""Maximum number of reweightings."""


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

    @property
    def sd(self) -> np.ndarray:
        """Posterior standard deviations of z, (D,)."""
        return np.sqrt(np.diag(self.covariance))

    def residuals(self, block: Block, z: np.ndarray | None = None) -> np.ndarray:
        """Residuals (..., rows, C), m, of a block, at the estimate or at other z (..., D)."""
        z = self.z if z is None else z
        slices = self.model.slices
        return block.residual(self.model.deviations(z[..., slices[ARM]]), z[..., slices[block.target]])


def calibrated(
    scene: Scene,
    effects: tuple[str, ...],
    prior_width: float = 1.0,
    robust: bool = True,
    without: Sequence[Part] = (),
) -> Estimate:
    """Fit a model, then fit it again with the gravity moments at the fitted pose of the arm.

    With nominal moments the error of a compliance is several standard deviations, and larger with a payload;
    the residuals do not show it. A model that gravity does not act on is fitted once.
    """
    found = estimate(build(scene, effects, prior_width, without), robust=robust)
    if not effects or scene.moments is None:
        return found
    model = build(settled(found), effects, prior_width, without)
    if same_motion(found.model, model):
        return replace(found, model=model)
    # a tilt may give a torque to a joint that had none: the two models' parameters are matched by name
    known = dict(zip(found.model.names, found.z.tolist(), strict=True))
    return estimate(model, robust=robust, start=np.array([known.get(name, 0.0) for name in model.names]))


def same_motion(a: Model, b: Model) -> bool:
    """Whether two models of the same rows have equal nominal angles, parameters and drivers."""
    return (
        np.array_equal(a.scene.q, b.scene.q)
        and len(a.parameters) == len(b.parameters)
        and all(p.same(q) for p, q in zip(a.parameters, b.parameters, strict=True))
    )


def settled(fitted: Estimate) -> Scene:
    """The scene with its gravity moments at the fitted pose of the arm, including its deflection."""
    model = fitted.model
    return standing(model, model.deviations(fitted.z[model.slices[ARM]]))


def standing(model: Model, values: np.ndarray) -> Scene:
    """The scene with its gravity moments and compliances at the pose of the arm for deviations (P,), SI."""
    scene = model.scene
    delta = model.motion(np.arange(len(scene.q))).displacements(values)
    # the model's reference includes the deflection by the robot file's compliances; the statics' does not
    delta[:, 1:-1, 0] += scene.q - link_angles(scene.dataset.robot, scene.dataset.measurements.readings)
    return scene.posed_at(delta, compliances(model.parameters, values))


def estimate(
    model: Model,
    robust: bool = True,
    start: np.ndarray | None = None,
    left_out: np.ndarray | None = None,
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
    weights = unit_weights(model, z)
    z, covariance, iterations = solve(model, weights, z)
    weights = replace(unit_weights(model, z), scale=weights.scale)
    if left_out is not None:
        row = {b.name: (~np.isin(b.rows, left_out)).astype(float) for b in model.blocks}
        weights = replace(weights, row=row)
    elif robust:
        z, weights, more = without_outliers(model, z, weights)
        iterations += more
    for _ in range(ROUNDS):
        z, covariance, more = solve(model, weights, z)
        iterations += more
        linear = linearise(model, z, weights)
        cov = covariance()
        rescaled, dof = rescaled_weights(model, weights, linear, cov)
        if max(abs(np.log(rescaled.scale[g] / weights.scale[g])) for g in weights.scale) < 1e-4:
            break
        weights = rescaled
    check_converged(linear, cov, z)
    check_within_reach(model, z)
    rejected = np.concatenate([b.rows[weights.row[b.name] == 0.0] for b in model.blocks])
    return Estimate(model, z, cov, weights, linear, iterations, np.unique(rejected), dof)
