"""Result of planning: the contacts in the order of probing, and what can be expected of them.

Expected are the uncertainty of distances and parameters, assuming the model is correct.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import Site
from bayescal.model import ARM
from bayescal.planning.exchange import Selection, grow, mean_variance, root_of, shrink
from bayescal.planning.goals import Goal
from bayescal.planning.pool import Linearised, Pool

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


Way = np.ndarray | None
"""Readings (K, n), rad, that are passed on a motion; None where no free motion is known."""


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

    via: tuple[Way, ...] = ()
    leave: tuple[Way, ...] = ()
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


TIMES = 15
"""Random selections of which the median counts."""
FURTHER = 20
"""Further contacts whose benefit is reported."""
PARTS = (0.4, 0.55, 0.7, 0.85, 1.0, 1.25, 1.6, 2.0)
"""Points of the curve, relative to the number of contacts of a plan."""
FEWEST = 8
"""Smallest number of random contacts that a plan is compared with."""
STEPS = 14
"""Numbers of random contacts at which their uncertainty is computed, to interpolate between them."""


@dataclass(frozen=True)
class Random:
    """Random selections as an operator would make them: equally many contacts on every target, no payload.

    Candidates with a payload are used only where a target has too few others.
    """

    pool: Pool
    seed: int = 0

    @cached_property
    def _of_target(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Candidates of each target: without and with a payload."""
        m, rows = self.pool.session.measurements, self.pool.candidates
        loaded = np.zeros(len(rows), bool) if m.payload is None else m.payload[rows] > 0
        target = m.target[rows]
        return [
            (np.flatnonzero((target == t) & ~loaded), np.flatnonzero((target == t) & loaded))
            for t in np.unique(target)
        ]

    def selections(self, count: int, times: int) -> list[np.ndarray]:
        """Random candidates (count,), `times` selections; larger ones contain the smaller ones."""
        return [self._selection(count, np.random.default_rng([self.seed, k])) for k in range(times)]

    def _selection(self, count: int, rng: np.random.Generator) -> np.ndarray:
        order = [np.concatenate([rng.permutation(part) for part in parts]) for parts in self._of_target]
        # in turns over the targets, in random order, until enough are chosen
        turn = np.concatenate([np.arange(len(candidates)) for candidates in order])
        begin = np.concatenate([np.full(len(candidates), rng.random()) for candidates in order])
        return np.asarray(np.concatenate(order)[np.lexsort((begin, turn))[:count]])

    def u(self, linear: Linearised, goal: Goal, count: int) -> float:
        """Median u, m, of a goal after random selections."""
        return float(np.median([u_of(linear, goal, chosen) for chosen in self.selections(count, TIMES)]))


def u_of(linear: Linearised, goal: Goal, chosen: Sequence[int] | np.ndarray) -> float:
    """Standard uncertainty, m, of the distances of a goal after a selection: root mean square over them."""
    return float(np.sqrt(mean_variance(goal.slopes, linear.covariance(chosen)) + goal.fixed_variance))


def expected(
    linear: Linearised, goals: Sequence[Goal], chosen: Sequence[int] | np.ndarray, random: Random
) -> tuple[ExpectedDistances, ...]:
    """Expected uncertainty of the distances of every goal, with its origins.

    Notes
    -----
    The covariance of z is C = C (I + Jc'Jc + J'J) C, because the bracket is its inverse. The variance of a
    distance with slopes s is the sum of s'CCs (prior), of s'C Jc'Jc Cs (certificates) and of s'C J'J Cs
    (noise of all fitted contacts). The variance of the certified values that the distances are compared with
    is added to the second part; that of locating their ends is `probing`.
    """
    covariance = linear.covariance(chosen)
    noise = linear.measured + linear.selected(chosen)
    out = []
    for goal in goals:
        by = goal.slopes @ covariance
        parts = {
            "noise": np.mean(np.sum(by @ noise * by, axis=1)),
            "certificate": np.mean(np.sum(by @ linear.certificates * by, axis=1)) + np.mean(goal.certificate),
            "probing": np.mean(goal.probing),
            "prior": np.mean(np.sum(by**2, axis=1)),
        }
        total = float(sum(parts.values()))
        shares = {name: float(part / total) for name, part in parts.items()}
        by_chance = random.u(linear, goal, len(chosen))
        out.append(ExpectedDistances(goal.over, len(goal.slopes), float(np.sqrt(total)), by_chance, shares))
    return tuple(out)


def parameters(linear: Linearised, chosen: Sequence[int] | np.ndarray) -> tuple[ExpectedParameter, ...]:
    """Expected standard uncertainty of every parameter of the arm, in a file's unit."""
    model = linear.model
    units, factors = model.in_file_units()
    arm = model.slices[ARM]
    sd = np.sqrt(np.diag(linear.covariance(chosen))[arm]) * model.sd * factors[arm]
    prior = model.sd * factors[arm]
    return tuple(
        ExpectedParameter(p.name, units[k], float(sd[k]), float(prior[k]))
        for k, p in enumerate(model.parameters)
    )


def curves(
    linear: Linearised, goals: Sequence[Goal], chosen: Sequence[int] | np.ndarray, random: Random
) -> Curves:
    """Uncertainty by the number of contacts, of plans like the chosen one and of random selections."""
    count, first = len(chosen), goals[0]
    counts = sorted({round(part * count) for part in PARTS})
    counts = [n for n in counts if max(FEWEST, linear.model.size - linear.residuals) < n <= linear.count]
    root = root_of(goals, linear.covariance(chosen))
    u = {count: u_of(linear, first, chosen)}
    fewer = Selection(linear, chosen, root)
    for n in sorted((n for n in counts if n < count), reverse=True):
        shrink(fewer, n)
        u[n] = u_of(linear, first, fewer.chosen)
    more = Selection(linear, chosen, root)
    further = min(count + FURTHER, count + int(np.sum(more.free)))
    for n in sorted({*(n for n in counts if n > count), further}):
        grow(more, n, Selection.gains)
        u[n] = u_of(linear, first, more.chosen)
    plan = tuple((n, u[n]) for n in sorted({*counts, count}))
    by_chance = tuple((n, random.u(linear, first, n)) for n, _ in plan if n <= linear.count)
    equal = equals_random(linear, first, u[count], random)
    return Curves(curve=plan, curve_random=by_chance, equals_random=equal, next_u=u[further])


def equals_random(linear: Linearised, goal: Goal, u: float, random: Random) -> float:
    """Number of random contacts with the median uncertainty `u`, m, of a goal; infinite above the pool.

    Interpolated between logarithms; never below `FEWEST`.
    """
    counts = np.unique(np.geomspace(FEWEST, linear.count, STEPS).astype(int))
    uncertainty = np.array([random.u(linear, goal, int(n)) for n in counts])
    if u < uncertainty[-1]:
        return float("inf")
    return float(np.exp(np.interp(-np.log(u), -np.log(uncertainty), np.log(counts))))
