"""A plan in sentences, for the terminal and for the page: cost, benefit, limits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.planning.levers import NO_LEVER
from bayescal.planning.result import BOTH, DISTANCES, GAP, Confusable, Plan
from bayescal.reporting.plan.contacts import count, payloads
from bayescal.reporting.plan.sheets import COVERAGE, PURPOSES, dropped, gain, over, strength
from bayescal.reporting.shared.text import um2

AIMS = {DISTANCES: "for distances", GAP: "for the gap", BOTH: "for distances and the gap"}
IF_RIGHT = "assuming the model is correct"
FURTHER = 20
"""Further contacts of `Plan.next_u`."""


def title(plan: Plan) -> str:
    """Contacts, purpose and model in a line."""
    aim = AIMS.get(plan.aim, plan.aim)
    return f"plan of {count(plan)} contacts {aim}; model: {', '.join(plan.effects) or 'nominal'}"


def headline(plan: Plan) -> Iterator[str]:
    """The expected U of the first goal, and the random contacts that give the same."""
    for e in plan.expected[:1]:
        yield f"Expected U = {um2(COVERAGE * e.u)} µm (k = 2) of {e.count} {over(e)}, {IF_RIGHT}"
        if np.isfinite(plan.equals_random):
            yield f"Equivalent to about {two_digits(plan.equals_random)} random contacts"
        else:
            yield "No number of the candidates, chosen at random, gives the same"


def further(plan: Plan) -> str:
    """What further contacts would gain, or ""."""
    if not plan.expected or not np.isfinite(plan.next_u):
        return ""
    now = plan.expected[0].u
    less = 100 * (1 - plan.next_u / now) if now > 0 else 0.0
    return f"{FURTHER} further contacts: U = {um2(COVERAGE * plan.next_u)} µm ({less:.1f} % less)"


def contacts(plan: Plan) -> str:
    """Contacts by purpose, and changes of the payload."""
    parts = [f"{n} {text}" for p, text in PURPOSES.items() if (n := plan.purpose.count(p))]
    changes = int(np.count_nonzero(np.diff(payloads(plan.session))))
    loads = f"; the payload changes {times(changes)}" if changes else ""
    return f"{', '.join(parts)}{loads}"


def travel(plan: Plan) -> str:
    """Time of the motions and the order of probing."""
    known = plan.clearance[np.isfinite(plan.clearance)]
    clear = f"; clearance {1e3 * known.min():.1f} mm or more" if len(known) else ""
    stops = sum(bool(text) for text in plan.changes[1:])
    stopped = f"; the arm waits {times(stops)} for a change" if stops else ""
    return f"{duration(plan.travel)} of motion between contacts{clear}{stopped}; order: {plan.order}"


def candidates(plan: Plan) -> str:
    """Candidates, and why other contacts were none."""
    reasons = "; ".join(f"{n} {why}" for why, n in dropped(plan) if n)
    every = f"{len(plan.pool.candidates)} candidates"
    return f"{every}; dropped: {reasons}" if reasons else every


def detectability(plan: Plan) -> str:
    """Detectable amplitudes beside those of a random selection in a sentence, or ""."""
    ratio = gain(plan)
    if not np.isfinite(ratio):
        return ""
    return f"amplitudes are {ratio:.2f} of those of a random selection (geometric mean over effects)"


def not_separated(plan: Plan) -> tuple[str, ...]:
    """Pairs of effects that the plan does not separate, each with what would."""
    return tuple(
        f"{pair(c)} (detectability {strength(c.after)}); "
        + (
            f"{NO_LEVER} separates them"
            if c.intervention == NO_LEVER
            else f"would be separated by {c.intervention}"
        )
        for c in plan.confusable
        if c.intervention
    )


def separated(plan: Plan) -> str:
    """How many pairs of confusable effects the plan separates, or ""."""
    if not plan.confusable:
        return ""
    done = sum(not c.intervention for c in plan.confusable)
    return f"{done} of {len(plan.confusable)} pairs of confusable effects"


def pair(c: Confusable) -> str:
    """The names of a pair."""
    return " from ".join(c.pair)


def duration(seconds: float) -> str:
    """A time in s, min or h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def two_digits(number: float) -> str:
    """A number of contacts with two significant digits."""
    return f"{float(f'{number:.2g}'):.0f}"


def times(number: int) -> str:
    """``once``, ``twice``, ``7 times``."""
    return {1: "once", 2: "twice"}.get(number, f"{number} times")
