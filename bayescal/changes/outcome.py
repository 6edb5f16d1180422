"""The conclusion: what changed by how much, what cannot be distinguished, what a change moves, what would have been seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.inverse import nearest, solutions
from bayescal.changes.joint import Item, Joint, prepared
from bayescal.changes.linear import Evidence, evidence, integrated
from bayescal.changes.search import (
    FREE,
    LISTED,
    NAMED,
    NONE,
    SURE,
    Member,
    Search,
    Weighed,
    averaged,
    gains,
    log_priors,
    options,
    search,
    selector,
)
from bayescal.dataset import Dataset
from bayescal.dataset.join import stacked
from bayescal.effects import Parameter
from bayescal.errors import BayescalError
from bayescal.estimate.further import model_with
from bayescal.programs.text import Target
from bayescal.programs.tools import nominal_arm
from bayescal.storage.stopping import Progress, silent

AT = "at"
"""Role of poses that are given: they are neither fitted nor validated."""
PAIRS, DRAWS = 3000, 400
"""Pairs of poses whose distances are compared, and draws for their u."""
POWER = 1.2816
"""Standard deviations by which a change must exceed the limit to be found with a probability of 90 %."""
MOST = 8
"""Largest number of items in a class."""
OF_ARM = ("arm", "effect", "unknown")
"""Kinds of items of the arm; others are of its surroundings: base, targets, tool."""


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
class Effect:
    """What the changes of the arm and tool do to distances between poses; m."""

    rms: float
    u_rms: float
    largest: float
    u_largest: float


@dataclass(frozen=True)
class Shift:
    """Displacement of the TCP in F0 at a given pose, m; `reason` why there is none."""

    where: str
    shift: np.ndarray | None = None  # (3,)
    covariance: np.ndarray | None = None
    reason: str = ""

    @property
    def size(self) -> float:
        """Length, m."""
        return 0.0 if self.shift is None else float(np.linalg.norm(self.shift))

    @property
    def u(self) -> float:
        """Standard uncertainty of the vector, m."""
        return 0.0 if self.covariance is None else float(np.sqrt(np.trace(self.covariance)))


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
    distances: Effect | None
    shifts: tuple[Shift, ...]
    noise: tuple[float, ...]
    errors: tuple[tuple[str, float], ...]  # of all sessions alike: effect, share of its prior variance
    compared: frozenset[str]  # targets in more than one session
    warnings: tuple[str, ...]

    @property
    def stated(self) -> tuple[Difference, ...]:
        """Differences that are named, alone or in a class."""
        return tuple(d for d in self.differences if d.stated)


def changed(
    sessions: Sequence[Dataset],
    effects: tuple[str, ...],
    *,
    remounted: bool = False,
    robust: bool = True,
    targets: Sequence[Target] = (),
    progress: Progress = silent,
) -> Changed:
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
    progress("estimate", 0.0)
    *others, last = sessions
    extended, reasons = with_poses(last, targets)
    joint = prepared([*others, extended], effects, remounted, robust)
    progress("evidence", 0.0)
    e = evidence(joint)
    progress("search", 0.0)
    found = search(e)
    arm_same = sum(w.probability for w in found.weighed if not any(_of_arm(joint, m) for m in w.members))
    classes = {m: members_of_class(found, m) for m in found.best.members}
    said = {m for group in classes.values() for m in group}
    verdict = verdict_of(found.same, all(classes.values()) and bool(classes))
    of_arm = {m: g for m, g in classes.items() if _of_arm(joint, m)}
    arm = verdict_of(arm_same, all(of_arm.values()) and bool(of_arm))
    listed = [m for m, p in found.probability.items() if p >= LISTED or m in said]
    listed.sort(key=lambda m: (m not in said, -found.probability[m]))
    differences = [
        d
        for m in listed
        for d in _differences(found, m, next((g for g in classes.values() if m in g), ()), verdict != "same")
    ]
    moves = tcp_slopes(joint, [p for i in joint.items for p in i.parameters])
    effect, shifts = _moved(found, moves, len(targets), reasons)
    warnings = []
    if remounted:
        warnings.append(
            "the tools were remounted: the tool of each session is its own, and its change is not judged"
        )
    if not joint.placed:
        warnings.append(
            "no target is in two sessions: the base is not compared, nor the zero of the first joint"
        )
    return Changed(
        joint.dataset,
        effects,
        joint.dataset.sessions,
        verdict,
        arm,
        found.same,
        arm_same,
        tuple(differences),
        detectable(found, moves),
        effect,
        shifts,
        tuple(e.noise.tolist()),
        _errors(e),
        joint.placed,
        tuple(warnings),
    )


def _of_arm(joint: Joint, m: Member) -> bool:
    return joint.items[m.item].kind in OF_ARM


def verdict_of(same: float, resolved: bool) -> str:
    """The verdict, from the probability that nothing changed, and whether all changes are named or in classes."""
    if same >= NONE:
        return "same"
    return "changed" if 1.0 - same >= SURE and resolved else "ambiguous"


def members_of_class(found: Search, m: Member) -> tuple[Member, ...]:
    """A member of the best set with those that may be in its place: together nearly certain; () if too many."""
    chosen, rest = [m], [w for w in found.weighed if w.members]
    total = found.probability[m]
    others = set(found.best.members) - {m}
    if total >= NAMED:
        return (m,)
    while total < SURE and len(chosen) <= MOST:
        mass: dict[Member, float] = {}
        for w in rest:
            if not set(w.members) & set(chosen):
                for other in set(w.members) - others:
                    mass[other] = mass.get(other, 0.0) + w.probability
        if not mass:
            break
        best = max(mass, key=lambda k: mass[k])
        chosen.append(best)
        total += mass[best]
    return tuple(chosen) if total >= SURE and len(chosen) <= MOST else ()


def posterior(e: Evidence, members: Sequence[Member]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (K, k) of a set of changes, and mean (k,) and covariance (k, k) of their amplitudes."""
    by = np.column_stack([np.zeros((len(e.columns), 0)), *(selector(e, m) for m in members)])
    a = by.T @ e.information @ by + np.eye(by.shape[1]) / FREE**2
    scale = 1.0 / np.sqrt(np.diag(a))
    covariance = np.linalg.inv(a * np.outer(scale, scale)) * np.outer(scale, scale)
    return by, covariance @ (by.T @ e.score), covariance


