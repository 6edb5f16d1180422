"""Exact distances of a capsule from other shapes, by coal: the only module that imports it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from typing import Any

import coal
import numpy as np

from bayescal.collision.shapes import Ball, Box, Capsule, Shape


def distances(capsule: Capsule, poses: np.ndarray, other: Shape, others: np.ndarray | None) -> np.ndarray:
    """Signed distances of a capsule from another shape, negative where they overlap.

    Parameters
    ----------
    capsule : Capsule
    poses : np.ndarray, shape (K, 4, 4)
        Poses in F0 of the middle of the capsule (`Capsule.pose` in its frame).
    other : Shape
    others : np.ndarray, shape (K, 4, 4) or None
        Poses in F0 of the middle of the other, if it is a capsule that moves; None if it is fixed.

    Returns
    -------
    np.ndarray, shape (K,), m
    """
    first, (second, fixed) = _geometry(capsule)[0], _geometry(other)
    compute = coal.ComputeDistance(first, second)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    out = np.empty(len(poses))
    for k, (here, there) in enumerate(zip(_moving(poses), _second(others, fixed), strict=False)):
        result.clear()
        out[k] = compute(here, there, request, result)
    return out


def overlap(capsule: Capsule, poses: np.ndarray, other: Shape, others: np.ndarray | None) -> np.ndarray:
    """Whether a capsule overlaps another shape, (K,) bool; parameters as for `distances`."""
    first, (second, fixed) = _geometry(capsule)[0], _geometry(other)
    compute = coal.ComputeCollision(first, second)
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.enable_contact = False
    out = np.empty(len(poses), bool)
    for k, (here, there) in enumerate(zip(_moving(poses), _second(others, fixed), strict=False)):
        result.clear()
        out[k] = compute(here, there, request, result) > 0
    return out


def _geometry(shape: Shape) -> tuple[Any, Any]:
    """The shape as coal states it, and its pose; a capsule's is that in its frame."""
    if isinstance(shape, Capsule):
        length = shape.length
        body = coal.Capsule(shape.radius, length) if length else coal.Sphere(shape.radius)
        return body, _transform(shape.pose)
    if isinstance(shape, Box):
        return coal.Box(*(2 * shape.half)), _transform(shape.pose)
    if isinstance(shape, Ball):
        return coal.Sphere(shape.radius), coal.Transform3s(np.eye(3), shape.centre)
    return coal.Halfspace(shape.normal, shape.offset), coal.Transform3s()


def _second(others: np.ndarray | None, fixed: Any) -> Iterator[Any]:
    return repeat(fixed) if others is None else _moving(others)


def _moving(poses: np.ndarray) -> Iterator[Any]:
    """One transform, set to each pose (K, 4, 4) in turn: a new one for each takes longer than the check."""
    out = coal.Transform3s()
    turns, shifts = np.ascontiguousarray(poses[:, :3, :3]), np.ascontiguousarray(poses[:, :3, 3])
    for turn, shift in zip(turns, shifts, strict=True):
        out.setTransform(turn, shift)
        yield out


def _transform(pose: np.ndarray) -> Any:
    return coal.Transform3s(pose[:3, :3], pose[:3, 3])
