"""Criteria of a selection: I, D, A and E, and the observability indices O1 to O5.

All are of the information of the arm's parameters, in units of their prior standard deviations, with the
states of the targets eliminated and the prior included as one observation of each parameter. Without the
scaling, a length and an angle cannot be compared. Combinations of the parameters of which even all candidates
together tell less than the prior are left out: they would make E and O2 to O5 the same for every selection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.planning.information import Linearised, inverse


@dataclass(frozen=True)
class Criteria:
    """Criteria of optimal design (Pukelsheim, Optimal Design of Experiments, 1993), of P parameters.

    `d`: log determinant of the information, nats; `a`: mean variance; `e`: largest variance of a combination
    of the parameters; both relative to the prior (1: nothing is known beyond it). `d` is the larger the
    better, `a` and `e` the smaller.
    """

    d: float
    a: float
    e: float


def arm_information(linear: Linearised, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
    """Information (L, L) of the L identifiable combinations of the arm's parameters after a selection.

    Identifiable are the principal axes of the information of all candidates that exceed the prior.
    """
    every = _marginal(linear, np.arange(linear.count))
    values, axes = np.linalg.eigh(every)
    axes = axes[:, values > 2.0]
    return inverse(axes.T @ inverse(_marginal(linear, chosen)) @ axes)


def _marginal(linear: Linearised, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
    """Information (P, P) of the arm's parameters, with the states of the targets eliminated."""
    size = len(linear.model.parameters)
    return inverse(linear.covariance(chosen)[:size, :size])


def criteria(information: np.ndarray) -> Criteria:
    """Criteria D, A and E of an information matrix (P, P)."""
    values = np.linalg.eigvalsh(information)
    return Criteria(float(np.sum(np.log(values))), float(np.mean(1 / values)), float(1 / values[0]))


def mean_variance(slopes: np.ndarray, covariance: np.ndarray) -> float:
    """Criterion I: mean variance of K quantities with slopes (K, D), for the covariance (D, D) of z."""
    return float(np.mean(np.sum(slopes @ covariance * slopes, axis=1))) if len(slopes) else 0.0


def observability(information: np.ndarray, count: int) -> dict[str, float]:
    """Observability indices of `count` contacts, from their information matrix (P, P).

    With the singular values s_1 >= ... >= s_P of a Jacobian J of information J'J. Larger is better.

    Notes
    -----
    O1: geometric mean of s over the square root of the number of contacts (Borm and Menq, Int. J. Robotics
    Research 10, 1991). O2: s_P / s_1 (Driels and Pathre, J. Robotic Systems 7, 1990). O3: s_P (Nahvi,
    Hollerbach and Hayward, ICRA 1994). O4: s_P^2 / s_1 (Nahvi and Hollerbach, ICRA 1996). O5: 1 / sum(1 / s)
    (Sun and Hollerbach, Observability index selection for robot calibration, ICRA 2008; names all).
    """
    s = np.sqrt(np.maximum(np.linalg.eigvalsh(information), 0.0))[::-1]
    with np.errstate(divide="ignore"):
        return {
            "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(count)),
            "O2": float(s[-1] / s[0]),
            "O3": float(s[-1]),
            "O4": float(s[-1] ** 2 / s[0]),
            "O5": float(1 / np.sum(1 / s)),
        }


def observability_of(linear: Linearised, chosen: Sequence[int] | np.ndarray) -> dict[str, float]:
    """Observability indices of the arm's parameters after a selection; rows measured already count."""
    fitted = len(linear.model.scene.rows("calibrate"))
    return observability(arm_information(linear, chosen), len(chosen) + fitted - linear.count)
