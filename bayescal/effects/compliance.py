"""Compliance of joints and base: displacements by torques, in proportion or not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.motion import Term
from bayescal.effects import common, location
from bayescal.effects.location import COMPLIANT, FACTOR, Driver, Size
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter, Scan, Where

SHOULDER, ELBOW, WRIST = 3e-5, 2e-4, 2e-3  # rad/(N m)
ALONG = 5e-8  # m/N, of a prismatic joint
SPREAD = 1.5  # prior standard deviation over the prior mean


def typical(n: int) -> np.ndarray:
    """Typical compliances (n,), rad/(N m): the last three joints are the wrist, the one before the elbow."""
    every = np.array([SHOULDER] * (n - 4) + [ELBOW] + [WRIST] * 3)
    return every[len(every) - n :]


def of_joints(robot: Robot, along: float = ALONG) -> np.ndarray:
    """Typical compliances (n,) of the joints; of prismatic ones, which do not count, `along`, m/N."""
    out = np.full(robot.n, along)
    out[~robot.slides] = typical(int(np.sum(~robot.slides)))
    return out


def expected(robot: Robot) -> np.ndarray:
    """Compliances (n,), rad/(N m) or m/N, of the robot file, and typical ones where none is stated."""
    mean = of_joints(robot)
    return mean if robot.compliance is None else np.where(robot.compliance > 0, robot.compliance, mean)


def loaded(c: Circumstances) -> Iterator[tuple[int, str, float, np.ndarray]]:
    """Joints that carry a torque: number (from 1), name, expected compliance, torque (N,), N m."""
    assert c.torques is not None
    for j, (name, mean) in enumerate(zip(c.robot.joint_names, expected(c.robot), strict=True), start=1):
        torque = c.torques[:, j - 1]
        if common.carries(torque):
            yield j, name, float(mean), torque


def by_torque(
    c: Circumstances,
    effect: str,
    driver: Callable[[np.ndarray, float], np.ndarray],
    sd: Callable[[float, float], float],
    unit: str = "rad",
    form: str = "",
) -> list[Parameter]:
    """Parameters of every joint that carries a torque.

    `driver` is a function of the torque (N,) and the usual one, N m; `sd` of the expected compliance and the
    usual torque. A prismatic joint has one only if `unit` is rad; it is then in m.
    """
    return [
        Parameter(
            f"{effect} {name}", "m" if slides else unit,
            (Term(j, c.robot.axes[j - 1], driver(torque, most)),), sd(compliance, most),
            **common.site_and_driver(j, Driver("torque", j, form=form)),
        )
        for j, name, compliance, torque in loaded(c)
        for slides in [c.robot.slides[j - 1]]
        for most in [common.usual(c, torque)]
        if unit == "rad" or not slides
    ]  # fmt: skip


def _compliance(c: Circumstances) -> list[Parameter]:
    nominal = c.robot.compliance if c.robot.compliance is not None else np.zeros(c.robot.n)
    return [
        Parameter(
            f"compliance {name}", unit, (Term(j, axis, torque),), SPREAD * mean, float(nominal[j - 1]),
            mean, positive=True, **common.site_and_driver(j, Driver("torque", j)),
        )
        for j, name, mean, torque in loaded(c)
        for axis in [c.robot.axes[j - 1]]
        for unit in ["m/N" if axis == "tz" else "rad/(N m)"]
    ]  # fmt: skip


COMPLIANCE = Effect(
    "compliance",
    "joint k yields elastically to its gravity torque",
    _compliance,
    common.without_torques,
    sizes={"rad/(N m)": COMPLIANT, "m/N": COMPLIANT, "1": FACTOR},
    phrase=("every joint", "deflects under gravity torque"),
    remedy=(
        "Normal for an elastic gear: compensate it with the calibrated model. If a joint is softer "
        "than similar joints, check the preload of its gear and bearings, the belt tension and the "
        "bolts of the motor."
    ),
    in_robot_file=True,
    simulated_within=2e-8,
    linear_spring=True,
)
r"""Compliance: each joint turns by its gravity torque over its stiffness.

Formula: $`\rho_{z,k} = c_k \tau_k`$; τ is the gravity torque, N m. A prismatic joint deflects along its axis
under the weight along it, N.

Prior: the mean is the compliance of small arms (an ABB IRB 120 measured with a laser tracker): shoulder
3e-5, elbow 2e-4, wrist 2e-3 rad/(N m). The standard deviation is 1.5 times the mean, so that a factor
of 3 is well within it. Along a prismatic joint the mean is 0.05 µm/N (assumed: a rack or a ball screw of 20
N/µm). If the robot file states a compliance, that is the mean.
Only the product of compliance and mass is identifiable: masses are assumed to be as stated. If the session
measures torques (``torques: measured``), these are the driver, and no masses are needed.
"""


CHANGE = 0.3  # of the compliance
WOUND_UP = 1.6e-3  # rad
KNEES = np.array([0.2, 0.3, 0.45, 0.8])
UNEVEN_KNEE = 0.45  # as a share of the usual torque
UNEVEN_ODDS = 0.1  # assumed: two amounts fit other errors by torque too


def _hardening(c: Circumstances) -> list[Parameter]:
    def sd(compliance: float, most: float) -> float:
        return CHANGE * compliance**2 / WOUND_UP

    return by_torque(c, "hardening", lambda torque, most: torque * np.abs(torque), sd, "rad/(N m)^2")


def _uneven(c: Circumstances) -> list[Parameter]:
    """Parameters of a soft part that differs between the signs of the torque."""
    return [
        Parameter(
            f"hardening {name} {words}", "m" if c.robot.slides[j - 1] else "rad",
            (Term(j, c.robot.axes[j - 1], side * np.maximum(side * soft, 0.0)),),
            CHANGE * compliance * UNEVEN_KNEE * common.usual(c, torque),
            **common.site_and_driver(j, Driver("torque", j, form="uneven")),
        )
        for j, name, compliance, torque in loaded(c)
        for soft in [np.tanh(torque / (UNEVEN_KNEE * common.usual(c, torque)))]
        for side, words in ((1.0, "positive"), (-1.0, "negative"))
    ]  # fmt: skip


def _at(c: Circumstances, knee: float) -> list[Parameter]:
    """Parameters with a knee: soft up to a share of the joint's usual torque, linear beyond."""
    return by_torque(
        c,
        "hardening",
        lambda torque, most: np.tanh(torque / (knee * most)),
        lambda compliance, most: CHANGE * compliance * knee * most,
    )


