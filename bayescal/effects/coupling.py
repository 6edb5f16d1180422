r"""Coupling: motion of a joint turns its neighbours slightly, through a shared gear train.

Formula: $`\rho_{z,k} = x_{kj} \, q_j, \quad j \in \{k-2, k-1, k+1\}`$.

Driver: the reading of one of the two preceding joints, or of the following joint, rad; none of prismatic
joints. It acts as an error of the joint's own encoder (`common.turned`). Prior: 1e-4, as for an encoder
scale (assumed: laser tracker measurements of an ABB IRB 120 showed no coupling at the wrist).

A joint may also be dragged along by friction, less and less away from the middle of the session. In
``coupling@levels-off`` the error is a tanh that bends at 1.4 standard deviations of the other reading
(assumed), with the same slope in its middle. On coupled axes, the other parameters absorb a straight line
but not this.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.common import at, motion, side_of, turned
from bayescal.effects.location import Driver
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter

SD = 1e-4  # rad per rad
BENDS = 1.4  # standard deviations of the other reading over the fitted measurements
BEFORE = 2  # joints: gear trains run through a wrist, from J4 to J5 and J6


def _couplings(
    c: Circumstances, drive: Callable[[np.ndarray], np.ndarray], form: str = ""
) -> list[Parameter]:
    """Parameters with a function of the other reading (N,), rad, as driver."""
    robot, names, side = c.robot, c.robot.joint_names, side_of(c.robot)

    def terms(j: int, k: int) -> tuple[Term, ...]:
        """An error of joint j by the reading of joint k, in the sense in which j reads."""
        other = drive(c.readings[:, k - 1])
        by = motion(robot, j, np.where(np.arange(robot.n) == j - 1, other[:, None], 0.0), side)
        return turned(robot, j, by, side)

    return [
        Parameter(
            f"coupling {names[k - 1]} to {names[j - 1]}", "1", terms(j, k), SD,
            **at(j, Driver("angle", k, form=form)),
        )
        for j in range(1, c.robot.n + 1)
        for k in range(max(1, j - BEFORE), min(c.robot.n, j + 1) + 1)
        if k != j and c.readings[:, k - 1].any() and not c.robot.slides[[j - 1, k - 1]].any()
    ]  # fmt: skip


def _levelling(c: Circumstances) -> list[Parameter]:
    def bent(reading: np.ndarray) -> np.ndarray:
        mine = reading[c.fitted]
        reach = BENDS * float(np.std(mine))
        return reach * np.tanh((reading - np.median(mine)) / reach) if reach > 0 else reading

    return _couplings(c, bent, form="level")


COUPLING = Effect(
    "coupling",
    "joint k turns when a neighbouring joint turns",
    lambda c: _couplings(c, lambda reading: reading),
    sizes={"1": Size("share of the other angle")},
    phrase=("every joint", "has an error proportional to the preceding joint"),
    remedy=(
        "Check the coupling ratio of the wrist in the controller, and the shared gear train or belt. "
        "Check that no cable or hose pulls the joint."
    ),
    confusable_with=("bending",),
    forms=(Form("levels-off", "levelling off away from the middle of the session", _levelling),),
    simulated_within=5e-8,
)
