"""Validation errors of one estimate and their predicted uncertainty, propagated linearly.

Contacts of fitted targets are compared with the fit. Where the session has too few validation data, each
fitted contact, or each image, is left out in turn, in closed form (leave-one-out cross-validation). A target
that was not fitted (a sphere, an instrument) is first located from its own rows. Only lengths are validated:
an orientation that a row measures together with its point is used in the fit and is never left out.

A test of a name needs more: neighbours share errors. For it, fitted measurements are left out in `folds`, and
in `regions` of the joints.

Blocked cross-validation: fitted measurements are left out in blocks of poses and time, or in regions of the
joints, in closed form.

Bootstrap of validation errors: rows of one pose of the arm are resampled together.

Distances that share spheres have no such blocks. Their bootstrap is parametric, by errors of the centres.

95 % intervals: of draws, and of a value with its bootstrap draws.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from bayescal.dataset import Measurements
from bayescal.estimate import Estimate, linearise, root
from bayescal.estimate.families import poses
from bayescal.estimate.unexplained import GROUPS
from bayescal.model import ARM, Block
from bayescal.model.model import length_blocks
from bayescal.model.scene import Scene
from bayescal.predict.errors import CentreDistances, ValidationErrors, centre_distances
from bayescal.predict.targets import RowPrediction, by_readings, prepared
from bayescal.statistics import t_ppf

Folded = Callable[[Measurements, np.ndarray], np.ndarray]
"""Block (R,) of each of some rows of a session."""
FOLDS = 10
"""Number of blocks of rows that are left out in turn (convention)."""
REGIONS = 5
"""Number of regions of the joints that are left out in turn (tuned on sessions of real arms: of 10 or 20,
more names pass that do not extrapolate)."""
STILL = 0.01
"""Spread of the readings of a joint, rad or m, below which it counts less for its region (assumed)."""
ROUNDING = 1e-9
"""Smallest share of the information on a direction that the other blocks must have."""


def folds(m: Measurements, rows: np.ndarray) -> np.ndarray:
    """Block (R,) of each of some rows, from 0, by time within each target; rows of one pose are together.

    The rows of a target are in the order of time, and a block is a stretch of them. A session that probes one
    face after the other so never loses a whole face, whose location the other rows do not determine.

    Parameters
    ----------
    m : Measurements
    rows : np.ndarray of int, shape (R,)
        Rows of the session, in any order; several residuals may have the same row.
    """
    unique_rows, inverse = np.unique(rows, return_inverse=True)
    block = np.empty(len(unique_rows), int)
    for target in np.unique(m.target[unique_rows]):
        mine = np.flatnonzero(m.target[unique_rows] == target)
        block[mine] = np.arange(len(mine)) * FOLDS // len(mine)
    pose = poses(m, unique_rows)
    _, first = np.unique(pose, return_index=True)
    return block[first][pose][inverse]


def regions(m: Measurements, rows: np.ndarray) -> np.ndarray:
    """Region (R,) of the joints that each of some rows is in, from 0: clusters of readings by k-means.

    A session returns to its poses: a stretch of time is hardly ever the only one with its poses. Leaving out
    all rows of a region tests what a fit predicts for other poses than its own.

    Parameters
    ----------
    m : Measurements
    rows : np.ndarray of int, shape (R,)
        Rows of the session, in any order.
    """
    from scipy.cluster.vq import kmeans2  # slow to import

    poses, inverse = np.unique(m.readings[rows], axis=0, return_inverse=True)
    if len(poses) <= REGIONS:
        return inverse
    scaled = (poses - np.mean(poses, axis=0)) / np.maximum(np.std(poses, axis=0), STILL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a cluster that has become empty: there is one region less
        return np.asarray(kmeans2(scaled, REGIONS, iter=50, minit="++", seed=0)[1])[inverse]


def without_fold(
    residual: np.ndarray, by: np.ndarray, weight: np.ndarray, fold: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Predict the rows of each block by a fit to the others, exact for a linear model.

    Parameters
    ----------
    residual : np.ndarray, shape (R,)
        Whitened residuals at the optimum.
    by : np.ndarray, shape (R, D)
        Whitened slopes by posterior standard normals: J F with covariance F F'.
    weight : np.ndarray, shape (R,)
        0 for rows that were not fitted, else 1.
    fold : np.ndarray of int, shape (R,)

    Yields
    ------
    rows : np.ndarray of int, shape (K,)
        Residuals of a block.
    residual : np.ndarray, shape (K,)
        Whitened, by the fit to the other blocks.
    by : np.ndarray, shape (K, D)
        Whitened slopes by posterior standard normals of that fit.

    Notes
    -----
    With B of the block's rows, the others have the information 1 - B'WB in these coordinates, and the optimum
    moves by its inverse times B'W r.
    """
    for one in np.unique(fold):
        mine = np.flatnonzero(fold == one)
        b, used = by[mine], weight[mine]
        values, vectors = np.linalg.eigh(np.eye(by.shape[1]) - (b.T * used) @ b)
        slopes = (b @ vectors) / np.sqrt(np.maximum(values, ROUNDING))
        yield mine, residual[mine] + slopes @ (slopes.T @ (used * residual[mine])), slopes


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
    unique_rows = np.unique(rows[alone])
    count = max(len(unique_rows), 1)
    place = np.searchsorted(unique_rows, rows) * min(BLOCKS, count) // count
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
    excess = pair @ pair.T / pair.shape[1] - floor
    variance = np.maximum(np.diag(excess), SMALLEST * floor)
    largest = CORRELATED * np.sqrt(variance[0] * variance[1])
    across = float(np.clip(excess[0, 1], -largest, largest))
    factor = np.linalg.cholesky(np.array([[variance[0], across], [across, variance[1]]]))
    by = before.by_centres / np.sqrt(2.0)  # a distance has the errors of two centres along it
    errors = np.einsum("ij,sjk->sik", factor, rng.standard_normal((RESAMPLES, 2, by.shape[1]))) @ by.T
    noise = rng.standard_normal((RESAMPLES, after.by_parameters.shape[1])) @ after.by_parameters.T
    noise += rng.standard_normal((RESAMPLES, after.by_noise.shape[1])) @ after.by_noise.T
    noise += rng.standard_normal((RESAMPLES, after.by_certificates.shape[1])) @ after.by_certificates.T
    simulated = np.mean((errors + noise[:, None]) ** 2, axis=2)
    number = independent_distances(before)
    # the simulated covariance was itself estimated from this number of distances
    wider = np.sqrt(number / (number - 1.0)) if number > 1.0 else 1.0
    return np.mean(pair**2, axis=1) * ((variance + floor) / simulated) ** wider


