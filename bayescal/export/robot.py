"""A calibrated robot as DH rows: exactly the displaced chain, joint for joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.arm.chain import chain_of, displaced
from bayescal.arm.robot import Robot
from bayescal.arm.transforms import AXES, rigid, rotation
from bayescal.effects.geometry import PARALLEL
from bayescal.estimate import Estimate
from bayescal.model import ARM


def calibrated_robot(fitted: Estimate, name: str = "") -> Robot:
    """The robot of an estimate: DH rows, Hayati's beta and compliances; the tool is not part of it.

    Between two joints' Rz Tz stands a constant transform, displaced by the estimate. It is split anew
    into Rx Tx (Ry) and what belongs to the joints before and behind: the flange moves exactly as in the
    model, whatever components the displacement had.
    """
    model = fitted.model
    robot = model.scene.dataset.robot
    values = model.deviations(fitted.z[model.slices[ARM]])
    delta = np.zeros((robot.n + 2, 6))
    compliance = np.zeros(robot.n) if robot.compliance is None else robot.compliance.copy()
    for value, p in zip(values, model.parameters, strict=True):
        for term in p.terms:
            if p.effect == "compliance":
                compliance[term.frame - 1] += value
            elif 0 <= term.frame <= robot.n and np.ndim(term.driver) == 0:  # not a contact's, not a paper's
                delta[term.frame, AXES.index(term.axis)] += value * float(term.driver)
    out = _displaced_rows(robot, delta)
    return replace(
        out, name=name or f"{robot.name}-calibrated", compliance=compliance if np.any(compliance) else None
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
        (alpha[row], a[row], beta[row]), before, behind = _split(between[k])
        offset[k - 1] += before[0]
        d[k - 1] += before[1]
        if k < n:
            offset[k] += behind[0]
            d[k] += behind[1]
    if robot.convention == "mdh":  # behind the last joint only Rz and Tz have a place
        offset[n - 1] += delta[n, 0]
        d[n - 1] += delta[n, 1]
    return replace(robot, alpha=alpha, a=a, beta=beta, offset=offset, d=d, base=base)


def _split(
    m: np.ndarray,
) -> tuple[tuple[float, float, float], tuple[float, float], tuple[float, float]]:
    """Split a transform into Rz Tz (before), alpha, a, beta, and Rz Tz (behind).

    Between near-parallel axes beta takes the place of a distance along the second axis, which there
    is ill determined; elsewhere beta is zero (Hayati and Mirmirani 1985).
    """
    axis = m[:3, 2]  # the second axis seen from the first
    if np.hypot(axis[0], axis[1]) < np.sin(PARALLEL):
        turn = _small(np.arctan2(m[1, 3], m[0, 3])) if np.hypot(m[0, 3], m[1, 3]) > 1e-9 else 0.0
        r, p = rotation(2, -turn) @ m[:3, :3], rotation(2, -turn) @ m[:3, 3]
        alpha, beta = np.arctan2(-r[1, 2], r[2, 2]), np.arcsin(np.clip(r[0, 2], -1.0, 1.0))
        rest = rotation(1, -beta) @ rotation(0, -alpha) @ r
        before, behind = p[2], 0.0
    else:  # turn about the first axis until the second has no component along x: the common normal
        turn = _small(np.arctan2(axis[0], -axis[1]))
        r, p = rotation(2, -turn) @ m[:3, :3], rotation(2, -turn) @ m[:3, 3]
        alpha, beta = np.arctan2(-r[1, 2], r[2, 2]), 0.0
        rest = rotation(0, -alpha) @ r
        behind = -p[1] / np.sin(alpha)  # p = Tz(before) Tx(a) Rx(alpha) Tz(behind)
        before = p[2] - np.cos(alpha) * behind
    return (
        (float(alpha), float(p[0]), float(beta)),
        (float(turn), float(before)),
        (float(np.arctan2(rest[1, 0], rest[0, 0])), float(behind)),
    )


def _small(turn: float) -> float:
    """Of the two turns half a revolution apart the smaller: a and alpha keep the signs of the drawing."""
    return float(turn - np.pi * np.round(turn / np.pi))
