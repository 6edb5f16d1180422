r"""Axis bending: the guide of a prismatic joint bends under its load, the more the farther it is extended.

Formula: $`\rho_a = c_a (M_a L \pm F_b L^2 / 2), \quad \delta_b = c_a (F_b L^3 / 3 \pm M_a L^2 / 2)`$;
c = 1 / (E I), L the extension, M and F the moment and the weight on the carriage, a and b across the axis.

The end of a cantilever of length L, clamped at the lower limit of the joint: a lifting column, or an arm
that is pushed out. In ``axis-bending@beam`` the guide lies on supports at both limits of the joint: a force
F at a distance p from one and r from the other deflects it there by F p^2 r^2 / (3 E I (p + r)), and turns
it by F p r (r - p) / (3 E I (p + r)); moments M turn it by M (p^3 + r^3) / (3 E I (p + r)^2), and deflect it
as the forces turn it. Each of the two directions across the axis has its own stiffness.

Prior: mean 2e-7 rad/(N m2), with a standard deviation of 1.5 times the mean (assumed: a steel tube of 200 x
200 x 6 mm has 1.6e-7).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.common import at, carries, without_masses, without_slides
from bayescal.effects.compliance import SPREAD
from bayescal.effects.location import Driver
from bayescal.effects.sizes import COMPLIANT, FACTOR
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter

MEAN = 2e-7  # rad/(N m2)

Beam = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Distances p and r (N,), m, from both limits -> per 1 / (E I): turn by a moment, turn by a force, which is
the deflection by a moment, and deflection by a force."""


def cantilever(p: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`Beam` that is clamped at p = 0 and ends at the carriage."""
    return p, p**2 / 2, p**3 / 3


def supported(p: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`Beam` on supports at p = 0 and r = 0."""
    length = p + r
    return (p**3 + r**3) / (3 * length**2), p * r * (r - p) / (3 * length), p**2 * r**2 / (3 * length)


def _bent(c: Circumstances, beam: Beam, label: str) -> list[Parameter]:
    assert c.loads is not None
    out = []
    for j in (np.flatnonzero(c.robot.slides) + 1).tolist():
        (low, high), sign = c.robot.limits[j - 1], np.sign(c.robot.link_from_reading[j - 1, j - 1])
        place = np.clip(sign * c.q[:, j - 1], low, high)
        turn, both, shift = beam(place - low, high - place)
        moment, force = c.loads.moments[:, j], c.loads.weights[:, j]
        # a turn about y moves the end of what extends along z along x, one about x against y
        for name, about, along, way in (("x", 1, 0, sign), ("y", 0, 1, -sign)):
            m, f = moment[:, about], way * force[:, along]
            turned, moved = turn * m + both * f, way * (shift * f + both * m)
            if carries(turned) or carries(moved):
                terms = (Term(j, f"r{'xyz'[about]}", turned), Term(j, f"t{'xyz'[along]}", moved))
                out.append(
                    Parameter(
                        f"axis-bending {label}{c.robot.joint_names[j - 1]} {name}", "rad/(N m^2)", terms,
                        SPREAD * MEAN, 0.0, MEAN, positive=True, **at(j, Driver("extended moment")),
                    )
                )  # fmt: skip
    return out


AXIS_BENDING = Effect(
    "axis-bending",
    "a linear axis bends under its load, by its extension",
    lambda c: _bent(c, cantilever, ""),
    lambda c: without_slides(c) or without_masses(c),
    sizes={"rad/(N m^2)": COMPLIANT, "1": FACTOR},
    phrase=("the linear axis", "bends under its load"),
    remedy=(
        "Check the clamping of the column or the supports of the rail. If they are firm, keep the effect "
        "in the model, and calibrate at the loads of the task."
    ),
    confusable_with=("bending",),
    requires=("compliance",),
    forms=(Form("beam", "as a beam on supports at its ends", lambda c: _bent(c, supported, "beam ")),),
)
