"""A session's second round, on a worker: the diagnosis plans it, the simulator probes it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from analysis.blind.folder import DATASET, write
from analysis.blind.make import NO_PINOCCHIO
from bayescal.errors import BayescalError

COUNT = 60
"""Further contacts of a session."""
POOL = 1500
"""Candidate contacts from which they are chosen."""
PAYLOAD = 2.0
"""Mass, kg, that may be attached for them."""
ERROR = "error"
"""Key of the reason why there is no plan, or no further contact."""

Rows = list[dict[str, Any]]
"""Contacts in the units of a file: target, j_deg, j_degps or None, payload_kg."""


@dataclass(frozen=True)
class Open:
    """A session whose answer leaves something open, as a worker receives it."""

    name: str
    texts: dict[str, str]
    gap: dict[str, Any]


@dataclass(frozen=True)
class Continued:
    """A session with its further contacts, as the simulator receives it; the seed is part of the truth."""

    name: str
    options: dict[str, Any]
    rows: dict[str, Rows]
    text: str  # measurements.csv


def planned(task: Open) -> dict[str, Any]:
    """Plan one session's further contacts from its own files and its answer, on a worker."""
    # imported here: the process that distributes the work does not need it
    from dataclasses import replace

    from bayescal.dataset import read_dataset
    from bayescal.model.options import parts_of
    from bayescal.planning import plan, setup
    from bayescal.planning.candidates import candidates
    from bayescal.planning.contrasts import contrasts
    from bayescal.planning.projection import nominal
    from bayescal.planning.separate import choose

    with TemporaryDirectory(prefix="bayescal-blind-") as name:
        folder = Path(name)
        for file in DATASET:
            write(folder / file, task.texts[file])
        dataset = read_dataset(folder)
    asked = plan.continued(task.gap, f"world {task.name}")
    try:
        pool = candidates(replace(setup.continued(dataset), payloads=(PAYLOAD,)), POOL)
        parts = parts_of(asked.without, asked.effects)
        c = contrasts(
            pool, nominal(pool.session, asked.effects, parts), asked.pairs, parts, asked.probability
        )
    except BayescalError as error:
        return {ERROR: str(error)}
    rng = np.random.default_rng(int(task.name))
    m = pool.session.measurements
    load = np.zeros(len(m.ids)) if m.payload is None else m.payload
    bare = np.flatnonzero(load[pool.candidates] == 0)
    chosen = {"chosen": choose(c, COUNT, rng), "random": rng.choice(bare, COUNT, replace=False)}
    rows = {arm: pool.candidates[own] for arm, own in chosen.items()}

    def row(k: int) -> dict[str, Any]:
        moving = None if m.velocity is None else np.degrees(m.velocity[k]).tolist()
        place = {"target": dataset.targets[m.target[k]].name, "j_deg": np.degrees(m.readings[k]).tolist()}
        return place | {"j_degps": moving, "payload_kg": float(load[k])}

    return {arm: [row(int(k)) for k in rng.permutation(own)] for arm, own in rows.items()}


def probed(task: Continued) -> dict[str, str]:
    """measurements.csv of each arm, from the simulator, on a worker; 'error' where it cannot be continued."""
    try:
        from analysis.world.build import make
        from analysis.world.further import Wanted, further
    except ImportError:
        raise NO_PINOCCHIO from None
    made = make(number=int(task.name), **{"generator": 1} | task.options)
    if made.texts["measurements.csv"] != task.text:
        raise BayescalError("the simulator makes another session now", f"world {task.name}")
    out = {}
    for k, (arm, rows) in enumerate(task.rows.items()):
        wanted = [
            Wanted(
                r["target"],
                np.radians(r["j_deg"]),
                None if r["j_degps"] is None else np.radians(r["j_degps"]),
                r["payload_kg"],
            )
            for r in rows
        ]
        try:
            rng = np.random.default_rng([made.truth["seed"], 7, int(task.name), k])
            out[arm] = further(made, wanted, rng)
        except RuntimeError as error:
            return {ERROR: str(error)}
    return out
