"""A calibrated robot as DH rows, exactly the displaced chain, joint for joint: robot.yaml, and a table."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from bayescal.arm.chain import Robot, chain_of
from bayescal.arm.transforms import rpy_of, split
from bayescal.dataset.table import csv_text
from bayescal.effects import Parameter
from bayescal.effects.common import READING, SIDES, side_of
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.geometry import JOINT, PARALLEL
from bayescal.effects.readings import ENCODER_SCALE
from bayescal.effects.selection import Selection
from bayescal.exporting.geometry import constant, constant_displacements, items, transform_of
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.fitted.arm import FittedArm
from bayescal.model import Model
from bayescal.robots import robot_to_yaml
from bayescal.storage.files import json_text


def calibrated_robot(model: Model, values: np.ndarray, state: int | None = None) -> Robot:
    """The robot of a fitted arm: DH rows, Hayati's beta, scales and compliances; the tool is no part of it.

    Between two joints' Rz Tz stands a constant transform, displaced by the fit. It is split anew into Rx Tx
    (Ry) and what belongs to the joints before and behind: the flange moves exactly as in the model, whatever
    components the displacement had.

    Parameters
    ----------
    model : Model
    values : np.ndarray, shape (P,)
        Deviations of its parameters from nominal, SI.
    state : int, optional
        Row of the session whose state (time, temperature, events) holds; without it, what changes during the
        session is left out.
    """
    robot = model.scene.dataset.robot
    coupling = robot.link_from_reading.copy()
    side = side_in(model, ENCODER_SCALE.name)
    for value, p in zip(values, model.parameters, strict=True):
        if is_scale(p):
            joint = p.site.number - 1
            if side == READING:  # every link that the reading moves turns so
                coupling[:, joint] *= 1.0 + value
            else:
                coupling[joint] *= 1.0 + value
    compliance = _compliance(model, values)
    out = _displaced_rows(robot, constant_displacements(model, values, state))
    return replace(
        out,
        name=f"{robot.name}-calibrated",
        link_from_reading=coupling,
        # a negative estimate is not physical: such a joint is rigid
        compliance=np.maximum(compliance, 0.0) if np.any(compliance > 0) else None,
        priors=(),  # of deviations from the nominal robot
    )


def robot_text(arm: FittedArm, tool_in: str, state: int | None = None) -> str:
    """The text of a robot.yaml of a fitted arm: what it is, and the reasons not to use it, first.

    `tool_in` is the file that has the tool; `state` as of `calibrated_robot`.
    """
    model, values = arm.model, arm.values
    robot, dataset = calibrated_robot(model, values, state=state), model.scene.dataset
    comment = "".join(f"NOT TO BE USED: {reason}.\n" for reason in arm.use.against)
    comment += f"{dataset.robot.name} calibrated on {dataset.name}: {', '.join(model.effects)}.\n"
    comment += f"The tool is not part of it: see {tool_in}."
    rigid = [n for n, c in zip(robot.joint_names, _compliance(model, values), strict=True) if c < 0.0]
    if rigid:
        comment += f"\nRigid here, because the estimated compliance is negative: {', '.join(rigid)}."
    return robot_to_yaml(robot, comment)


def _compliance(model: Model, values: np.ndarray) -> np.ndarray:
    """Compliances (n,), rad/(N m) or m/N, as estimated: also negative ones."""
    robot = model.scene.dataset.robot
    out = np.zeros(robot.n) if robot.compliance is None else robot.compliance.copy()
    for value, p in zip(values, model.parameters, strict=True):
        if p.effect == COMPLIANCE.name:
            for part in p.stands_for or (p,):
                out[part.site.number - 1] += value * (part.centre if p.stands_for else 1.0)
    return out


def is_scale(p: Parameter) -> bool:
    """Whether a parameter is a scale of a joint's readings, and not its zero."""
    return p.effect in (ENCODER_SCALE.name, JOINT.name) and p.unit == "1"


def side_in(model: Model, effect: str) -> str:
    """The side of coupled axes on which the model has an effect of the gears."""
    asked = next((s.setting for s in map(Selection.read, model.effects) if s.effect == effect), None)
    return asked if asked in SIDES else side_of(model.scene.dataset.robot)


def _displaced_rows(robot: Robot, delta: np.ndarray) -> Robot:
    n, chain, modified = robot.n, chain_of(robot), robot.convention == "mdh"
    alpha, a, beta = robot.alpha.copy(), robot.a.copy(), robot.beta.copy()
    along = np.array([robot.offset, robot.d])  # of Rz and Tz
    between = np.array([transform_of(delta[k]) @ chain.link[k] for k in range(n + 1)])
    # of modified DH row 1 stays; the base takes its displacement
    base = chain.base @ (transform_of(delta[0]) if modified else between[0])
    for k in range(1, n if modified else n + 1):
        row = k if modified else k - 1
        (alpha[row], a[row], beta[row]), before, behind = split(between[k], PARALLEL)
        along[:, k - 1] += before
        if k < n:
            along[:, k] += behind
    if modified:  # behind the last joint only Rz and Tz have a place
        along[:, n - 1] += delta[n, :2]
    return replace(robot, alpha=alpha, a=a, beta=beta, offset=along[0], d=along[1], base=base)