def independent_distances(d: CentreDistances) -> float:
    """Effective number of independent distances among D distances that share spheres (Satterthwaite)."""
    joint = d.by_centres @ d.by_centres.T
    return float(np.trace(joint) ** 2 / np.sum(joint**2))


VALIDATED, LEFT_OUT = "validation measurements", "leave-one-out cross-validation"
IMAGES_LEFT_OUT = "leave-one-out cross-validation by images"
BLOCKED, BY_REGION = "blocked cross-validation", "cross-validation by regions of the joints"
"""How validation errors were obtained."""
FOLDED: dict[str, Folded] = {BLOCKED: folds, BY_REGION: regions}
"""The blocks of rows that are left out together, in tests of names."""
TOGETHER: dict[str, Folded] = FOLDED | {IMAGES_LEFT_OUT: poses}
"""The same, with those of validation errors: the corners of an image share the errors of its pose."""
FEWEST = 8
"""Number of validation data of fitted targets below which leave-one-out cross-validation is used instead."""


@dataclass(frozen=True)
class _Part:
    """Residuals of a block, component by component; fields as in `ValidationErrors`."""

    block: Block
    residual: np.ndarray
    noise: np.ndarray
    by_parameters: np.ndarray
    noise_covariance: np.ndarray


def validation_errors(estimate: Estimate, strict: bool = True, without: str = LEFT_OUT) -> ValidationErrors:
    """Residuals, predictions and distances of rows that an estimate did not use.

    Parameters
    ----------
    estimate : Estimate
    strict : bool
        As for `prepared`.
    without : str
        What is done if the session has too few validation measurements: `LEFT_OUT`, `BLOCKED` or `BY_REGION`.

    Raises
    ------
    BayescalError
        If a target cannot be located from its rows.
    """
    scene = estimate.model.scene
    linearised, factor = prepared(estimate, strict=strict), root(estimate.covariance)
    fitted = [r for r in linearised.rows if r.target is None]
    how = VALIDATED if sum(len(r.block.rows) for r in fitted) >= FEWEST else without
    in_images = scene.in_images[scene.rows("calibrate")]
    if how == LEFT_OUT and len(in_images) and in_images.all():
        how = IMAGES_LEFT_OUT
    if how == VALIDATED:
        parts = [_predicted(r, factor) for r in fitted]
    else:
        parts = list(left_out(estimate) if how == LEFT_OUT else blocks_left_out(estimate, TOGETHER[how]))
    fold = None
    if how in TOGETHER:  # as they were left out; what was not fitted is predicted by the fit to all
        of_fitted = _rows([p.block for p in parts])
        of_located = _rows([r.block for r in linearised.rows if r.target is not None])
        fitted_fold = TOGETHER[how](scene.dataset.measurements, of_fitted)
        fold = np.concatenate([fitted_fold, np.full(len(of_located), -1)])
    main = next((g for g in GROUPS if any(p.block.group == g for p in parts)), "point")
    parts += [_predicted(r, factor) for r in linearised.rows if r.target is not None]
    blocks_of = [p.block for p in parts]
    rows = _rows(blocks_of)
    order = np.argsort(rows, kind="stable")

    def joined(values: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate(values)[order]

    def labels(values: Sequence[str]) -> np.ndarray:
        return np.repeat(values, [b.residuals for b in blocks_of])[order]

    def padded(values: Sequence[np.ndarray]) -> np.ndarray:
        width = max([v.shape[1] for v in values], default=0)
        return joined([np.pad(v, ((0, 0), (0, width - v.shape[1]))) for v in values])

    return ValidationErrors(
        how,
        main,
        joined([p.residual for p in parts]),
        joined([p.noise for p in parts]),
        padded([p.by_parameters for p in parts]),
        rows[order],
        labels(["planes" if b.kind.rows == 1 else "points" for b in blocks_of]),
        labels([b.group for b in blocks_of]),
        labels([b.target for b in blocks_of]),
        blocks(scene, rows[order]),
        centre_distances(scene, linearised.located, factor[estimate.model.slices[ARM]]),
        padded([p.noise_covariance for p in parts]),
        estimate.dof,
        None if fold is None else fold[order],
        padded([by_readings(estimate, b) for b in blocks_of]) if scene.in_images.any() else None,
    )


def _rows(blocks: Sequence[Block]) -> np.ndarray:
    """Row of the session (R,) of each residual of some blocks, component by component."""
    return np.concatenate([np.empty(0, int), *(np.tile(b.rows, b.kind.rows) for b in blocks)])


def _predicted(r: RowPrediction, factor: np.ndarray) -> _Part:
    """Validation measurements by the posterior's factor (D, D)."""
    spread = r.by_z @ factor
    if r.target is None:
        return _part(r.block, r.residual, r.noise, spread)
    spread = spread + (r.by_target @ r.target.by_arm) @ factor[: r.target.by_arm.shape[1]]
    scatter = r.by_target @ r.target.scatter
    if not r.locates_target:
        return _part(r.block, r.residual, r.noise, np.column_stack([spread, scatter]))
    # with G = by_target gain, (1 - G) noise and the prior add up to noise^2 - scatter^2
    less = np.maximum(r.noise**2 - np.sum(scatter**2, axis=1), 1e-3 * r.noise**2)
    return _part(r.block, r.residual, np.sqrt(less), spread)


def _part(
    block: Block,
    residual: np.ndarray,
    noise: np.ndarray,
    by: np.ndarray,
    covariance: np.ndarray | None = None,
) -> _Part:
    """Residuals (R,) of a block; `covariance` (C, k, k) is that of `noise`, independent if not given."""
    k = block.kind.rows
    if covariance is None:
        covariance = np.eye(k) * noise.reshape(k, -1).T[:, None] ** 2
    return _Part(block, residual, noise, by, np.swapaxes(covariance, 0, 1).reshape(len(noise), k))


def left_out(estimate: Estimate) -> Iterator[_Part]:
    """Leave-one-out residuals of all fitted contacts: (1 - H)^-1 r, with H the leverage of a contact.

    Exact for a linear model. A rejected contact was not fitted; its residual is unchanged. `noise` includes
    the uncertainty of the fit to the other contacts, which is nearly uncorrelated between contacts. An
    orientation that a row measures together with its point stays in the fit.
    """
    model = estimate.model
    whole = estimate.weights.full.apart
    linear = linearise(model, estimate.z, whole)
    factor = root(estimate.covariance)
    for b in length_blocks(model):
        mine, k, c = linear.of_block[b.target], b.kind.rows, len(b.rows)
        noise = 1.0 / whole.whitening(b)
        by = (linear.jacobian[mine] @ factor).reshape(k, c, -1)
        leverage = np.einsum("icf,jcf->cij", by, by)  # of whitened residuals
        weight = estimate.weights.row[b.name][:, None, None]
        free = np.linalg.inv(np.eye(k) - np.minimum(weight, 1 - 1e-9) * leverage)
        r = np.einsum("cij,jc->ic", free, linear.residual[mine].reshape(k, c))
        spread = np.where(weight > 0, free, np.eye(k) + leverage)
        each = noise.reshape(k, c)
        covariance = spread * np.einsum("ic,jc->cij", each, each)
        sd = np.sqrt(np.einsum("cii->ic", covariance)).ravel()
        yield _part(b, r.ravel() * noise, sd, np.zeros((k * c, 0)), covariance)


def blocks_left_out(estimate: Estimate, folded: Folded = folds) -> Iterator[_Part]:
    """Residuals of all fitted contacts by fits without their block of poses and time, or their region.

    Rejected contacts are predicted too. Residuals of one block are dependent through `by_parameters`; those
    of different blocks are not.
    """
    model = estimate.model
    whole = estimate.weights.full
    linear = linearise(model, estimate.z, whole)
    lengths = length_blocks(model)
    index = np.concatenate([np.arange(len(linear.residual))[linear.of_block[b.target]] for b in lengths])
    rows = _rows(lengths)
    weight = np.concatenate([np.tile(estimate.weights.row[b.name], b.kind.rows) for b in lengths])
    residual = linear.residual[index]
    by = linear.jacobian[index] @ root(estimate.covariance)
    spread = np.empty_like(by)
    fold = folded(model.scene.dataset.measurements, rows)
    for mine, moved, slopes in without_fold(residual.copy(), by, weight, fold):
        residual[mine], spread[mine] = moved, slopes
    ends = np.cumsum([b.residuals for b in lengths])
    for b, of_block in zip(lengths, np.split(np.arange(len(rows)), ends[:-1]), strict=True):
        noise, apart = 1.0 / whole.whitening(b), whole.decorrelation(b)
        r, by = (x[of_block] if apart is None else apart.coloured(x[of_block]) for x in (residual, spread))
        yield _part(b, r * noise, noise, by * noise[:, None])


TAILS = (0.025, 0.975)
"""Probabilities below the ends of a 95 % interval."""


def interval95(predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central 95 % interval of draws (S, ...): lower and upper ends, (...)."""
    low, high = np.quantile(predicted, TAILS, axis=0)
    return low, high


def inside95(measured: np.ndarray | float, predicted: np.ndarray) -> np.ndarray:
    """Which measured values (...) lie in the 95 % intervals of draws (S, ...)."""
    low, high = interval95(predicted)
    return (low <= measured) & (measured <= high)


def bootstrap_interval95(value: float, draws: np.ndarray, blocks: int) -> tuple[float, float]:
    """95 % interval of a value from its bootstrap draws, widened for few blocks (Student t)."""
    if blocks < 2 or not len(draws):
        return float("nan"), float("nan")
    wider = np.sqrt(blocks / (blocks - 1)) * t_ppf(TAILS[1], blocks - 1) / ndtri(TAILS[1])
    low, high = value + wider * (np.quantile(draws, TAILS) - value)
    return float(low), float(high)
