"""Uncertainty budget of a calibration (JCGM 100:2008): components, their contributions, and their sum."""

from bayescal.assess.budget.budget import COVERAGE, MOST_DOF, Budget, Component, budget
from bayescal.assess.budget.inputs import Basis, Input, Propagated, propagated
from bayescal.assess.budget.main import headline, of_distances, usual, with_budgets
from bayescal.assess.budget.measurand import Measurand, certified_distances, distance, parameter, volume

__all__ = [
    "COVERAGE",
    "MOST_DOF",
    "Basis",
    "Budget",
    "Component",
    "Input",
    "Measurand",
    "Propagated",
    "budget",
    "certified_distances",
    "distance",
    "headline",
    "of_distances",
    "parameter",
    "propagated",
    "usual",
    "volume",
    "with_budgets",
]
