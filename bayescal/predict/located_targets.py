"""Targets that no fit knows, found from their own rows: where they are, how sure that is, how far apart.

Linear at the estimate, where `validate` draws: the same figures in a tenth of the time. What an effect does
to a contact itself (lobing, the size of the ball) is taken off here too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from bayescal.arm.motion import Motion
from bayescal.effects.tool import LOOSE
from bayescal.estimate import Estimate, unit_weights
from bayescal.model import ARM, Block
from bayescal.model.scene import Scene
from bayescal.predict.locate import find, robust_rows
from factors.fixed_point import FixedPoint
from factors.kind import Kind
from factors.sphere import Sphere

SUSPICIOUS = 2.0
"""Noise standard deviations of a least-squares residual from which on slipped contacts are looked for."""


@dataclass(frozen=True)
class Distances:
    """D distances between centres that were found apart, m; the factors' squares are covariances."""

    names: tuple[tuple[str, str], ...]
    error: np.ndarray  # (D,) measured by the arm minus certified
    by_parameters: np.ndarray  # (D, F) of posterior standard normals
    by_noise: np.ndarray  # (D, M) of standard normals: contacts of the spheres, diameters
    u: np.ndarray  # (D,) of the certificates

    def predicted_sd(self, noise: float = 1.0) -> np.ndarray:
        """Predicted standard deviations (D,), m, with the fit's noise times a factor."""
        square = np.sum(self.by_parameters**2, axis=1) + noise**2 * np.sum(self.by_noise**2, axis=1)
        return np.sqrt(square + self.u**2)

    @property
    def block(self) -> np.ndarray:
        """Block labels (D,): the placement of the spheres, after '@' in their names; else each its own."""
        places = ["+".join(sorted({n.partition("@")[2] for n in pair})) for pair in self.names]
        labels = np.unique(places, return_inverse=True)[1]
        return labels if "" not in places and labels.max(initial=0) > 1 else np.arange(len(places))


@dataclass(frozen=True)
class Found:
    """A target found from its rows; its unknowns are its own part of z and, where unknown, the tool's.

    All at unit prior standard deviation.
    """

    block: Block  # of the rows that found it, as they touch there
    z: np.ndarray  # (size,)
    tool: np.ndarray  # (3,) m, shift of the tool's centre
    tool_sd: float  # m, its prior; 0 where the tool is known
    by_arm: np.ndarray  # (size + 0 or 3, P) slopes by the arm's z
    scatter: np.ndarray  # (size + 0 or 3, ...) factor of their covariance given the arm

    @property
    def centre(self) -> np.ndarray:
        """Where its centre is, (3,), m."""
        return self.block.kind.centre + self.block.state(self.z)[:3]  # type: ignore[attr-defined]

    @property
    def to_centre(self) -> np.ndarray:
        """Slopes (3, size + 0 or 3) of the centre by the unknowns, m."""
        out = np.zeros((3, len(self.by_arm)))
        for k, component in enumerate(self.block.free):
            if component < 3:
                out[component, k] = self.block.sd[k]
        return out


def root(covariance: np.ndarray) -> np.ndarray:
    """Factor L (D, D) with L L' = covariance, however near singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def noise_of(estimate: Estimate, block: Block) -> np.ndarray:
    """Noise (R,), m, of a block that is not fitted, by its group's scale; as stated where that has none."""
    sub = replace(estimate.model, blocks=(block,), constraints=())
    z = np.concatenate([estimate.z[estimate.model.slices[ARM]], np.zeros(block.size)])
    scale = {block.group: estimate.weights.scale.get(block.group, 1.0)}
    return 1.0 / replace(unit_weights(sub, z), scale=scale).whitening(block)


def locate(estimate: Estimate, target: int, rows: np.ndarray, u_diameter: float | None = None) -> Found:
    """Find a target, and a tool that no fitted row used, from some rows.

    `u_diameter` is the standard uncertainty of a sphere's nominal diameter, m; None leaves it loose.
    """
    block = estimate.model.block(target, rows)
    if u_diameter is not None and isinstance(block.kind, Sphere):
        block = replace(block, kind=replace(block.kind, sd=np.append(block.kind.sd[:3], u_diameter)))
    noise, tool_sd = noise_of(estimate, block), _unknown_tool(estimate.model.scene, rows)
    values = estimate.model.deviations(estimate.z[estimate.model.slices[ARM]])
    p, kind = block.motion.points(values), block.touched(values)
    slopes = _by_tool(block, values, p)[None] if tool_sd else None
    sigma = noise.reshape(kind.rows, -1)
    keep = np.ones(len(rows))
    at = find(kind, p[None], keep / sigma, None, slopes, tool_sd)
    if _suspicious(kind, at.x, p if slopes is None else p + np.tensordot(at.tool[0], slopes[0], 1), sigma):
        keep = robust_rows(kind, p, sigma, slopes, tool_sd)
        at = find(kind, p[None], keep / sigma, None, slopes, tool_sd)
    z, tool = at.x[0, block.free] / block.sd, at.tool[0]
    block = _moved(block, tool) if tool_sd else block
    _, by_arm, design = _design(estimate, block, z, tool_sd)
    weighted = design.T * (np.tile(keep, kind.rows) / noise**2)
    factor = cho_factor(weighted @ design + np.eye(design.shape[1]))
    covariance = cho_solve(factor, np.eye(len(weighted)))
    return Found(block, z, tool, tool_sd, -cho_solve(factor, weighted @ by_arm), root(covariance))


