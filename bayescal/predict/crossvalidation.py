"""What one estimate leaves on rows that did not fit, and what it expected to leave, propagated linearly.

Contacts of fitted targets are judged against the fit; where the session keeps none back, each fitted contact
is left out in turn, in closed form. What no fit knows (a sphere, an instrument) is first found from its rows.
Lengths alone are judged: an orientation that a row reads beside its point helps to fit, and is not held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from bayescal.estimate import Estimate, linearise, unit_weights
from bayescal.model import ARM, Block
from bayescal.model.length_blocks import length_blocks
from bayescal.model.scene import Scene
from bayescal.predict.located_targets import Distances, Found, against, distances, locate, root
from factors.sphere import Sphere

KEPT_BACK, LEFT_OUT = "validation rows", "leave-one-out cross-validation"
"""How validation errors were obtained."""
FEWEST = 8
"""Validate rows of fitted targets below which the fitted rows are left out one by one instead."""
GROSS = 5.0
"""Predicted standard deviations beyond which a row is gross, unless a tenth of all rows strays as far."""
RESAMPLES = 2000
BLOCKS = 40
"""Blocks for the bootstrap into which rows without a stop or repeat are cut, in order of time."""


@dataclass(frozen=True)
class HeldOut:
    """R residuals of held-out contacts, three for a point, in the order of their rows, and the distances."""

    how: str  # KEPT_BACK or LEFT_OUT
    main: str  # whose noise the gap is set against: "contact" where a fit judges contacts, else "point"
    residual: np.ndarray  # (R,) m
    noise: np.ndarray  # (R,) m, of one residual by the fit's own scale
    by_parameters: np.ndarray  # (R, F) m, of posterior standard normals; 0 where in `noise` already
    rows: np.ndarray  # (R,) of the session
    kind: np.ndarray  # (R,) "planes" or "points"
    group: np.ndarray  # (R,) whose noise: "contact" or "point"
    target: np.ndarray  # (R,) names
    block: np.ndarray  # (R,) labels for the bootstrap
    distances: Distances

    @property
    def sd(self) -> np.ndarray:
        """Predicted standard deviations (R,), m."""
        return np.sqrt(self.noise**2 + np.sum(self.by_parameters**2, axis=1))

    @property
    def gross(self) -> np.ndarray:
        """Which residuals (R,) belong to contacts that no calibration explains.

        More than `GROSS` predicted standard deviations off. Where a tenth of all rows are, or a quarter of a
        target's, they are no slips but the gap itself, and the limit follows them.
        """
        size = np.abs(self.residual) / self.sd
        limit = np.ones(len(size))
        for label, share in ((self.kind, 0.9), (self.target, 0.75)):
            for own in np.unique(label):
                mine = label == own
                usual = np.quantile(size[mine], share) / norm.ppf(0.5 + 0.5 * share)
                limit[mine] = np.maximum(limit[mine], usual)
        return np.isin(self.rows, self.rows[size > GROSS * limit])


def kept(*held: HeldOut) -> np.ndarray:
    """Which residuals (R,) of the same session count: all but those gross under every one of the models."""
    return ~np.logical_and.reduce([h.gross for h in held])


@dataclass(frozen=True)
class _Part:
    """Some residuals of one target, component after component; fields as of `HeldOut`."""

    target: str
    group: str
    kind: str
    rows: np.ndarray
    residual: np.ndarray
    noise: np.ndarray
    by_parameters: np.ndarray


def held_out(estimate: Estimate) -> HeldOut:
    """Residuals, predictions and distances of the rows that an estimate did not see."""
    scene, model = estimate.model.scene, estimate.model
    m = scene.dataset.measurements
    rows = scene.rows("validate")
    fitted = [t for t, item in enumerate(scene.dataset.targets) if item.name in model.block_of]
    own = rows[np.isin(m.target[rows], fitted)]
    parts = _against_fit(estimate, own) if len(own) >= FEWEST else left_out(estimate)
    how = KEPT_BACK if len(own) >= FEWEST else LEFT_OUT
    main = "contact" if any(p.group == "contact" for p in parts) else "point"
    arm = root(estimate.covariance)[model.slices[ARM]]
    certified = {c.targets[0]: c.u_distance for c in scene.dataset.certificates if c.kind == "diameter"}
    found: dict[str, Found] = {}
    for t in map(int, np.setdiff1d(m.target[rows], fitted)):
        name, mine = scene.dataset.targets[t].name, scene.rows_of(t, rows)
        apart = scene.rows_of(t, scene.rows("locate"))
        is_sphere = isinstance(scene.kind(t, mine), Sphere)
        found[name] = locate(estimate, t, mine if is_sphere or not len(apart) else apart, certified.get(name))
        if not is_sphere:
            parts.append(_part(*against(estimate, found[name], t, mine, arm)))
    width = max([p.by_parameters.shape[1] for p in parts], default=0)
    at = np.concatenate([p.rows for p in parts])
    order = np.argsort(at, kind="stable")

    def joined(values: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate(values)[order]

    return HeldOut(
        how,
        main,
        joined([p.residual for p in parts]),
        joined([p.noise for p in parts]),
        joined([np.pad(p.by_parameters, ((0, 0), (0, width - p.by_parameters.shape[1]))) for p in parts]),
        at[order],
        joined([np.full(len(p.rows), p.kind) for p in parts]),
        joined([np.full(len(p.rows), p.group) for p in parts]),
        joined([np.full(len(p.rows), p.target) for p in parts]),
        blocks(scene, at[order]),
        distances(scene, found, arm),
    )


def blocks(scene: Scene, rows: np.ndarray) -> np.ndarray:
    """Block labels (R,) of rows in order of time: a stop or a group of repeats, else neighbours in time."""
    m = scene.dataset.measurements
    given = m.stop if m.stop is not None else m.repeat
    own = np.full(len(rows), "") if given is None else given[rows].astype(str)
    rest = np.unique(rows[own == ""])
    place = np.searchsorted(rest, rows) * min(BLOCKS, max(len(rest), 1)) // max(len(rest), 1)
    target = m.target[rows]
    labels = [f"{target[k]} {g}" if g else f"after {place[k]}" for k, g in enumerate(own)]
    return np.unique(labels, return_inverse=True)[1]


def _part(block: Block, residual: np.ndarray, noise: np.ndarray, by: np.ndarray) -> _Part:
    kind = "planes" if block.kind.rows == 1 else "points"
    rows = np.tile(block.rows, block.kind.rows)
    return _Part(block.target, block.group, kind, rows, residual, noise, by)


def _against_fit(estimate: Estimate, rows: np.ndarray) -> list[_Part]:
    """Rows of fitted targets, judged by the fit."""
    model, scene = estimate.model, estimate.model.scene
    present = np.unique(scene.dataset.measurements.target[rows])
    own = tuple(model.block(int(t), scene.rows_of(int(t), rows)) for t in present)
    sub = replace(model, blocks=own, constraints=())
    at = np.concatenate([np.r_[model.slices[name]] for name in sub.slices]).astype(int)
    weights = replace(unit_weights(sub, estimate.z[at]), scale=estimate.weights.scale)
    linear, factor = linearise(sub, estimate.z[at], weights), root(estimate.covariance)[at]
    out = []
    for b in own:
        mine, noise = linear.of_block[b.target], 1.0 / weights.whitening(b)
        by = (linear.jacobian[mine] * noise[:, None]) @ factor
        out.append(_part(b, linear.residual[mine] * noise, noise, by))
    return out


def left_out(estimate: Estimate) -> list[_Part]:
    """Every fitted contact by the fit to all the others: (1 - H)^-1 r, with H a contact's leverage.

    Exact where the model is linear. A rejected contact was not fitted; its residual stays as it is. `noise`
    holds what the other contacts leave uncertain too, which hardly runs together from contact to contact.
    The orientation that a row reads beside its point stays in the fit.
    """
    model = estimate.model
    full = {name: np.ones_like(row) for name, row in estimate.weights.row.items()}
    linear = linearise(model, estimate.z, replace(estimate.weights, row=full))
    factor, out = root(estimate.covariance), []
    for b in length_blocks(model):
        mine, k, c = linear.of_block[b.target], b.kind.rows, len(b.rows)
        noise = 1.0 / replace(estimate.weights, row=full).whitening(b)
        by = (linear.jacobian[mine] @ factor).reshape(k, c, -1)
        leverage = np.einsum("icf,jcf->cij", by, by)  # of whitened residuals
        weight = estimate.weights.row[b.name][:, None, None]
        free = np.linalg.inv(np.eye(k) - np.minimum(weight, 1 - 1e-9) * leverage)
        r = np.einsum("cij,jc->ic", free, linear.residual[mine].reshape(k, c))
        spread = np.where(weight > 0, free, np.eye(k) + leverage)
        sd = np.sqrt(np.einsum("cii->ic", spread))
        out.append(_part(b, r.ravel() * noise, sd.ravel() * noise, np.zeros((k * c, 0))))
    return out


def resampled(block: np.ndarray, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Means (RESAMPLES, K) of values (K, R) over block bootstrap samples, the same ones for all K."""
    labels, inverse = np.unique(block, return_inverse=True)
    draws = rng.multinomial(len(labels), np.full(len(labels), 1.0 / len(labels)), size=RESAMPLES)
    sums = np.stack([np.bincount(inverse, v) for v in values], axis=1)
    return (draws @ sums) / (draws @ np.bincount(inverse))[:, None]


def interval(value: float, draws: np.ndarray, blocks: int) -> tuple[float, float]:
    """95 % interval of a value by its bootstrap draws, as much wider as few blocks ask for (Student t)."""
    if blocks < 2 or not len(draws):
        return float("nan"), float("nan")
    end = 0.975
    wider = np.sqrt(blocks / (blocks - 1)) * student.ppf(end, blocks - 1) / norm.ppf(end)
    low, high = value + wider * (np.quantile(draws, [1.0 - end, end]) - value)
    return float(low), float(high)
