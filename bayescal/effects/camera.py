"""Camera: what a session states of a camera and its board, within the stated uncertainty.

Part of every model, as the tool: focal lengths, optical axis and distortion of the lens; scale and bow of the
board. What an effect such as `focal-length` names is an error beyond it. A value with a stated uncertainty
of 0 is not fitted.
"""

from __future__ import annotations

from bayescal.effects.imaging import bow, centre, distortion, focal, scale
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter


def _parameters(c: Circumstances) -> list[Parameter]:
    parts = (focal, centre, distortion, scale, bow)
    return [p for v in c.views for make in parts for p in make(v, v.name, 1.0)]


CAMERA = Effect(
    "camera",
    "lens of a camera, size and flatness of its board, within their stated uncertainty",
    _parameters,
    remedy="Calibrate the camera again, and measure the board.",
    in_robot_file=True,
)
