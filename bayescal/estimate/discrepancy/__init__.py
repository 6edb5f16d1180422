"""Uncertainty of an estimate where the model is not the machine (Kennedy and O'Hagan 2001)."""

from bayescal.estimate.discrepancy.families import EFFECT, Family, families
from bayescal.estimate.discrepancy.inputs import MASSES, Inputs, inputs, mixed
from bayescal.estimate.discrepancy.stated import Stated, sized, stated

__all__ = [
    "EFFECT",
    "MASSES",
    "Family",
    "Inputs",
    "Stated",
    "families",
    "inputs",
    "mixed",
    "sized",
    "stated",
]
