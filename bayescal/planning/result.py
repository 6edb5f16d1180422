"""Result of planning: the contacts in the order of probing, and what can be expected of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import Site
from bayescal.planning.pool import Pool

DISTANCES, GAP, REPEAT, VALIDATE = "distances", "gap", "repeat", "validate"
"""Purposes of a contact."""
BOTH = "both"
"""A plan for distances and for the gap."""


@dataclass(frozen=True)
class ExpectedDistances:
    """Expected standard uncertainty of distances, assuming the model is correct.

    `u` and `u_random` (median of random selections of the same size) are root mean squares over the
    distances, m. `shares` of the variance, by origin: noise, certificate, probing, prior.
    """

    over: str  # "certified distances", "volume of interest", "given poses"
    count: int
    u: float
    u_random: float
    shares: Mapping[str, float]


@dataclass(frozen=True)
class ExpectedParameter:
    """Expected standard uncertainty of a parameter, and that of its prior, in a file's unit."""

    name: str
    unit: str
    u: float
    prior: float


@dataclass(frozen=True)
class Detectable:
    """Smallest amplitude of an effect that the plan, and a random selection, would show; in `unit` (SI)."""

    effect: str
    site: Site
    unit: str
    smallest: float
    smallest_random: float
    plausible: float


@dataclass(frozen=True)
class Confusable:
    """Two effects at plausible amplitudes: lambda of one beside the other, before and after.

    `before` is that of a random selection of the same size without interventions, or of the rows measured
    already; `intervention` is what would separate them, "" if the plan does.
    """

    pair: tuple[str, str]
    before: float
    after: float
    intervention: str = ""


@dataclass(frozen=True)
class Plan:
    """Contacts to measure, in the order of probing.

    Attributes
    ----------
    pool : Pool
        The candidates from which they were chosen.
    session : Dataset
        The planned rows; instrument readings and lengths are those of the nominal arm.
    purpose : tuple of str
        Of each row: DISTANCES, GAP, REPEAT or VALIDATE.
    approach : np.ndarray, shape (N, n)
        Readings, rad, before and after each contact.
    effects : tuple of str
        The model.
    expected : tuple of ExpectedDistances
        The first is the headline.
    parameters : tuple of ExpectedParameter
    observability, observability_random : mapping of str to float
        Indices O1 to O5.
    curve, curve_random : tuple of (int, float)
        Numbers of contacts of a plan of this kind, and of random selections; `u` of the headline, m.
    equals_random : float
        Number of random contacts with the same `u` of the headline; infinite if none of the pool has.
    next_u : float
        `u` of the headline after 20 further contacts, m.
    detectable : tuple of Detectable
    confusable : tuple of Confusable
    travel : float
        Time between contacts, s.
    seconds : float
        Time of the computation.
    warnings : tuple of str
    aim : str
        `--for`: DISTANCES, GAP or BOTH.
    order : str
        Order of probing: sweeps, shortest or random.
    seed : int
    via : tuple of np.ndarray, shape (K, n), or None
        Readings, rad, to be passed before the approach of each row, most often none (K = 0); None where no
        collision-free path was found.
    """

    pool: Pool
    session: Dataset
    purpose: tuple[str, ...]
    approach: np.ndarray
    effects: tuple[str, ...]
    expected: tuple[ExpectedDistances, ...]
    parameters: tuple[ExpectedParameter, ...]
    observability: Mapping[str, float]
    observability_random: Mapping[str, float]
    curve: tuple[tuple[int, float], ...]
    equals_random: float
    next_u: float
    detectable: tuple[Detectable, ...]
    confusable: tuple[Confusable, ...]
    travel: float
    seconds: float
    warnings: tuple[str, ...] = ()
    curve_random: tuple[tuple[int, float], ...] = ()
    aim: str = BOTH
    order: str = "sweeps"
    seed: int = 0
    via: tuple[np.ndarray | None, ...] = ()
