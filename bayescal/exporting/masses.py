"""Errors of stated masses at poses of a fitted arm: they move points, and moved the fitted parameters.

A compliance that is too small for masses that are too large deflects the arm as before: a point's uncertainty
is less than that of the compliances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.effects.masses import masses
from bayescal.estimate import Estimate
from bayescal.estimate.compliances import compliant
from bayescal.estimate.discrepancy import Inputs, mixed
from bayescal.model import ARM, Model


@dataclass(frozen=True)
class MassErrors:
    """L independent errors of masses, of unit variance.

    `mixing` (L, L) makes them of the errors of `effects.masses`; `shifts` (P, L) is what each adds to the
    arm's parameters, SI.
    """

    mixing: np.ndarray
    shifts: np.ndarray

    @classmethod
    def of(cls, found: Estimate, inputs: Inputs | None) -> MassErrors | None:
        """Those of an estimate; None where it holds no masses."""
        if inputs is None or not inputs.names:
            return None
        arm = found.model.slices[ARM]
        return cls(inputs.mixing, found.model.sd[:, None] * (inputs.slopes[arm] @ inputs.mixing))

    @classmethod
    def read(cls, record: Mapping[str, Any] | None, parameters: int) -> MassErrors | None:
        """From the entry of arm.json; None where there is none."""
        if record is None:
            return None
        mixing = np.array(record["mixing"], float)
        return cls(mixing, np.array(record["shifts_si"], float).reshape(parameters, len(mixing)))

    def record(self) -> dict[str, Any]:
        """The entry of arm.json."""
        return {"mixing": self.mixing.tolist(), "shifts_si": self.shifts.tolist()}

    def without(self, covariance: np.ndarray) -> np.ndarray:
        """A covariance (P, P) of the parameters without the part of the masses."""
        values, vectors = np.linalg.eigh(covariance - self.shifts @ self.shifts.T)
        return (vectors * np.maximum(values, 0.0)) @ vectors.T

    def at(self, model: Model, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Displacements (C, 3, L) of the points of rows by each error, for the arm's values (P,), SI."""
        around = model.scene.circumstances(model.scene.rows("calibrate"))
        errors = mixed(masses(compliant(around, model, values)), self.mixing)
        motion = Model(model.scene, model.effects, (*model.parameters, *errors), (), ()).motion(rows)
        every = np.concatenate([values, np.zeros(len(errors))])
        points = motion.points(every)
        ways = np.repeat(np.eye(3)[:, :, None], len(rows), axis=2)
        by = np.stack([motion.columns(every, points, np.ascontiguousarray(u)) for u in ways], axis=1).T
        return by[..., len(values) :]
