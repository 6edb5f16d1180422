"""What the data leave open: explanations that they do not separate, and names that they do not confirm."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from bayescal.gap.examine import Examined
from bayescal.gap.result import Pair, Side, Suspect
from bayescal.gap.search.beam import Hypothesis
from bayescal.gap.search.candidates import Candidates
from bayescal.gap.search.refit import model_name
from bayescal.gap.settings import VERDICT


def rivals(e: Examined) -> list[tuple[Hypothesis, Hypothesis]]:
    """Pairs of hypotheses that the data do not distinguish: the most probable and its alternatives."""
    named = [w for w in e.decision.weighed if w.cell is None]
    leader = named[0]
    others = [
        w
        for w in named[1:]
        if w.probability > VERDICT.doubt and w.hypothesis.names != leader.hypothesis.names
    ]
    return [(leader.hypothesis, w.hypothesis) for w in others[: VERDICT.advised]]


def undecided(e: Examined) -> tuple[Pair, ...]:
    """Pairs of explanations with their fitted parameters; then every name that is not confirmed."""
    d, pairs = e.decision, []
    for a, b in rivals(e):
        shared = set(a.names) & set(b.names)
        pairs.append(
            Pair(
                _side(a, e.candidates, set(a.names) - shared),
                _side(b, e.candidates, set(b.names) - shared),
                _side(a, e.candidates, shared),
            )
        )
    leader = next(w.hypothesis for w in d.weighed if w.cell is None)
    for effect in (*d.unclaimed, *d.withheld):
        h = d.hypothesis if effect in d.hypothesis.names else leader
        if effect in h.names:
            rest = set(h.names) - {effect}
            pairs.append(Pair(_side(h, e.candidates, {effect}), (), _side(h, e.candidates, rest)))
    return tuple(pairs)


def _side(h: Hypothesis, known: Candidates, effects: Collection[str]) -> Side:
    """Some effects of a hypothesis, with the parameters that it fits."""
    if not effects:
        return ()
    ends = np.cumsum([len(m.variant.columns) for m in h.members])
    out = []
    for m, amplitudes in zip(h.members, np.split(h.state.amplitudes, ends[:-1]), strict=True):
        if m.effect in effects:
            own = [known.pool[k] for k in m.variant.columns]
            values = {p.name: float(x * p.sd) for p, x in zip(own, amplitudes, strict=True)}
            out.append(Suspect(model_name(m, known), values, {p.name: p.unit for p in own}))
    return tuple(out)
