"""Errors of cameras and boards, each as parameters of a view; effects differ in their priors alone."""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import IMAGE, Term
from bayescal.effects import location
from bayescal.effects.common import NO_CAMERA
from bayescal.effects.location import BOARD, Driver, Site, Size
from bayescal.effects.vocabulary import Circumstances, Effect, ImageErrors, Parameter, View, Where

TIMES = 5.0
"""Prior of an error beyond the stated uncertainty, in units of this (assumed, as that of a certificate)."""
LEAST_SCALE = 2e-3
"""Least prior of an error of the size of a board beyond what is stated (assumed: prints stretch by tenths
of a percent, whatever a session states of them)."""

DRIVERS = {location.CAMERA: Driver("image"), BOARD: Driver("board")}
"""Of errors at a site."""


def at_view(v: View, site: Site) -> Site:
    """The camera or the board of a view, by name where there are several."""
    return site.of(v.name) if v.several else site


def late_images(c: Circumstances, v: View, by: np.ndarray | float = 1.0) -> tuple[Term, ...]:
    """Terms of readings later than the images of a view, in proportion to `by` (N,)."""
    assert c.velocity is not None
    rates = (c.velocity @ c.robot.link_from_reading.T).T * v.rows * by
    return tuple(Term(j, c.robot.axes[j - 1], -rate) for j, rate in enumerate(rates, start=1) if rate.any())


def of_view(v: View, kind: str, prefix: str, times: float = 1.0, least: float = 0.0) -> list[Parameter]:
    """Errors of a kind, a field of `View`; none without a prior or a change in the image.

    Their prior is `times` the stated uncertainty, and at least `least`.
    """
    e: ImageErrors = getattr(v, kind)
    site = BOARD if e.of_board else location.CAMERA
    where: Where = {"site": at_view(v, site), "driver": DRIVERS[site]}
    nominal = np.zeros(len(e.u)) if e.nominal is None else e.nominal
    out = []
    for k, (name, sd) in enumerate(zip(e.names, np.maximum(times * e.u, least).tolist(), strict=True)):
        terms = tuple(Term(IMAGE, axis, e.by[:, j, k]) for j, axis in enumerate("uv") if e.by[:, j, k].any())
        if sd > 0 and terms:
            out.append(Parameter(f"{prefix} {name}", e.unit, terms, sd, float(nominal[k]), **where))
    return out


def without_camera(c: Circumstances) -> str:
    """A message if no camera is fitted, or ""."""
    return "" if c.views else NO_CAMERA


def beyond(
    kind: str, name: str, summary: str, size: tuple[str, str], phrase: tuple[str, str], remedy: str,
    confusable_with: tuple[str, ...], least: float = 0.0,
) -> Effect:  # fmt: skip
    """An effect: errors of a kind in every view beyond what is stated; `size` is their unit and its words."""
    return Effect(
        name, summary,
        lambda c: [p for v in c.views for p in of_view(v, kind, f"{name} {v.name}", TIMES, least)],
        without_camera, sizes={size[0]: Size(size[1])}, phrase=phrase, remedy=remedy,
        confusable_with=confusable_with, in_robot_file=True, beside_arm=True,
    )  # fmt: skip


def _camera(c: Circumstances) -> list[Parameter]:
    kinds = ("focal", "centre", "distortion", "scale", "bow")
    return [p for v in c.views for kind in kinds for p in of_view(v, kind, v.name)]


CAMERA = Effect(
    "camera",
    "lens of a camera, size and flatness of its board, within their stated uncertainty",
    _camera,
    remedy="Calibrate the camera again, and measure the board.",
    in_robot_file=True,
)
"""Camera: what a session states of a camera and its board, within the stated uncertainty.

Part of every model, as the tool: focal lengths, optical axis and distortion of the lens; scale and bow of the
board. What an effect such as `focal-length` names is an error beyond it. A value with a stated uncertainty
of 0 is not fitted.
"""


FOCAL_LENGTH = beyond(
    "focal",
    "focal-length",
    "focal length of a camera in error",
    size=("px", "error of the focal length"),
    phrase=("the camera", "has a focal length in error"),
    remedy="Calibrate the camera again at this focus; check autofocus and scaling of the images.",
    confusable_with=("board-scale", "lens-distortion"),
)
r"""Focal length: those of a camera are in error by more than stated.

Formula: $`\delta u = x_x \, x_d, \; \delta v = x_y \, y_d`$; (x_d, y_d) is the distorted direction, in
focal lengths.

Driver: the place in the image. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`). A common
error of both is distinguishable from an error of the size of the board by images at several distances.
"""


IMAGE_CENTRE = beyond(
    "centre",
    "image-centre",
    "optical axis of a camera in error",
    size=("px", "error of the optical axis"),
    phrase=("the camera", "has its optical axis elsewhere in the image"),
    remedy="Calibrate the camera again; check that images are neither cropped nor scaled.",
    confusable_with=("lens-distortion",),
)
r"""Image centre: the optical axis meets the image elsewhere than stated.

Formula: $`\delta u = x_x, \; \delta v = x_y`$.

Driver: constant in the image. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`). A turn of
the camera on its mount looks nearly the same where all images are taken at one distance.
"""


LENS_DISTORTION = beyond(
    "distortion",
    "lens-distortion",
    "distortion of a lens in error",
    size=("1", "error of a coefficient"),
    phrase=("the camera", "has another distortion than stated"),
    remedy="Calibrate the camera again with corners up to the edges of the images.",
    confusable_with=("focal-length", "image-centre", "board-bow"),
)
r"""Distortion: coefficients of a lens are in error by more than stated.

Formula: $`\delta u = f_x \sum_k x_k \, \partial x_d / \partial k`$; v alike, with the coefficients k of
the model of the lens (`factors.camera`).

Driver: the place in the image. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`).
"""


BOARD_SCALE = beyond(
    "scale",
    "board-scale",
    "size or squareness of a board in error",
    size=("1", "relative error of the size, or skew"),
    phrase=("the board", "has another size than stated, or is not square"),
    remedy="Measure the board over several squares along both axes, and write the size of its squares.",
    confusable_with=("focal-length",),
    least=LEAST_SCALE,
)
r"""Board scale: a board is larger or smaller than stated, along each of its axes, or printed askew.

Formula: $`\delta p = (x_x \, a + x_s \, b, x_y \, b, 0)`$ of a point (a, b) of the board, from its middle.

Driver: the place on the board. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`), at
least 0.2 %: a printer stretches its print by some tenths of a percent.
"""


BOARD_BOW = beyond(
    "bow",
    "board-bow",
    "board not flat",
    size=("m", "height of the middle, or of a corner by a twist"),
    phrase=("the board", "is not flat"),
    remedy="Mount the board on a stiff, flat plate, and check it with a straightedge.",
    confusable_with=("lens-distortion",),
)
r"""Board bow: a board is bent, along its axes or any other direction.

Formula: $`\delta p = (0, 0, x_x (1 - (a / A)^2) + x_y (1 - (b / B)^2) + x_t a b / (A B))`$ of a point (a, b)
of a board of the half size (A, B), from its middle.

Driver: the place on the board. Prior: five times the stated flatness (assumed, `imaging.TIMES`).
"""
