"""Base compliance: what the arm stands on turns by the gravity moment of the whole arm.

Driver: the components of the gravity moment in the base frame. Each turns that frame about its own axis; a
stand may yield more one way than another, so each axis has its compliance. The hinge lies below the frame's
origin, no one says how far, so that a tilt also slides the origin: a slide for each of the two axes. Prior:
about 1e-5 rad/(N m), a third of a shoulder's, with 1.5 times that as standard deviation, and a hinge within
0.3 m (assumed: 30 N m tilt by 0.3 mrad, of which the fit takes up most as geometry; bending and base tilt
took the mean error of an ABB IRB 120 from 0.099 to 0.081 mm).
"""

from __future__ import annotations

from bayescal.arm.motion import Term
from bayescal.effects import location
from bayescal.effects.compliance import SPREAD
from bayescal.effects.joints import carries, without_masses
from bayescal.effects.location import Driver
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Where

MEAN = 1e-5  # rad/(N m)
LEVER = 0.3  # m, from the hinge to the frame's origin
BASE: Where = {"site": location.BASE, "driver": Driver("base moment")}


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.moments is not None
    out = []
    for k, axis in enumerate("xyz"):
        moment = c.moments[:, 0, k]
        if not carries(moment):
            continue
        tilt = (Term(0, f"r{axis}", moment),)
        name = f"base-compliance {axis}"
        out.append(Parameter(name, "rad/(N m)", tilt, SPREAD * MEAN, 0.0, MEAN, positive=True, **BASE))
        if axis in "xy":
            slide = (Term(0, "ty" if axis == "x" else "tx", moment),)
            out.append(
                Parameter(f"base-compliance slide {axis}", "m/(N m)", slide, SPREAD * MEAN * LEVER, **BASE)
            )
    return out


BASE_COMPLIANCE = Effect(
    "base-compliance",
    "the base deflects under the gravity moment of the arm",
    _parameters,
    without_masses,
    phrase=("the base", "deflects under the gravity moment of the arm"),
    requires=("compliance",),
)
