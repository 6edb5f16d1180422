r"""Bending: transverse compliance of the joint bearings, and bending of the links.

Formula: $`\rho_{a,k} = c_{a,k} M_{a,k}, \quad a \perp z_k`$; M is the gravity moment at the hinge.

The bearing of each link tilts at its joint under the gravity moment transverse to the axis (components x
and y in the joint's frame, each about its own axis). The link bends as if it had two spring hinges at its
middle, across its length, each with its own compliance: sections are rarely round. A uniform cantilever of
length L and stiffness EI under a moment M and a force F at its far end turns there by M L / EI + F L^2 / (2
EI). That is L / EI times the moment at its middle, and the end sinks as if it turned about the middle, but
for F L^3 / (12 EI). A link extends from before its joint's d to the next row of the table. Its own mass is
beyond the middle. A link without length does not bend. Its torsion is left to the joints.

Prior of a bearing: mean 0.3 of the joint's typical compliance, with a standard deviation of 1.5 times the
mean (assumed; the order of magnitude agrees with an ABB IRB 120, where bending and base tilt reduced the
mean error from 0.099 to 0.081 mm, which is 0.06 mm at half a metre and 30 N m). That of a link is the same,
but not above that of the elbow: a wrist yields in its gears. The first joint's bearing is omitted if its
axis is vertical or horizontal: there its effect equals that of `base-compliance`.
The carriage of a prismatic joint tilts under the moment about itself, with the compliance of a shoulder.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import Chain
from bayescal.arm.motion import Term
from bayescal.arm.transforms import cross
from bayescal.effects.common import LEANING, carries, first_axis, vertical, without_masses
from bayescal.effects.compliance import ELBOW, SHOULDER, SPREAD, of_joints
from bayescal.effects.location import Driver, link
from bayescal.effects.sizes import COMPLIANT, FACTOR
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter, Where

SHARE = 0.3  # of the joint's compliance about its axis
SHORT = 1e-3  # m: a link of this length counts as without length


def ends(chain: Chain, j: int) -> np.ndarray:
    """Ends of link j (from 1) in its frame, (2, 3), m: before its joint's d, and at the next row's axis."""
    slides = np.broadcast_to(chain.slides, chain.n)[j - 1]  # from its carriage on
    return np.array([[0.0, 0.0, 0.0 if slides else -chain.d[j - 1]], chain.link[j, :3, 3]])


def across(ends: np.ndarray) -> dict[str, np.ndarray]:
    """Unit axes (3,) across a link between two ends (2, 3), m, named by the nearest axis of its frame.

    Ends differ along x and z of the frame alone: one axis is y, the other is in that plane.
    """
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length < SHORT:
        return {}
    other = np.array([-along[2], 0.0, along[0]]) / length
    return {"y": np.array([0.0, 1.0, 0.0]), "xyz"[int(np.argmax(np.abs(other)))]: other}


def _bearing(c: Circumstances, j: int) -> list[Term]:
    assert c.loads is not None
    moment = c.loads.moments[:, j]
    return [Term(j, "rx", moment[:, 0]), Term(j, "ry", moment[:, 1])]


def _hinge(c: Circumstances, j: int, axis: np.ndarray, point: np.ndarray) -> list[Term]:
    """Turns of frame j about an axis (3,) through a point (3,), m, by the moment there; it does not slide."""
    assert c.loads is not None
    moment = (c.loads.moments[:, j] - cross(point, c.loads.weights[:, j])) @ axis
    parts = zip(("rx", "ry", "rz", "tx", "ty", "tz"), (*axis, *np.cross(point, axis)), strict=True)
    return [Term(j, name, part * moment) for name, part in parts if abs(part) > 1e-12]


def _parameters(c: Circumstances) -> list[Parameter]:
    upright = float(first_axis(c) @ vertical(c))
    first_leans = min(abs(upright), np.sqrt(max(1.0 - upright**2, 0.0))) > LEANING
    usual = SHARE * of_joints(c.robot, SHOULDER)
    out = []
    for j, (name, of_joint) in enumerate(zip(c.robot.joint_names, usual.tolist(), strict=True), start=1):
        parts = {"bearing": (_bearing(c, j), of_joint)} if j > 1 or first_leans or c.robot.slides[0] else {}
        if j < c.robot.n:
            of_link, two = min(of_joint, SHARE * ELBOW), ends(c.chain, j)
            for axis, way in across(two).items():
                parts[f"link {axis}"] = _hinge(c, j, way, two.mean(axis=0)), of_link
        where: Where = {"site": link(j), "driver": Driver("bending moment")}
        for part, (terms, mean) in parts.items():
            if any(carries(np.asarray(term.driver)) for term in terms):
                label, sd = f"bending {name} {part}", SPREAD * mean
                out.append(Parameter(label, "rad/(N m)", tuple(terms), sd, 0.0, mean, positive=True, **where))
    return out


BENDING = Effect(
    "bending",
    "transverse (bending) compliance of link k",
    _parameters,
    without_masses,
    sizes={"rad/(N m)": COMPLIANT, "1": FACTOR},
    phrase=("every link", "has transverse (bending) compliance"),
    remedy=(
        "Check the bolts of the joint bearing and of the link, and the firm seat of the flanges; a "
        "worn cross-roller bearing tilts. Of the last links: the bracket of the tool or camera bends alike. "
        "If all are tight, keep the effect in the model."
    ),
    confusable_with=("coupling", "axis-bending"),
    requires=("compliance",),
    simulated_within=5e-7,
    linear_spring=True,
)
