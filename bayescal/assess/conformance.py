"""Conformance of distance errors to a tolerance.

The rule is that of ISO 14253-1, in which the uncertainty counts against the party that proves: with a
measured error e, its expanded uncertainty U = k u and a tolerance X, conformance is proven if
abs(e) + U <= X, nonconformance if abs(e) - U > X; in between there is no decision. The edition of 2017
requires by default a probability of conformance of 95 %, which a guard band of 1.65 u gives where X is large
beside u (one-sided; JCGM 106:2012, 8.3). U with a coverage of 95.45 %, the guard band of the editions before
and of calibration certificates, is the stricter of the two (97.7 % one-sided), and is what this program uses.

u and k are those of the uncertainty budget of the error (`assess.budget`), which a report and a certificate
state: noise of the contacts, parameters of the arm, unexplained residuals, and the certificate. u is larger
than that of the measurement alone, so that the rule is conservative: more results are 'not decided'.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from bayescal.assess.acceptance import Acceptance
from bayescal.assess.budget import MOST_DOF, Budget
from bayescal.errors import BayescalError
from bayescal.predict.forecast import Forecast
from bayescal.predict.validation import DistanceCheck, Validation

PASS, FAIL, OPEN = "PASS", "FAIL", "cannot be decided"


@dataclass(frozen=True)
class Conformance:
    """One distance, certified, and the decision on its error; m."""

    between: tuple[str, str]
    error: float
    expanded: float  # U = k u
    k: float
    probability: float  # that its error is within the tolerance
    decision: str


@dataclass(frozen=True)
class Tolerance:
    """Decisions on a tolerance of distance errors, m."""

    tolerance: float
    decision: str  # of all together
    why: str
    probability: float  # that the error of a distance in the probed volume is within
    expanded: float  # U = k u of such an error
    k: float
    distances: tuple[Conformance, ...]


def conformance(
    tolerance: float, expected: Forecast, checked: Validation, tests: Acceptance,
    budgets: Mapping[tuple[str, str], Budget],
) -> Tolerance:  # fmt: skip
    """Decide whether distance errors are within a tolerance.

    Parameters
    ----------
    tolerance : float
        m, of the absolute error of a distance.
    expected : Forecast
        With u and k of its distances.
    checked : Validation
    tests : Acceptance
        Where the model is not validated, does not explain the machine, or rests on priors, conformance is
        not proven.
    budgets : mapping
        Budget of the error of each certified distance (`assess.budget.of_distances`).

    Raises
    ------
    BayescalError
        Where the tolerance is no positive number.
    """
    check_tolerance(tolerance)
    space = expected.workspace
    distances = tuple(_decided(d, tolerance, budgets[d.between]) for d in checked.distances)
    failed = [d for d in distances if d.decision == FAIL]
    undecided = [d for d in distances if d.decision == OPEN]
    of, wide = f"of {len(distances)} certified distances", space.expanded > tolerance
    cases = (
        (failed, FAIL, f"{len(failed)} {of}: error - U > tolerance"),
        (not tests.explains, OPEN, "the model does not explain the machine"),
        (not tests.validated, OPEN, "no validation measurements verify the prediction"),
        (not tests.determined, OPEN, "the prediction rests on priors, not on measurements"),
        (undecided, OPEN, f"{len(undecided)} {of}: error within U of the tolerance"),
        (wide, OPEN, "U of a distance in the probed volume is larger than the tolerance"),
        (True, PASS, "error + U <= tolerance, for every distance"),
    )
    decision, why = next((decision, why) for applies, decision, why in cases if applies)
    return Tolerance(tolerance, decision, why, space.within(tolerance), space.expanded, space.k, distances)


def check_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that is no positive length, m."""
    if not (np.isfinite(tolerance) and tolerance > 0):
        what = f"a tolerance of {1e3 * tolerance:g} mm"
        raise BayescalError(what, "--tolerance-mm", "give a positive length, in mm")


def decide(error: float, expanded: float, tolerance: float) -> str:
    """PASS, FAIL or not decided, by ISO 14253-1 with a guard band of U."""
    if abs(error) + expanded <= tolerance:
        return PASS
    return FAIL if abs(error) - expanded > tolerance else OPEN


def _decided(d: DistanceCheck, tolerance: float, b: Budget) -> Conformance:
    low, high = ((end - d.error) / b.u for end in (-tolerance, tolerance))
    p = float(np.diff(stdtr(min(b.dof, MOST_DOF), (low, high)))[0])
    return Conformance(d.between, d.error, b.expanded, b.k, p, decide(d.error, b.expanded, tolerance))
