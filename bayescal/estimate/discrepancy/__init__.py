"""Uncertainty of an estimate where the model is not the machine (Kennedy and O'Hagan 2001)."""

from bayescal.estimate.discrepancy.families import EFFECT, Family, families
from bayescal.estimate.discrepancy.stated import Stated, sized, stated

__all__ = ["EFFECT", "Family", "Stated", "families", "sized", "stated"]
