"""A mechanism as the `robot` of dataset.yaml, as `bayescal.logs.schema.Arm` reads it; commands as a table."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayescal.arm.transforms import rpy_of
from bayescal.logs.mechanism import PAIRS, Mechanism
from bayescal.logs.schema import OF_JOINTS
from bayescal.storage.writing import Block, block_lines, flow, in_file, row_keys, scalar

DIGITS = 9
"""Significant digits of a value."""


def arm_text(m: Mechanism) -> str:
    """YAML of an arm: mm, deg, kg, kg m2, N m.

    Raises
    ------
    ValueError
        If its joints are coupled, which the format cannot hold.
    """
    if m.coupled:
        raise ValueError("coupled joints")
    columns = {
        "origin_mm": m.place[:, :3, 3],
        "rpy_deg": np.array([rpy_of(place[:3, :3]) for place in m.place]),
        "axis": m.axis,
        **{key: getattr(m, field) for key, field in OF_JOINTS.items()},
        "inertia_kgm2": m.inertia[:, *np.transpose(PAIRS)],
    }
    load: dict[str, np.ndarray | float] = {
        "centre_of_mass_mm": m.payload_centre,
        "radius_of_gyration_mm": m.payload_gyration,
    }
    block: Block = {
        "joints": [
            flow([("name", scalar(name)), *row_keys(columns, k, DIGITS)])
            for k, name in enumerate(m.joint_names)
        ],
        "friction_transition_degps": in_file("friction_transition_degps", m.transition, DIGITS),
        "payload": flow((key, in_file(key, value, DIGITS)) for key, value in load.items()),
    }
    return "\n".join(block_lines(block)) + "\n"


Commands = tuple[str, np.ndarray, np.ndarray]
"""Name of a motion, times (N,), s, and readings (N, n), rad."""


def commands_text(motions: Iterable[Commands]) -> str:
    """Commands as a table: `t_s`, `motion`, `q1_deg` ..., one row a step; at rest between motions."""
    lines: list[str] = []
    for name, time, q in motions:
        if not lines:
            lines.append(",".join(["t_s", "motion", *(f"q{j + 1}_deg" for j in range(q.shape[1]))]))
        rows = zip(time.tolist(), np.degrees(q).tolist(), strict=True)
        lines += [f"{t:.6g},{name}," + ",".join(f"{x:.5f}" for x in row) for t, row in rows]
    return "\n".join([*lines, ""])