def against(
    estimate: Estimate, found: Found, target: int, rows: np.ndarray, arm: np.ndarray
) -> tuple[Block, np.ndarray, np.ndarray, np.ndarray]:
    """Any rows of a target that was found.

    Parameters
    ----------
    arm : np.ndarray, shape (P, F)
        The arm's part of the posterior's factor.

    Returns
    -------
    block : Block
    residual, noise : np.ndarray, shape (R,), m
    spread : np.ndarray, shape (R, ...), m
        Of standard normals: what arm and target leave uncertain.
    """
    block = estimate.model.block(target, rows)
    noise = noise_of(estimate, block)
    block = _moved(block, found.tool) if found.tool_sd else block
    r, by_arm, design = _design(estimate, block, found.z, found.tool_sd)
    spread, scatter = (by_arm + design @ found.by_arm) @ arm, design @ found.scatter
    if not np.array_equal(rows, found.block.rows):
        return block, r, noise, np.column_stack([spread, scatter])
    # rows that found it bend it towards themselves
    less = np.maximum(noise**2 - np.sum(scatter**2, axis=1), 1e-3 * noise**2)
    return block, r, np.sqrt(less), spread


def distances(scene: Scene, found: Mapping[str, Found], arm: np.ndarray) -> Distances:
    """Certified distances between spheres, or sockets, that were found; arm (P, F) as for `against`."""
    centres = {k: f for k, f in found.items() if isinstance(f.block.kind, Sphere | FixedPoint)}
    scatter = block_diag(*(f.to_centre @ f.scatter for f in centres.values()))  # (3 N, M)
    number = {name: k for k, name in enumerate(centres)}
    names, errors, u = [], [], []
    by_parameters, by_noise = [np.zeros((0, arm.shape[1]))], [np.zeros((0, scatter.shape[1]))]
    for c in scene.dataset.certificates:
        if c.kind != "distance" or any(name not in centres for name in c.targets):
            continue
        a, b = (centres[name] for name in c.targets)
        apart = a.centre - b.centre
        length = float(np.linalg.norm(apart))
        i, j = (3 * number[name] for name in c.targets)
        names.append((c.targets[0], c.targets[1]))
        errors.append(length - (c.distance or 0.0))
        u.append(c.u_distance or 0.0)
        along = (apart / length)[None]
        by_parameters.append(along @ (a.to_centre @ a.by_arm - b.to_centre @ b.by_arm) @ arm)
        by_noise.append(along @ (scatter[i : i + 3] - scatter[j : j + 3]))
    return Distances(
        tuple(names), np.array(errors), np.concatenate(by_parameters), np.concatenate(by_noise), np.array(u)
    )


def _suspicious(kind: Kind, x: np.ndarray, p: np.ndarray, sigma: np.ndarray) -> bool:
    size = np.sqrt(np.mean((kind.residual(x, p[None])[0] / sigma) ** 2, axis=0))
    return bool(size.max() > SUSPICIOUS * max(float(np.median(size)) / 0.6745, 1.0))


def _unknown_tool(scene: Scene, rows: np.ndarray) -> float:
    """Prior sd of the centre of the tool that these rows use, m; 0 where it is fitted, known or mixed."""
    used = np.unique(scene.dataset.measurements.tool[rows])
    if len(used) != 1 or used[0] in scene.dataset.measurements.tool[scene.rows("calibrate")]:
        return 0.0
    stated = scene.dataset.tools[used[0]].u
    return LOOSE if stated is None else stated


def _moved(block: Block, shift: np.ndarray) -> Block:
    """A block with its tools shifted by (3,) m in the flange frame."""
    old = block.motion
    return replace(block, motion=Motion(old.chain, old.q, old.tool + shift, old.terms, old.size))


def _by_tool(block: Block, values: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Change (3, 3, C) of the ball centres (axis 1) by the tool's three shifts (axis 0)."""
    return np.stack([_moved(block, axis).motion.points(values) - p for axis in np.eye(3)])


def _design(
    estimate: Estimate, block: Block, z: np.ndarray, tool_sd: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (R,), m, and gradients by the arm's z (R, P) and by all unknowns of the target (R, ...)."""
    model = estimate.model
    values = model.deviations(estimate.z[model.slices[ARM]])
    r, by_arm, design = block.linearise(values, z)
    if tool_sd:
        p = block.motion.points(values)
        _, u, _ = block.kind.linearise(block.state(z), p)
        by_tool = np.einsum("rkc,jkc->rcj", u, _by_tool(block, values, p)).reshape(len(r), 3)
        design = np.column_stack([design, by_tool * tool_sd])
    return r, by_arm * model.sd, design
