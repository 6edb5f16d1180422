"""Interventions that would separate what the candidates of a pool cannot.

The planned contacts are repeated under other conditions (`gap.design.interventions`), and the best of them
are chosen for the pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.dataset.append import taken
from bayescal.estimate import Estimate
from bayescal.gap.design.interventions import widened
from bayescal.gap.result import Pair
from bayescal.gap.settings import DESIGN
from bayescal.model import Scene
from bayescal.model.parts import Part
from bayescal.planning.contrasts import contrasts
from bayescal.planning.detectable import SEPARATED
from bayescal.planning.pool import Pool
from bayescal.planning.projection import Projection
from bayescal.planning.result import Confusable
from bayescal.planning.separate import choose
from bayescal.planning.vocabulary import nominal

NO_LEVER = "no known measurement"


def with_levers(
    pool: Pool,
    effects: tuple[str, ...],
    chosen: np.ndarray,
    found: Sequence[tuple[Pair, Confusable]],
    rng: np.random.Generator,
    without: Sequence[Part] = (),
) -> tuple[Confusable, ...]:
    """Pairs of effects, each that the plan cannot separate with the intervention that would.

    Parameters
    ----------
    pool : Pool
    effects : tuple of str
        The model.
    chosen : np.ndarray of int
        Candidates of the plan.
    found : sequence of (Pair, Confusable)
        Of `detectable.confusable`.
    rng : np.random.Generator
    without : sequence of Part
        Parts that the model lacks.

    Notes
    -----
    `DESIGN.contacts` further contacts are chosen of each intervention. The first that reaches `SEPARATED` is
    stated, more contacts at the same poses before all others.
    """
    if all(c.after >= SEPARATED for _, c in found):
        return tuple(c for _, c in found)
    again, names, which = _repeated(pool, chosen)
    fitted = nominal(again.session, effects, without)
    out = []
    for pair, c in found:
        words = "" if c.after >= SEPARATED else _lever(again, fitted, pair, names, which, rng, without)
        out.append(replace(c, intervention=words))
    return tuple(out)


def _repeated(pool: Pool, chosen: np.ndarray) -> tuple[Pool, list[str], np.ndarray]:
    """The planned session as measured, its contacts under other conditions as candidates; which are whose."""
    rows = np.sort(np.concatenate([np.arange(pool.measured), pool.candidates[chosen]]))
    planned = replace(pool.session, measurements=taken(pool.session.measurements, rows))
    at = np.arange(pool.measured, len(rows))
    wide, interventions = widened(Scene(planned), at)
    role = wide.measurements.role.copy()
    role[len(rows) :] = "calibrate"
    session = replace(wide, measurements=replace(wide.measurements, role=role))
    which = np.repeat(np.arange(len(interventions)), [len(i.rows) for i in interventions])
    again = replace(pool, session=session, measured=len(rows), approach=session.measurements.readings)
    return again, [i.what for i in interventions], which


def _lever(
    again: Pool,
    fitted: Estimate,
    pair: Pair,
    names: Sequence[str],
    which: np.ndarray,
    rng: np.random.Generator,
    without: Sequence[Part],
) -> str:
    """The first intervention that separates a pair, as text."""
    c = contrasts(again, fitted, [pair], without)
    for k, name in enumerate(names):
        best = choose(c, DESIGN.contacts, rng, allowed=which == k, exchanges=0)
        if c.strengths(Projection(c.columns, best))[0] >= SEPARATED:
            return f"{len(best)} contacts: {name}"
    return NO_LEVER
