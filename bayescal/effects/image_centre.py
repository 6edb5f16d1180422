r"""Image centre: the optical axis meets the image elsewhere than stated.

Formula: $`\delta u = x_x, \; \delta v = x_y`$.

Driver: constant in the image. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`). A turn of
the camera on its mount looks nearly the same where all images are taken at one distance.
"""

from __future__ import annotations

from bayescal.effects.imaging import beyond

IMAGE_CENTRE = beyond(
    "centre",
    "image-centre",
    "optical axis of a camera in error",
    size=("px", "error of the optical axis"),
    phrase=("the camera", "has its optical axis elsewhere in the image"),
    remedy="Calibrate the camera again; check that images are neither cropped nor scaled.",
    confusable_with=("lens-distortion",),
)
