"""A camera that sees points of a board, one on the flange and the other fixed: ``pixel(p) - (u, v) = 0``.

The kind judges poses of the tool, which is the board, or the camera. A residual is the distance in pixels
times the nominal distance from the camera over the focal length: a length across the line of sight, m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.instrument import Framed
from factors.lens import Lens
from factors.turns import left_jacobian, product

NEAREST = 1e-2
"""m from the camera: a point that a search puts nearer, or behind it, is seen as if it were there."""


@dataclass(frozen=True)
class Camera(Framed):
    """Corners of a board in images; its state turns and moves what is fixed, whose frame it has.

    Poses of the tool in F0 are (..., 3, 4, C), orientation and origin. Gradients by them are (..., 2, 6, C),
    by a shift of the tool in F0 and by a turn about its origin: that of one force along the line of sight.

    Parameters
    ----------
    corner : (C, 3) m, in the frame of the board
    pixel : (C, 2)
    lens : of the camera
    scale : (C,) m per px
    sd : (6,) prior standard deviations: rotation vector (rad), translation at the pivot (m), in F0
    carried : whether the tool is the camera
    image : (C,) number of the pose of each corner, where poses (..., 3, 4, I) are of images, not of corners
    """

    corner: np.ndarray
    pixel: np.ndarray
    lens: Lens
    scale: np.ndarray
    sd: np.ndarray
    carried: bool
    image: np.ndarray | None = None
    rows = 2

    def _frames(self, x: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses (..., 3, 4, I or 1) in F0 of the camera, and of the board."""
        fixed = self.placed(x)[..., None]
        return (pose, fixed) if self.carried else (fixed, pose)

    def seen(self, x: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Corners in the frame of the camera, (..., 3, C), m."""
        camera, board = self._frames(x, pose)
        back = np.swapaxes(camera[..., :3, :], -3, -2)
        seen = product(back, board)
        seen[..., 3, :] -= product(back, camera[..., 3:, :])[..., 0, :]
        if self.image is None:
            return product(seen[..., :3, :], self.corner.T[:, None])[..., 0, :] + seen[..., 3, :]
        # all points of the board in all images, as one product, cost less than a pose for each corner
        points, of = self._points
        every = np.swapaxes(seen, -1, -2) @ np.insert(points, 3, 1.0, axis=1).T
        return np.take(every.reshape(*every.shape[:-2], -1), self.image * len(points) + of, axis=-1)

    @cached_property
    def _points(self) -> tuple[np.ndarray, np.ndarray]:
        """Different points (Q, 3) of the board, and which of them each corner is, (C,)."""
        points, of = np.unique(self.corner, axis=0, return_inverse=True)
        return points, of.ravel()

    def pixels(self, x: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Predicted pixels (..., 2, C)."""
        at = self.seen(x, pose)
        return self.lens.pixels(at[..., :2, :] / np.maximum(at[..., 2:, :], NEAREST))

    def residual(self, x: np.ndarray, pose: np.ndarray) -> np.ndarray:
        return self.scale * (self.pixels(x, pose) - self.pixel.T)

    def linearise(self, x: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (camera, _), local = self._frames(x, pose), self.seen(x, pose)
        axes = camera[..., :3, :]
        at = product(axes, local[..., None, :])[..., 0, :] + camera[..., 3, :]
        depth = np.maximum(local[..., 2, :], NEAREST)
        xy = local[..., :2, :] / depth[..., None, :]
        r = self.scale * (self.lens.pixels(xy) - self.pixel.T)
        # by the corner in the camera's frame (..., 2, 3, C), then in F0
        scale = self.lens.focal[:, None, None] * self.scale / depth[..., None, None, :]
        slopes = self.lens.slopes(xy) * scale
        inward = -np.sum(slopes * xy[..., None, :, :], axis=-2) * (local[..., 2, :] > NEAREST)[..., None, :]
        by = np.concatenate([slopes, inward[..., None, :]], axis=-2)
        w = product(by, np.swapaxes(axes, -3, -2))
        force = -w if self.carried else w
        lever = at - pose[..., 3, :]
        moment = np.cross(lever[..., None, :, :], force, axis=-2)
        own = w if self.carried else -w  # by what is fixed, moved along F0
        about = at - (self.pivot + x[..., 3:])[..., None]
        spin = np.cross(about[..., None, :, :], own, axis=-2)
        by_turn = np.einsum("...ijc,...jk->...ick", spin, left_jacobian(x[..., :3]))
        dx = np.concatenate([by_turn, np.swapaxes(own, -1, -2)], axis=-1)
        return r, np.concatenate([force, moment], axis=-2), dx