def _set_with(found: Search, m: Member) -> Weighed:
    return next(w for w in found.weighed if m in w.members)


def _differences(found: Search, m: Member, group: Sequence[Member], any_change: bool) -> list[Difference]:
    e, item = found.evidence, found.evidence.joint.items[m.item]
    members = _set_with(found, m).members
    by, mean, covariance = posterior(e, members)
    first = sum(len(e.joint.items[k.item].parameters) for k in members[: members.index(m)])
    shared = e.shared + e.follow @ (by @ mean)
    place = {name: k for k, name in enumerate(e.names)}
    sign = -1.0 if 0 in m.sessions else 1.0  # the first session alone has another value
    out = []
    for k, p in enumerate(item.parameters, start=first):
        difference, u = sign * p.sd * float(mean[k]), p.sd * float(np.sqrt(covariance[k, k]))
        at = place.get(p.name)
        value = None if at is None or not p.name else float(e.centre[at] + e.sd[at] * shared[at])
        names = tuple(e.joint.names[i] for i in m.sessions)
        out.append(
            Difference(
                item,
                p,
                names,
                value,
                None if value is None else value + difference,
                difference,
                u,
                min(found.probability[m], 1.0),
                tuple(e.joint.items[g.item].name for g in group) if len(group) > 1 else (),
                bool(group) and any_change,
            )
        )
    return out


