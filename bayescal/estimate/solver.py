"""Levenberg-Marquardt on the factor graph: weights of the residuals, linearisation, noise scales.

Cholesky factors of small matrices are those of LAPACK itself: SciPy prepares a call for longer than it takes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtri

from bayescal.estimate.correlated import Decorrelation, Shared, fields
from bayescal.model.block import ARM, Block, Constraint
from bayescal.model.model import Model
from bayescal.model.scene import Scene
from bayescal.statistics import grouped

if TYPE_CHECKING:
    from factors.graph import Function, Graph


@dataclass(frozen=True)
class Weights:
    """Weights of the residuals by block: `sigma` (R,) m at noise scale 1, row weights (C,)."""

    sigma: Mapping[str, np.ndarray]
    row: Mapping[str, np.ndarray]
    scale: Mapping[str, float]  # by noise group
    shared: Mapping[str, Shared] = field(default_factory=dict)  # of images: errors of readings

    @property
    def full(self) -> Weights:
        """The same with full weight for every row; those that had none share no noise."""
        shared = {
            name: s.without(np.tile(self.row[name] == 0, len(s.by) // max(len(self.row[name]), 1)))
            for name, s in self.shared.items()
        }
        return replace(self, row={name: np.ones_like(row) for name, row in self.row.items()}, shared=shared)

    @property
    def apart(self) -> Weights:
        """The same with independent noise of every row."""
        return replace(self, shared={}) if self.shared else self

    def whitening(self, block: Block) -> np.ndarray:
        """Factors (R,) on a block's residuals, over the noise of each."""
        row = np.tile(self.row[block.name], block.kind.rows)
        return np.sqrt(row) / (self.sigma[block.name] * self.scale[block.group])

    def decorrelation(self, block: Block) -> Decorrelation | None:
        """What whitens a block's residuals over the noise of each; None where they are independent."""
        shared = self.shared.get(block.name)
        return None if shared is None else shared.decorrelated(np.tile(self.row[block.name], block.kind.rows))


def shared_errors(model: Model, z: np.ndarray, block: Block) -> np.ndarray:
    """Standard errors (R, n) of the residuals of a block, m, that the residuals of an image share.

    Those of the readings (of any rows), and those of the image itself.
    """
    scene, (joint, share) = model.scene, model.scene.dataset.reading_noise
    noise, out = scene.dataset.noise, []
    if joint > 0:
        coupling, slices = scene.dataset.robot.link_from_reading * share, model.slices
        arm, state = model.deviations(z[slices[ARM]]), z[slices[block.target]]
        out.append(joint * block.by_readings(arm, state, coupling))
    if noise.field > 0 and scene.in_images[block.rows].all():
        out.append(noise.field * of_images(scene, block, noise.power))
    return np.hstack(out) if out else np.zeros((block.residuals, 0))


def of_images(scene: Scene, block: Block, power: int) -> np.ndarray:
    """Errors (R, n) of the images of a block of corners, each of the size of the noise of a corner, m."""
    m = scene.dataset.measurements
    image = np.unique(m.readings[block.rows], axis=0, return_inverse=True)[1].ravel()
    assert m.pixel is not None
    by = fields(m.pixel[block.rows, :2], image, power)
    return np.tile(block.sigma, block.kind.rows)[:, None] * by


def unit_weights(model: Model, z: np.ndarray) -> Weights:
    """Full weight for every contact, at its stated noise, plus the errors that residuals share, at z."""
    sigma, shared = {}, {}
    for block in model.blocks:
        noise, by = np.tile(block.sigma, block.kind.rows), shared_errors(model, z, block)
        if by.shape[1]:
            noise = np.sqrt(noise**2 + np.sum(by**2, axis=1))
            if model.scene.in_images[block.rows].all():
                readings = model.scene.dataset.measurements.readings[block.rows]
                shared[block.name] = Shared.of(by / noise[:, None], readings)
        sigma[block.name] = noise
    row = {block.name: np.ones(len(block.rows)) for block in model.blocks}
    return Weights(sigma, row, {block.group: 1.0 for block in model.blocks}, shared)


@dataclass(frozen=True)
class Linear:
    """The problem linearised at z, whitened, without the prior: contacts of each block, then constraints."""

    residual: np.ndarray  # (R,)
    jacobian: np.ndarray  # (R, D)
    of_block: Mapping[str, slice]  # rows of each block's contacts, by the block's name


