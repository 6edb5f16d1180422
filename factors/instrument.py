"""An instrument that reads the point: ``T_instrument^-1 p - (x, y, z) = 0``.

An instrument that reads how the tool stands: ``log(R_read^T R_instrument^T R_tool) = 0``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.kind import Feature, slopes
from factors.turns import cross_matrix, inverse_left_jacobian, left_jacobian, rotation_vector, turned


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

    def feature(self, x: np.ndarray) -> Feature:
        by = slopes(x)
        arm = (turned(x[..., :3]) @ (self.frame[:3, 3] - self.pivot)[:, None])[..., 0]
        by[..., :3, :] = np.swapaxes(-cross_matrix(arm) @ left_jacobian(x[..., :3]), -1, -2)
        by[..., 3:, :] = np.eye(3)
        return Feature(self.pivot + x[..., 3:] + arm, by)


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
        spin = turn @ left_jacobian(x[..., :3])
        crosses = cross_matrix(np.swapaxes(local, -1, -2))  # (..., C, 3, 3)
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
        return rotation_vector(to_read @ np.moveaxis(turns, -1, -3)), to_read

    def residual(self, x: np.ndarray, turns: np.ndarray) -> np.ndarray:
        return np.swapaxes(self._apart(x, turns)[0], -1, -2)

    def linearise(self, x: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r, to_read = self._apart(x, turns)
        by_turn = inverse_left_jacobian(r) @ to_read  # (..., C, 3, 3)
        dx = np.zeros((*by_turn.shape[:-1], 6))
        # the instrument turned one way is the tool turned the other
        dx[..., :3] = -by_turn @ left_jacobian(x[..., :3])[..., None, :, :]
        return np.swapaxes(r, -1, -2), np.moveaxis(by_turn, -3, -1), np.swapaxes(dx, -2, -3)

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        """The instrument's frame, turned; where it stands is for its points to say."""
        out = self.frame.copy()
        out[:3, :3] = turned(x[:3]) @ self.frame[:3, :3]
        return {"frame": out}
