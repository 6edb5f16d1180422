"""`plan.json`: a plan as numbers, by the output contract; units are in the keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayescal.planning.result import Confusable, Detectable, ExpectedDistances, Plan
from bayescal.reporting.plan.contacts import count, payloads, purposes
from bayescal.reporting.shared.origin import origin
from bayescal.reporting.shared.plain import plain
from bayescal.reporting.shared.text import MM, UM, amplitude

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
    headline = plan.expected[0] if plan.expected else None
    volume = setup.volume
    record = {
        **origin(SCHEMA, setup.dataset, plan.seed, LIBRARIES),
        "for": plan.aim,
        "model": plan.effects,
        "order": plan.order,
        "contacts": count(plan),
        "rows": len(m.ids),
        "purposes": purposes(plan),
        "targets": {names[k]: int(n) for k, n in zip(used, touched, strict=True)},
        "payloads": [{"payload_kg": x, "contacts": int(n)} for x, n in zip(mass, loaded, strict=True)],
        "purpose": dict(zip(m.ids, plan.purpose, strict=True)),
        "clearance_mm": dict(zip(m.ids, (MM * plan.clearance).tolist(), strict=False)),
        "smallest_clearance_mm": MM * setup.clearance,
        "changes": {name: text for name, text in zip(m.ids, plan.changes, strict=False) if text},
        "by_hand": {name: text for name, text in zip(m.ids, plan.by_hand, strict=False) if text},
        "candidates": len(plan.pool.candidates),
        "dropped": dict(plan.pool.dropped),
        "measured": plan.pool.measured,
        "volume": None if volume is None else {"centre_mm": MM * volume.centre, "size_mm": MM * volume.size},
        "expected": {
            "over": headline.over if headline else None,
            "distance_sd_um": UM * headline.u if headline else None,
            "distance_sd_um_random": UM * headline.u_random if headline else None,
            "equals_random_contacts": plan.equals_random,
            "next_distance_sd_um": UM * plan.next_u,
            "distances": [_distances(e) for e in plan.expected],
            "parameters": [
                {"name": p.name, "unit": p.unit, "u": p.u, "prior_u": p.prior} for p in plan.parameters
            ],
        },
        "observability": dict(plan.observability),
        "observability_random": dict(plan.observability_random),
        "curve": _curve(plan.curve),
        "curve_random": _curve(plan.curve_random),
        "detectable": [_detectable(d) for d in plan.detectable],
        "confusable": [_confusable(c) for c in plan.confusable],
        "travel_s": plan.travel,
        "seconds": plan.seconds,
        "warnings": plan.warnings,
        "commands": dict(commands or {}),
    }
    return {key: plain(value) for key, value in record.items()}


def _distances(e: ExpectedDistances) -> dict[str, Any]:
    return {
        "over": e.over,
        "count": e.count,
        "distance_sd_um": UM * e.u,
        "distance_sd_um_random": UM * e.u_random,
        "shares": dict(e.shares),
    }


def _curve(points: Sequence[tuple[int, float]]) -> list[dict[str, Any]]:
    return [{"contacts": n, "distance_sd_um": UM * u} for n, u in points]


def _detectable(d: Detectable) -> dict[str, Any]:
    smallest, unit = amplitude(d.smallest, d.unit)
    return {
        "effect": d.effect,
        "site": str(d.site),
        "smallest": smallest,
        "smallest_random": amplitude(d.smallest_random, d.unit)[0],
        "plausible": amplitude(d.plausible, d.unit)[0],
        "unit": unit,
    }


def _confusable(c: Confusable) -> dict[str, Any]:
    return {
        "pair": c.pair,
        "lambda_before": c.before,
        "lambda_after": c.after,
        "intervention": c.intervention or None,
    }
