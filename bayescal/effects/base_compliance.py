"""Base compliance: what the arm stands on turns by the gravity moment of the whole arm.

Driver: the gravity moment about the base's origin, in F0, on its two horizontal axes, each with a compliance
of its own: a stand may yield more one way than another. About the vertical no weight has a moment. So it is
for an arm on the floor, at the ceiling or on a wall; about a first axis that lies, the tilt is that of the
first joint's compliance, and only their sum is identifiable. The hinge lies below the base's origin (or above
it), no one says how far, so that a tilt also slides the origin sideways; where the first axis does not stand
upright, it may lie behind the mounting plate too, and a tilt then raises the origin. Prior: about 1e-5
rad/(N m), a third of a shoulder's, with 1.5 times that as standard deviation, and a hinge within 0.3 m
(assumed: 30 N m tilt by 0.3 mrad, of which the fit takes up most as geometry; bending and base tilt took the
mean error of an ABB IRB 120 from 0.099 to 0.081 mm).
"""

from __future__ import annotations

import numpy as np

from bayescal.effects import location
from bayescal.effects.compliance import SPREAD
from bayescal.effects.joints import without_masses
from bayescal.effects.location import Driver
from bayescal.effects.stand import LEANING, base_terms, first_axis, tilts, vertical
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Where

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


BASE_COMPLIANCE = Effect(
    "base-compliance",
    "the base deflects under the gravity moment of the arm",
    _parameters,
    without_masses,
    phrase=("the base", "deflects under the gravity moment of the arm"),
    requires=("compliance",),
)
