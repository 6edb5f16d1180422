"""Errors of cameras and boards, each as parameters of a view; effects differ in their priors alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayescal.arm.motion import IMAGE, Term
from bayescal.effects.common import NO_CAMERA
from bayescal.effects.location import BOARD, CAMERA, Driver, Site
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, View, Where

TIMES = 5.0
"""Prior of an error beyond the stated uncertainty, in units of this (assumed, as that of a certificate)."""
LEAST_SCALE = 2e-3
"""Least prior of an error of the size of a board beyond what is stated (assumed: prints stretch by tenths
of a percent, whatever a session states of them)."""

DRIVERS = {CAMERA: Driver("image"), BOARD: Driver("board")}
"""Of errors at a site."""

Make = Callable[[View, str, float], list[Parameter]]


def _parameters(
    v: View, names: Sequence[str], unit: str, by: np.ndarray, sd: np.ndarray, site: Site,
    nominal: np.ndarray | None = None,
) -> list[Parameter]:  # fmt: skip
    """Parameters that change both coordinates in the image by (N, 2, K); none without a prior or a change."""
    where: Where = {"site": site.of(v.name) if v.several else site, "driver": DRIVERS[site]}
    out = []
    for k, (name, u) in enumerate(zip(names, sd.tolist(), strict=True)):
        terms = tuple(Term(IMAGE, axis, by[:, j, k]) for j, axis in enumerate("uv") if by[:, j, k].any())
        if u > 0 and terms:
            stated = 0.0 if nominal is None else float(nominal[k])
            out.append(Parameter(name, unit, terms, u, stated, **where))
    return out


def focal(v: View, prefix: str, times: float) -> list[Parameter]:
    """Focal lengths along both axes of the image, px."""
    names = f"{prefix} fx", f"{prefix} fy"
    return _parameters(v, names, "px", v.by_focal, times * v.u_focal, CAMERA, v.focal)


def centre(v: View, prefix: str, times: float) -> list[Parameter]:
    """The optical axis in the image, px."""
    names = f"{prefix} cx", f"{prefix} cy"
    return _parameters(v, names, "px", v.by_centre, times * v.u_centre, CAMERA, v.centre)


def distortion(v: View, prefix: str, times: float) -> list[Parameter]:
    """Deviations of the coefficients of the lens from their stated values."""
    names = [f"{prefix} {name}" for name in v.coefficients]
    return _parameters(v, names, "1", v.by_coefficients, times * v.u_coefficients, CAMERA)


def scale(v: View, prefix: str, times: float) -> list[Parameter]:
    """Relative errors of the size of the board along both of its axes."""
    u = times * v.u_scale if times == 1.0 else max(times * v.u_scale, LEAST_SCALE)
    by = v.by_board[:, :, :2] * v.corner[:, None, :2]
    return _parameters(v, (f"{prefix} scale x", f"{prefix} scale y"), "1", by, np.full(2, u), BOARD)


def bow(v: View, prefix: str, times: float) -> list[Parameter]:
    """Height of the middle of the board over its edges, of a bend along each of its axes, m."""
    bent = (1.0 - (v.corner[:, None, :2] / v.half) ** 2) * v.rows[:, None, None]
    names, u = (f"{prefix} bow x", f"{prefix} bow y"), np.full(2, times * v.u_flatness)
    return _parameters(v, names, "m", v.by_board[:, :, 2, None] * bent, u, BOARD)


def without_camera(c: Circumstances) -> str:
    """A message if no camera is fitted, or ""."""
    return "" if c.views else NO_CAMERA


def beyond(
    make: Make, name: str, summary: str, size: tuple[str, str], phrase: tuple[str, str], remedy: str,
    confusable_with: tuple[str, ...],
) -> Effect:  # fmt: skip
    """An effect: errors of every view beyond the stated uncertainty; `size` is their unit and its words."""
    return Effect(
        name, summary, lambda c: [p for v in c.views for p in make(v, f"{name} {v.name}", TIMES)],
        without_camera, sizes={size[0]: Size(size[1])}, phrase=phrase, remedy=remedy,
        confusable_with=confusable_with, in_robot_file=True, beside_arm=True,
    )  # fmt: skip