HARDENING = Effect(
    "hardening",
    "nonlinear (torque-dependent) stiffness of joint k",
    _hardening,
    common.without_torques,
    Scan(
        "knee as a share of the usual torque",
        "low stiffness up to {:.0%} of the usual torque",
        lambda c: KNEES,
        _at,
    ),
    sizes={
        "rad/(N m)^2": Size("change of the compliance per torque"),
        **dict.fromkeys(("rad", "m"), Size("deflection of the soft part")),
    },
    phrase=("every joint", "has nonlinear stiffness"),
    remedy=(
        "Check the preload of the reduction and of its bearings, and look for wear of the strain-wave "
        "gear. If the gear is in order, keep the effect in the model and calibrate at the loads of "
        "the task."
    ),
    confusable_with=("hysteresis",),
    requires=("compliance",),
    forms=(Form("uneven", "of another amount at each sign of the torque", _uneven, UNEVEN_ODDS),),
    simulated_within=5e-7,
)
r"""Nonlinear stiffness of a joint: it depends on the torque. A positive value is softening.

Formula: $`\rho_{z,k} = h_k \, \tau_k |\tau_k|`$;
with a knee: h tanh(τ / (s T)), T the usual torque and s the share.

Driver: gravity torque times its magnitude, in addition to `compliance`. Prior: an elbow of 2e-4 rad/(N m) was
30 % softer near zero torque than at 8 N m, where its wind-up is 1.6 mrad (an ABB IRB 120 measured with a
laser tracker). So the compliance of every joint is assumed to change by 30 % at 1.6 mrad: the prior is 0.3
of the compliance divided by the torque that causes this wind-up. For joints other than the elbow this is an
assumption. A gear may also be soft up to a knee and linear beyond it: ``hardening@0.4`` has the knee at 40 %
of the joint's usual torque, the 90th percentile over the contacts. Knees are scanned. The two flanks of the
teeth may differ: ``hardening@uneven`` has a deflection of its own for each sign of the torque.
"""


MEAN = 1e-5  # rad/(N m)
LEVER = 0.3  # m, from the hinge to the frame's origin
BASE: Where = {"site": location.BASE, "driver": Driver("base moment")}


def _base_compliance(c: Circumstances) -> list[Parameter]:
    up, out = common.vertical(c), []
    for tilt in common.tilts(c):
        turn = common.base_terms(c, "r", tilt.axis, tilt.moment)
        name = f"base-compliance {tilt.name}"
        out.append(Parameter(name, "rad/(N m)", turn, SPREAD * MEAN, 0.0, MEAN, positive=True, **BASE))
        slides = {"slide": tilt.across}
        if abs(np.cross(tilt.axis, common.first_axis(c)) @ up) > common.LEANING:  # a hinge behind the plate
            slides["rise"] = up
        for how, along in slides.items():
            moved = common.base_terms(c, "t", along, tilt.moment)
            label = f"base-compliance {how} {tilt.name}"
            out.append(Parameter(label, "m/(N m)", moved, SPREAD * MEAN * LEVER, **BASE))
    return out


def _turned(c: Circumstances) -> list[Parameter]:
    """The same about two horizontal axes of any direction: a symmetric matrix, and its lever arm."""
    usual, pair = _base_compliance(c), common.tilts(c)
    if len(pair) < 2:
        return usual
    one, other = pair
    terms = partial(common.base_terms, c)
    turn = (*terms("r", one.axis, other.moment), *terms("r", other.axis, one.moment))
    slide = (*terms("t", one.axis, one.moment), *terms("t", other.axis, -other.moment))
    return [
        *usual,
        Parameter("base-compliance cross", "rad/(N m)", turn, SPREAD * MEAN, **BASE),
        Parameter("base-compliance slide cross", "m/(N m)", slide, SPREAD * MEAN * LEVER, **BASE),
    ]


BASE_COMPLIANCE = Effect(
    "base-compliance",
    "the base deflects under the gravity moment of the arm",
    _base_compliance,
    common.without_masses,
    sizes={"rad/(N m)": COMPLIANT, "m/(N m)": COMPLIANT, "1": FACTOR},
    phrase=("the base", "deflects under the gravity moment of the arm"),
    remedy=(
        "Tighten the base bolts to the stated torque, clean and shim the mounting face, and stiffen "
        "or anchor the stand. Then repeat the session."
    ),
    requires=("compliance",),
    forms=(
        common.by_session(_base_compliance),
        Form("turned", "about horizontal axes that are turned against those of F0", _turned),
    ),
    simulated_within=1e-7,
    linear_spring=True,
)
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
