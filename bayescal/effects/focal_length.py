r"""Focal length: those of a camera are in error by more than stated.

Formula: $`\delta u = x_x \, x_d, \; \delta v = x_y \, y_d`$; (x_d, y_d) is the distorted direction, in
focal lengths.

Driver: the place in the image. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`). A common
error of both is distinguishable from an error of the size of the board by images at several distances.
"""

from __future__ import annotations

from bayescal.effects.imaging import errors, focal, without_camera
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter


def _parameters(c: Circumstances) -> list[Parameter]:
    return errors(c, focal, "focal-length")


FOCAL_LENGTH = Effect(
    "focal-length",
    "focal length of a camera in error",
    _parameters,
    without_camera,
    sizes={"px": Size("error of the focal length")},
    phrase=("the camera", "has a focal length in error"),
    remedy="Calibrate the camera again at this focus; check autofocus and scaling of the images.",
    confusable_with=("board-scale", "lens-distortion"),
    in_robot_file=True,
    beside_arm=True,
)
