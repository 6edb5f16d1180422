"""A calibrated robot as DH rows: exactly the displaced chain, joint for joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.arm.chain import chain_of, displaced
from bayescal.arm.robot import Robot
from bayescal.arm.rows import split
from bayescal.arm.transforms import AXES, rigid
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.encoder_scale import ENCODER_SCALE
from bayescal.effects.geometry import PARALLEL
from bayescal.effects.joint import JOINT
from bayescal.effects.joints import READING, side_of
from bayescal.effects.selection import Selection
from bayescal.estimate import Estimate
from bayescal.model import ARM


def calibrated_robot(fitted: Estimate, name: str = "") -> Robot:
    """The robot of an estimate: DH rows, Hayati's beta, scales and compliances; the tool is no part of it.

    Between two joints' Rz Tz stands a constant transform, displaced by the estimate. It is split anew
    into Rx Tx (Ry) and what belongs to the joints before and behind: the flange moves exactly as in the
    model, whatever components the displacement had.
    """
    model = fitted.model
    robot = model.scene.dataset.robot
    values = model.deviations(fitted.z[model.slices[ARM]])
    delta = np.zeros((robot.n + 2, 6))
    compliance = np.zeros(robot.n) if robot.compliance is None else robot.compliance.copy()
    coupling = robot.link_from_reading.copy()
    asked = [s.setting for s in map(Selection.read, model.effects) if s.effect == ENCODER_SCALE.name]
    side = asked[0] if asked and asked[0] else side_of(robot)
    for value, p in zip(values, model.parameters, strict=True):
        if p.effect in (ENCODER_SCALE.name, JOINT.name) and p.unit == "1":  # not a joint's zero
            joint = p.site.number - 1
            if side == READING:  # every link that the reading moves turns so
                coupling[:, joint] *= 1.0 + value
            else:
                coupling[joint] *= 1.0 + value
        if p.effect == COMPLIANCE.name:
            for own in p.stands_for or (p,):
                compliance[own.site.number - 1] += value * (own.centre if p.stands_for else 1.0)
            continue
        for term in p.terms:
            if 0 <= term.frame <= robot.n and np.ndim(term.driver) == 0:  # not of a contact or a certificate
                delta[term.frame, AXES.index(term.axis)] += value * float(term.driver)
    out = _displaced_rows(robot, delta)
    return replace(
        out,
        name=name or f"{robot.name}-calibrated",
        link_from_reading=coupling,
        compliance=compliance if np.any(compliance) else None,
    )


def _matrix(delta: np.ndarray) -> np.ndarray:
    """The displacement of a frame as a transform (4, 4)."""
    corners = displaced(np.vstack([np.zeros(3), np.eye(3)]), delta)
    return rigid((corners[1:] - corners[0]).T, corners[0])


def _displaced_rows(robot: Robot, delta: np.ndarray) -> Robot:
    n = robot.n
    chain = chain_of(robot)
    alpha, a, beta = robot.alpha.copy(), robot.a.copy(), robot.beta.copy()
    offset, d = robot.offset.copy(), robot.d.copy()
    between = np.array([_matrix(delta[k]) @ chain.link[k] for k in range(n + 1)])
    base = chain.base
    if robot.convention == "mdh":
        base = base @ _matrix(delta[0])  # row 1 stays; the base takes its displacement
        between[0] = chain.link[0]
    else:
        base = base @ between[0]
    for k in range(1, n if robot.convention == "mdh" else n + 1):
        row = k if robot.convention == "mdh" else k - 1
        (alpha[row], a[row], beta[row]), before, behind = split(between[k], PARALLEL)
        offset[k - 1] += before[0]
        d[k - 1] += before[1]
        if k < n:
            offset[k] += behind[0]
            d[k] += behind[1]
    if robot.convention == "mdh":  # behind the last joint only Rz and Tz have a place
        offset[n - 1] += delta[n, 0]
        d[n - 1] += delta[n, 1]
    return replace(robot, alpha=alpha, a=a, beta=beta, offset=offset, d=d, base=base)
