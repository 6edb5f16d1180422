"""The conclusion: what changed, by how much and with which probability; what would have been seen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.changes import search
from bayescal.changes.joint import (
    DistanceChange,
    Item,
    Joint,
    Shift,
    distance_change,
    distance_slopes,
    prepared,
    tcp_slopes,
    with_poses,
)
from bayescal.changes.linear import evidence, integrated
from bayescal.dataset import Dataset
from bayescal.effects import EFFECTS, Parameter
from bayescal.effects.location import magnitude
from bayescal.programs.text import Target
from bayescal.storage.stopping import Progress, silent

POWER = 1.2816
"""Standard deviations by which a change must exceed the limit to be found with a probability of 90 %."""
MOST = 8
"""Largest number of items in a class."""
OF_ARM = ("arm", "effect", "unknown")
"""Kinds of items of the arm; others are of its surroundings: base, targets, tool."""
REMOUNTED = "the tools were remounted: the tool of each session is its own, and its change is not judged"
SCATTERED = "many of its measurements are outliers; whether it moved in between is not judged"
UNDIRECTED = (
    "a lost motion changed, and no direction of motion is stated (`j1_degps` ...): it is not in this pose"
)
NOT_PLACED = "no target is in two sessions: the base is not compared, nor the zero of the first joint"
"""Warnings."""


@dataclass(frozen=True)
class Difference:
    """One parameter of an item that may have changed; SI."""

    item: Item
    parameter: Parameter
    sessions: tuple[str, ...]  # that have the value after the change
    before: float | None  # None: only the difference is known
    after: float | None
    difference: float
    u: float
    probability: float  # of the item
    group: tuple[str, ...]  # names of the class, with this one; () if it is named alone
    stated: bool  # named, alone or in a class


@dataclass(frozen=True)
class Detectable:
    """The smallest change of a parameter that would have been found, with a probability of 90 %; SI."""

    item: Item
    parameter: Parameter
    value: float | None  # None: these sessions do not tell
    tcp: float | None  # m, RMS displacement of the TCP by it


@dataclass(frozen=True)
class Changed:
    """What changed between sessions of one arm."""

    dataset: Dataset
    effects: tuple[str, ...]
    sessions: tuple[Dataset, ...]
    verdict: str  # same, changed or ambiguous
    arm: str  # the same of the arm alone
    same: float  # probability that nothing changed
    arm_same: float
    differences: tuple[Difference, ...]
    detectable: tuple[Detectable, ...]
    distances: DistanceChange | None
    shifts: tuple[Shift, ...]
    noise: tuple[float, ...]
    of_stops: tuple[float, ...]  # RMS error that measurements of one stop share, over the noise
    errors: tuple[tuple[str, float], ...]  # of all sessions alike: effect, share of its prior variance
    compared: frozenset[str]  # targets in more than one session
    warnings: tuple[str, ...]


def changed(
    sessions: Sequence[Dataset], effects: tuple[str, ...], *, remounted: bool = False, robust: bool = True,
    targets: Sequence[Target] = (), progress: Progress = silent,
) -> Changed:  # fmt: skip
    """What changed between sessions of one arm.

    Parameters
    ----------
    sessions : sequence of Dataset
        Two or more, in the order of time.
    effects : tuple of str
        The model that they share.
    remounted : bool
        Every session has tools of its own.
    robust : bool
        Exclude outliers.
    targets : sequence of Target
        Poses at which the displacement of the TCP is wanted.
    progress : callable

    Raises
    ------
    BayescalError
        If they are not of one arm, or the model cannot be fitted.
    """
    orders = [tuple(sessions)]
    if len(sessions) == 2:  # errors that all sessions have are those of the first: each of two may be it
        orders.append((sessions[1], sessions[0]))
    every = []
    for number, (*others, last) in enumerate(orders):
        progress("estimate", number / len(orders))
        extended, reasons = with_poses(last, targets)
        joint = prepared([*others, extended], effects, remounted, robust)
        every.append((search.search(evidence(joint)), reasons))
    back = max(range(len(every)), key=lambda k: every[k][0].log_evidence)
    sets, reasons = every[back]
    e, joint = sets.evidence, sets.evidence.joint
    arm_same = sum(w.probability for w in sets.weighed if not any(_of_arm(joint, m) for m in w.members))
    classes = {m: members_of_class(sets, m) for m in sets.best.members}
    of_class = {m: group for group in reversed(classes.values()) for m in group}
    verdict = verdict_of(sets.same, any(classes.values()))
    of_arm = {m: g for m, g in classes.items() if _of_arm(joint, m)}
    arm = verdict_of(arm_same, any(of_arm.values()))
    listed = [m for m, p in sets.probability.items() if p >= search.LISTED or m in of_class]
    # members of the best set are in the order of what they explain
    rank = {m: k for k, lead in enumerate(sets.best.members) for m in reversed(classes[lead] or (lead,))}
    listed.sort(key=lambda m: (m not in of_class, rank.get(m, len(rank)), -sets.probability[m]))
    differences = [
        d
        for m in listed
        for d in _differences(sets, m, of_class.get(m, ()), m in of_class and verdict != "same")
    ]
    best = {m.item for m in sets.best.members}
    moved = [k in best or i.kind != "unknown" for k, i in enumerate(joint.items)]
    each = zip(joint.items, moved, strict=True)
    moves = tcp_slopes(joint, [(p, used) for item, used in each for p in item.parameters])
    effect, shifts = _moved(sets, moves, [t.id for t in targets], reasons)
    noise, of_stops = e.noise.tolist(), e.of_stops.tolist()
    if back:
        differences = [_reversed(d, joint.names[0]) for d in differences]
        effect = effect and replace(effect, largest=-effect.largest)
        shifts = tuple(replace(s, shift=None if s.shift is None else -s.shift) for s in shifts)
        noise, of_stops = noise[::-1], of_stops[::-1]
    of_time = every[0][0].evidence.joint.dataset
    changes = [p for m in sets.best.members for p in joint.items[m.item].parameters]
    lost = any(p.driver.kind in ("direction", "flank") for p in changes)
    warnings = (
        *((REMOUNTED,) if remounted else ()),
        *(f"pose {t.id or k}: {UNDIRECTED}" for k, t in enumerate(targets, 1) if lost and t.velocity is None),
        *(f"target {name}: {SCATTERED}" for name in sorted(joint.scattered)),
        *(() if joint.placed else (NOT_PLACED,)),
    )
    return Changed(
        of_time, effects, of_time.sessions, verdict, arm, sets.same, arm_same, tuple(differences),
        detectable(sets, moves), effect, shifts, tuple(noise), tuple(of_stops), _errors(sets), joint.placed,
        warnings,
    )  # fmt: skip


def _reversed(d: Difference, last: str) -> Difference:
    """A difference in the order of time, of two sessions that were compared in the other order."""
    return replace(d, sessions=(last,), before=d.after, after=d.before, difference=-d.difference)


def _of_arm(joint: Joint, m: search.Member) -> bool:
    return joint.items[m.item].kind in OF_ARM


def verdict_of(same: float, resolved: bool) -> str:
    """The verdict, by the probability that nothing changed, and whether one is named, alone or in a class."""
    if same >= search.NONE:
        return "same"
    return "changed" if 1.0 - same >= search.SURE and resolved else "ambiguous"


def members_of_class(sets: search.Search, m: search.Member) -> tuple[search.Member, ...]:
    """A member of the best set with those that may replace it: together nearly certain; () if too many."""
    chosen, with_change = [m], [w for w in sets.weighed if w.members]
    total = sets.probability[m]
    others = set(sets.best.members) - {m}
    if total >= search.NAMED:
        return (m,)
    while total < search.SURE and len(chosen) <= MOST:
        mass: dict[search.Member, float] = {}
        for w in with_change:
            if not set(w.members) & set(chosen):
                for other in set(w.members) - others:
                    mass[other] = mass.get(other, 0.0) + w.probability
        if not mass:
            break
        best = max(mass, key=lambda k: mass[k])
        chosen.append(best)
        total += mass[best]
    return tuple(chosen) if total >= search.SURE and len(chosen) <= MOST else ()


def _differences(
    sets: search.Search, m: search.Member, of_class: Sequence[search.Member], stated: bool
) -> list[Difference]:
    probability = min(sets.probability[m], 1.0)
    e, item = sets.evidence, sets.evidence.joint.items[m.item]
    members = search.set_with(sets, m).members
    by, mean, covariance = search.posterior(e, members)
    first = sum(len(e.joint.items[k.item].parameters) for k in members[: members.index(m)])
    variances = np.diag(covariance)[first : first + len(item.parameters)] + search.by_sets(sets, m)
    shared = e.shared + e.follow @ (by @ mean)
    place = {name: k for k, name in enumerate(e.names)}
    sign = -1.0 if 0 in m.sessions else 1.0  # the first session alone has another value
    size = EFFECTS[item.effect].sizes.get(item.parameters[0].unit) if item.effect in EFFECTS else None
    out = []
    for p, amplitude, variance in zip(item.parameters, mean[first:], variances, strict=False):
        difference = sign * p.sd * float(amplitude)
        u = float(np.hypot(p.sd * np.sqrt(variance), search.by_masses(e.joint, p) * difference))
        index = place.get(p.name) if p.name else None
        before = None if index is None else float(e.centre[index] + e.sd[index] * shared[index])
        after = None if before is None else before + difference
        larger = difference if before is None or after is None else max(before, after, key=abs)
        if size is not None and size.value is magnitude and larger < 0:
            # the effect defines the sign, not the parameter
            before, after = (None if v is None else -v for v in (before, after))
            difference = -difference
        names = tuple(e.joint.names[i] for i in m.sessions)
        group = tuple(e.joint.items[g.item].name for g in of_class) if len(of_class) > 1 else ()
        out.append(Difference(item, p, names, before, after, difference, u, probability, group, stated))
    return out


def _moved(
    sets: search.Search, moves: np.ndarray, ids: Sequence[str], reasons: Sequence[str]
) -> tuple[DistanceChange | None, tuple[Shift, ...]]:
    """What the best set does to distances, and at given poses; base and targets are not part of it."""
    e, joint = sets.evidence, sets.evidence.joint
    _, mean, covariance = search.posterior(e, sets.best.members)
    first = np.cumsum([0, *(len(i.parameters) for i in joint.items)])
    parameters = [k for m in sets.best.members for k in range(first[m.item], first[m.item + 1])]
    weight = [  # of the last session relative to the first
        m.weights(len(joint.sessions))[-1] * (_of_arm(joint, m) or joint.items[m.item].site.kind == "tool")
        for m in sets.best.members
    ]
    sign = np.repeat(weight, [len(joint.items[m.item].parameters) for m in sets.best.members])
    kept = sign != 0
    by = moves[parameters][kept] * sign[kept, None, None] if parameters else moves[:0]
    mean, covariance = mean[kept], covariance[np.ix_(kept, kept)]
    count = moves.shape[2]
    shifts = []
    rows = iter(range(count - (len(ids) - sum(map(bool, reasons))), count))
    for k, (name, reason) in enumerate(zip(ids, reasons, strict=True), start=1):
        if reason:
            shifts.append(Shift(name or f"{k}", reason=reason))
            continue
        slopes = by[:, :, next(rows)]
        shifts.append(Shift(name or f"{k}", slopes.T @ mean, slopes.T @ covariance @ slopes))
    if not len(by):
        return None, tuple(shifts)
    fitted = joint.circumstances.fitted
    points = joint.estimate.model.motion(fitted).points(joint.estimate.arm)
    return distance_change(distance_slopes(points, by[:, :, fitted]), mean, covariance), tuple(shifts)


def detectable(sets: search.Search, moves: np.ndarray) -> tuple[Detectable, ...]:
    """The smallest change of every parameter of the arm and of the tool that would have been found."""
    e, joint = sets.evidence, sets.evidence.joint

    def beside(item: Item | None) -> np.ndarray:
        """Information with the changes of the best set, without that of an item, integrated out."""
        others = [m for m in sets.best.members if joint.items[m.item] is not item]
        return integrated(e.information, e.score, search.FREE * search.selectors(e, others))[0]

    usual = beside(None)
    inside = {m.item for m in sets.best.members}
    every = search.options(e)
    prior = search.log_priors(e, every)
    first = np.cumsum([0, *(len(i.parameters) for i in joint.items)])
    fitted = joint.circumstances.fitted
    out = []
    for m in (m for m in every if m.sessions == (len(joint.sessions) - 1,)):
        item = joint.items[m.item]
        if item.kind not in ("arm", "effect") and item.site.kind != "tool":
            continue
        select, g = search.selector(e, m), beside(item) if m.item in inside else usual
        for k, p in enumerate(item.parameters):
            columns = np.flatnonzero(select[:, k])
            information = float(np.sum(g[np.ix_(columns, columns)]))
            value = _least(information, prior[m] + float(np.log(1.0 - search.NONE)))
            tcp = moves[first[m.item] + k][:, fitted]
            size = float(np.sqrt(np.mean(np.sum(tcp**2, axis=0))))
            if value is None or value > search.SCALES[-1]:  # beyond every prior of a change
                out.append(Detectable(item, p, None, None))
            else:
                out.append(Detectable(item, p, value * p.sd, value * size))
    return tuple(out)


def _least(information: float, prior: float) -> float | None:
    """The change, in units of its prior, that is found with a probability of 90 %."""
    if information * search.FREE**2 < 1.0:
        return None

    square = search.SCALES**2
    with_it = 1.0 + square * information
    limit = float(np.log(search.NONE) + np.log(search.SURE / (1.0 - search.SURE))) - prior

    def odds(a: float) -> float:
        return search.averaged(0.5 * ((information * a) ** 2 * square / with_it - np.log(with_it))) - limit

    low, high = 0.0, 1.0 / np.sqrt(information)
    while odds(high) < 0.0:
        low, high = high, 2.0 * high
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if odds(middle) < 0.0 else (low, middle)
    return high + POWER / float(np.sqrt(information))


def _errors(sets: search.Search) -> tuple[tuple[str, float], ...]:
    """Errors that the model lacks, of all sessions alike, that these tell; largest variance first."""
    variances, odds = sets.evidence.variances, search.log_odds(sets)
    # any of the families may be it by chance
    least = float(np.log(search.SURE / (1.0 - search.SURE) * max(len(odds), 1)))
    sure = [(name, variances[name]) for name, o in odds.items() if name in EFFECTS and o >= least]
    return tuple(sorted(sure, key=lambda x: -x[1]))
