"""Errors of cameras and boards, each as parameters of a view; effects differ in their priors alone."""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import IMAGE, Term
from bayescal.effects.common import NO_CAMERA
from bayescal.effects.location import BOARD, CAMERA, Driver, Site
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, ImageErrors, Parameter, View, Where

TIMES = 5.0
"""Prior of an error beyond the stated uncertainty, in units of this (assumed, as that of a certificate)."""
LEAST_SCALE = 2e-3
"""Least prior of an error of the size of a board beyond what is stated (assumed: prints stretch by tenths
of a percent, whatever a session states of them)."""

DRIVERS = {CAMERA: Driver("image"), BOARD: Driver("board")}
"""Of errors at a site."""


def at_view(v: View, site: Site) -> Site:
    """The camera or the board of a view, by name where there are several."""
    return site.of(v.name) if v.several else site


def late_images(c: Circumstances, v: View, by: np.ndarray | float = 1.0) -> tuple[Term, ...]:
    """Terms of readings later than the images of a view, in proportion to `by` (N,)."""
    assert c.velocity is not None
    rates = (c.velocity @ c.robot.link_from_reading.T).T * v.rows * by
    return tuple(Term(j, c.robot.axes[j - 1], -rate) for j, rate in enumerate(rates, start=1) if rate.any())


def reading_errors(c: Circumstances, sd: np.ndarray, image: np.ndarray) -> list[Parameter]:
    """An error of each reading of each image, which its corners share: nuisance parameters.

    Parameters
    ----------
    c : Circumstances
    sd : np.ndarray, shape (n,)
        Standard uncertainty of a reading of each joint, rad or m.
    image : np.ndarray, shape (N,)
        Number of the image of each row; rows without one have -1.
    """
    out = []
    for one in np.unique(image[image >= 0]):
        rows = (image == one).astype(float)
        for k in np.flatnonzero(sd > 0):
            by = [(j, x) for j, x in enumerate(c.robot.link_from_reading[:, k].tolist(), start=1) if x]
            terms = tuple(Term(j, c.robot.axes[j - 1], x * rows) for j, x in by)
            out.append(Parameter(f"reading {k + 1} of image {one}", "", terms, float(sd[k])))
    return out


def of_view(v: View, kind: str, prefix: str, times: float = 1.0, least: float = 0.0) -> list[Parameter]:
    """Errors of a kind, a field of `View`; none without a prior or a change in the image.

    Their prior is `times` the stated uncertainty, and at least `least`.
    """
    e: ImageErrors = getattr(v, kind)
    site = BOARD if e.of_board else CAMERA
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
