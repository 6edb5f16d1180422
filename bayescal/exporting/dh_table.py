"""The calibrated DH rows as a table (CSV), and with the full covariance of all values (JSON)."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rpy_of
from bayescal.exporting.robot import ROBOT_YAML, calibrated_robot, robot_items
from bayescal.exporting.written import Format, Options, Written
from bayescal.fitted.arm import FittedArm
from bayescal.storage.files import json_text

SCHEMA = "bayescal-dh/1"
COLUMNS = {
    "alpha": ("deg", 180.0 / np.pi),
    "a": ("mm", 1e3),
    "d": ("mm", 1e3),
    "offset": ("deg", 180.0 / np.pi),
    "beta": ("deg", 180.0 / np.pi),
}
"""Columns of the rows, with unit and factor from SI; beta is Hayati's angle of near-parallel axes."""
COMPLIANCE = ("urad_per_nm", 1e6)
STEP = 1e-3
"""Step of the numerical derivatives, in prior standard deviations of a parameter."""
ROUNDING = 1e-9
"""mm, deg and µrad/(N m)."""


def quantities(robot: Robot) -> Iterator[tuple[str, str, str, float]]:
    """All numbers of a robot: place (a joint or base), quantity, unit of files, value in that unit."""
    for key, value in zip(("x", "y", "z"), robot.base[:3, 3].tolist(), strict=True):
        yield "base", key, "mm", 1e3 * value
    for key, value in zip(("roll", "pitch", "yaw"), rpy_of(robot.base[:3, :3]).tolist(), strict=True):
        yield "base", key, "deg", float(np.degrees(value))
    for k, joint in enumerate(robot.joint_names):
        for key, (unit, factor) in COLUMNS.items():
            yield joint, key, unit, factor * float(getattr(robot, key)[k])
        yield joint, "scale", "1", float(robot.link_from_reading[k, k])
        yield joint, "compliance", *_compliance(robot, k)


def _compliance(robot: Robot, k: int) -> tuple[str, float]:
    unit, factor = COMPLIANCE
    return unit, 0.0 if robot.compliance is None else factor * float(robot.compliance[k])


def _values(robot: Robot) -> np.ndarray:
    return np.array([value for *_, value in quantities(robot)])


def spread(arm: FittedArm, state: int) -> np.ndarray:
    """Covariance of all `quantities` of the calibrated robot, in their units."""

    def of(values: np.ndarray) -> np.ndarray:
        return _values(calibrated_robot(arm.model, values, state=state))

    slopes = []
    for k, sd in enumerate(arm.model.sd):
        step = np.zeros(len(arm.values))
        step[k] = STEP * sd
        slopes.append((of(arm.values + step) - of(arm.values - step)) / (2.0 * step[k]))
    by = np.array(slopes).reshape(len(arm.values), -1)
    # a slope that displaces by less than `ROUNDING` for a prior standard deviation is rounding
    by[np.abs(by * arm.model.sd[:, None]) < ROUNDING] = 0.0
    return by.T @ arm.covariance @ by


def _write(arm: FittedArm, options: Options) -> Written:
    robot = calibrated_robot(arm.model, arm.values, state=options.state)
    covariance = spread(arm, options.state)
    every = list(quantities(robot))
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    return Written(
        _csv(robot, {(place, key): own for (place, key, *_), own in zip(every, u, strict=True)}),
        robot_items(arm),
        beside={".json": json_text(_record(arm, robot, every, u, covariance))},
        notes=["the JSON file beside it has the base, the coupling of the readings and the full covariance"],
    )


def _csv(robot: Robot, u: dict[tuple[str, str], float]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    units = {key: unit for key, (unit, _) in COLUMNS.items()}
    units |= {"compliance": COMPLIANCE[0]} if robot.compliance is not None else {}
    heads = [head for key, unit in units.items() for head in (f"{key}_{unit}", f"u_{key}_{unit}")]
    writer.writerow(["joint", "convention", *heads])
    values = {(place, key): value for place, key, _, value in quantities(robot)}
    for joint in robot.joint_names:
        cells = [repr(x) for key in units for x in (values[joint, key], u[joint, key])]
        writer.writerow([joint, robot.convention, *cells])
    return out.getvalue()


def _record(
    arm: FittedArm, robot: Robot, every: list[tuple[str, str, str, float]], u: list[float],
    covariance: np.ndarray,
) -> dict[str, Any]:  # fmt: skip
    return {
        "schema": SCHEMA,
        "robot": arm.dataset.robot.name,
        "convention": robot.convention,
        "link_from_reading": robot.link_from_reading.tolist(),
        "flange_in_last_row": robot.flange.tolist(),
        "values": [
            {"place": place, "quantity": key, "unit": unit, "value": value, "u": own}
            for (place, key, unit, value), own in zip(every, u, strict=True)
        ],
        "covariance": covariance.tolist(),
    }


DH_CSV = Format(
    "dh-csv",
    ".csv",
    "DH rows with u as CSV, and with the full covariance as JSON",
    _write,
    ROBOT_YAML.holds,
    "a DH table has constant geometry, scales of readings and compliances of joints",
)
"""The calibrated table for any other program."""
