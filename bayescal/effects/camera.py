"""Camera: what a session states of a camera and its board, within the stated uncertainty.

Part of every model, as the tool: focal lengths, optical axis and distortion of the lens; scale and bow of the
board. What an effect such as `focal-length` names is an error beyond it. A value with a stated uncertainty
of 0 is not fitted.
"""

from __future__ import annotations

from bayescal.effects.imaging import of_view
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter


def _parameters(c: Circumstances) -> list[Parameter]:
    kinds = ("focal", "centre", "distortion", "scale", "bow")
    return [p for v in c.views for kind in kinds for p in of_view(v, kind, v.name)]


CAMERA = Effect(
    "camera",
    "lens of a camera, size and flatness of its board, within their stated uncertainty",
    _parameters,
    remedy="Calibrate the camera again, and measure the board.",
    in_robot_file=True,
)
