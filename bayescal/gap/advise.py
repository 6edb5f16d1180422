"""Advice: what to measure next to distinguish two explanations of the gap.

Candidate contacts are contacts of the session, repeated under other conditions (`candidate_contacts`). The
detectability lambda of A, with the parameters of the model *and* of B free, grows by e^2 / (1 + v) with each
contact, where e is the error of the prediction by B and v its variance: closed form, without simulation or
refit.

Blind spots: effects of plausible amplitude that are not detectable, and the resulting distance errors.

All is linear at one state. The column x of an effect, projected off the model, has the detectability x'Mx.
The calibration absorbs z = Cov J'x of it, which displaces every located centre.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import Parameter, Site
from bayescal.estimate import Estimate
from bayescal.gap.candidate_contacts import AGAIN, PairSide, Possible, located, possibilities
from bayescal.gap.examine import Examined
from bayescal.gap.linear.evidence import Projected, project
from bayescal.gap.linear.state import State
from bayescal.gap.result import Advice, BlindSpot, NextContact, Pair, Side, Suspect
from bayescal.gap.search.beam import Hypothesis
from bayescal.gap.search.candidates import Candidates
from bayescal.gap.search.refit import model_name
from bayescal.gap.settings import DESIGN, VERDICT
from bayescal.model import ARM, Model
from bayescal.model.scene import Scene
from bayescal.predict.errors import by_points
from bayescal.predict.targets import centre_of
from bayescal.statistics import grouped

NOTHING = "noise only"


def choose(
    sides: Sequence[PairSide], contact: np.ndarray, pose: np.ndarray, count: int
) -> tuple[list[int], float]:
    """Contacts, the best first, each with the largest increase of the smaller lambda; and that lambda.

    Parameters
    ----------
    sides : sequence of Side
        For the same R residuals of candidate contacts.
    contact : np.ndarray, shape (R,)
        The contact of each residual, counted from 0.
    pose : np.ndarray, shape (contacts,)
        The row of the session with its pose; no pose is chosen twice.
    count : int
    """
    allowed = np.zeros(len(pose))
    order: list[int] = []
    for _ in range(min(count, len(np.unique(pose)))):
        reach = [s.strength + np.bincount(contact, s.error**2 / (1.0 + s.variance)) for s in sides]
        best = int(np.argmax(np.min(reach, axis=0) + allowed))
        allowed[pose == pose[best]] = -np.inf
        order.append(best)
        rows = np.flatnonzero(contact == best)
        for side in sides:
            side.add(rows)
    return order, min(s.strength for s in sides)


def advise(
    fitted: Estimate, candidates: Candidates, pairs: Sequence[tuple[Hypothesis, Hypothesis]]
) -> tuple[Advice, ...]:
    """Next measurements to distinguish each pair of hypotheses: the best intervention, or the best two.

    Parameters
    ----------
    fitted : Estimate
        The baseline.
    candidates : Candidates
        Of the search.
    pairs : sequence of (Hypothesis, Hypothesis)
        Effects that both contain belong to the model.

    Returns
    -------
    tuple of Advice
        The same poses again where no intervention is much better; none for a pair to whose lambda no
        intervention adds `DESIGN.least`.

    Notes
    -----
    Either of the two may be the true one: lambda is the smaller, of A beside B and of B beside A, each
    at its fitted amplitude, so that neither can replace the other.
    """
    members = [m for pair in pairs for h in pair for m in h.members]
    if not members:
        return ()
    interventions = possibilities(fitted, candidates, members)
    dataset = fitted.model.scene.dataset
    images = fitted.model.scene.in_images.all()
    contacts = min(DESIGN.contacts, DESIGN.images) if images else DESIGN.contacts
    readings = dataset.measurements.readings
    out: list[Advice] = []
    for a, b in pairs:
        ways = (a, b), (b, a)
        names = [" and ".join(n for n in x.names if n not in y.names) or NOTHING for x, y in ways]
        tried: list[Advice] = []
        for intervention in interventions:
            if intervention is not interventions[0] and not intervention.differs(interventions[0], a, b):
                continue
            sides = [s for one, other in ways if (s := intervention.side(one, other)) is not None]
            if not sides:
                break
            before = min(s.strength for s in sides)
            order, after = choose(sides, intervention.contact, intervention.pose, contacts)
            contacts_of = () if intervention.measured else next_contacts(dataset, intervention, order)
            poses = tuple(tuple(pose) for pose in readings[intervention.pose[order]].tolist())
            pair = names[0], names[1]
            tried.append(Advice(pair, intervention.what, poses, before, after, contacts_of))
        if max((t.lambda_after - t.lambda_before for t in tried), default=0.0) < DESIGN.least:
            continue
        better = [t for t in tried[1:] if t.lambda_after > DESIGN.better * tried[0].lambda_after]
        better.sort(key=lambda t: -t.lambda_after)
        out += [t for t in better[:2] if t.lambda_after > 0.5 * better[0].lambda_after] or tried[:1]
    return tuple(out)


def next_contacts(dataset: Dataset, chosen: Possible, order: Sequence[int]) -> tuple[NextContact, ...]:
    """Contacts of an intervention as they are to be measured: at rows of a session, under its conditions."""
    m = dataset.measurements
    return tuple(
        NextContact(
            dataset.targets[m.target[row]].name,
            dataset.tools[m.tool[row]].name,
            tuple(m.readings[row].tolist()),
            None if chosen.velocity is None else tuple(chosen.velocity[k].tolist()),
            None if chosen.payload is None else float(chosen.payload[k]),
            m.ids[row] if chosen.what == AGAIN else "",
        )
        for k, row in zip(order, chosen.pose[list(order)].tolist(), strict=True)
    )


def rivals(e: Examined) -> list[tuple[Hypothesis, Hypothesis]]:
    """Pairs of hypotheses that the data do not distinguish: the most probable and its alternatives."""
    named = [w for w in e.decision.weighed if not w.unmodelled]
    leader = named[0]
    likely = [w.hypothesis for w in named[1:] if w.probability > VERDICT.doubt]
    others = [h for h in likely if h.names != leader.hypothesis.names]
    return [(leader.hypothesis, h) for h in others[: VERDICT.advised]]


def undecided(e: Examined) -> tuple[Pair, ...]:
    """Pairs of explanations with their fitted parameters; then every name that is not confirmed."""
    d, pairs = e.decision, []
    for a, b in rivals(e):
        shared = set(a.names) & set(b.names)
        parts = (a, set(a.names) - shared), (b, set(b.names) - shared), (a, shared)
        pairs.append(Pair(*(_side(h, e.candidates, effects) for h, effects in parts)))
    leader = next(w.hypothesis for w in d.weighed if not w.unmodelled)
    for effect in (*sorted(d.unclaimed), *sorted(d.withheld)):  # as sets their order differs by process
        h = d.hypothesis if effect in d.hypothesis.names else leader
        if effect in h.names:
            others = set(h.names) - {effect}
            pairs.append(Pair(_side(h, e.candidates, {effect}), (), _side(h, e.candidates, others)))
    return tuple(pairs)


def _side(h: Hypothesis, candidates: Candidates, effects: Collection[str]) -> Side:
    """Some effects of a hypothesis, with the parameters that it fits."""
    out = []
    for m in h.members:
        if m.effect in effects:
            fitted = [candidates.pool[k] for k in m.variant.columns]
            amplitudes = h.state.amplitudes_of(m.variant.columns)
            values = {p.name: float(x * p.sd) for p, x in zip(fitted, amplitudes, strict=True)}
            out.append(Suspect(model_name(m, candidates), values, {p.name: p.unit for p in fitted}))
    return tuple(out)


@dataclass(frozen=True)
class Seat:
    """Parameters of an effect at one site, in one unit: columns of the pool."""

    effect: str
    site: Site
    unit: str
    columns: np.ndarray  # (k,)


def seats(candidates: Candidates, named: Sequence[str] = ()) -> list[Seat]:
    """Sites of every candidate except the named ones, in the usual setting: the first one."""
    out: list[Seat] = []
    for effect, variants in candidates.variants.items():
        if effect in named:
            continue
        indices = np.unique(np.concatenate([v.columns for v in variants if v.setting == variants[0].setting]))
        pool = candidates.pool
        groups = grouped(((pool[k].site, pool[k].unit), k) for k in indices.tolist())
        out += [Seat(effect, *key, np.array(columns)) for key, columns in groups.items()]
    return out


def blind_spots(
    fitted: Estimate, candidates: Candidates, state: State, named: tuple[str, ...] = ()
) -> tuple[BlindSpot, ...]:
    """Detectability of every effect that is neither in the model nor named, largest distance error first.

    Parameters
    ----------
    fitted : Estimate
        The baseline, as the problem of `state` was linearised at.
    candidates : Candidates
        Their pool is that of the problem.
    state : State
        Baseline and named effects, with weights and noise.
    named : tuple of str
        Effects that are not assessed.

    Returns
    -------
    tuple of BlindSpot
        One per effect; `unseen` selects the blind spots.

    Notes
    -----
    The parameters of a site (of one unit) are a random draw of their prior: the detectability of the site is
    the sum over its parameters, and so is the mean square error of a distance. The least detectable
    combination is not used: of many functions on a face, or of the two phases of a wave, one is always
    undetectable and mostly harmless. `plausible` and `smallest` are root mean squares over the parameters;
    `smallest` is infinite where the contacts cannot show the effect at all. An effect is represented by its
    undetected site with the largest distance error or, if all sites are detectable, by the least detectable
    one. The least detectable site in general is not relevant: it is always a wrist joint without load.
    """
    judged = seats(candidates, named)
    if not judged:
        return ()
    free = state.columns[state.columns < len(candidates.pool)]
    used = np.union1d(np.concatenate([s.columns for s in judged]), free)
    seen = project(state, state.problem.pool[:, used])
    raw = np.sum(seen.weighted**2, axis=0)
    strength = np.maximum(raw - np.sum(seen.across * seen.solved, axis=0), DESIGN.rounding * raw)
    moved = distances(fitted, [candidates.pool[k] for k in used], used, seen)
    harm = np.mean(moved**2, axis=0) if len(moved) else np.full(len(used), np.nan)
    best: dict[str, tuple[tuple[bool, float], BlindSpot]] = {}
    for s in judged:
        index = np.searchsorted(used, s.columns)
        total = float(np.sum(strength[index]))
        ratio = np.sqrt(DESIGN.named / total) if total > 0 else np.inf
        plausible = float(np.sqrt(np.mean([candidates.pool[k].sd ** 2 for k in s.columns])))
        error = float(np.sqrt(np.sum(harm[index])))
        spot = BlindSpot(s.effect, s.site, float(ratio) * plausible, plausible, s.unit, error)
        blind = bool(ratio > 1.0)
        rank = (blind, error if blind and not np.isnan(error) else float(ratio))
        if s.effect not in best or rank > best[s.effect][0]:
            best[s.effect] = rank, spot
    spots = [spot for _, spot in best.values()]
    return tuple(sorted(spots, key=lambda b: -np.nan_to_num(b.distance_error, nan=-1.0)))


def unseen(spots: Iterable[BlindSpot]) -> tuple[BlindSpot, ...]:
    """Effects that would not be named at their plausible amplitude."""
    return tuple(b for b in spots if b.smallest > b.plausible)


def distances(fitted: Estimate, extra: Sequence[Parameter], used: np.ndarray, seen: Projected) -> np.ndarray:
    """Errors of distances (Q, K), m, by one prior standard deviation of each of K unmodelled candidates.

    Parameters
    ----------
    fitted : Estimate
    extra : sequence of Parameter
        The candidates.
    used : np.ndarray, shape (K,)
        Indices of the candidates in the pool, ascending.
    seen : Projected
        Their columns, projected by a state, which includes named columns.

    Returns
    -------
    np.ndarray
        Of certified distances between centres; where there are none, of distances between points of the
        session; (0, K) where there is neither.
    """
    model, state = fitted.model, seen.state
    wide = Model(model.scene, model.effects, (*model.parameters, *extra), (), ())
    arm_size, size, count = len(model.parameters), len(fitted.z), len(used)
    values = np.append(model.deviations(fitted.z[model.slices[ARM]]), np.zeros(count))
    # error of the calibrated arm
    off = np.zeros((arm_size + count, count))
    off[:arm_size] = seen.solved[:arm_size]
    free = np.flatnonzero(np.isin(state.columns, used))
    index = np.searchsorted(used, state.columns[free])
    off[arm_size + index] += state.scales[free, None] * seen.solved[size + free]
    off[arm_size + np.arange(count), np.arange(count)] -= 1.0
    off *= wide.sd[:, None]
    centres: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    pairs = certified_distances(model.scene)
    for name in dict.fromkeys(name for pair in pairs for name in pair):
        if (centre := _centre(fitted, wide, name, values, off, seen.solved)) is not None:
            centres[name] = centre
    ends = [(centres[a], centres[b]) for a, b in pairs if a in centres and b in centres]
    if not ends:
        ends = _points(wide, values, off)
    out = np.empty((len(ends), count))
    for i, ((a, da), (b, db)) in enumerate(ends):
        out[i] = (a - b) / np.linalg.norm(a - b) @ (da - db)
    return out


def certified_distances(scene: Scene) -> list[tuple[str, ...]]:
    """Targets of all certified distances."""
    return [c.targets for c in scene.dataset.certificates if c.kind == "distance"]


def _centre(
    fitted: Estimate, wide: Model, name: str, values: np.ndarray, off: np.ndarray, solved: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Centre of a target (3,) and its errors (3, K), m, for errors `off` (P + K, K) of the arm."""
    model = fitted.model
    if name in model.block_of:
        block, part = model.block_of[name], model.slices[name]
        if not model.scene.declared_of(name).centred:
            return None
        shift = np.zeros((len(block.kind.sd), solved.shape[1]))
        shift[block.free] = solved[part] * block.sd[:, None]
        return centre_of(block, block.state(fitted.z[part])), shift[:3]
    location = located(fitted, wide, model.scene.index[name], values)
    if location is None:
        return None
    block, z = location
    _, by_arm, by_target = block.linearise(values, z)
    sigma = np.tile(block.sigma, block.kind.rows)[:, None]
    slopes, errors = by_target / sigma, (by_arm @ off) / sigma
    shift = -np.linalg.solve(slopes.T @ slopes + np.eye(block.size), slopes.T @ errors)
    return centre_of(block, block.state(z)), shift[:3] * block.sd[:3, None]


def _points(
    wide: Model, values: np.ndarray, off: np.ndarray
) -> list[tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]:
    """Pairs of ball centres at least `DESIGN.apart` apart, and the errors of their distances, m."""
    rng = np.random.default_rng(0)
    rows = wide.scene.rows("calibrate")
    rows = np.sort(rng.permutation(rows)[: DESIGN.points])
    motion = wide.motion(rows)
    p = motion.points(values)
    shift = np.stack([by.T @ off for by in by_points(motion, values, p)], axis=1)  # (points, 3, K)
    a, b = np.triu_indices(len(rows), 1)
    far = np.flatnonzero(np.linalg.norm(p[:, a] - p[:, b], axis=0) >= DESIGN.apart)
    chosen = rng.permutation(far)[: DESIGN.pairs]
    return [((p[:, i], shift[i]), (p[:, j], shift[j])) for i, j in zip(a[chosen], b[chosen], strict=True)]
