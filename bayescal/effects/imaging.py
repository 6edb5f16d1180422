"""Errors of cameras and boards, each as parameters of a view; effects differ in their priors alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.motion import IMAGE, Term
from bayescal.effects.common import NO_CAMERA
from bayescal.effects.location import BOARD, CAMERA, Driver, Site
from bayescal.effects.vocabulary import Circumstances, Parameter, View

TIMES = 5.0
"""Prior of an error beyond the stated uncertainty, in units of this (assumed, as that of a certificate)."""
LEAST_SCALE = 2e-3
"""Least prior of an error of the size of a board beyond what is stated (assumed: prints stretch by tenths
of a percent, whatever a session states of them)."""
Make = Callable[[View, str, float], list[Parameter]]


def _parameter(
    name: str, unit: str, by: np.ndarray, sd: float, site: Site, driver: str, nominal: float = 0.0
) -> list[Parameter]:
    """A parameter that changes both coordinates in the image by (N, 2); none without a prior."""
    terms = tuple(Term(IMAGE, axis, by[:, k]) for k, axis in enumerate("uv") if by[:, k].any())
    made = Parameter(name, unit, terms, sd, nominal, site=site, driver=Driver(driver))
    return [made] if sd > 0 and terms else []


def focal(v: View, prefix: str, times: float) -> list[Parameter]:
    """Focal lengths along both axes of the image, px."""
    return [
        p
        for k, axis in enumerate("xy")
        for p in _parameter(
            f"{prefix} f{axis}", "px", v.by_focal[:, :, k], times * v.u_focal[k], _site(CAMERA, v), "image",
            float(v.focal[k]),
        )
    ]  # fmt: skip


def centre(v: View, prefix: str, times: float) -> list[Parameter]:
    """The optical axis in the image, px."""
    return [
        p
        for k, axis in enumerate("xy")
        for p in _parameter(
            f"{prefix} c{axis}", "px", v.by_centre[:, :, k], times * v.u_centre[k], _site(CAMERA, v), "image",
            float(v.centre[k]),
        )
    ]  # fmt: skip


def distortion(v: View, prefix: str, times: float) -> list[Parameter]:
    """Deviations of the coefficients of the lens from their stated values."""
    return [
        p
        for k, name in enumerate(v.coefficients)
        for p in _parameter(
            f"{prefix} {name}", "1", v.by_coefficients[:, :, k], times * v.u_coefficients[k],
            _site(CAMERA, v), "image",
        )
    ]  # fmt: skip


def scale(v: View, prefix: str, times: float) -> list[Parameter]:
    """Relative errors of the size of the board along both of its axes."""
    return [
        p
        for k, axis in enumerate("xy")
        for p in _parameter(
            f"{prefix} scale {axis}", "1", v.by_board[:, :, k] * v.corner[:, k, None],
            times * v.u_scale if times == 1.0 else max(times * v.u_scale, LEAST_SCALE),
            _site(BOARD, v), "board",
        )
    ]  # fmt: skip


def bow(v: View, prefix: str, times: float) -> list[Parameter]:
    """Height of the middle of the board over its edges, of a bend along each of its axes, m."""
    return [
        p
        for k, axis in enumerate("xy")
        for p in _parameter(
            f"{prefix} bow {axis}", "m",
            v.by_board[:, :, 2] * (1.0 - (v.corner[:, k, None] / v.half[k]) ** 2) * v.rows[:, None],
            times * v.u_flatness, _site(BOARD, v), "board",
        )
    ]  # fmt: skip


def _site(site: Site, v: View) -> Site:
    return site.of(v.name) if v.several else site


def errors(c: Circumstances, make: Make, effect: str) -> list[Parameter]:
    """The parameters of an effect: errors beyond the stated uncertainty, of every view."""
    return [p for v in c.views for p in make(v, f"{effect} {v.name}", TIMES)]


def without_camera(c: Circumstances) -> str:
    """A message if no camera is fitted, or ""."""
    return "" if c.views else NO_CAMERA
