"""Limits of counts: what a stated chance of a false alarm may give in a number of sessions."""

from scipy.stats import binom

RARE = 1e-3
"""Chance that a test of a right program fails."""


def most(sessions: int, chance: float) -> int:
    """Largest number of sessions with an event of such a chance that is no surprise."""
    return int(binom.isf(RARE, sessions, chance))


def least(sessions: int, chance: float) -> int:
    """Smallest such number."""
    return int(binom.ppf(RARE, sessions, chance))
