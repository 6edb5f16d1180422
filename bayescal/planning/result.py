"""Result of planning: the contacts in the order of probing, and what can be expected of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Uncertainty u, m, of the distances that are reported first, by the number of contacts.

    Attributes
    ----------
    curve : tuple of (int, float)
        Below the size of the plan, its contacts that matter most for distances; above, with the best further
        candidates.
    curve_random : tuple of (int, float)
        Median of random selections; as far as the pool has candidates.
    equals_random : float
        Number of random contacts with the u of the plan, interpolated; infinite if all candidates have more.
    next_u : float
        m, after 20 further contacts, or after all candidates that are left.
    """

    curve: tuple[tuple[int, float], ...]
    curve_random: tuple[tuple[int, float], ...] = ()
    equals_random: float
    next_u: float


@dataclass(frozen=True, kw_only=True)
class Ways:
    """Motions to the approaches of N rows in the order of probing.

    Attributes
    ----------
    via : tuple of np.ndarray, shape (K, n), or None
        Readings, rad, to be passed on the way to the approach of each row, most often none (K = 0); None
        where no collision-free path was found, and the arm is jogged manually (`by_hand`). The way begins at
        the approach of the row before, or at the last of `leave` where the arm has stopped.
    leave : tuple of np.ndarray, shape (K, n), or None
        Of each row before which something is changed (`changes`): readings, rad, to be passed from the
        approach of the row before; at the last the arm stops and waits, far from all solids of both places.
        The way there is checked among the solids, with the tool, of the row before; the way from there among
        those of the row. Of the first row the pose (1, n) where the session begins, always. K = 0 for the
        other rows; None where no free way was found.
    changes : tuple of str
        What the person has to do before each row while the arm waits, such as "mount tool ball2; move the
        artefact to placement 4; attach 2 kg to the tool"; "" if nothing. Of the first row what is to be
        there at the beginning.
    by_hand : tuple of str
        How the arm is jogged manually to the approach of each row, in words; "" where a free way is known.
    clearance : np.ndarray, shape (N,)
        Smallest distance, m, of arm, tool and solids from each other on all motions of a row: the way there
        with its stop, the approach and the retract. nan where a part of the way is by hand.
    """

    via: tuple[np.ndarray | None, ...] = ()
    leave: tuple[np.ndarray | None, ...] = ()
    changes: tuple[str, ...] = ()
    by_hand: tuple[str, ...] = ()
    clearance: np.ndarray = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, kw_only=True)
class Plan(Ways, Curves):
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
    detectable: tuple[Detectable, ...]
    confusable: tuple[Confusable, ...]
    travel: float
    seconds: float
    warnings: tuple[str, ...] = ()
    aim: str = BOTH
    order: str = "sweeps"
    seed: int = 0
