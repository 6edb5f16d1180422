"""The same posterior in JAX: the chain unrolled over its frames, only what a term moves computed.

What is constant is a constant of the trace; sines and cosines of the nominal angles are known, as in
the kernel. XLA fuses the rest, except for one matrix product half-way down the chain: without it XLA
computes points anew for each of their uses (the value is then seven times as slow); with more, or with
matrix products alone, value and gradient are slower too (131 us with one, 140 with none, 190 with all).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from analysis.benchmarks.problem import Problem
from analysis.benchmarks.walls import contact_residuals, place, tie_residuals
from bayescal.arm.transforms import AXES
from bayescal.estimate import STATED_WORTH
from bayescal.posterior import Density

jax.config.update("jax_enable_x64", True)

TINY = 1e-15  # a cosine of 90 degrees
PAIRS = ((1, 4, 5), (0, 2, 3), (2, 0, 1))  # axis, turn and slide, from Ry Ty outward


def _turn(p: list[Any], axis: int, c: Any, s: Any) -> list[Any]:
    out = list(p)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i], out[j] = c * p[i] - s * p[j], s * p[i] + c * p[j]
    return out


def _map(p: list[Any], m: np.ndarray, fused: bool = True) -> list[Any]:
    """Points mapped by a constant matrix: its zeros and ones cost nothing, or by a matrix product."""
    if not fused:
        mapped = jnp.asarray(m[:3, :3]) @ jnp.stack(p) + m[:3, 3:]
        return [mapped[0], mapped[1], mapped[2]]
    out = []
    for row in np.where(np.abs(m[:3]) < TINY, 0.0, m[:3]):
        terms = [x if k == 1.0 else k * x for k, x in zip(row[:3], p, strict=True) if k != 0.0]
        total = sum(terms[1:], start=terms[0])
        out.append(total if row[3] == 0.0 else total + row[3])
    return out


def points_function(problem: Problem) -> Callable[[Any], list[Any]]:
    """Ball centres, three rows (C,), m, at the arm's deviations (P,)."""
    motion = problem.motion
    chain, n = motion.chain, motion.chain.n
    sites: dict[tuple[int, int], list[tuple[int, Any]]] = {}
    for parameter, term in motion.terms:
        driver = np.asarray(term.driver, float)
        constant = driver.ndim == 0 or bool(np.all(driver == driver[0]))
        sites.setdefault((term.frame, AXES.index(term.axis)), []).append(
            (parameter, float(driver.flat[0]) if constant else driver)
        )
    sines, cosines, tool = np.sin(motion.q), np.cos(motion.q), motion.tool

    def moved(values: Any, frame: int, component: int) -> Any:
        terms = [values[k] * driver for k, driver in sites.get((frame, component), [])]
        return sum(terms[1:], start=terms[0]) if terms else None

    def points(values: Any) -> list[Any]:
        p: list[Any] = [jnp.zeros(len(tool)) for _ in range(3)]
        for frame in range(n + 1, -1, -1):
            joint = 1 <= frame <= n
            if joint:
                p = _map(p, chain.link[frame], fused=frame != n // 2)
            for axis, turn, slide in PAIRS:
                shift, angle = moved(values, frame, slide), moved(values, frame, turn)
                if joint and axis == 2:
                    shift = chain.d[frame - 1] + (0.0 if shift is None else shift)
                if shift is not None:
                    p = [x + shift if k == axis else x for k, x in enumerate(p)]
                if joint and axis == 2:
                    s, c = sines[:, frame - 1], cosines[:, frame - 1]
                    if angle is not None:
                        ds, dc = jnp.sin(angle), jnp.cos(angle)
                        s, c = s * dc + c * ds, c * dc - s * ds
                    p = _turn(p, 2, c, s)
                elif angle is not None:
                    p = _turn(p, axis, jnp.cos(angle), jnp.sin(angle))
            if frame == n + 1:
                p = [x + tool[:, k] for k, x in enumerate(p)]
        return _map(_map(p, chain.link[0]), chain.base)

    return points


def density_function(problem: Problem, density: Density) -> Callable[[Any], Any]:
    """Log density at one point (D + 1,), equal to `Density` up to rounding."""
    model = problem.model
    (count,) = density.count  # one noise group
    sigma = np.concatenate([density.estimate.weights.sigma[b.target] for b in model.blocks])
    walls = problem.walls(sigma)
    points = points_function(problem)
    shift_of_prior = model.deviations(np.zeros(len(model.parameters)))  # from nominal
    sd = model.deviations(np.ones(len(model.parameters))) - shift_of_prior
    size = len(sd)
    faces = np.concatenate([np.arange(model.size)[model.slices[b.target]] for b in model.blocks])

    def log_density(x: Any) -> Any:
        z, log_kappa = x[:-1], x[-1]
        values = z[:size] * sd + shift_of_prior
        normal, shift = place(jnp, walls, z[faces].reshape(-1, 3))
        contacts = jnp.sum(contact_residuals(jnp, walls, normal, shift, points(values)) ** 2)
        rest = jnp.sum(tie_residuals(jnp, walls, normal, shift) ** 2) + jnp.sum(z**2)
        half = 0.5 * (contacts + STATED_WORTH) * jnp.exp(-2.0 * log_kappa)
        return -(count + STATED_WORTH) * log_kappa - 0.5 * rest - half

    return log_density
