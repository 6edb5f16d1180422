r"""Distortion: coefficients of a lens are in error by more than stated.

Formula: $`\delta u = f_x \sum_k x_k \, \partial x_d / \partial k`$; v alike, with the coefficients k of
the model of the lens (`factors.lens`).

Driver: the place in the image. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`).
"""

from __future__ import annotations

from bayescal.effects.imaging import beyond

LENS_DISTORTION = beyond(
    "distortion",
    "lens-distortion",
    "distortion of a lens in error",
    size=("1", "error of a coefficient"),
    phrase=("the camera", "has another distortion than stated"),
    remedy="Calibrate the camera again with corners up to the edges of the images.",
    confusable_with=("focal-length", "image-centre", "board-bow"),
)
