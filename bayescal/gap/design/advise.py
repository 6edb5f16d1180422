"""Advice: what to measure next to distinguish two explanations of the gap.

Candidate contacts are contacts of the session, repeated under other conditions (`candidate_contacts`). The
detectability lambda of A, with the parameters of the model *and* of B free, grows by e^2 / (1 + v) with each
contact, where e is the error of the prediction by B and v its variance: closed form, without simulation or
refit.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from bayescal.dataset import Dataset
from bayescal.estimate import Estimate
from bayescal.gap.design.candidate_contacts import AGAIN, PairSide, Possible, possibilities
from bayescal.gap.design.settings import DESIGN
from bayescal.gap.examine import Examined
from bayescal.gap.result import Advice, NextContact, Pair, Side, Suspect
from bayescal.gap.search.beam import Hypothesis
from bayescal.gap.search.candidates import Candidates
from bayescal.gap.search.refit import model_name
from bayescal.gap.settings import VERDICT

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

    def contact(k: int) -> NextContact:
        row = int(chosen.pose[k])
        return NextContact(
            dataset.targets[m.target[row]].name,
            dataset.tools[m.tool[row]].name,
            tuple(m.readings[row].tolist()),
            None if chosen.velocity is None else tuple(chosen.velocity[k].tolist()),
            None if chosen.payload is None else float(chosen.payload[k]),
            m.ids[row] if chosen.what == AGAIN else "",
        )

    return tuple(contact(k) for k in order)


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
    if not effects:
        return ()
    ends = np.cumsum([len(m.variant.columns) for m in h.members])
    out = []
    for m, amplitudes in zip(h.members, np.split(h.state.amplitudes, ends[:-1]), strict=True):
        if m.effect in effects:
            fitted = [candidates.pool[k] for k in m.variant.columns]
            values = {p.name: float(x * p.sd) for p, x in zip(fitted, amplitudes, strict=True)}
            out.append(Suspect(model_name(m, candidates), values, {p.name: p.unit for p in fitted}))
    return tuple(out)
