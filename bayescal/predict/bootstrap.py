"""Bootstrap of validation errors: rows of one pose of the arm are resampled together.

Distances that share spheres have no such blocks. Their bootstrap is parametric, by errors of the centres.
"""

from __future__ import annotations

import numpy as np

from bayescal.estimate.clusters import poses
from bayescal.model.scene import Scene
from bayescal.predict.distances import CentreDistances

RESAMPLES = 2000
BLOCKS = 40
"""Number of blocks, in order of time, of rows that share their pose with no other row."""
SMALLEST, CORRELATED = 1e-3, 0.999
"""Smallest simulated excess of a mean square, relative to the mean square that is expected for a correct
model, and largest correlation of the errors of two models."""


def blocks(scene: Scene, rows: np.ndarray) -> np.ndarray:
    """Block labels (R,) of rows in order of time: a pose, or else neighbours in time."""
    pose = poses(scene.dataset.measurements, rows)
    alone = np.bincount(pose)[pose] == 1
    rest = np.unique(rows[alone])
    place = np.searchsorted(rest, rows) * min(BLOCKS, max(len(rest), 1)) // max(len(rest), 1)
    return np.unique(np.where(alone, place, len(rows) + pose), return_inverse=True)[1]


def resampled(block: np.ndarray, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Means (RESAMPLES, K) of values (K, R) over block bootstrap samples, the same ones for all K."""
    labels, inverse = np.unique(block, return_inverse=True)
    draws = rng.multinomial(len(labels), np.full(len(labels), 1.0 / len(labels)), size=RESAMPLES)
    sums = np.stack([np.bincount(inverse, v) for v in values], axis=1)
    return (draws @ sums) / (draws @ np.bincount(inverse))[:, None]


def resampled_distances(
    before: CentreDistances, after: CentreDistances, rng: np.random.Generator
) -> np.ndarray:
    """Bootstrap draws of the mean squared error (RESAMPLES, 2), m2, of the same distances by two models.

    Model error is simulated as an independent error of every centre, with the same variance in all three
    coordinates. Its variance and its correlation between the two models are estimated from the distances.
    Noise and parameter errors are simulated as the second model expects them. Each draw is the measured mean
    square divided by the ratio of a simulated mean square to its expectation; the ratio is widened for few
    distances. This respects that distances share centres and that both models see the same noise.
    """
    floor = float(np.mean(after.predicted_sd() ** 2))
    pair = np.stack([before.error, after.error])
    left = pair @ pair.T / pair.shape[1] - floor
    own = np.maximum(np.diag(left), SMALLEST * floor)
    largest = CORRELATED * np.sqrt(own[0] * own[1])
    across = float(np.clip(left[0, 1], -largest, largest))
    factor = np.linalg.cholesky(np.array([[own[0], across], [across, own[1]]]))
    by = before.by_centres / np.sqrt(2.0)  # a distance has the errors of two centres along it
    errors = np.einsum("ij,sjk->sik", factor, rng.standard_normal((RESAMPLES, 2, by.shape[1]))) @ by.T
    noise = rng.standard_normal((RESAMPLES, after.by_parameters.shape[1])) @ after.by_parameters.T
    noise += rng.standard_normal((RESAMPLES, after.by_noise.shape[1])) @ after.by_noise.T
    noise += after.u * rng.standard_normal(noise.shape)
    simulated = np.mean((errors + noise[:, None]) ** 2, axis=2)
    number = independent_distances(before)
    # the simulated covariance was itself estimated from this number of distances
    wider = np.sqrt(number / (number - 1.0)) if number > 1.0 else 1.0
    return np.mean(pair**2, axis=1) * ((own + floor) / simulated) ** wider


def independent_distances(d: CentreDistances) -> float:
    """Effective number of independent distances among D distances that share spheres (Satterthwaite)."""
    joint = d.by_centres @ d.by_centres.T
    return float(np.trace(joint) ** 2 / np.sum(joint**2))
