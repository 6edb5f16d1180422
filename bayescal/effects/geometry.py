"""Geometry of the arm at three levels of detail, and the tool: what is constant in its place."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.arm.motion import TURN, Term
from bayescal.effects import location
from bayescal.effects.common import apart
from bayescal.effects.location import BASE, joint, link
from bayescal.effects.readings import ENCODER_SCALE
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

LENGTH_SD = 0.3e-3  # m
TWIST_SD = 1e-3  # rad
ZERO_SD = 2e-3  # rad
BASE_SD = {"t": 50e-3, "r": 0.2}  # m and rad: as a target without a stated uncertainty
PARALLEL = np.radians(5.0)  # below this twist only the sum of two offsets along the axes is identifiable

KINDS = {"theta": ("rz", "rad", ZERO_SD), "d": ("tz", "m", LENGTH_SD), "alpha": ("rx", "rad", TWIST_SD)}
KINDS |= {"a": ("tx", "m", LENGTH_SD), "beta": ("ry", "rad", TWIST_SD)}


def _nominal(c: Circumstances, kind: str, i: int) -> float:
    """Nominal value of a_i, alpha_i, ... in the subscripts of Craig: link i follows joint i."""
    robot = c.robot
    if kind in ("theta", "d"):
        return float((robot.offset if kind == "theta" else robot.d)[i - 1])
    row = i if robot.convention == "mdh" else i - 1
    return float({"alpha": robot.alpha, "a": robot.a, "beta": robot.beta}[kind][row])


def _link(c: Circumstances, kind: str, i: int) -> Parameter:
    axis, unit, sd = KINDS[kind]
    site = joint(i) if kind in ("theta", "d") else link(i)
    return Parameter(f"{kind}{i}", unit, (Term(i, axis),), sd, _nominal(c, kind, i), site=site)


def _base(c: Circumstances) -> Iterator[Parameter]:
    for axis in ("tx", "ty", "tz", "rx", "ry", "rz") if c.tied_base else ():
        unit = "m" if axis[0] == "t" else "rad"
        term = (Term(0, axis),)
        yield Parameter(f"base {axis.removeprefix('t')}", unit, term, BASE_SD[axis[0]], site=BASE)


def _geometry(c: Circumstances) -> list[Parameter]:
    n = c.robot.n
    out = apart(c, _base)
    for i in range(1, n + 1):
        last, slides = i == n, bool(c.robot.slides[i - 1])
        # the first theta and d are not distinguishable from the base; the last ones are distinguishable from
        # the tool only if the tool's position is stated
        if (i > 1) and (not last or c.tied_tool):
            out.append(_link(c, "theta", i))
            if not c.robot.slides[: i - 1].all():  # a constant shift of what only slides is that of the base
                out.append(_link(c, "d", i))
        if not last:
            out += [_link(c, "alpha", i)] if slides else [_link(c, "a", i), _link(c, "alpha", i)]
            if abs(c.chain.link[i, 2, 1]) < np.sin(PARALLEL):  # parallel or opposed axes
                out.append(_link(c, "beta", i))
    return out


GEOMETRY = Effect(
    "geometry",
    "lengths, twists and joint zeros of the kinematic model differ from nominal",
    _geometry,
    phrase=("the arm", "differs from the nominal geometry"),
    remedy=(
        "Load the calibrated robot.yaml into the controller or the path planning (bayescal export). "
        "If a zero changed since the last session, look for a collision, a moved encoder or a loose "
        "flange, and set the joint zeros again."
    ),
    in_robot_file=True,
    simpler="joint",
    dimensions=True,
    simulated_within=1e-9,
)
r"""Geometry: every length, twist and joint zero of the (modified or standard) DH rows.

Formula: $`E_k = R_z(\Delta\theta_k) D_z(\Delta d_k) R_x(\Delta\alpha_k) D_x(\Delta a_k) R_y(\Delta\beta_k)`$;
the displacement of frame k; β where neighbouring axes are parallel.

Of a prismatic joint only the direction counts (alpha, theta, and beta), and the zero of its reading, d: a
constant shift of its carriage is the same before and behind it, so that it has no a.

Prior scales: standard deviations observed in 22 factory-calibrated UR arms and an ABB IRB 120 measured
with a laser tracker: lengths 0.3 mm, twists 1 mrad, joint zeros 2 mrad.
"""


def _joint(c: Circumstances) -> list[Parameter]:
    geometry = GEOMETRY.parameters(c)
    zeros = [p for p in geometry if p.site == BASE or (p.site.kind == "joint" and _zero(c, p))]
    return [*zeros, *ENCODER_SCALE.parameters(c)]


def _zero(c: Circumstances, p: Parameter) -> bool:
    """Whether a parameter displaces a joint along or about its axis of motion."""
    return all(term.axis == c.robot.axes[term.frame - 1] for term in p.terms)


JOINT = Effect(
    "joint",
    "zeros and scales of the joints, lengths and twists nominal",
    _joint,
    part_of=("geometry", "encoder-scale"),
    remedy=("Set the joint zeros again at the reference marks, and check the gear ratios in the controller."),
    in_robot_file=True,
    simulated_within=5e-8,
)
"""Joint level: only zeros and scales of the joints; every length and twist is nominal.

The first of the three levels of Mooring, Roth and Driels (Fundamentals of Manipulator Calibration, 1991):
the relation of a joint's reading and its angle. It shares its parameters and their priors with `geometry` and
`encoder-scale`. A diagnosis does not name it.
"""


LOOSE, LOOSE_ANGLE = 5e-3, 0.2  # m, rad: the contract's priors if none is stated


def _tool(c: Circumstances) -> list[Parameter]:
    """The point of each tool, and the turn from its stated or first estimated orientation."""
    end, out = c.chain.n + 1, list[Parameter]()
    used_tools = (*c.fitted_tools, *c.predicted_tools)
    places = [(k, c.tool_u[k], LOOSE, "m", end, "t", c.tool_centres[k].tolist()) for k in used_tools]
    turns = [(k, c.tool_u_angle[k], LOOSE_ANGLE, "rad", TURN, "r", [0.0] * 3) for k in c.turned_tools]
    for k, stated, loose, unit, frame, kind, nominal in (*places, *turns):
        sd = loose if stated is None else stated
        used = (c.tool == k).astype(float)
        driver = 1.0 if np.all(used) else used
        for axis, value in zip("xyz", nominal, strict=True) if sd else ():
            name = f"{c.tool_names[k]} {(kind + axis).removeprefix('t')}"
            terms = (Term(frame, kind + axis, driver),)
            out.append(Parameter(name, unit, terms, sd, value, site=location.TOOL))
    return out


TOOL = Effect(
    "tool",
    "position of the stylus tip in the flange frame, and orientation of the tool",
    _tool,
    remedy=("Measure the tool centre point again, and check that the stylus and the flange bolts are tight."),
)
"""Tool: the TCP offset, the stylus tip in the flange frame, of every tool that the fitted measurements use.

A tool that only validation measurements of fitted targets use keeps its prior, which their prediction has.
Also the tool's orientation on the flange, if rows read it. Part of every model. A tool with a stated
uncertainty of 0 is not fitted.
"""
