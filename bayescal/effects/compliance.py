"""Compliance: each joint turns by its gravity torque over its stiffness.

Prior: about the compliance of small arms (an ABB IRB 120 measured with a laser tracker): shoulder
3e-5, elbow 2e-4, wrist 2e-3 rad/(N m), with a standard deviation of 1.5 times that, so that a factor
of 3 lies well inside. Where the robot file knows a compliance, the prior is about that.
Compliance and mass cannot be told apart: masses are taken as stated.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SHOULDER, ELBOW, WRIST = 3e-5, 2e-4, 2e-3  # rad/(N m)
SPREAD = 1.5  # prior standard deviation over the prior mean
NO_TORQUE = 1e-6  # N m: a joint that never carries more tells nothing of its compliance


def typical(n: int) -> np.ndarray:
    """Typical compliances (n,), rad/(N m): the last three joints are the wrist, the one before the elbow."""
    return np.array([SHOULDER] * (n - 4) + [ELBOW] + [WRIST] * 3)[-n:]


def _parameters(c: Circumstances) -> list[Parameter]:
    assert c.moments is not None
    known = c.robot.compliance if c.robot.compliance is not None else np.zeros(c.robot.n)
    out = []
    for j, usual in enumerate(typical(c.robot.n), start=1):
        torque = c.moments[:, j, 2]
        if np.max(np.abs(torque), initial=0.0) < NO_TORQUE:
            continue
        nominal = float(known[j - 1])
        mean = nominal if nominal > 0 else float(usual)
        name = f"compliance {c.robot.joint_names[j - 1]}"
        sag = (Term(j, "rz", torque),)
        out.append(Parameter(name, "rad/(N m)", sag, SPREAD * mean, nominal, mean, positive=True))
    return out


def _missing(c: Circumstances) -> str:
    return "" if c.moments is not None else "the robot file gives no links (mass_kg, centre_of_mass_mm)"


COMPLIANCE = Effect("compliance", "joints that yield to gravity torque", _parameters, _missing)
