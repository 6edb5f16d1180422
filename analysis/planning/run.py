"""Plans beside random selections, and their expected uncertainty beside the errors of simulated sessions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from analysis.pages import published
from analysis.planning import page
from analysis.planning.session import CHOSEN, RANDOM, ground, measured
from analysis.records import arguments_of, completed
from bayescal.planning.result import Random, equals_random

RAW = "planning.json"
SIZES = ((40, 120), (100, 300), (200, 600))
"""Numbers of chosen contacts, and of random ones beside."""
SELECTIONS = ((CHOSEN, 80), (CHOSEN, 120), (CHOSEN, 200), (RANDOM, 300))
"""Selections that simulated sessions measure in turns."""
Record = dict[str, Any]


def compared(task: tuple[int, int, int]) -> Record:
    """Expected uncertainties of chosen and of more random contacts; a task: candidates and both numbers."""
    candidates, few, many = task
    on = ground(candidates)
    random, chosen = Random(on.pool), on.u(on.selection(CHOSEN, few))
    return {
        "count": few,
        "count_random": many,
        "u_um": [1e6 * u for u in chosen],
        "u_random_um": [1e6 * random.u(on.linear, goal, many) for goal in on.goals],
        "equals_random": [
            equals_random(on.linear, goal, u, random) for goal, u in zip(on.goals, chosen, strict=True)
        ],
    }


@cache
def _chosen(candidates: int, count: int) -> tuple[int, ...]:
    return tuple(int(k) for k in ground(candidates).selection(CHOSEN, count))


def simulated(task: tuple[int, str, int, int]) -> Record:
    """Expected and measured distance errors of a session; a task: candidates, selection, its size, seed."""
    candidates, how, count, seed = task
    on = ground(candidates)
    contacts = on.selection(RANDOM, count, seed) if how == RANDOM else np.array(_chosen(candidates, count))
    found = measured(on, contacts, seed)
    return {
        "selection": f"{count} {how}",
        "seed": seed,
        "u_um": [1e6 * u for u in on.u(contacts)],
        "measured_um": [1e6 * e for e in found],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study and write what it shows."""
    parser = arguments_of("planning", __doc__, "one seed, one study")
    parser.add_argument("--sessions", type=int, default=200, help="simulated sessions")
    parser.add_argument("--candidates", type=int, default=5000, help="possible contacts")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    given = parser.parse_args(arguments)
    raw = given.out / RAW
    sizes = {f"{n} {given.candidates} {few}": (given.candidates, few, n) for few, n in SIZES}
    plans = completed(raw, sizes, compared, 1, "selections")
    sessions = {}
    for k in range(given.sessions):
        how, count = SELECTIONS[k % len(SELECTIONS)]
        seed = 10_000 * given.seed + k
        sessions[f"{given.candidates} {how} {count} {seed}"] = (given.candidates, how, count, seed)
    records = completed(raw, sessions, simulated, given.workers, "sessions")
    published(page.tables(plans, records), given.page, (page.BEGIN, page.END))
