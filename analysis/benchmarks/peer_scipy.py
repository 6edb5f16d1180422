"""Our Levenberg-Marquardt against `scipy.optimize.least_squares` as one calls it without further thought.

SciPy has its default method and finite differences, on the NumPy reference of the same model:
same parameters, priors and certificates, same start.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from analysis.benchmarks.clock import fastest
from analysis.benchmarks.problem import Problem
from analysis.benchmarks.reference import points_reference
from analysis.benchmarks.walls import contact_residuals, place, tie_residuals
from bayescal.estimate import solve

NEAR = 1e-2  # of half chi-squared: so close to the optimum counts as there


def residual_function(problem: Problem) -> Callable[[np.ndarray], np.ndarray]:
    """Whitened residuals of contacts, certificates and prior at z (D,), by NumPy alone."""
    model, walls, motion = problem.model, problem.walls(problem.sigma), problem.motion

    def residuals(z: np.ndarray) -> np.ndarray:
        p = points_reference(motion, model.deviations(z[: motion.size]))
        normal, shift = place(np, walls, problem.faces_of(z))
        contacts = contact_residuals(np, walls, normal, shift, p)
        return np.concatenate([contacts, tie_residuals(np, walls, normal, shift), z])

    return residuals


def measure_ours(problem: Problem) -> float:
    """Duration of our solution from the nominal values with its covariance, s."""

    def ours() -> None:
        _, covariance, _ = solve(problem.model, problem.weights, problem.start)
        covariance()

    return fastest({"ours": (5, ours)}, rounds=7)["ours"]


def measure(problem: Problem, rounds: int = 3) -> dict[str, float]:
    """Durations, s, and how near SciPy came: its time is that until it first was near the optimum."""
    residuals = residual_function(problem)
    best = 0.5 * float(np.sum(residuals(solve(problem.model, problem.weights, problem.start)[0]) ** 2))
    ours, until, whole, excess, evaluations = [], [], [], np.inf, 0
    for _ in range(rounds):
        ours.append(measure_ours(problem))
        near: list[float] = []
        start = time.perf_counter()

        def timed(z: np.ndarray, start: float = start, near: list[float] = near) -> np.ndarray:
            r = residuals(z)
            if not near and 0.5 * float(r @ r) < best + NEAR:
                near.append(time.perf_counter() - start)
            return r

        found = least_squares(timed, problem.start)
        whole.append(time.perf_counter() - start)
        until.append(near[0] if near else whole[-1])
        excess, evaluations = float(found.cost) - best, int(found.nfev)
    return {
        "ours_s": min(ours),
        "scipy_s": min(until),
        "scipy_whole_s": min(whole),
        "scipy_excess": excess,
        "scipy_steps": float(evaluations),
    }
