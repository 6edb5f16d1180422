"""An instrument that reads how the tool stands: ``log(R_read^T R_instrument^T R_tool) = 0``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.instrument import Instrument
from factors.turns import inverse_left_jacobian, left_jacobian, rotation_vector, turned


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
