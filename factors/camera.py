"""Instruments: one that reads the point, ``T_instrument^-1 p - (x, y, z) = 0``, and a camera.

An instrument may read how the tool stands: ``log(R_read^T R_instrument^T R_tool) = 0``.

A camera sees points of a board, one on the flange and the other fixed: ``pixel(p) - (u, v) = 0``. The kind
judges poses of the tool, which is the board, or the camera. A residual is the distance in pixels times the
nominal distance from the camera over the focal length: a length across the line of sight, m.

Lenses: from a direction in the frame of a camera to a pixel, with derivatives, and back.

Pinhole with Brown-Conrady distortion (D. C. Brown, Photogrammetric Engineering 32, 1966): coefficients
k1, k2, p1, p2, k3. Fisheye (J. Kannala and S. Brandt, PAMI 28, 2006, as in OpenCV): k1 to k4 of the odd
powers of the angle from the optical axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors import kind
from factors.kind import slopes, turned


@dataclass(frozen=True)
class Framed:
    """What has a frame in F0.

    Its state turns and moves the frame about `pivot` (F0), a point near the measurements, so that
    the rotation does not drag the translation along.

    Parameters
    ----------
    frame : (4, 4) nominal pose in F0
    pivot : (3,) m, in F0
    """

    frame: np.ndarray
    pivot: np.ndarray
    parts = (("rx", "rad"), ("ry", "rad"), ("rz", "rad"), ("x", "m"), ("y", "m"), ("z", "m"))

    def placed(self, x: np.ndarray) -> np.ndarray:
        """Poses (..., 3, 4) of the frame in F0 at states x (..., 6)."""
        turn = turned(x[..., :3])
        shift = turn @ (self.frame[:3, 3] - self.pivot) + self.pivot + x[..., 3:]
        return np.concatenate([turn @ self.frame[:3, :3], shift[..., None]], axis=-1)

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        return {"frame": np.concatenate([self.placed(x), np.eye(4)[3:]])}

    def feature(self, x: np.ndarray) -> kind.Feature:
        by = slopes(x)
        arm = (turned(x[..., :3]) @ (self.frame[:3, 3] - self.pivot)[:, None])[..., 0]
        by[..., :3, :] = np.swapaxes(-kind.cross_matrix(arm) @ kind.left_jacobian(x[..., :3]), -1, -2)
        by[..., 3:, :] = np.eye(3)
        return kind.Feature(self.pivot + x[..., 3:] + arm, by)


@dataclass(frozen=True)
class Instrument(Framed):
    """A laser tracker, CMM or measuring arm, by its frame.

    Parameters
    ----------
    xyz : (C, 3) what it read, in its own frame, m
    sd : (6,) prior standard deviations: rotation vector (rad), translation at the pivot (m), in F0
    """

    xyz: np.ndarray
    sd: np.ndarray
    rows = 3

    def _apart(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals, points relative to the moved pivot, turned back (..., 3, C), and that turn."""
        turn = np.swapaxes(turned(x[..., :3]), -1, -2)
        local = turn @ (p - (self.pivot + x[..., 3:])[..., None])
        in_frame = self.frame[:3, :3].T @ (local + (self.pivot - self.frame[:3, 3])[:, None])
        return in_frame - self.xyz.T, local, turn

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        return self._apart(x, p)[0]

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r, local, turn = self._apart(x, p)
        home = self.frame[:3, :3].T
        to_instrument = home @ turn
        count = r.shape[-1]
        lead = r.shape[:-2]
        u = np.broadcast_to(to_instrument[..., None], (*lead, 3, 3, count))
        dx = np.empty((*lead, 3, count, 6))
        # exp(-(J dv)) in front of the turned-back point: its change is local x (R' J dv)
        spin = turn @ kind.left_jacobian(x[..., :3])
        crosses = kind.cross_matrix(np.swapaxes(local, -1, -2))  # (..., C, 3, 3)
        dx[..., :3] = np.moveaxis(home @ crosses @ spin[..., None, :, :], -2, -3)
        dx[..., 3:] = -to_instrument[..., :, None, :]
        return r, u, dx


