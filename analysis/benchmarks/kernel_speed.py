"""The chain's kernel against the core's own matrix product and against NumPy."""

from __future__ import annotations

import numpy as np

from analysis.benchmarks.clock import dgemm, fastest
from analysis.benchmarks.flops import kernel_flops
from analysis.benchmarks.problem import Problem
from analysis.benchmarks.reference import points_reference

WALKERS = 64


def measure(problem: Problem) -> dict[str, float]:
    """Raw numbers: flops a contact, ns a contact of value, columns and NumPy, and dgemm's flops a second.

    The value is timed twice: for many parameter vectors at once, as the sampler asks for it (against
    dgemm), and for one, as the solver does (against columns and NumPy, which take one).
    """
    motion, count = problem.motion, problem.contacts
    z = problem.estimate.z[: motion.size]
    values = problem.model.deviations(z)
    many = problem.model.deviations(z + 0.01 * np.random.default_rng(0).normal(size=(WALKERS, motion.size)))
    p = motion.points(values)
    u = np.repeat(np.eye(3)[:, :1], count, axis=1)
    flops, product = dgemm()
    s = fastest(
        {
            "dgemm": (2, product),
            "many": (20, lambda: motion.points(many)),
            "value": (2000, lambda: motion.points(values)),
            "columns": (1000, lambda: motion.columns(values, p, u)),
            "numpy": (5, lambda: points_reference(motion, values)),
        },
        rounds=15,
    )
    return {
        "flops_a_contact": float(kernel_flops(motion)),
        "dgemm_flops_a_second": flops / s["dgemm"],
        "value_ns": 1e9 * s["many"] / (WALKERS * count),
        "value_one_ns": 1e9 * s["value"] / count,
        "columns_ns": 1e9 * s["columns"] / count,
        "numpy_ns": 1e9 * s["numpy"] / count,
    }
