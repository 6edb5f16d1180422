r"""Base compliance: the base deflects under the gravity moment of the whole arm.

Formula: $`\rho_a = c_a M_a, \quad \delta_{a'} = s_a M_a, \quad a \in \{x, y\}`$;
M is the gravity moment on the base; a' is the direction across a.

Driver: the gravity moment about the base's origin, in F0, about its two horizontal axes, each with its own
compliance because a stand may be stiffer in one direction. Weight has no moment about the vertical. This
holds for any mounting (upright, inverted, wall). If the first joint's axis is horizontal, the tilt about
it equals the effect of the first joint's compliance, and only the sum of the two is identifiable. The hinge
is an unknown distance below or above the base's origin, so that a tilt also displaces the origin sideways
(`slide`). If the first axis is not vertical, the hinge may also be behind the mounting plate, and a tilt then
raises the origin (`rise`). In ``base-compliance@turned`` the two axes have any direction: a moment about one
of F0's axes also tilts the base about the other. Prior: mean 1e-5 rad/(N m), a third of a shoulder's
compliance, with a standard deviation of 1.5 times the mean, and a hinge within 0.3 m (assumed: 30 N m tilt
the base by 0.3 mrad, most of which the fit attributes to geometry; bending and base tilt reduced the mean
error of an ABB IRB 120 from 0.099 to 0.081 mm).
"""

from __future__ import annotations

import numpy as np

from bayescal.effects import location
from bayescal.effects.common import (
    LEANING,
    base_terms,
    by_session,
    first_axis,
    tilts,
    vertical,
    without_masses,
)
from bayescal.effects.compliance import SPREAD
from bayescal.effects.location import Driver
from bayescal.effects.sizes import COMPLIANT, FACTOR
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Where

MEAN = 1e-5  # rad/(N m)
LEVER = 0.3  # m, from the hinge to the frame's origin
BASE: Where = {"site": location.BASE, "driver": Driver("base moment")}


def _parameters(c: Circumstances) -> list[Parameter]:
    up, out = vertical(c), []
    for tilt in tilts(c):
        turn = base_terms(c, "r", tilt.axis, tilt.moment)
        name = f"base-compliance {tilt.name}"
        out.append(Parameter(name, "rad/(N m)", turn, SPREAD * MEAN, 0.0, MEAN, positive=True, **BASE))
        slides = {"slide": tilt.across}
        if abs(np.cross(tilt.axis, first_axis(c)) @ up) > LEANING:  # a hinge behind the plate
            slides["rise"] = up
        for how, along in slides.items():
            moved = base_terms(c, "t", along, tilt.moment)
            label = f"base-compliance {how} {tilt.name}"
            out.append(Parameter(label, "m/(N m)", moved, SPREAD * MEAN * LEVER, **BASE))
    return out


def _turned(c: Circumstances) -> list[Parameter]:
    """The same about two horizontal axes of any direction: a symmetric matrix, and its lever arm."""
    usual, pair = _parameters(c), tilts(c)
    if len(pair) < 2:
        return usual
    one, other = pair
    turn = (*base_terms(c, "r", one.axis, other.moment), *base_terms(c, "r", other.axis, one.moment))
    slide = (*base_terms(c, "t", one.axis, one.moment), *base_terms(c, "t", other.axis, -other.moment))
    return [
        *usual,
        Parameter("base-compliance cross", "rad/(N m)", turn, SPREAD * MEAN, **BASE),
        Parameter("base-compliance slide cross", "m/(N m)", slide, SPREAD * MEAN * LEVER, **BASE),
    ]


BASE_COMPLIANCE = Effect(
    "base-compliance",
    "the base deflects under the gravity moment of the arm",
    _parameters,
    without_masses,
    sizes={"rad/(N m)": COMPLIANT, "m/(N m)": COMPLIANT, "1": FACTOR},
    phrase=("the base", "deflects under the gravity moment of the arm"),
    remedy=(
        "Tighten the base bolts to the stated torque, clean and shim the mounting face, and stiffen "
        "or anchor the stand. Then repeat the session."
    ),
    requires=("compliance",),
    forms=(
        by_session(_parameters),
        Form("turned", "about horizontal axes that are turned against those of F0", _turned),
    ),
    simulated_within=1e-7,
    linear_spring=True,
)
