"""Uncertainty budget of a calibration (JCGM 100:2008): components, their contributions, and their sum.

The budget of a measurand: contributions of all inputs, their sum, and the expanded uncertainty.

All by JCGM 100:2008: contributions c_i u_i (5.1), effective degrees of freedom by the formula of Welch and
Satterthwaite (G.4), k from Student's t for a coverage of 95.45 %. The inputs are independent, so that the
variances add up; the estimates of the parameters are not, and their correlations are listed.

The measurands whose budgets a fit writes, and the uncertainty of the distance errors that it predicts.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
from scipy.optimize import brentq

from bayescal.assess.inputs import GROUPS, PRIOR, PROBING, Basis, Input
from bayescal.assess.measurand import Measurand, certified_distances, distance, distances, readings, volume
from bayescal.model import ARM
from bayescal.predict.forecast import CENTRES, READINGS, DistanceErrors, Forecast
from bayescal.statistics import f_isf, f_sf

MOST_VALUES = 4_000_000
"""Slopes of values by unit errors that are held at a time: a session may have 100 000 rows."""
COVERAGE = 0.9545
"""Probability that the expanded uncertainty covers: that of k = 2 of a normal distribution."""
LISTED = 0.01
"""Share of the variance from which on a prior value is a component of its own."""
MOST_DOF = 1e6
"""Degrees of freedom from which on a distribution is normal."""
CORRELATED, MOST_PAIRS = 0.5, 20
"""Size of a correlation of two parameters from which on it is listed, and most pairs that are."""


@dataclass(frozen=True)
class Component:
    """One input and its contribution to the combined uncertainty, SI of the measurand.

    `sensitivity` is the contribution by unit of u; its sign is that of the effect where there is one.
    `by_target` are the contributions of the targets on which the errors were made.
    """

    input: Input
    contribution: float
    sensitivity: float | None
    by_target: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Budget:
    """Components of a measurand, largest first within their groups, and its uncertainty; SI.

    `spread` are the standard uncertainties of each of several distances, or the principal ones of a point.
    `correlations` are pairs of parameters with their correlation.
    """

    measurand: Measurand
    components: tuple[Component, ...]
    spread: np.ndarray
    correlations: tuple[tuple[str, str, float], ...]

    @property
    def u(self) -> float:
        """Combined standard uncertainty: of any one of several distances, their root mean square."""
        return float(np.sqrt(sum(c.contribution**2 for c in self.components)))

    @property
    def prior_share(self) -> float:
        """Share of the variance that is of priors: of what no row reduced."""
        prior = sum(c.contribution**2 for c in self.components if c.input.group == PRIOR)
        return float(prior / self.u**2) if self.u > 0 else 0.0

    @property
    def dof(self) -> float:
        """Effective degrees of freedom, by Welch and Satterthwaite; a variance estimated once counts once."""
        square: dict[tuple[str, float], float] = {}
        for c in self.components:
            key = (c.input.scale or c.input.name, c.input.dof)
            square[key] = square.get(key, 0.0) + c.contribution**2
        below = sum(variance**2 / dof for (_, dof), variance in square.items())
        return self.u**4 / below if below > 0 else inf

    @cached_property
    def k(self) -> float:
        """Coverage factor: U = k u covers `COVERAGE`.

        For a single quantity the quantile of Student's t. For the length of a vector with the principal
        uncertainties s_i, the length squared over u^2 is taken for F with h = (sum s_i^2)^2 / sum s_i^4 and
        the effective degrees of freedom; that is exact for one coordinate and for equal ones. For any one of
        several distances, the mean of their coverages is `COVERAGE`.
        """
        dof, square = min(self.dof, MOST_DOF), self.spread**2
        if not self.u > 0:
            return 2.0
        if not self.measurand.any_of:
            h = float(np.sum(square) ** 2 / np.sum(square**2))
            return float(np.sqrt(f_isf(1.0 - COVERAGE, h, dof)))

        some = square[square > 0] / self.u**2

        def beyond(k: float) -> float:
            return float(np.sum(f_sf(k**2 / some, 1.0, dof)) / len(square)) - (1.0 - COVERAGE)

        return float(brentq(beyond, 1e-3, 1e3))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k u."""
        return self.k * self.u


