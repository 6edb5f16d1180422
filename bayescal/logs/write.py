"""A mechanism as the `robot` of dataset.yaml, as `bayescal.logs.schema.Arm` reads it."""

from __future__ import annotations

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
