r"""Geometry: every length, twist and joint zero of the (modified or standard) DH rows.

Formula: $`E_k = R_z(\Delta\theta_k) D_z(\Delta d_k) R_x(\Delta\alpha_k) D_x(\Delta a_k) R_y(\Delta\beta_k)`$;
the displacement of frame k; β where neighbouring axes are parallel.

Of a prismatic joint only the direction counts (alpha, theta, and beta), and the zero of its reading, d: a
constant shift of its carriage is the same before and behind it, so that it has no a.

Prior scales: standard deviations observed in 22 factory-calibrated UR arms and an ABB IRB 120 measured
with a laser tracker: lengths 0.3 mm, twists 1 mrad, joint zeros 2 mrad.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.common import apart
from bayescal.effects.location import BASE, joint, link
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


def _base(c: Circumstances) -> list[Parameter]:
    out = []
    for axis in ("tx", "ty", "tz", "rx", "ry", "rz") if c.tied_base else ():
        unit = "m" if axis[0] == "t" else "rad"
        term = (Term(0, axis),)
        out.append(Parameter(f"base {axis.removeprefix('t')}", unit, term, BASE_SD[axis[0]], site=BASE))
    return out


def _parameters(c: Circumstances) -> list[Parameter]:
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
    _parameters,
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