def budget(basis: Basis, measurand: Measurand) -> Budget:
    """The uncertainty budget of a measurand."""
    components: list[Component] = []
    total = np.zeros(len(measurand.by_z))
    matrix = np.zeros((len(total), len(total))) if not measurand.any_of else None
    of_fit = ((p.input, measurand.by_z, p.by, p.targets) for p in basis.propagated)
    of_measurand = ((one, None, by, None) for one, by in measurand.errors)
    columns = max(MOST_VALUES // max(len(total), 1), 1)
    for source, slopes, changes, targets in (*of_fit, *of_measurand):
        variances, square = np.zeros(len(total)), np.zeros(changes.shape[1])  # by value, by unit error
        for start in range(0, changes.shape[1], columns):
            part = slice(start, start + columns)
            by = changes[:, part] if slopes is None else slopes @ changes[:, part]
            variances += np.sum(by**2, axis=1)
            square[part] = np.sum(by**2, axis=0)
            if matrix is not None:
                matrix += by @ by.T
        total += variances
        contribution = float(np.sqrt(measurand.weight * np.sum(variances)))
        signed = float(by[0, 0]) if len(total) == len(square) == 1 else contribution
        sensitivity = signed / source.u if source.u else None
        parts = _parts(measurand.weight * square, targets)
        components.append(Component(source, contribution, sensitivity, parts))
    spread = np.sqrt(total if matrix is None else np.maximum(np.linalg.eigvalsh(matrix), 0.0))
    return Budget(measurand, tuple(_ordered(components)), spread, correlations(basis))


def _parts(square: np.ndarray, targets: np.ndarray | None) -> tuple[tuple[str, float], ...]:
    """Contributions by the target on which errors (M,) were made; nothing for a single target."""
    names = [] if targets is None else list(dict.fromkeys(targets.tolist()))
    if targets is None or len(names) < 2:
        return ()
    parts = [(name, float(np.sqrt(np.sum(square[targets == name])))) for name in names]
    return tuple(sorted(parts, key=lambda part: -part[1]))


def _ordered(components: list[Component]) -> list[Component]:
    """Components in the order of their groups, the largest first; small stated values of a kind as one."""
    limit = LISTED * sum(c.contribution**2 for c in components)
    kept: list[Component] = []
    small: dict[str, list[Component]] = {}
    for c in components:
        stated = c.input.group in (PRIOR, PROBING) and c.input.evaluation == "B" and c.input.common
        if stated and c.contribution**2 < limit:
            small.setdefault(c.input.common, []).append(c)
        elif c.contribution > 0:
            kept.append(c)
    for name, each in small.items():
        if size := float(np.sqrt(sum(c.contribution**2 for c in each))):
            units = {c.input.unit for c in each}
            unit = units.pop() if len(units) == 1 else "1"
            both = replace(each[0].input, name=f"{name} ({len(each)})", value=None, u=None, unit=unit)
            kept.append(Component(both, size, None))
    return sorted(kept, key=lambda c: (GROUPS.index(c.input.group), -c.contribution))


def correlations(basis: Basis) -> tuple[tuple[str, str, float], ...]:
    """Pairs of parameters of the arm whose estimates are correlated, the largest first."""
    plain = basis.stated.plain
    arm = plain.model.slices[ARM]
    covariance = basis.stated.limited[arm, arm]
    sd = np.sqrt(np.diag(covariance))
    r = covariance / np.outer(sd, sd)
    first, second = np.triu_indices(len(sd), 1)
    size = np.abs(r[first, second])
    order = [k for k in np.argsort(-size, kind="stable")[:MOST_PAIRS] if size[k] >= CORRELATED]
    names = plain.model.names
    return tuple((names[first[k]], names[second[k]], float(r[first[k], second[k]])) for k in order)


SINGLE = 3
"""Certified distances, those with the largest errors, that have a budget of their own."""


def certified(basis: Basis) -> Measurand | None:
    """Error of any one of the certified distances; None without any."""
    pairs = certified_distances(basis)
    if len(pairs) == 1:
        return distance(basis, pairs[0])
    name = f"error of a distance between {CENTRES} ({len(pairs)} distances)"
    return distances(basis, pairs, name) if pairs else None


MEASURED = {CENTRES: certified, READINGS: readings}
"""Measurand of distances that validation rows measure, by the type of their ends; else that of the volume."""


def headline(basis: Basis) -> Measurand:
    """The distances that a fit reports first: measured ones where there are any, else those of the volume."""
    return next((m for of in MEASURED.values() if (m := of(basis)) is not None), None) or volume(basis)


def with_budgets(expected: Forecast, basis: Basis) -> Forecast:
    """Predicted distance errors with u and k of their budgets: the only ones that are stated of them."""

    def stated(d: DistanceErrors) -> DistanceErrors:
        measurand = MEASURED.get(d.over, volume)(basis)
        assert measurand is not None, "distances that are predicted have a budget"
        b = budget(basis, measurand)
        return replace(d, u=b.u, k=b.k)

    checked = tuple(stated(d) for d in expected.checked)
    return replace(expected, checked=checked, workspace=stated(expected.workspace))


def of_distances(basis: Basis) -> dict[tuple[str, str], Budget]:
    """The budget of the error of each certified distance, by its ends."""
    return {pair: budget(basis, distance(basis, pair)) for pair in certified_distances(basis)}


def usual(basis: Basis) -> tuple[Budget, ...]:
    """Budgets of the measured distances, of the probed volume, and of the largest certified errors."""
    each = [budget(basis, m) for of in (*MEASURED.values(), volume) if (m := of(basis)) is not None]
    each += sorted(of_distances(basis).values(), key=lambda b: -abs(b.measurand.value or 0.0))[:SINGLE]
    return tuple({b.measurand.name: b for b in each}.values())
