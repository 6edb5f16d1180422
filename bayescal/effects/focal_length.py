r"""Focal length: those of a camera are in error by more than stated.

Formula: $`\delta u = x_x \, x_d, \; \delta v = x_y \, y_d`$; (x_d, y_d) is the distorted direction, in
focal lengths.

Driver: the place in the image. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`). A common
error of both is distinguishable from an error of the size of the board by images at several distances.
"""

from __future__ import annotations

from bayescal.effects.imaging import beyond

FOCAL_LENGTH = beyond(
    "focal",
    "focal-length",
    "focal length of a camera in error",
    size=("px", "error of the focal length"),
    phrase=("the camera", "has a focal length in error"),
    remedy="Calibrate the camera again at this focus; check autofocus and scaling of the images.",
    confusable_with=("board-scale", "lens-distortion"),
)
