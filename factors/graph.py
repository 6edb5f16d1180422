"""The one place that knows GTSAM: whitened residual functions as factors, priors, solve, covariance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import gtsam
import numpy as np
from scipy.linalg.lapack import dgeqrf, dpotrf

Linearised = tuple[np.ndarray, Sequence[np.ndarray]]
Function = Callable[..., Linearised]
"""(*vectors of the factor's variables) -> whitened residual (m,), gradients [(m, size)]."""

LONG = 10
"""Residuals of a factor, in units of its unknowns, beyond which a triangle with the same products serves."""


class Graph:
    """A least-squares problem over named vectors, as a GTSAM factor graph."""

    def __init__(self) -> None:
        self._graph = gtsam.NonlinearFactorGraph()
        self._keys: dict[str, int] = {}
        self._sizes: dict[str, int] = {}

    def variable(self, name: str, size: int) -> None:
        """Declare a whitened vector, with its standard normal prior."""
        key = gtsam.symbol("v", len(self._keys))
        self._keys[name], self._sizes[name] = key, size
        self._graph.add(gtsam.PriorFactorVector(key, np.zeros(size), gtsam.noiseModel.Unit.Create(size)))

    def factor(self, names: Sequence[str], rows: int, function: Function) -> None:
        """Add a factor of `rows` whitened residuals; of many only a triangle with their products is kept."""
        keys, sizes = [self._keys[name] for name in names], [self._sizes[name] for name in names]
        long = rows > LONG * (sum(sizes) + 1)
        last = b""
        linearised: Linearised = np.zeros(0), ()

        def error(
            _: gtsam.CustomFactor, values: gtsam.Values, gradients: list[np.ndarray] | None
        ) -> np.ndarray:
            nonlocal last, linearised
            parts = [values.atVector(key) for key in keys]
            here = b"".join([part.tobytes() for part in parts])
            if here != last:  # the solver asks for the error just where it will ask for the gradients next
                r, slopes = function(*parts)
                if long:
                    every = np.vstack([*(slope.T for slope in slopes), r]).T
                    triangle, failed = dpotrf(every.T @ every)
                    if failed:  # of columns without a residual, or that differ by rounding
                        triangle = np.triu(dgeqrf(every, overwrite_a=1)[0][: sum(sizes) + 1])
                    *slopes, r = np.split(triangle, np.cumsum(sizes), axis=1)
                linearised, last = (np.ravel(r), slopes), here
            r, slopes = linearised
            if gradients is not None:
                for i, slope in enumerate(slopes):
                    gradients[i] = slope
            return r

        self._graph.add(
            gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(sum(sizes) + 1 if long else rows), keys, error)
        )

    def solve(
        self, start: Mapping[str, np.ndarray], iterations: int = 100
    ) -> tuple[dict[str, np.ndarray], int]:
        """Levenberg-Marquardt from `start`; returns the variables and the number of iterations."""
        values = gtsam.Values()
        for name, key in self._keys.items():
            values.insert(key, start[name])
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setlambdaInitial(1e-6)
        # Cholesky gives up, or crawls, where known and loose variables meet; QR costs no more at this size
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        parameters.setMaxIterations(iterations)
        parameters.setRelativeErrorTol(1e-10)
        parameters.setAbsoluteErrorTol(1e-5)
        optimizer = gtsam.LevenbergMarquardtOptimizer(self._graph, values, parameters)
        self._solution = optimizer.optimize()
        estimate = {name: self._solution.atVector(key) for name, key in self._keys.items()}
        return estimate, optimizer.iterations()

    def covariance(self, names: Sequence[str]) -> np.ndarray:
        """Joint covariance of variables at the solution; `names` the first declared, in their order.

        The inverse of the linearised graph's information, scaled to a unit diagonal first; as
        `gtsam.Marginals`, whose Cholesky gives up where known and loose variables meet.
        """
        ordering = gtsam.Ordering()
        for key in self._keys.values():
            ordering.push_back(key)
        information, _ = self._graph.linearize(self._solution).hessian(ordering)
        scale = 1.0 / np.sqrt(np.diag(information))
        covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
        size = sum(self._sizes[name] for name in names)
        return covariance[:size, :size]
