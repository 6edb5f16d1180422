r"""Compliance: each joint turns by its gravity torque over its stiffness.

Formula: $`\rho_{z,k} = c_k \tau_k`$; τ is the gravity torque, N m.

Prior: the mean is the compliance of small arms (an ABB IRB 120 measured with a laser tracker): shoulder
3e-5, elbow 2e-4, wrist 2e-3 rad/(N m). The standard deviation is 1.5 times the mean, so that a factor
of 3 is well within it. If the robot file states a compliance, that is the mean.
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
SPREAD = 1.5  # prior standard deviation over the prior mean


def typical(n: int) -> np.ndarray:
    """Typical compliances (n,), rad/(N m): the last three joints are the wrist, the one before the elbow."""
    return np.array([SHOULDER] * (n - 4) + [ELBOW] + [WRIST] * 3)[-n:]


def expected(robot: Robot) -> np.ndarray:
    """Compliances (n,), rad/(N m), of the robot file, and typical ones for joints without a stated one."""
    mean = typical(robot.n)
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
    usual torque.
    """
    return [
        Parameter(
            f"{effect} {name}", unit, (Term(j, "rz", driver(torque, most)),), sd(compliance, most),
            **at(j, Driver("torque", j, form=form)),
        )
        for j, name, compliance, torque in loaded(c)
        for most in [usual(c, torque)]
    ]  # fmt: skip


def _parameters(c: Circumstances) -> list[Parameter]:
    nominal = c.robot.compliance if c.robot.compliance is not None else np.zeros(c.robot.n)
    return [
        Parameter(
            f"compliance {name}", "rad/(N m)", (Term(j, "rz", torque),), SPREAD * mean, float(nominal[j - 1]),
            mean, positive=True, **at(j, Driver("torque", j)),
        )
        for j, name, mean, torque in loaded(c)
    ]  # fmt: skip


COMPLIANCE = Effect(
    "compliance",
    "joint k yields elastically to its gravity torque",
    _parameters,
    without_torques,
    sizes={"rad/(N m)": COMPLIANT, "1": FACTOR},
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