def tcp_slopes(joint: Joint, parameters: Sequence[Parameter]) -> np.ndarray:
    """Displacements (K, 3, N), m, of the TCP in all rows by a prior standard deviation of each parameter."""
    wide, own, _ = model_with(joint.found.model, parameters)
    motion = wide.motion(np.arange(len(joint.found.model.scene.q)))
    values = np.append(joint.found.arm, np.zeros(len(parameters)))
    out = []
    for k, p in enumerate(parameters, start=len(values) - len(parameters)):
        step = 0.01 * p.sd * np.eye(len(values))[k]
        out.append((motion.points(values + step) - motion.points(values - step)) / 0.02)
    return np.array(out).reshape(len(parameters), 3, -1)


def _moved(
    found: Search, moves: np.ndarray, given: int, reasons: Sequence[str]
) -> tuple[Effect | None, tuple[Shift, ...]]:
    """What the best set does to distances, and at given poses; base and targets are not part of it."""
    e, joint = found.evidence, found.evidence.joint
    _, mean, covariance = posterior(e, found.best.members)
    first = np.cumsum([0, *(len(i.parameters) for i in joint.items)])
    parameters = [k for m in found.best.members for k in range(first[m.item], first[m.item + 1])]
    counts = [len(joint.items[m.item].parameters) for m in found.best.members]
    of_arm = np.repeat(
        [_of_arm(joint, m) or joint.items[m.item].site.kind == "tool" for m in found.best.members], counts
    ).astype(bool)
    of_last = np.repeat(
        [len(joint.sessions) - 1 in m.sessions or 0 in m.sessions for m in found.best.members], counts
    )
    kept = of_arm & of_last.astype(bool)
    by = moves[parameters][kept] if parameters else moves[:0]
    mean, covariance = mean[kept], covariance[np.ix_(kept, kept)]
    count = moves.shape[2]
    shifts = []
    rows = iter(range(count - (given - sum(map(bool, reasons))), count))
    for k, reason in enumerate(reasons, start=1):
        if reason:
            shifts.append(Shift(f"{k}", reason=reason))
            continue
        own = by[:, :, next(rows)]
        shifts.append(Shift(f"{k}", own.T @ mean, own.T @ covariance @ own))
    if not len(by):
        return None, tuple(shifts)
    fitted = joint.circumstances.fitted
    points = joint.found.model.motion(fitted).points(joint.found.arm)
    rng = np.random.default_rng(0)
    a, b = rng.integers(len(fitted), size=(2, PAIRS))
    apart = points[:, a] - points[:, b]
    size = np.linalg.norm(apart, axis=0)
    a, b, apart = a[size > 0], b[size > 0], (apart / np.maximum(size, 1e-12))[:, size > 0]
    along = np.einsum("kcp,cp->kp", by[:, :, fitted[a]] - by[:, :, fitted[b]], apart)
    draws = rng.multivariate_normal(mean, covariance, DRAWS, method="eigh") @ along
    value = mean @ along
    most = int(np.argmax(np.abs(value)))
    rms = np.sqrt(np.mean(draws**2, axis=1))
    return Effect(
        float(np.sqrt(np.mean(value**2))),
        float(np.std(rms)),
        float(value[most]),
        float(np.std(draws[:, most])),
    ), tuple(shifts)


def detectable(found: Search, moves: np.ndarray) -> tuple[Detectable, ...]:
    """The smallest change of every parameter of the arm and of the tool that would have been found."""
    e, joint = found.evidence, found.evidence.joint

    def beside(item: Item | None) -> np.ndarray:
        """Information with the changes of the best set integrated out, but for that of an item."""
        by = [FREE * selector(e, m) for m in found.best.members if joint.items[m.item] is not item]
        return integrated(e.information, e.score, np.column_stack([np.zeros((len(e.columns), 0)), *by]))[0]

    usual = beside(None)
    inside = {m.item for m in found.best.members}
    every = options(e)
    prior = log_priors(e, every)
    first = np.cumsum([0, *(len(i.parameters) for i in joint.items)])
    fitted = joint.circumstances.fitted
    out = []
    for m in (m for m in every if m.sessions == (len(joint.sessions) - 1,)):
        item = joint.items[m.item]
        if item.kind not in ("arm", "effect") and item.site.kind != "tool":
            continue
        select, g = selector(e, m), beside(item) if m.item in inside else usual
        for k, p in enumerate(item.parameters):
            at = np.flatnonzero(select[:, k])
            value = _least(float(np.sum(g[np.ix_(at, at)])), prior[m] + float(np.log(1.0 - NONE)))
            tcp = moves[first[m.item] + k][:, fitted]
            size = float(np.sqrt(np.mean(np.sum(tcp**2, axis=0))))
            known = value is not None and value < FREE
            out.append(Detectable(item, p, value * p.sd if known else None, value * size if known else None))
    return tuple(out)


