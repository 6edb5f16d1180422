"""Levenberg-Marquardt on the factor graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from bayescal.estimate.weights import Weights
from bayescal.model.block import ARM, Block, Constraint
from bayescal.model.model import Model

if TYPE_CHECKING:
    from factors.graph import Function, Graph


def solve(
    model: Model, weights: Weights, start: np.ndarray
) -> tuple[np.ndarray, Callable[[], np.ndarray], int]:
    """Levenberg-Marquardt on the factor graph: a factor per target, a prior per variable, the certificates.

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
    slices = model.slices
    graph = Graph()
    for name, own in slices.items():
        if own.stop > own.start:
            graph.variable(name, own.stop - own.start)
    variables = [name for name, own in slices.items() if own.stop > own.start]
    for block in model.blocks:
        add_block(graph, model, block, weights.whitening(block))
    add_constraints(graph, model, variables)
    solution, iterations = graph.solve({name: start[slices[name]] for name in variables})
    z = np.zeros(model.size)
    for name, value in solution.items():
        z[slices[name]] = value
    return z, lambda: graph.covariance(variables), iterations


def add_block(graph: Graph, model: Model, block: Block, whiten: np.ndarray) -> None:
    """Add the stacked contacts of one target to a graph."""
    across = whiten[:, None]

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        arm = parts[0] if model.parameters else np.zeros(0)
        own = parts[-1] if block.size else np.zeros(0)
        r, by_arm, by_target = block.linearise(model.deviations(arm), own)
        slopes = []
        if model.parameters:
            by_arm *= model.sd
            by_arm *= across
            slopes.append(by_arm)
        if block.size:
            by_target *= across
            slopes.append(by_target)
        return r * whiten, slopes

    names = ([ARM] if model.parameters else []) + ([block.target] if block.size else [])
    if names:  # without unknowns (nominal arm, known target) the residuals are constant
        graph.factor(names, block.residuals, function)


def add_constraints(graph: Graph, model: Model, variables: list[str]) -> None:
    """Add the certificates that join at least one variable of the graph."""
    for constraint in model.constraints:
        free = [name for name in constraint.variables if name in variables]
        if free:
            graph.factor(free, constraint.rows, _constraint_function(model, constraint, free))


def _constraint_function(model: Model, constraint: Constraint, free: list[str]) -> Function:
    known = dict.fromkeys(constraint.targets, np.zeros(0))  # overridden by the free ones

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        r, by = model.linearised(constraint, known | dict(zip(free, parts, strict=True)))
        return r, [by[name] for name in free]

    return function
