"""An instrument that reads the point: ``T_instrument^-1 p - (x, y, z) = 0``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def _turned(vector: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = _cross_matrix(vector)
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def _left_jacobian(v: np.ndarray) -> np.ndarray:
    """J with exp(v + dv) = exp(J dv) exp(v), (..., 3, 3) (Sola et al., A micro Lie theory, 2018)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = _cross_matrix(v)
    first = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    safe = np.where(angle < 1e-4, 1.0, angle)
    second = np.where(angle < 1e-4, 1 / 6, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * k + second * (k @ k)


@dataclass(frozen=True)
class Instrument:
    """A laser tracker, CMM or measuring arm, by its frame in F0.

    Its state turns and moves the frame about `pivot` (F0), a point near the measurements, so that
    the rotation does not drag the translation along.

    Parameters
    ----------
    frame : (4, 4) nominal pose in F0
    pivot : (3,) m, in F0
    xyz : (C, 3) what it read, in its own frame, m
    sd : (6,) prior standard deviations: rotation vector (rad), translation at the pivot (m), in F0
    """

    frame: np.ndarray
    pivot: np.ndarray
    xyz: np.ndarray
    sd: np.ndarray
    rows = 3
    parts = (("rx", "rad"), ("ry", "rad"), ("rz", "rad"), ("x", "m"), ("y", "m"), ("z", "m"))

    def _local(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points relative to the moved pivot, turned back (..., 3, C), and that turn (..., 3, 3)."""
        turn = np.swapaxes(_turned(x[..., :3]), -1, -2)
        return turn @ (p - (self.pivot + x[..., 3:])[..., None]), turn

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        local, _ = self._local(x, p)
        home = self.frame[:3, :3].T
        return home @ (local + (self.pivot - self.frame[:3, 3])[:, None]) - self.xyz.T

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        local, turn = self._local(x, p)
        home = self.frame[:3, :3].T
        r = home @ (local + (self.pivot - self.frame[:3, 3])[:, None]) - self.xyz.T
        to_instrument = home @ turn
        count = r.shape[-1]
        lead = r.shape[:-2]
        u = np.broadcast_to(to_instrument[..., None], (*lead, 3, 3, count))
        dx = np.empty((*lead, 3, count, 6))
        # exp(-(J dv)) in front of the turned-back point: its change is local x (R' J dv)
        spin = turn @ _left_jacobian(x[..., :3])
        crosses = _cross_matrix(np.swapaxes(local, -1, -2))  # (..., C, 3, 3)
        dx[..., :3] = np.moveaxis(home @ crosses @ spin[..., None, :, :], -2, -3)
        dx[..., 3:] = -to_instrument[..., :, None, :]
        return r, u, dx

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        turn = _turned(x[:3])
        out = np.eye(4)
        out[:3, :3] = turn @ self.frame[:3, :3]
        out[:3, 3] = turn @ (self.frame[:3, 3] - self.pivot) + self.pivot + x[3:]
        return {"frame": out}
