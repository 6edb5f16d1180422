"""Commands of motions as a table: `t_s`, `motion`, `q1_deg` ..., one row a step; at rest between motions."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

Commands = tuple[str, np.ndarray, np.ndarray]
"""Name of a motion, times (N,), s, and readings (N, n), rad."""


def commands_text(motions: Iterable[Commands]) -> str:
    """The table of some motions."""
    lines: list[str] = []
    for name, time, q in motions:
        if not lines:
            lines.append(",".join(["t_s", "motion", *(f"q{j + 1}_deg" for j in range(q.shape[1]))]))
        rows = zip(time.tolist(), np.degrees(q).tolist(), strict=True)
        lines += [f"{t:.6g},{name}," + ",".join(f"{x:.5f}" for x in row) for t, row in rows]
    return "\n".join([*lines, ""])
