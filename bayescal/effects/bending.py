"""Bending of bearings, links and of the beam of a linear axis."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.chain import Chain
from bayescal.arm.motion import Term
from bayescal.arm.transforms import cross
from bayescal.effects.common import LEANING, at, carries, first_axis, vertical, without_masses, without_slides
from bayescal.effects.compliance import ELBOW, SHOULDER, SPREAD, of_joints
from bayescal.effects.location import COMPLIANT, FACTOR, Driver, link
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Where

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


def _bending(c: Circumstances) -> list[Parameter]:
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
    _bending,
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
