"""The log score: log probability that an answer gives to the ground truth, compared with base rates.

An answer states a probability of every set of effects. The score is the log of the probability of the true
event:

- no hidden effect: the probability of noise only;
- an effect not in the list of known effects: the probability of 'unknown', with or without named effects;
- effects: the probability of exactly this set. gap.json lists the most probable sets; the remaining
  probability is distributed over all other sets in proportion to the product of the stated marginals.

These events exclude each other and their probabilities add up to 1, so that the mean log probability is a
strictly proper score: its expectation is largest for the true probabilities. A probability below `CLIP`
counts as `CLIP`, and so does a missing answer.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from math import comb, log
from typing import Any

from analysis.blind.assessed import OTHERS, Record
from analysis.blind.rates import mean

CLIP = 1e-4
TOGETHER = {"null": 0, "single": 1, "pair": 2, "outside": 0}
"""Number of known effects in a session of each kind."""


def stated(r: Record) -> float:
    """Probability that an answer gives to the ground truth of its session."""
    p: Mapping[str, float] = r["probability"]
    if r["kind"] == "null":
        return p.get("null", 0.0)
    if r["kind"] == "outside":
        return p.get("unknown", 0.0)
    listed = {frozenset(names): q for names, q in r["sets"] if names and "unknown" not in names}
    true = frozenset(r["effects"])
    if true in listed or not p:
        return listed.get(true, 0.0)
    marginals = {name: q for name, q in p.items() if name not in OTHERS}
    rest = 1.0 - p["null"] - p["unknown"] - sum(listed.values())
    others = 1.0 - sum(independent(names, marginals) for names in (frozenset[str](), *listed))
    return max(rest, 0.0) * independent(true, marginals) / others if others > 0 else 0.0


def independent(names: Iterable[str], marginals: Mapping[str, float]) -> float:
    """Probability of exactly these effects, if effects occur independently."""
    there = set(names)
    out = 1.0 if there <= set(marginals) else 0.0
    for name, p in marginals.items():
        out *= p if name in there else 1.0 - p
    return out


def base_rates(records: Sequence[Record]) -> list[float]:
    """Probability by base rates: the share of a kind, divided evenly among the sets of that kind.

    The shares are those of the scored sessions, which are not known to the answers: a demanding reference.
    """
    kinds = Counter(r["kind"] for r in records)
    said = chain.from_iterable((*r["probability"], *r["effects"]) for r in records)
    names = len(set(said) - set(OTHERS))
    return [kinds[r["kind"]] / len(records) / max(comb(names, TOGETHER[r["kind"]]), 1) for r in records]


def log_score(records: Sequence[Record]) -> dict[str, Any]:
    """Mean log score of all sessions and of each kind, nats, and that of the base rates."""
    answers = [log(max(stated(r), CLIP)) for r in records]
    base = [log(max(p, CLIP)) for p in base_rates(records)]

    def of(own: Sequence[int]) -> dict[str, Any]:
        a, b = mean(answers[k] for k in own), mean(base[k] for k in own)
        return {"count": len(own), "mean": a, "base": b}

    kinds = {kind: of([k for k, r in enumerate(records) if r["kind"] == kind]) for kind in TOGETHER}
    return of(range(len(records))) | {"clip": CLIP, "kinds": kinds}
