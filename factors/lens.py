"""Lenses: from a direction in the frame of a camera to a pixel, with derivatives, and back.

Pinhole with Brown-Conrady distortion (D. C. Brown, Photogrammetric Engineering 32, 1966): coefficients
k1, k2, p1, p2, k3. Fisheye (J. Kannala and S. Brandt, PAMI 28, 2006, as in OpenCV): k1 to k4 of the odd
powers of the angle from the optical axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
        return self.focal[:, None] * self.distorted(xy) + self.centre[:, None]

    def distorted(self, xy: np.ndarray) -> np.ndarray:
        """Distorted directions (..., 2, C)."""
        x, y = xy[..., 0, :], xy[..., 1, :]
        if self.model == FISHEYE:
            return xy * self._fisheye(x, y)[0][..., None, :]
        factor, square = self._brown(x, y)
        _, _, p1, p2, _ = self.coefficients
        return xy * factor[..., None, :] + np.array([[p2], [p1]]) * square[..., None, :]

    def slopes(self, xy: np.ndarray) -> np.ndarray:
        """Derivatives (..., 2, 2, C) of `distorted` by the direction."""
        x, y = xy[..., 0, :], xy[..., 1, :]
        if self.model == FISHEYE:
            factor, by_radius = self._fisheye(x, y)
            a, b, cross = factor + x * x * by_radius, factor + y * y * by_radius, x * y * by_radius
            return np.stack([np.stack([a, cross], -2), np.stack([cross, b], -2)], -3)
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
            left = self.distorted(xy) - goal
            (a, b), (c, d) = self.slopes(xy)
            size = a * d - b * c
            size = np.where(np.abs(size) > 1e-6, size, 1e-6)
            step = np.stack([d * left[0] - b * left[1], a * left[1] - c * left[0]]) / size
            xy = xy - np.clip(step, -0.3, 0.3)
            if np.max(np.abs(step), initial=0.0) < 1e-14:
                break
        return xy

    def _brown(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factor f and squared radius s by which a direction (x, y) becomes f (x, y) + s (p2, p1)."""
        k1, k2, p1, p2, k3 = self.coefficients
        square = x * x + y * y
        return 1 + square * (k1 + square * (k2 + square * k3)) + 2 * (p1 * y + p2 * x), square

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
