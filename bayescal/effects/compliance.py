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

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.motion import Term
from bayescal.effects.common import at, carries, usual, without_torques
from bayescal.effects.location import Driver
from bayescal.effects.sizes import COMPLIANT, FACTOR
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

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
        if carries(torque):
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
            **at(j, Driver("torque", j, form=form)),
        )
        for j, name, compliance, torque in loaded(c)
        for slides in [c.robot.slides[j - 1]]
        for most in [usual(c, torque)]
        if unit == "rad" or not slides
    ]  # fmt: skip


def _parameters(c: Circumstances) -> list[Parameter]:
    nominal = c.robot.compliance if c.robot.compliance is not None else np.zeros(c.robot.n)
    return [
        Parameter(
            f"compliance {name}", unit, (Term(j, axis, torque),), SPREAD * mean, float(nominal[j - 1]),
            mean, positive=True, **at(j, Driver("torque", j)),
        )
        for j, name, mean, torque in loaded(c)
        for axis in [c.robot.axes[j - 1]]
        for unit in ["m/N" if axis == "tz" else "rad/(N m)"]
    ]  # fmt: skip


COMPLIANCE = Effect(
    "compliance",
    "joint k yields elastically to its gravity torque",
    _parameters,
    without_torques,
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
