"""The run folder of a plan: `plan.json`, by the output contract, and `plan.csv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.table import CLEARANCE
from bayescal.dataset.write import table_text
from bayescal.planning.result import DISTANCES, GAP, REPEAT, VALIDATE, Plan
from bayescal.reporting.shared.origin import entry, origin, plain, sized
from bayescal.reporting.shared.text import MM, UM


def payloads(session: Dataset) -> np.ndarray:
    """Payloads (N,), kg; 0 where the session states none."""
    m = session.measurements
    return np.zeros(len(m.ids)) if m.payload is None else m.payload


def count(plan: Plan) -> int:
    """Number of contacts that calibrate: all but those of validation."""
    return sum(p != VALIDATE for p in plan.purpose)


def table_of_plan(plan: Plan) -> str:
    """The content of plan.csv: measurements.csv in the order of probing, cells of results empty.

    Columns of what an instrument reads are there for sessions that have instruments. The last column is the
    smallest clearance of the motions of a row.
    """
    m = plan.session.measurements

    def empty(column: np.ndarray | None) -> np.ndarray | None:
        return None if column is None else np.full_like(column, np.nan)

    rows = replace(
        m, payload=payloads(plan.session), xyz=empty(m.xyz), rpy=empty(m.rpy), length=empty(m.length),
        pixel=None, u=None, stop=None, command=None, torque=None, time=None, temperature=None,
    )  # fmt: skip
    head, *lines = table_text(replace(plan.session, measurements=rows), name_tool=True).splitlines()
    cells = zip(lines, clearances(plan), strict=True)
    return "\n".join([f"{head},{CLEARANCE}", *(f"{line},{clearance}" for line, clearance in cells), ""])


def clearances(plan: Plan) -> list[str]:
    """Clearance of the motions of each row, mm, rounded down; empty where it is not known."""
    clearance = plan.clearance if len(plan.clearance) else np.full(len(plan.purpose), np.nan)
    return [f"{np.floor(1e4 * value) / 10:.1f}" if np.isfinite(value) else "" for value in clearance]


SCHEMA = "bayescal-plan/1"
LIBRARIES = ("numpy", "scipy", "numba")


def plan_record(plan: Plan, commands: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The contents of plan.json; a value that is not finite is null.

    Parameters
    ----------
    plan : Plan
    commands : mapping of str to str, optional
        What to run next, by its purpose.
    """
    setup, session = plan.pool.setup, plan.session
    m = session.measurements
    names = [t.name for t in session.targets]
    mass, loaded = np.unique(payloads(session), return_counts=True)
    used, touched = np.unique(m.target, return_counts=True)
    distances = [
        entry(e, "over", "count", "distance_sd_um=u")
        | {"distance_sd_um_random": UM * e.u_random}
        | entry(e, "shares")
        for e in plan.expected
    ]
    first = distances[0] if distances else {}
    volume = setup.volume
    record = {
        **origin(SCHEMA, setup.dataset, plan.seed, LIBRARIES),
        **entry(plan, "for=aim", "model=effects", "order"),
        "contacts": count(plan),
        "rows": len(m.ids),
        "purposes": {p: plan.purpose.count(p) for p in (DISTANCES, GAP, REPEAT, VALIDATE)},
        "targets": {names[k]: int(n) for k, n in zip(used, touched, strict=True)},
        "payloads": [{"payload_kg": x, "contacts": int(n)} for x, n in zip(mass, loaded, strict=True)],
        "purpose": dict(zip(m.ids, plan.purpose, strict=True)),
        "clearance_mm": dict(zip(m.ids, (MM * plan.clearance).tolist(), strict=False)),
        "smallest_clearance_mm": MM * setup.clearance,
        "changes": {name: text for name, text in zip(m.ids, plan.changes, strict=False) if text},
        "by_hand": {name: text for name, text in zip(m.ids, plan.by_hand, strict=False) if text},
        "candidates": len(plan.pool.candidates),
        **entry(plan.pool, "dropped", "measured"),
        "volume": volume and entry(volume, "centre_mm", "size_mm"),
        "expected": {
            **{key: first.get(key) for key in ("over", "distance_sd_um", "distance_sd_um_random")},
            "equals_random_contacts": plan.equals_random,
            "next_distance_sd_um": UM * plan.next_u,
            "distances": distances,
            "parameters": [entry(p, "name", "unit", "u", "prior_u=prior") for p in plan.parameters],
        },
        **entry(plan, "observability", "observability_random"),
        "curve": _curve(plan.curve),
        "curve_random": _curve(plan.curve_random),
        "detectable": [
            entry(d, "effect", "site") | sized(d, "smallest", "smallest_random", "plausible")
            for d in plan.detectable
        ],
        "confusable": [
            entry(c, "pair", "lambda_before=before", "lambda_after=after")
            | {"intervention": c.intervention or None}
            for c in plan.confusable
        ],
        **entry(plan, "travel_s=travel", "seconds", "warnings"),
        "commands": dict(commands or {}),
    }
    return {key: plain(value) for key, value in record.items()}


def _curve(points: Sequence[tuple[int, float]]) -> list[dict[str, Any]]:
    return [{"contacts": n, "distance_sd_um": UM * u} for n, u in points]