def _least(information: float, prior: float) -> float | None:
    """The change, in units of its prior, that is found with a probability of 90 %."""
    if information * FREE**2 < 1.0:
        return None

    def odds(a: float) -> float:
        gain = averaged(gains(np.array([[information]]), np.array([information * a])))
        return gain + prior - float(np.log(NONE)) - float(np.log(SURE / (1.0 - SURE)))

    low, high = 0.0, 1.0 / np.sqrt(information)
    while odds(high) < 0.0:
        low, high = high, 2.0 * high
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if odds(middle) < 0.0 else (low, middle)
    return high + POWER / float(np.sqrt(information))


def _errors(e: Evidence) -> tuple[tuple[str, float], ...]:
    """Errors that the model lacks, of all sessions alike, largest variance first."""
    from bayescal.effects import EFFECTS

    return tuple(
        sorted(((n, v) for n, v in e.variances.items() if n in EFFECTS and v > 0.1), key=lambda x: -x[1])
    )


def with_poses(dataset: Dataset, targets: Sequence[Target]) -> tuple[Dataset, list[str]]:
    """A session with rows at given poses, by the nominal arm; and for each of these why it has no row, or "".

    Raises
    ------
    BayescalError
        For a tool that the session does not have.
    """
    if not targets:
        return dataset, []
    m, names = dataset.measurements, [t.name for t in dataset.tools]
    readings, tools, kept, reasons = [], [], [], []
    for target in targets:
        if target.tool is not None and target.tool not in names:
            raise BayescalError(
                f"there is no tool `{target.tool}`", target.where, f"known: {', '.join(names)}"
            )
        tool = names.index(target.tool) if target.tool else int(np.bincount(m.tool).argmax())
        found = target.readings
        if target.pose is not None:
            arm = nominal_arm(dataset.robot, dataset.tools[tool])
            near = m.readings[:1] if found is None else found[None]
            every = solutions(arm, target.pose[None], near[None, :1])[0]
            found = nearest(arm, every, m.readings if found is None else near)
        reasons.append("" if found is not None else "the nominal arm does not reach it")
        if found is not None:
            readings.append(found)
            tools.append(tool)
            kept.append(target)
    count = len(kept)
    if not count:
        return dataset, reasons
    at = np.full(count, len(m.ids) - 1)
    columns = {k: None if v is None else v[at] for k, v in vars(m).items() if k != "ids"}
    columns |= {
        "ids": tuple(f"{AT} {k}" for k in range(1, count + 1)),
        "readings": np.array(readings),
        "tool": np.array(tools),
        "role": np.full(count, AT, dtype=m.role.dtype if m.role.dtype.kind != "U" else "<U16"),
    }
    for name in ("repeat", "stop"):
        if columns.get(name) is not None:
            columns[name] = np.full(count, "", dtype=columns[name].dtype)
    if m.velocity is not None:
        columns["velocity"] = np.array(
            [np.zeros(dataset.robot.n) if t.velocity is None else t.velocity for t in kept]
        )
    if m.payload is not None:
        columns["payload"] = np.array([t.payload for t in kept])
    extra = type(m)(**columns)
    both, _ = stacked([m, extra])
    return replace(dataset, measurements=type(m)(**both)), reasons
