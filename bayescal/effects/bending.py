"""Bending: transverse compliance of the joint bearings, and bending of the links.

Each link has two compliances. Its bearing tilts at the joint under the gravity moment transverse to the axis
(components x and y in the joint's frame, each about its own axis). The link bends and twists under the moment
at its root, so that its far end, the next joint's frame, turns about that moment. Prior: mean 0.3 of the
joint's typical compliance, with a standard deviation of 1.5 times the mean (assumed; the order of magnitude
agrees with an ABB IRB 120, where bending and base tilt reduced the mean error from 0.099 to 0.081 mm, which
is 0.06 mm at half a metre and 30 N m). The first joint's bearing is omitted if its axis is vertical or
horizontal: there its effect equals that of `base-compliance`.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import frames
from bayescal.arm.motion import Term
from bayescal.effects.compliance import SPREAD, typical
from bayescal.effects.joints import carries, without_masses
from bayescal.effects.location import Driver, link
from bayescal.effects.sizes import COMPLIANT, FACTOR
from bayescal.effects.stand import LEANING, first_axis, vertical
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Where

SHARE = 0.3  # of the joint's compliance about its axis


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.moments is not None
    turned = frames(c.chain, c.q)[:, :, :3, :3]
    upright = float(first_axis(c) @ vertical(c))
    first_leans = min(abs(upright), np.sqrt(max(1.0 - upright**2, 0.0))) > LEANING
    out = []
    for j, (name, about) in enumerate(zip(c.robot.joint_names, typical(c.robot.n), strict=True), start=1):
        moment = c.moments[:, j]
        mean = SHARE * float(about)
        where: Where = {"site": link(j), "driver": Driver("bending moment")}
        terms: dict[str, list[Term]] = {"bearing": [], "link": []}
        if j > 1 or first_leans:
            terms["bearing"] = [Term(j, "rx", moment[:, 0]), Term(j, "ry", moment[:, 1])]
        if j < c.robot.n:
            # the moment at the root, in the frame at the far end
            far = np.einsum("cji,cjk,ck->ci", turned[:, j + 1], turned[:, j], moment)
            terms["link"] = [Term(j + 1, f"r{axis}", far[:, k]) for k, axis in enumerate("xyz")]
        for part, own in terms.items():
            if any(carries(np.asarray(term.driver)) for term in own):
                label = f"bending {name} {part}"
                sd = SPREAD * mean
                out.append(Parameter(label, "rad/(N m)", tuple(own), sd, 0.0, mean, positive=True, **where))
    return out


BENDING = Effect(
    "bending",
    "transverse (bending) compliance of link k",
    _parameters,
    without_masses,
    sizes={"rad/(N m)": COMPLIANT, "1": FACTOR},
    phrase=("every link", "has transverse (bending) compliance"),
    confusable_with=("coupling",),
    requires=("compliance",),
)
