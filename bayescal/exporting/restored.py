"""The estimate of a run folder, linearised again at the values of its arm: nothing is fitted.

arm.json has the values, the prior of every parameter, the positions of the targets and the rejected
measurements. Row weights, noise scales, covariance and discrepancy follow from them; the stated covariance
must be that of arm.json.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, at_solution
from bayescal.exporting.fitted import FittedArm
from bayescal.model import ARM

AGREES = 0.02
"""Largest difference of a stated standard uncertainty from that of arm.json, relative."""


def restored(arm: FittedArm) -> Estimate:
    """The estimate of an arm that was read from a run folder.

    Raises
    ------
    BayescalError
        If arm.json does not state the position of a fitted target.
    """
    model = arm.model
    z = np.zeros(model.size)
    z[model.slices[ARM]] = (arm.values - model.shift) / model.sd
    for block in model.states:
        if block.target not in arm.states:
            raise BayescalError(f"no position of {block.target}", "arm.json", "repeat the command")
        state = arm.states[block.target]
        z[model.slices[block.target]] = state[block.free] / block.sd
    ids = model.scene.dataset.measurements.ids
    rejected = np.array([ids.index(name) for name in arm.rejected], int)
    held = tuple(n.parameter for n in arm.use.rigid.parameters)
    return replace(at_solution(model, z, rejected), held=held)


def check_restored(arm: FittedArm, covariance: np.ndarray) -> None:
    """Refuse an estimate whose stated covariance (D, D) is not that of the arm.

    Raises
    ------
    BayescalError
        With the parameter that differs most.
    """
    model = arm.model
    own = covariance[model.slices[ARM], model.slices[ARM]] * np.outer(model.sd, model.sd)
    ratio = np.sqrt(np.diag(own) / np.maximum(np.diag(arm.covariance), np.finfo(float).tiny))
    k = int(np.argmax(np.abs(np.log(ratio)))) if len(ratio) else 0
    if len(ratio) and abs(np.log(ratio[k])) > AGREES:
        what = f"u of {model.names[k]} is {ratio[k]:.3g} times that of arm.json when it is computed again"
        raise BayescalError(
            what, "arm.json", "repeat bayescal fit with this version, without --latent-joints"
        )