class _Last:
    """A function of arrays that keeps its last result, for the point at which it is asked for again."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.point, self.result = function, b"", None

    def __call__(self, *point: np.ndarray) -> Any:
        here = b"".join([part.tobytes() for part in point])
        if self.result is None or self.point != here:
            self.point, self.result = here, self.function(*point)
        return self.result


class Evaluations:
    """Residuals and slopes of a model's blocks and constraints, each kept for the point asked for last.

    The solver, the search for outliers and the noise ask for the same points one after another, with other
    weights. The arrays are not whitened, and not to be changed.

    Attributes
    ----------
    blocks : list of callable
        Of the arm's z and the target's: residuals (R,), m, and slopes by both, (R, P) and (R, size).
    constraints : list of callable
        Of the z of the constraint's variables: as `Model.linearised`.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.blocks = [_Last(partial(self._block, block)) for block in model.blocks]
        self.constraints = [_Last(partial(self._constraint, c)) for c in model.constraints]

    def _block(
        self, block: Block, arm: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r, by_arm, by_target = block.linearise(self.model.deviations(arm), target)
        by_arm *= self.model.sd
        return r, by_arm, by_target

    def _constraint(
        self, constraint: Constraint, *parts: np.ndarray
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        return self.model.linearised(constraint, dict(zip(constraint.variables, parts, strict=True)))


def linearise(
    model: Model, z: np.ndarray, weights: Weights, evaluations: Evaluations | None = None
) -> Linear:
    """Whitened residuals and Jacobian at z, in NumPy arrays; from evaluations of the model, where given."""
    evaluations = evaluations or Evaluations(model)
    count = sum(b.residuals for b in model.blocks) + sum(t.rows for t in model.constraints)
    residual, jacobian, of_block, start = np.empty(count), np.zeros((count, model.size)), {}, 0
    arm = model.slices[ARM]
    for block, evaluate in zip(model.blocks, evaluations.blocks, strict=True):
        target, rows = model.slices[block.target], slice(start, start + block.residuals)
        r, by_arm, by_target = evaluate(z[arm], z[target])
        whiten, apart = weights.whitening(block), weights.decorrelation(block)
        residual[rows] = r * whiten
        # in place: of a large session each copy counts
        np.multiply(by_arm, whiten[:, None], out=jacobian[rows, arm])
        jacobian[rows, target] = by_target * whiten[:, None]
        if apart is not None:
            residual[rows], jacobian[rows] = apart.white(residual[rows]), apart.white(jacobian[rows])
        of_block[block.name] = rows
        start = rows.stop
    for constraint, evaluate in zip(model.constraints, evaluations.constraints, strict=True):
        rows = slice(start, start + constraint.rows)
        residual[rows], by = evaluate(*(z[model.slices[name]] for name in constraint.variables))
        for name, slope in by.items():
            jacobian[rows, model.slices[name]] = slope
        start = rows.stop
    return Linear(residual, jacobian, of_block)


def root(covariance: np.ndarray) -> np.ndarray:
    """Factor L (D, D) with L L' = covariance, also of a nearly singular covariance."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def solve(
    model: Model, weights: Weights, start: np.ndarray, evaluations: Evaluations | None = None
) -> tuple[np.ndarray, Callable[[], np.ndarray], int]:
    """Levenberg-Marquardt on the factor graph: a factor per target, a prior per variable, the certificates.

    Parameters
    ----------
    model : Model
    weights : Weights
    start : np.ndarray, shape (D,)
        Initial z.
    evaluations : Evaluations, optional
        Of the model, where other functions use them too.

    Returns
    -------
    z : np.ndarray, shape (D,)
    covariance : callable
        Computes the covariance of z, (D, D), from the graph's marginals.
    iterations : int
    """
    from factors.graph import Graph

    if not model.size:  # no unknowns
        return np.zeros(0), lambda: np.zeros((0, 0)), 0
    slices, evaluations = model.slices, evaluations or Evaluations(model)
    graph = Graph()
    begin = with_variables(graph, model, start)
    for block, evaluate in zip(model.blocks, evaluations.blocks, strict=True):
        names, function = _block_function(bool(model.parameters), block, evaluate, weights)
        if names:  # without unknowns (nominal arm, known target) the residuals are constant
            graph.factor(names, block.residuals, function)
    add_constraints(graph, model, list(begin), evaluations)
    solution, iterations = graph.solve(begin)
    z = np.zeros(model.size)
    for name, value in solution.items():
        z[slices[name]] = value
    return z, lambda: graph.covariance(list(begin)), iterations


def with_variables(graph: Graph, model: Model, start: np.ndarray) -> dict[str, np.ndarray]:
    """Add the arm and all targets with unknowns to a graph; their parts of a start z (D,), by name."""
    begin = {name: start[part] for name, part in model.slices.items() if part.stop > part.start}
    for name, part in begin.items():
        graph.variable(name, len(part))
    return begin


def _block_function(
    arms: bool, block: Block, evaluate: Callable[..., Any], weights: Weights
) -> tuple[list[str], Function]:
    """The variables of a block's stacked contacts, and their whitened residuals as a function of these."""
    whiten, apart, used = weights.whitening(block), weights.decorrelation(block), (arms, bool(block.size))
    across, white = whiten[:, None], apart.white if apart is not None else np.asarray

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        arm = parts[0] if arms else np.zeros(0)
        target = parts[-1] if block.size else np.zeros(0)
        r, *slopes = evaluate(arm, target)
        return white(r * whiten), [white(by * across) for by, use in zip(slopes, used, strict=True) if use]

    return [name for name, use in zip((ARM, block.target), used, strict=True) if use], function


def add_constraints(
    graph: Graph, model: Model, variables: list[str], evaluations: Evaluations | None = None
) -> None:
    """Add the certificates that join at least one variable of the graph."""
    evaluations = evaluations or Evaluations(model)
    for constraint, evaluate in zip(model.constraints, evaluations.constraints, strict=True):
        free = [name for name in constraint.variables if name in variables]
        if free:
            graph.factor(free, constraint.rows, _constraint_function(evaluate, constraint, free))


def _constraint_function(evaluate: Callable[..., Any], constraint: Constraint, free: list[str]) -> Function:
    fixed = dict.fromkeys(constraint.variables, np.zeros(0))  # overridden by the free ones

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        point = fixed | dict(zip(free, parts, strict=True))
        r, by = evaluate(*(point[name] for name in constraint.variables))
        return r, [by[name] for name in free]

    return function


STATED_WORTH = 8.0
"""Weight of the stated noise, in contacts, as a prior of the noise scale (inverse gamma)."""


def by_group(model: Model) -> dict[str, list[Block]]:
    """Blocks by noise group."""
    return grouped((block.group, block) for block in model.blocks)


def rescaled_weights(
    model: Model, weights: Weights, linear: Linear, covariance: np.ndarray
) -> tuple[Weights, dict[str, float]]:
    """Noise scales estimated from the residuals, and their degrees of freedom."""
    leverage = np.einsum("ij,jk,ik->i", linear.jacobian, covariance, linear.jacobian, optimize=True)
    scale, dof = {}, {}
    for group, blocks in by_group(model).items():
        rows = [linear.of_block[b.name] for b in blocks]
        chi2 = sum(float(np.sum(linear.residual[s] ** 2)) for s in rows) * weights.scale[group] ** 2
        count = sum(float(np.sum(weights.row[b.name])) * b.kind.rows for b in blocks)
        dof[group] = max(count - sum(float(np.sum(leverage[s])) for s in rows), 0.0)
        scale[group] = float(np.sqrt((STATED_WORTH + chi2) / (STATED_WORTH + dof[group])))
    return replace(weights, scale=scale), dof


def factored(matrix: np.ndarray) -> np.ndarray:
    """Lower factor L (D, D) of a positive definite matrix (D, D); what is above its diagonal is not used.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite, or not finite.
    """
    factor, failed = dpotrf(matrix, lower=1, clean=0)
    if failed or not np.isfinite(np.diag(factor)).all():
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return factor


def solved(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution x of L L' x = right, of shape (D,) or (D, K) as `right`, with the factor L of `factored`."""
    return _finite(dpotrs(factor, right, lower=1)[0])


def halved(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution x of L x = right, (D, K), with the factor L of `factored`.

    A product with the inverse takes half the time for thousands of columns.
    """
    return _finite(dtrmm(1.0, dtrtri(factor, lower=1)[0], right, lower=1))


def _finite(solution: np.ndarray) -> np.ndarray:
    if not np.isfinite(solution).all():
        raise ValueError("the right-hand side is not finite")
    return solution
