"""Whose error it is in images: of the arm, the camera, the board, a mount or the clock, each in pixels.

The part of a side is what its estimated parameters change in the images, less what another place of the
camera and of the board would change: hand-eye and place are estimated anew without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.effects import EFFECTS, Parameter
from bayescal.effects.location import BOARD, CAMERA
from bayescal.estimate import Estimate, linearise
from bayescal.model import ARM
from bayescal.model.block import Posed
from factors.camera import Camera

SITES = (CAMERA.kind, BOARD.kind)
"""Sites that are sides by themselves; all others are of the arm."""
PLACE = "tool"
"""Effect of the parameters of hand-eye."""


@dataclass(frozen=True)
class Part:
    """RMS of what one side changes in the images, px, its standard uncertainty, and the largest, px and m.

    Lengths are across the line of sight.
    """

    side: str
    rms: float
    u: float
    largest: float
    length: float


@dataclass(frozen=True)
class Images:
    """Fitted images and corners of a camera, noise of a coordinate, px, and the parts of all sides."""

    target: str
    images: int
    corners: int
    noise: float
    parts: tuple[Part, ...]


def side(parameter: Parameter) -> str:
    """Whether a parameter is of the arm, the camera, the board, a mount or the clock."""
    known, site = EFFECTS.get(parameter.effect), parameter.site.kind
    return (known.side if known else "") or (site if site in SITES else "arm")


def images(estimate: Estimate) -> Iterator[Images]:
    """What every side changes in the images of each camera of a fit, the largest first."""
    for block in estimate.model.blocks:
        if isinstance(block, Posed) and isinstance(block.kind, Camera):
            found = _of(estimate, block, block.kind)
            if found.corners:
                yield found


def _of(estimate: Estimate, block: Posed, kind: Camera) -> Images:
    model = estimate.model
    kept = estimate.weights.row[block.name] > 0
    both = np.tile(kept, kind.rows)
    scale, whitening = np.tile(kind.scale, kind.rows), estimate.weights.whitening(block)[both]
    mine = estimate.linear.of_block[block.name]
    linear = estimate.linear
    if estimate.weights.shared:  # of the corners themselves, whatever they share
        linear = linearise(model, estimate.z, estimate.weights.apart)
    jacobian, in_px, count = linear.jacobian[mine][both], scale[both], int(np.sum(kept))
    arm = model.slices[ARM]
    names = [side(p) for p in model.parameters]
    free = np.array([p.effect == PLACE for p in model.parameters], bool)
    place = np.concatenate([jacobian[:, arm][:, free], jacobian[:, model.slices[block.target]]], axis=1)
    basis = np.linalg.qr(place[:, np.any(place, axis=0)])[0]
    value = estimate.arm / model.sd
    parts = []
    for name in dict.fromkeys(names):
        own = np.flatnonzero((np.array(names) == name) & ~free)
        if not len(own):
            continue
        columns = jacobian[:, arm][:, own]
        columns = (columns - basis @ (basis.T @ columns)) / (whitening * in_px)[:, None]  # px
        moved = columns @ value[own]
        rms = float(np.sqrt(np.sum(moved**2) / max(count, 1)))
        slope = columns.T @ moved / max(count * rms, np.finfo(float).tiny)
        covariance = estimate.covariance[arm, arm][np.ix_(own, own)]
        u = float(np.sqrt(slope @ covariance @ slope))
        every = np.linalg.norm(moved.reshape(kind.rows, -1), axis=0)
        lengths = np.linalg.norm((moved * in_px).reshape(kind.rows, -1), axis=0)
        parts.append(Part(name, rms, u, float(every.max(initial=0)), float(lengths.max(initial=0))))
    parts.sort(key=lambda p: -p.rms)
    stated = float(np.median(block.sigma / kind.scale))  # few images are blurred
    noise = stated * estimate.weights.scale[block.group]
    return Images(block.target, len(np.unique(block.images[1][kept])), count, noise, tuple(parts))
