"""Straightness of a rail by a tracker: estimated curves against true ones, on the independent simulator.

    python -m analysis.straightness [sessions] [rows]

For each session: RMS of the true curve, of its difference from the estimated one, and of the stated u, along
x and z, and the share of positions whose true value is within U (k = 2). A straight line is part of neither
curve.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.polynomial.legendre import legvander

import bayescal as bc
from analysis.world import rail
from bayescal.fitted.arm import FittedArm, of_fit

MODEL = "geometry,compliance,encoder-scale,straightness,angular-motion,positioning"
GRID = 61


@dataclass(frozen=True)
class Curves:
    """Curves at positions (N,), m: true ones (2, N) along x and z, estimated ones with u, m."""

    at: np.ndarray
    true: np.ndarray
    estimated: np.ndarray
    u: np.ndarray

    @property
    def figures(self) -> tuple[float, float, float, float]:
        """RMS of the true curve, of the difference and of u, m; share of the positions within U (k = 2)."""
        off = self.estimated - self.true
        return _rms(self.true), _rms(off), _rms(self.u), float(np.mean(np.abs(off) <= 2 * self.u))


def curves(seed: int, rows: int = 400) -> Curves:
    """The curves of one session."""
    made = rail.make(seed, rows)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in made.texts.items():
            (Path(folder) / name).write_text(text)
        fitted = bc.fit(folder, model=MODEL, samples=0)
    assert fitted.data is not None
    at = np.linspace(0.0, rail.TRAVEL, GRID)
    estimated, u = curves_of(of_fit(fitted.data), at)
    return Curves(at, np.stack([curve.bent(at) for curve in made.rail.straight]), estimated, u)


def curves_of(arm: FittedArm, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Straightness (2, N) along x and z of F0 at positions, with u, m: y of the carriage is against z."""
    values, us = [], []
    for axis, sign in (("x", 1.0), ("y", -1.0)):
        own = [
            k for k, p in enumerate(arm.model.parameters) if p.name.startswith(f"straightness RAIL {axis} ")
        ]
        orders = np.array([int(arm.model.parameters[k].name.split()[-1]) for k in own])
        by = legvander(2 * at / rail.TRAVEL - 1, orders.max())[:, orders] * np.sqrt(2 * orders + 1)
        values.append(sign * by @ arm.values[own])
        us.append(np.sqrt(np.einsum("ni,ij,nj->n", by, arm.covariance[np.ix_(own, own)], by)))
    return np.array(values), np.array(us)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main(sessions: int = 6, rows: int = 400) -> None:
    """Print the figures of some sessions, and of all."""
    print("session  true (µm)  difference (µm)  stated u (µm)  within U")
    every = []
    for seed in range(1, sessions + 1):
        every.append(curves(seed, rows).figures)
        true, off, u, within = every[-1]
        print(f"{seed:7d}  {1e6 * true:9.1f}  {1e6 * off:15.2f}  {1e6 * u:13.2f}  {within:8.0%}")
    true, off, u, _ = (_rms(column) for column in np.array(every).T)
    within = float(np.mean([row[3] for row in every]))
    print(f"    all  {1e6 * true:9.1f}  {1e6 * off:15.2f}  {1e6 * u:13.2f}  {within:8.0%}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
