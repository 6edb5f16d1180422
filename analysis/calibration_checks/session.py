"""A session of the checks: simulate, fit, and the place of every true value among the draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.calibration_checks.designs import Design
from analysis.calibration_checks.truth import MODEL, Simulated, simulated
from bayescal.calibration import Fit, fit
from bayescal.errors import BayescalError
from bayescal.estimate import root
from bayescal.model import ARM, Model
from bayescal.model.model import noise_groups
from bayescal.model.options import FitOptions
from bayescal.predict.errors import evenly, far_pairs, lengths

REFERENCES = 8
"""Reference points of a session in the test of joint coverage."""
KEPT = 1000
"""Draws that are used of each fit, evenly spaced."""
POINTS = 40
"""Points of the workspace, evenly spaced among all rows."""
DISTANCES = 12
"""Distances between far ones of these that are recorded, evenly spaced."""

Record = dict[str, Any]


@dataclass(frozen=True)
class Joint:
    """Places of a truth among draws (S, D) of all unknowns together."""

    ellipsoid: float  # share of draws nearer to the mean, in the metric of the draws' covariance
    tarp: list[float]  # share of draws nearer to a random reference point, for each of these

    @classmethod
    def of(cls, truth: np.ndarray, draws: np.ndarray, rng: np.random.Generator) -> Joint:
        """Compare a truth (D,) with draws; reference points are as far from the mean as two draws are."""
        mean, sd = draws.mean(axis=0), draws.std(axis=0)
        draws, truth = (draws - mean) / sd, (truth - mean) / sd
        inverse = np.linalg.pinv(root(np.cov(draws.T)))
        own, at = inverse @ truth, draws @ inverse.T
        points = np.sqrt(2.0) * rng.standard_normal((REFERENCES, len(own)))
        nearer = [np.mean(_square(at - r) < _square(own - r)) for r in points]
        return cls(float(np.mean(_square(at) < _square(own))), [float(v) for v in nearer])


def _square(v: np.ndarray) -> np.ndarray:
    return np.sum(v**2, axis=-1)


def run(design: Design, seed: int) -> Record:
    """Simulate a session with a truth of its own, fit it, and compare; only a reason where it is refused."""
    try:
        made = simulated(design, seed)
        fitted = fit(made.dataset, MODEL, FitOptions(seed=seed), samples=design.samples)
    except BayescalError as error:
        return {"design": design.name, "seed": seed, "refused": str(error)}
    return compared(design, made, fitted)


def compared(design: Design, made: Simulated, fitted: Fit) -> Record:
    """Places (0 to 1) of the truth among the draws of a fit."""
    found, v = fitted.final.estimate, fitted.final.validation
    model, truth = found.model, made.z(found.model)
    known = np.isfinite(truth)
    pick = np.linspace(0, len(fitted.draws.flat) - 1, min(KEPT, len(fitted.draws.flat))).astype(int)
    plain, stated = fitted.sampled.flat[pick], fitted.draws.flat[pick]
    rng = np.random.default_rng([fitted.options.seed, 0x7A29])
    scales = noise_draws(fitted)
    joint = {
        name: Joint.of(truth[known], draws[:, known], rng)
        for name, draws in (("plain", plain), ("stated", stated))
    }
    rejected = set(found.rejected.tolist())
    return {
        "design": design.name,
        "seed": fitted.options.seed,
        "names": [n for n, k in zip(model.names, known, strict=True) if k],
        "plain": _places(truth, plain)[known].tolist(),
        "stated": _places(truth, stated)[known].tolist(),
        "ellipsoid": {name: j.ellipsoid for name, j in joint.items()},
        "tarp": {name: j.tarp for name, j in joint.items()},
        "independent": independent(truth[known], plain[:, known]).tolist(),
        "noise": {g: float(np.mean(scales[g] < made.scales[g])) for g in scales},
        "noise_over_truth": {g: float(np.median(scales[g]) / made.scales[g]) for g in scales},
        "distances": [float(np.mean(d.predicted < d.error)) for d in v.distances],
        "diameters": [float(np.mean(d.predicted < d.error)) for d in v.diameters],
        "contacts": np.concatenate([np.mean(p.predicted < p.residuals, axis=0) for p in v.planes]).tolist(),
        **_workspace(made, fitted, plain, rng),
        "sd_ratio": (np.std(stated, axis=0) / np.std(plain, axis=0))[known].tolist(),
        "families": list(fitted.stated.families),
        "excess_um": 1e6 * fitted.final.unexplained.excess,
        "explains": fitted.acceptance.explains,
        "dof": dict(found.dof),
        "gross": len(made.gross),
        "gross_rejected": len(rejected & set(made.gross.tolist())),
        "good_rejected": len(rejected - set(made.gross.tolist())),
    }


def _places(truth: np.ndarray, draws: np.ndarray) -> np.ndarray:
    """Share of the draws (S, D) below the truth (D,): uniform where the draws are right."""
    return np.mean(draws < truth, axis=0)


def independent(truth: np.ndarray, draws: np.ndarray) -> np.ndarray:
    """Scores (D,) of a truth, independent and standard normal if draws (S, D) are normal and right.

    The inverse of a covariance of S draws is too large by a factor S / (S - D - 2) (inverse Wishart).
    """
    count, size = draws.shape
    mean, sd = draws.mean(axis=0), draws.std(axis=0)
    own = np.linalg.solve(np.linalg.cholesky(np.cov((draws / sd).T)), (truth - mean) / sd)
    return np.sqrt((count - size - 2) / count) * own


def noise_draws(fitted: Fit) -> dict[str, np.ndarray]:
    """Draws (S,) of the noise scale of each group."""
    groups = noise_groups(fitted.final.estimate.model)
    return dict(zip(groups, fitted.sampled.kappa.T, strict=True))


def _workspace(made: Simulated, fitted: Fit, plain: np.ndarray, rng: np.random.Generator) -> Record:
    """Places of true distances among those of draws, and the ratio of the root mean squares of their s.d."""
    wide = fitted.stated
    places, u = workspace(made, wide.plain.model, plain)
    # with errors of masses and functions of the discrepancy, which move points beside the parameters
    places_stated, wider = workspace(made, wide.wide.model, wide.draws(plain, rng))
    return {
        "workspace": places.tolist(),
        "workspace_stated": places_stated.tolist(),
        "workspace_sd_ratio": float(np.sqrt(np.mean(wider**2) / np.mean(u**2))),
    }


def workspace(made: Simulated, model: Model, draws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of true distances in the workspace among those of draws (S, D) of a model, and their s.d."""
    rows = model.scene.rows("calibrate", "validate")
    rows = rows[evenly(len(rows), POINTS)]
    true, motion = made.points(rows), model.motion(rows)
    pairs = far_pairs(true)
    pairs = pairs[evenly(len(pairs), DISTANCES)]
    drawn = lengths(motion.points(model.deviations(draws[:, model.slices[ARM]])), pairs)
    return np.mean(drawn < lengths(true, pairs), axis=0), np.std(drawn, axis=0)
