"""Corrections of the joint zeros as a table, for controllers that have an offset for each joint only.

The true reading of a joint is what the controller shows plus its correction. Of coupled axes, corrections of
the links are converted to those of the readings.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.transforms import AXES
from bayescal.dataset.table import csv_text
from bayescal.exporting.geometry import at_state, constant
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.fitted.arm import FittedArm
from bayescal.robots.servos import STEPS

TURN = 2.0 * np.pi  # rad
LIMITS = "a controller's offsets hold the zeros of the joints only"


def zeros(arm: FittedArm, state: int) -> tuple[np.ndarray, np.ndarray]:
    """Corrections (n,) of the readings, rad, and their covariance (n, n)."""
    robot = arm.dataset.robot
    by = np.zeros((robot.n, len(arm.values)))
    for k, p in enumerate(arm.model.parameters):
        for t in at_state(p, state).terms if holds(arm, k) else ():
            by[t.frame - 1, k] += float(t.driver)
    by = np.linalg.solve(robot.link_from_reading, by)
    return by @ arm.values, by @ arm.covariance @ by.T


def holds(arm: FittedArm, k: int) -> bool:
    """Whether a parameter turns joints about their axes, and does nothing else."""
    p, n = arm.model.parameters[k], arm.model.scene.chain.n
    return constant(p) and all(t.axis == AXES[0] and 1 <= t.frame <= n for t in p.terms)


def items(arm: FittedArm, element: str, attribute: str) -> list[Item]:
    """The parameters in a file of offsets; `element` has the name of the joint in place of ``{}``."""
    names, parameters = arm.dataset.robot.joint_names, arm.model.parameters
    return [
        item(arm, k, element.format(names[p.terms[0].frame - 1]), attribute)
        for k, p in enumerate(parameters)
        if holds(arm, k)
    ]


def undetermined(arm: FittedArm, covariance: np.ndarray) -> list[str]:
    """A note on the joints whose zeros, of covariance (n, n), are not identifiable."""
    variances = zip(arm.dataset.robot.joint_names, np.diag(covariance), strict=True)
    named = [name for name, variance in variances if variance <= 0.0]
    return [f"the zero of {', '.join(named)} is not identifiable and has no correction"] if named else []


def _write(arm: FittedArm, options: Options) -> Written:
    robot = arm.dataset.robot
    correction, covariance = zeros(arm, options.state)
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    rows = (
        [name, *(repr(float(x)) for x in (np.degrees(c), np.degrees(sd), c, sd)), round(c / TURN * STEPS)]
        for name, c, sd in zip(robot.joint_names, correction.tolist(), u.tolist(), strict=True)
    )
    header = ["joint", "correction_deg", "u_deg", "correction_rad", "u_rad", f"correction_ticks_{STEPS}"]
    sign = "true reading = reading shown + correction; see docs/export.md for the sign of an offset"
    notes = [*undetermined(arm, covariance), sign]
    return Written(csv_text(header, rows), items(arm, "row of the joint", "correction"), notes=notes)


JOINT_ZEROS = Format("joint-zeros", ".csv", "corrections of the joint zeros as CSV", _write, holds, LIMITS)
"""Offsets of the joints for a controller, as in the files of LeRobot or TALOS."""
