"""The contacts of a plan: `plan.csv`, and their numbers by purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.write import table_text
from bayescal.importing.mapping import CLEARANCE
from bayescal.planning.result import DISTANCES, GAP, REPEAT, VALIDATE, Plan


def payloads(session: Dataset) -> np.ndarray:
    """Payloads (N,), kg; 0 where the session states none."""
    m = session.measurements
    return np.zeros(len(m.ids)) if m.payload is None else m.payload


def purposes(plan: Plan) -> dict[str, int]:
    """Numbers of contacts by purpose."""
    return {p: plan.purpose.count(p) for p in (DISTANCES, GAP, REPEAT, VALIDATE)}


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
        u=None, stop=None, command=None, torque=None, time=None, temperature=None,
    )  # fmt: skip
    head, *lines = table_text(replace(plan.session, measurements=rows), name_tool=True).splitlines()
    cells = zip(lines, clearances(plan), strict=True)
    return "\n".join([f"{head},{CLEARANCE}", *(f"{line},{own}" for line, own in cells), ""])


def clearances(plan: Plan) -> list[str]:
    """Clearance of the motions of each row, mm, rounded down; empty where it is not known."""
    known = plan.clearance if len(plan.clearance) else np.full(len(plan.purpose), np.nan)
    return [f"{np.floor(1e4 * own) / 10:.1f}" if np.isfinite(own) else "" for own in known]