def _write(arm: FittedArm, options: Options) -> Written:
    return Written(robot_text(arm, "the sidecar", options.state), robot_items(arm))


def robot_items(arm: FittedArm) -> list[Item]:
    """The parameters that a robot of DH rows holds, and where."""
    names = arm.dataset.robot.joint_names
    out = items(arm, [("base" if k == 0 else f"joints[{name}]", "DH row") for k, name in enumerate(names)])
    for k, p in enumerate(arm.model.parameters):
        if is_scale(p):
            out.append(item(arm, k, "link_from_reading", p.site.text))
        elif p.effect == COMPLIANCE.name and _holds(arm, k):
            key = "compliance_um_per_n" if p.unit == "m/N" else "joint_compliance_rad_per_nm"
            out.append(item(arm, k, key, p.site.text))
    return out


def _holds(arm: FittedArm, k: int) -> bool:
    p = arm.model.parameters[k]
    if p.effect == COMPLIANCE.name:
        return bool(p.nominal + arm.values[k] >= 0.0)
    return constant(p) or is_scale(p)


HELD = "constant geometry, scales of readings and compliances of joints"
ROBOT_YAML = Format(".yaml", _write, _holds, f"robot.yaml has {HELD}", prismatic=True, two_arms=("plain",))
"""The arm as the `robot:` of a further session."""


SCHEMA = "bayescal-dh/1"
DEG, MM = ("deg", 180.0 / np.pi), ("mm", 1e3)
ROWS = {"alpha": DEG, "a": MM, "d": MM, "offset": DEG, "beta": DEG}
"""Columns of the rows, with unit and factor from SI; beta is Hayati's angle of near-parallel axes."""
ELASTIC_ROWS = {**ROWS, "compliance": ("urad_per_nm", 1e6)}
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
    compliance = np.zeros(robot.n) if robot.compliance is None else robot.compliance
    for k, joint in enumerate(robot.joint_names):
        for key, (unit, factor) in ROWS.items():
            yield joint, key, unit, factor * float(getattr(robot, key)[k])
        yield joint, "scale", "1", float(robot.link_from_reading[k, k])
        unit, factor = ELASTIC_ROWS["compliance"]
        yield joint, "compliance", unit, factor * float(compliance[k])


def spread(arm: FittedArm, state: int) -> np.ndarray:
    """Covariance of all `quantities` of the calibrated robot, in their units."""

    def of(values: np.ndarray) -> np.ndarray:
        robot = calibrated_robot(arm.model, values, state=state)
        robot = replace(robot, compliance=_compliance(arm.model, values))  # its u has no bound at 0
        return np.array([value for *_, value in quantities(robot)])

    slopes = []
    for k, sd in enumerate(arm.model.sd):
        step = np.zeros(len(arm.values))
        step[k] = STEP * sd
        slopes.append((of(arm.values + step) - of(arm.values - step)) / (2.0 * step[k]))
    by = np.array(slopes).reshape(len(arm.values), -1)
    # a slope that displaces by less than `ROUNDING` for a prior standard deviation is rounding
    by[np.abs(by * arm.model.sd[:, None]) < ROUNDING] = 0.0
    return by.T @ arm.covariance @ by


def _write_table(arm: FittedArm, options: Options) -> Written:
    robot = calibrated_robot(arm.model, arm.values, state=options.state)
    covariance = spread(arm, options.state)
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    values = [
        {"place": place, "quantity": key, "unit": unit, "value": value, "u": u_of_value}
        for (place, key, unit, value), u_of_value in zip(quantities(robot), u, strict=True)
    ]
    record = {
        "schema": SCHEMA, "robot": arm.dataset.robot.name, "convention": robot.convention,
        "link_from_reading": robot.link_from_reading.tolist(), "flange_in_last_row": robot.flange.tolist(),
        "values": values, "covariance": covariance.tolist(),
    }  # fmt: skip
    text = _csv(robot, {(v["place"], v["quantity"]): (v["value"], v["u"]) for v in values})
    note = "the JSON file beside it has the base, the coupling of the readings and the full covariance"
    return Written(text, robot_items(arm), beside={".json": json_text(record)}, notes=[note])


def _csv(robot: Robot, values: Mapping[tuple[str, str], tuple[float, float]]) -> str:
    """The rows of a robot as CSV; `values` has value and u of each quantity of a joint."""
    columns = ROWS if robot.compliance is None else ELASTIC_ROWS
    heads = [head for key, (unit, _) in columns.items() for head in (f"{key}_{unit}", f"u_{key}_{unit}")]
    rows = (
        [joint, robot.convention, *(repr(x) for key in columns for x in values[joint, key])]
        for joint in robot.joint_names
    )
    return csv_text(["joint", "convention", *heads], rows)


DH_CSV = Format(".csv", _write_table, _holds, f"a DH table has {HELD}")
"""The calibrated table for any other program: rows with u as CSV, with the full covariance as JSON."""
