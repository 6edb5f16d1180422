"""Screening of wide scans: only the settings that explain most become candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.effects import EFFECTS, Circumstances
from bayescal.effects.selection import plain
from bayescal.gap.linear.evidence import Bank, weigh_sets
from bayescal.gap.linear.slopes import Slopes
from bayescal.gap.linear.state import State
from bayescal.gap.search.alias import unaliased
from bayescal.gap.search.candidates import Candidates, extended, wide
from bayescal.gap.settings import SEARCH


def screened(
    known: Candidates, slopes: Slopes, states: Sequence[State], c: Circumstances, baseline: tuple[str, ...]
) -> Candidates:
    """Candidates with the leading settings of every wide scan, by site, from gains over several states."""
    modelled = {plain(name) for name in baseline}
    for effect in EFFECTS.values():
        if effect.name in modelled or not wide(effect, c) or effect.scan is None:
            continue
        values = effect.scan.values(c)
        best = np.full(len(values), -np.inf)
        for first in range(0, len(values), SEARCH.chunk):
            chunk = values[first : first + SEARCH.chunk]
            tables = [effect.at(c, float(v)) for v in chunk]
            every = [p for table in tables for p in table]
            columns, seen = slopes.columns(every), np.array(unaliased(every, c))
            sets, owner, at = [], [], 0
            for k, table in enumerate(tables):
                for site in dict.fromkeys(p.site for p in table):
                    own = at + np.flatnonzero([p.site == site for p in table])
                    if np.any(seen[own]):
                        sets.append(own[seen[own]])
                        owner.append(first + k)
                at += len(table)
            bank = Bank(columns, tuple(sets), len(slopes.contact), slopes.worth)
            for state in states:
                np.maximum.at(best, owner, weigh_sets(state, bank).max(axis=1))
        leading = np.sort(values[np.argsort(-best)[: SEARCH.screened]])
        known = extended(known, effect, [float(v) for v in leading], c)
    return known