@dataclass(frozen=True)
class Orientation:
    """The orientations among an instrument's readings; its state is the instrument's.

    It judges turns of the tool's frame in F0, rotation matrices (..., 3, 3, C), where other kinds judge
    ball centres. Residuals are the components, rad, of the rotation vector that takes the reading to
    the prediction, in the tool's frame as read; gradients by the arm are those by a small turn in F0.

    Parameters
    ----------
    frame : (4, 4) nominal pose of the instrument in F0
    read : (C, 3, 3) the tool's orientations in the instrument's frame
    sd : (6,) prior standard deviations of the instrument's state
    """

    frame: np.ndarray
    read: np.ndarray
    sd: np.ndarray
    rows = 3
    parts = Instrument.parts

    def _apart(self, x: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation vectors (..., C, 3), and what takes F0 to the frames that were read, (..., C, 3, 3)."""
        home = np.swapaxes(turned(x[..., :3]) @ self.frame[:3, :3], -1, -2)
        to_read = np.swapaxes(self.read, -1, -2) @ home[..., None, :, :]
        return kind.rotation_vector(to_read @ np.moveaxis(turns, -1, -3)), to_read

    def residual(self, x: np.ndarray, turns: np.ndarray) -> np.ndarray:
        return np.swapaxes(self._apart(x, turns)[0], -1, -2)

    def linearise(self, x: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r, to_read = self._apart(x, turns)
        by_turn = kind.inverse_left_jacobian(r) @ to_read  # (..., C, 3, 3)
        dx = np.zeros((*by_turn.shape[:-1], 6))
        # the instrument turned one way is the tool turned the other
        dx[..., :3] = -by_turn @ kind.left_jacobian(x[..., :3])[..., None, :, :]
        return np.swapaxes(r, -1, -2), np.moveaxis(by_turn, -3, -1), np.swapaxes(dx, -2, -3)

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        """The instrument's frame, turned; where it stands is for its points to say."""
        out = self.frame.copy()
        out[:3, :3] = turned(x[:3]) @ self.frame[:3, :3]
        return {"frame": out}


PINHOLE, FISHEYE = "pinhole", "fisheye"
NAMES = {PINHOLE: ("k1", "k2", "p1", "p2", "k3"), FISHEYE: ("k1", "k2", "k3", "k4")}
"""Coefficients of the distortion, in the order of OpenCV."""
AXIAL = 1e-8
"""Distance from the optical axis, in focal lengths, below which a fisheye does not distort."""
UNDONE = 30
"""Iterations that undo a distortion."""


@dataclass(frozen=True)
class Lens:
    """Focal lengths (2,) and centre (2,), px, and the coefficients of the distortion, (5,) or (4,)."""

    model: str
    focal: np.ndarray
    centre: np.ndarray
    coefficients: np.ndarray

    def pixels(self, xy: np.ndarray) -> np.ndarray:
        """Pixels (..., 2, C) of directions (x / z, y / z), (..., 2, C)."""
        out = self.distorted(xy)
        out *= self.focal[:, None]
        out += self.centre[:, None]
        return out

    def distorted(self, xy: np.ndarray) -> np.ndarray:
        """Distorted directions (..., 2, C)."""
        x, y = xy[..., 0, :], xy[..., 1, :]
        if self.model == FISHEYE:
            return xy * self._fisheye(x, y)[0][..., None, :]
        factor, square = self._brown(x, y)
        out = xy * factor[..., None, :]
        for row, p in enumerate(self.coefficients[[3, 2]]):
            out[..., row, :] += p * square
        return out

    def slopes(self, xy: np.ndarray) -> np.ndarray:
        """Derivatives (..., 2, 2, C) of `distorted` by the direction."""
        x, y = xy[..., 0, :], xy[..., 1, :]
        if self.model == FISHEYE:
            factor, by_radius = self._fisheye(x, y)
            a, b, cross = factor + x * x * by_radius, factor + y * y * by_radius, x * y * by_radius
        else:
            factor, square = self._brown(x, y)
            k1, k2, p1, p2, k3 = self.coefficients
            by_square = k1 + square * (2 * k2 + 3 * square * k3)
            a, b = factor + 2 * x * (x * by_square + 2 * p2), factor + 2 * y * (y * by_square + 2 * p1)
            cross = 2 * (x * y * by_square + p1 * x + p2 * y)
        return np.stack([np.stack([a, cross], -2), np.stack([cross, b], -2)], -3)

    def by_coefficients(self, xy: np.ndarray) -> np.ndarray:
        """Derivatives (K, 2, C) of the distorted direction (2, C) by each coefficient."""
        x, y = xy
        square = x * x + y * y
        if self.model == FISHEYE:
            radius = np.sqrt(square)
            share = np.arctan(radius) / np.maximum(radius, AXIAL)
            return np.stack([xy * share * np.arctan(radius) ** (2 * k) for k in (1, 2, 3, 4)])
        tangential = [np.stack([2 * x * y, square + 2 * y * y]), np.stack([square + 2 * x * x, 2 * x * y])]
        return np.stack([xy * square, xy * square**2, *tangential, xy * square**3])

    def directions(self, pixel: np.ndarray) -> np.ndarray:
        """Directions (2, C) that are seen at pixels (2, C): Newton's method."""
        goal = (pixel - self.centre[:, None]) / self.focal[:, None]
        xy = goal.copy()
        for _ in range(UNDONE):
            residual = self.distorted(xy) - goal
            (a, b), (c, d) = self.slopes(xy)
            size = a * d - b * c
            size = np.where(np.abs(size) > 1e-6, size, 1e-6)
            step = np.stack([d * residual[0] - b * residual[1], a * residual[1] - c * residual[0]]) / size
            xy = xy - np.clip(step, -0.3, 0.3)
            if np.max(np.abs(step), initial=0.0) < 1e-14:
                break
        return xy

    def _brown(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factor f and squared radius s by which a direction (x, y) becomes f (x, y) + s (p2, p1)."""
        k1, k2, p1, p2, k3 = self.coefficients
        square = x * x + y * y
        factor = k3 * square  # in place: of many corners each array is made anew by the system
        for k in (k2, k1):
            factor += k
            factor *= square
        factor += 1
        factor += 2 * p1 * y
        factor += 2 * p2 * x
        return factor, square

    def _fisheye(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factor on the direction, and its derivative by the radius over the radius."""
        radius = np.sqrt(x * x + y * y)
        safe = np.maximum(radius, AXIAL)
        angle, powers = np.arctan(safe), 2 * np.arange(5)[:, None]
        terms = np.concatenate([[1.0], self.coefficients])[:, None] * angle[..., None, :] ** powers
        turned = angle * np.sum(terms, axis=-2)
        by_angle = np.sum((powers + 1) * terms, axis=-2)
        factor = turned / safe
        return factor, (by_angle / (1 + safe * safe) - factor) / safe**2


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
        seen = kind.product(back, board)
        seen[..., 3, :] -= kind.product(back, camera[..., 3:, :])[..., 0, :]
        if self.image is None:
            return kind.product(seen[..., :3, :], self.corner.T[:, None])[..., 0, :] + seen[..., 3, :]
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
        points = self.seen(x, pose)
        return self.lens.pixels(points[..., :2, :] / np.maximum(points[..., 2:, :], NEAREST))

    def residual(self, x: np.ndarray, pose: np.ndarray) -> np.ndarray:
        out = self.pixels(x, pose)
        out -= self.pixel.T
        out *= self.scale
        return out

    def linearise(self, x: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (camera, _), local = self._frames(x, pose), self.seen(x, pose)
        axes = camera[..., :3, :]
        points = kind.product(axes, local[..., None, :])[..., 0, :] + camera[..., 3, :]
        depth = np.maximum(local[..., 2, :], NEAREST)
        xy = local[..., :2, :] / depth[..., None, :]
        r = self.scale * (self.lens.pixels(xy) - self.pixel.T)
        # by the corner in the camera's frame (..., 2, 3, C), then in F0
        scale = self.lens.focal[:, None, None] * self.scale / depth[..., None, None, :]
        slopes = self.lens.slopes(xy) * scale
        inward = -np.sum(slopes * xy[..., None, :, :], axis=-2) * (local[..., 2, :] > NEAREST)[..., None, :]
        by = np.concatenate([slopes, inward[..., None, :]], axis=-2)
        w = kind.product(by, np.swapaxes(axes, -3, -2))
        force = -w if self.carried else w
        lever = points - pose[..., 3, :]
        moment = np.cross(lever[..., None, :, :], force, axis=-2)
        by_fixed = w if self.carried else -w  # by what is fixed, moved along F0
        about = points - (self.pivot + x[..., 3:])[..., None]
        spin = np.cross(about[..., None, :, :], by_fixed, axis=-2)
        by_turn = np.einsum("...ijc,...jk->...ick", spin, kind.left_jacobian(x[..., :3]))
        dx = np.concatenate([by_turn, np.swapaxes(by_fixed, -1, -2)], axis=-1)
        return r, np.concatenate([force, moment], axis=-2), dx
