"""Runs where pybotics 3 is installed: `python -m analysis.benchmarks.pybotics_worker problem.npz`.

The chain is pybotics' own, through its `OptimizationHandler`; faces, certificates and priors are the
same few lines of NumPy that the other peers have. Solved by SciPy's default, as in pybotics' own
examples. Where that takes too long, the time of one Jacobian is scaled by the number of steps.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from analysis.benchmarks.walls import Walls, contact_residuals, place, tie_residuals

PATIENCE = 60.0  # s
STEPS = 8  # assumed where patience ends: what SciPy's default takes on this problem


class _OutOfTime(Exception):
    pass


def residual_function(given: dict[str, Any]) -> tuple[Callable[[np.ndarray], np.ndarray], int]:
    """Whitened residuals at z (entries, then faces), and the length of z."""
    from pybotics.optimization import OptimizationHandler
    from pybotics.robot import Robot

    rows, entry, sd, q = given["rows"], given["entry"], given["sd_of_entry"], given["q"]
    walls = Walls(**{f.name: given[f.name] for f in fields(Walls)})
    robot = Robot.from_parameters(rows)
    robot.world_frame = given["base"]
    robot.tool.position = given["tool"]
    chain_mask = np.isin(np.arange(rows.size), entry)
    tool_mask = np.isin(rows.size + np.arange(6), entry)
    handler = OptimizationHandler(robot, list(chain_mask), list(tool_mask))
    nominal = handler.generate_optimization_vector()
    size = len(entry)

    def residuals(z: np.ndarray) -> np.ndarray:
        handler.apply_optimization_vector(nominal + sd * z[:size])
        p = np.array([handler.robot.fk(one)[:3, 3] for one in q]).T
        normal, shift = place(np, walls, z[size:].reshape(-1, 3))
        contacts = contact_residuals(np, walls, normal, shift, p)
        return np.concatenate([contacts, tie_residuals(np, walls, normal, shift), z])

    return residuals, size + 3 * len(walls.normal)


def run(given: dict[str, Any]) -> dict[str, float]:
    """Duration of the calibration, s, its size, steps and half chi-squared, and whether it was scaled."""
    residuals, size = residual_function(given)
    start = time.perf_counter()
    calls = [0]

    def timed(z: np.ndarray) -> np.ndarray:
        calls[0] += 1
        if time.perf_counter() - start > PATIENCE:
            raise _OutOfTime
        return residuals(z)

    out = {"parameters": float(size)}
    try:
        found = least_squares(timed, np.zeros(size))
    except _OutOfTime:
        each = (time.perf_counter() - start) / calls[0]
        whole = each * (size + 1) * STEPS
        return out | {"pybotics_s": whole, "steps": float(STEPS), "cost": np.nan, "scaled": 1.0}
    took = time.perf_counter() - start
    return out | {"pybotics_s": took, "steps": float(found.nfev), "cost": float(found.cost), "scaled": 0.0}


if __name__ == "__main__":
    with np.load(sys.argv[1]) as file:
        print(json.dumps(run(dict(file))))
