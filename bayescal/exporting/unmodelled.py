"""What moves the points of a fitted arm beyond its parameters: errors that the stated uncertainty contains.

Three kinds, all independent: the functions of the model discrepancy, each with its variance; errors of the
stated masses; and an error of each coordinate that neither explains. Functions and masses also moved the
fitted parameters: with G the displacements of a point by unit errors, J those by the parameters, S their
covariance without these errors, and A what each error added to the parameters, a point has the covariance

    J S J' + (G - J A)(G - J A)' + s^2 1        (Kennedy and O'Hagan 2001; `estimate.discrepancy.stated`)

A compliance that is too small for masses that are too large deflects the arm as before: the uncertainty of
the point is less than that of the compliances.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np

from bayescal.assess.budget import MOST_DOF, Basis
from bayescal.effects import Parameter
from bayescal.effects.masses import masses
from bayescal.errors import BayescalError
from bayescal.estimate.compliances import compliant
from bayescal.estimate.discrepancy import MASSES, families, mixed, sized
from bayescal.model import ARM, Model


def no_masses() -> np.ndarray:
    """Mixing of no errors of masses."""
    return np.zeros((0, 0))


@dataclass(frozen=True)
class Unmodelled:
    """K functions of a discrepancy and L errors of masses, of unit variance, and an error of coordinates.

    Parameters
    ----------
    shifts : np.ndarray, shape (P, K + L)
        What each adds to the arm's parameters, SI.
    variances, dof : mapping
        Of the families of the discrepancy: variance, and its effective degrees of freedom.
    mixing : np.ndarray, shape (L, L)
        Makes the errors of masses of those of `effects.masses`.
    excess, excess_dof : float
        m, standard deviation of the error of each coordinate, and its effective degrees of freedom.
    """

    shifts: np.ndarray
    variances: Mapping[str, float] = field(default_factory=dict)
    dof: Mapping[str, float] = field(default_factory=dict)
    mixing: np.ndarray = field(default_factory=no_masses)
    excess: float = 0.0
    excess_dof: float = inf

    @classmethod
    def of(cls, basis: Basis) -> Unmodelled:
        """What a fit states."""
        stated = basis.stated
        arm = stated.plain.model.slices[ARM]
        names = stated.families
        biases = [np.sqrt(stated.variances[name]) * stated.slopes[name] for name in names]
        by = np.concatenate([*biases, stated.inputs.slopes @ stated.inputs.mixing], axis=1)
        return cls(
            stated.plain.model.sd[:, None] * (stated.limit @ by)[arm],
            {name: stated.variances[name] for name in names},
            {name: stated.dof[name] for name in names},
            stated.inputs.mixing if stated.inputs.names else no_masses(),
            basis.excess,
            basis.excess_dof,
        )

    @classmethod
    def read(cls, record: Mapping[str, Any], parameters: int) -> Unmodelled:
        """From the entries `masses` and `discrepancy` of arm.json; None or missing where there is none."""
        of_masses, rest = record.get("masses"), record.get("discrepancy")
        mixing, shifts = no_masses(), np.zeros((parameters, 0))
        if of_masses is not None:
            mixing = np.array(of_masses["mixing"], float)
            shifts = np.array(of_masses["shifts_si"], float).reshape(parameters, len(mixing))
        if rest is None:
            return cls(shifts, mixing=mixing)
        each = rest["families"]
        dof = rest["unexplained_dof"]
        return cls(
            np.concatenate([np.array(rest["shifts_si"], float).reshape(parameters, -1), shifts], axis=1),
            {name: float(entry["variance"]) for name, entry in each.items()},
            {name: float(entry["dof"]) for name, entry in each.items()},
            mixing,
            1e-6 * rest["unexplained_um"],
            inf if dof is None else float(dof),
        )

    def record(self) -> dict[str, Any]:
        """The entries of arm.json."""
        count = self.shifts.shape[1] - len(self.mixing)
        each = {name: {"variance": self.variances[name], "dof": self.dof[name]} for name in self.variances}
        return {
            "masses": {"mixing": self.mixing.tolist(), "shifts_si": self.shifts[:, count:].tolist()}
            if len(self.mixing)
            else None,
            "discrepancy": {
                "families": each,
                "shifts_si": self.shifts[:, :count].tolist(),
                "unexplained_um": 1e6 * self.excess,
                "unexplained_dof": None if np.isinf(self.excess_dof) else self.excess_dof,
            },
        }

    def without(self, covariance: np.ndarray) -> np.ndarray:
        """A covariance (P, P) of the parameters without the part of these errors."""
        values, vectors = np.linalg.eigh(covariance - self.shifts @ self.shifts.T)
        return (vectors * np.maximum(values, 0.0)) @ vectors.T

    def functions(self, model: Model, values: np.ndarray) -> Iterator[Parameter]:
        """The errors as parameters with the name of their family, for the arm's values (P,)."""
        around = model.scene.circumstances(model.scene.rows("calibrate"))
        for family in families(around) if self.variances else ():
            if family.name in self.variances:
                yield from (replace(p, name=family.name) for p in sized([family], self.variances))
        if len(self.mixing):
            yield from (
                replace(p, name=MASSES) for p in mixed(masses(compliant(around, model, values)), self.mixing)
            )

    def widened(
        self, model: Model, values: np.ndarray, own: Callable[[Parameter], Parameter] = lambda p: p
    ) -> Model:
        """A model with the errors as its last parameters; `own` as of `rows.driven_by`.

        Raises
        ------
        BayescalError
            If the functions are not those of the fit: a torque that varied there does not vary here.
        """
        every = tuple(own(p) for p in self.functions(model, values))
        if len(every) != self.shifts.shape[1]:
            what = f"the model discrepancy has {len(every)} functions at these poses, and in the fit"
            remedy = "repeat the fit with this version"
            raise BayescalError(f"{what} {self.shifts.shape[1]}", "arm.json", remedy)
        return replace(model, parameters=(*model.parameters, *every))

    def dof_of(self, total: np.ndarray, parts: Mapping[str, np.ndarray]) -> np.ndarray:
        """Effective degrees of freedom (C,) of the variances `total` of C points (Welch and Satterthwaite).

        `parts` (C,) are the variances by family; the parameters and stated masses have none of their own.
        """
        below = np.full(len(total), (3.0 * self.excess**2) ** 2 / self.excess_dof)
        for name in parts.keys() & self.dof.keys():
            below += parts[name] ** 2 / self.dof[name]
        few = below > total**2 / MOST_DOF
        return np.divide(total**2, below, out=np.full(len(total), MOST_DOF), where=few)
