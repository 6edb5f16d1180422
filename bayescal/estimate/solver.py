"""Levenberg-Marquardt on the factor graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from bayescal.estimate.linear import Evaluations
from bayescal.estimate.weights import Weights
from bayescal.model.block import ARM, Block, Constraint
from bayescal.model.model import Model

if TYPE_CHECKING:
    from factors.graph import Function, Graph


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
    for name, own in slices.items():
        if own.stop > own.start:
            graph.variable(name, own.stop - own.start)
    variables = [name for name, own in slices.items() if own.stop > own.start]
    for block in model.blocks:
        add_block(graph, evaluations, block, weights.whitening(block))
    add_constraints(graph, model, variables, evaluations)
    solution, iterations = graph.solve({name: start[slices[name]] for name in variables})
    z = np.zeros(model.size)
    for name, value in solution.items():
        z[slices[name]] = value
    return z, lambda: graph.covariance(variables), iterations


def add_block(graph: Graph, evaluations: Evaluations, block: Block, whiten: np.ndarray) -> None:
    """Add the stacked contacts of one target to a graph."""
    across, arms = whiten[:, None], bool(evaluations.model.parameters)

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        arm = parts[0] if arms else np.zeros(0)
        own = parts[-1] if block.size else np.zeros(0)
        r, *slopes = evaluations.block(block, arm, own)
        used = (arms, block.size)
        return r * whiten, [slope * across for slope, use in zip(slopes, used, strict=True) if use]

    names = ([ARM] if arms else []) + ([block.target] if block.size else [])
    if names:  # without unknowns (nominal arm, known target) the residuals are constant
        graph.factor(names, block.residuals, function)


def add_constraints(
    graph: Graph, model: Model, variables: list[str], evaluations: Evaluations | None = None
) -> None:
    """Add the certificates that join at least one variable of the graph."""
    evaluations = evaluations or Evaluations(model)
    for constraint in model.constraints:
        free = [name for name in constraint.variables if name in variables]
        if free:
            graph.factor(free, constraint.rows, _constraint_function(evaluations, constraint, free))


def _constraint_function(evaluations: Evaluations, constraint: Constraint, free: list[str]) -> Function:
    known = dict.fromkeys(constraint.targets, np.zeros(0))  # overridden by the free ones

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        r, by = evaluations.constraint(constraint, known | dict(zip(free, parts, strict=True)))
        return r, [by[name] for name in free]

    return function
