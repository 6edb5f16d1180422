"""Rows of a session with their residuals: what pages and figures draw from a record."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayescal.estimate import Estimate
from bayescal.reporting.shared.plain import plain
from bayescal.reporting.shared.text import MM, UM

ROLES = ("calibrate", "validate")
DIGITS = 4
"""Decimals of residuals (µm), angles (deg) and times (s)."""
STANDSTILL = np.radians(0.03)
"""Joint speed, rad/s, below which a joint has no direction of motion; as for `backlash`."""


def rows_record(found: Estimate) -> dict[str, Any]:
    """``rows`` of fit.json and gap.json: one list for each quantity, in the order of the session.

    `residual_um` is the distance of a contact from its surface (signed), of a point the length of its error
    vector, under the model of the estimate; null where the target is not part of the model. `point_mm` is
    the stylus tip (or reflector) in F0 by the nominal arm, `angle_deg` are link angles, and `direction` has
    a sign for each joint.
    """
    scene = found.model.scene
    m, targets = scene.dataset.measurements, scene.dataset.targets
    count = len(m.ids)
    residual = np.full(count, np.nan)
    roles = np.full(count, "", dtype=object)
    for role in ROLES:
        rows = scene.rows(role)
        roles[rows] = role
        for k, target in enumerate(targets):
            own = scene.rows_of(k, rows)
            if len(own) and target.name in found.model.block_of:
                r = found.residuals(found.model.block(k, own))
                residual[own] = r[0] if len(r) == 1 else np.linalg.norm(r[:3], axis=0)
    rejected = np.zeros(count, bool)
    rejected[found.rejected] = True
    record = {
        "id": list(m.ids),
        "target": [targets[t].name for t in m.target],
        "role": roles.tolist(),
        "time_s": None if m.time is None else np.round(m.time, DIGITS),
        "point_mm": np.round(MM * scene.points, 3),
        "angle_deg": np.round(np.degrees(scene.q), DIGITS),
        "direction": None if m.velocity is None else _signs(m.velocity),
        "residual_um": np.round(UM * residual, DIGITS),
        "rejected": rejected,
    }
    return {key: plain(value) for key, value in record.items()}


def _signs(velocity: np.ndarray) -> list[str]:
    """Directions of motion at joint velocities (N, n), a sign for each joint: ``+-0++-``."""
    moving = np.where(velocity > 0, "+", "-")
    return ["".join(row) for row in np.where(np.abs(velocity) < STANDSTILL, "0", moving).tolist()]
