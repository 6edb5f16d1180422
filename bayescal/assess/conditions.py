"""Information of a session measured again with changes: poses, directions, length, payload, tool."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations

import numpy as np

from bayescal.dataset.target_kinds import KINDS
from bayescal.effects.tool import TOOL
from bayescal.estimate import Estimate
from bayescal.model import ORIENTATION
from bayescal.predict.elsewhere import elsewhere, joint_range, point_slopes

PLANNED = 120
"""Rows of a session with changes; as many again with a second tool, and with a payload."""
SECOND_TOOL = np.array([0.08, 0.05, 0.06])
"""m, from the TCP: the point of a second tool (assumed)."""
PAYLOAD = 2.0
"""kg: an attached mass (assumed)."""
ANGLE = 1e-3
"""rad: of the last joint, to measure the distance of the TCP from its axis."""
SEED = 20
"""Of the poses."""


class Conditions:
    """A fitted session, and the information that it would have with changes.

    All targets are taken as fixed to one body whose place, and without a known length whose size, is not
    known: both are eliminated.

    Parameters
    ----------
    fitted : Estimate
    index : np.ndarray of int, shape (P,)
        The parameters of the model that count.
    """

    def __init__(self, fitted: Estimate, index: np.ndarray) -> None:
        self.model, self.index, self._values = fitted.model, index, fitted.arm
        scene = self.model.scene
        rows = np.setdiff1d(scene.rows("calibrate"), fitted.rejected)
        self.rows = rows[np.linspace(0, len(rows) - 1, PLANNED).round().astype(int)]
        self.readings = scene.dataset.measurements.readings
        self._look = np.zeros((len(scene.points), 3, 3))
        noise = []
        for block in self.model.blocks:
            if block.group == ORIENTATION:
                continue
            _, u, _ = block.kind.linearise(np.zeros(len(block.kind.sd)), scene.points[block.rows].T)
            self._look[block.rows, : len(u)] = np.moveaxis(u, 2, 0)
            noise.append(fitted.weights.sigma[block.name] * fitted.weights.scale[block.group])
        self.noise = float(np.median(np.concatenate(noise)))
        self.values_per_row = float(np.mean(np.sum(np.any(self._look[self.rows], axis=2), axis=1)))
        # an instrument reads lengths; what certificates state is information of the session alone
        fitted_targets = {b.target for b in self.model.blocks}
        self._metric = any(KINDS[t.kind].metric for t in scene.dataset.targets if t.name in fitted_targets)
        self._slopes: dict[tuple[bool, str], tuple[np.ndarray, np.ndarray]] = {}
        self._information: dict[tuple[str, ...], np.ndarray] = {}

    def possible(self, changes: Sequence[str]) -> list[tuple[str, ...]]:
        """Sets of changes that the session may have, the smallest first, from none to all."""
        robot, looks = self.model.scene.dataset.robot, np.any(self._look[self.rows], axis=2)
        excluded = {"directions"} if np.all(looks) else set()
        excluded |= {"length"} if self._metric else set()
        excluded |= {"payload"} if robot.masses is None else set()
        left = [c for c in changes if c not in excluded]
        return [own for size in range(len(left) + 1) for own in combinations(left, size)]

    def information(self, changes: tuple[str, ...]) -> np.ndarray:
        """Information (P, P) of a session with changes, by z, with the place of its targets eliminated."""
        if changes not in self._information:
            a = self._seen(changes)
            self._information[changes] = a.T @ a
        return self._information[changes]

    def displacement(self, covariance: np.ndarray) -> float:
        """RMS displacement, m, of TCPs over the range of all joints, for a covariance (P, P) of z."""
        points, slopes = self._points(True, "")
        a = _free_of(slopes[..., self.index].reshape(-1, len(self.index)), _body(points, False))
        return float(np.sqrt(max(np.sum((a @ covariance) * a), 0.0) / len(points)))

    @property
    def lever(self) -> float:
        """Largest distance of a TCP from the last axis, m."""
        turned = self.readings[self.rows].copy()
        turned[:, -1] += ANGLE
        moved = elsewhere(self.model, self.rows, turned).points(self._values).T - self._points(False, "")[0]
        return float(np.max(np.linalg.norm(moved, axis=1)) / ANGLE)

    @cached_property
    def _everywhere(self) -> np.ndarray:
        robot = self.model.scene.dataset.robot
        return joint_range(robot, PLANNED, np.random.default_rng(SEED))

    def _points(self, everywhere: bool, other: str) -> tuple[np.ndarray, np.ndarray]:
        """TCP positions (N, 3), m, and their slopes (N, 3, P') by z; `other`: payload, tool, or ""."""
        if (everywhere, other) not in self._slopes:
            payload = self.model.scene.dataset.measurements.payload
            own = np.zeros(PLANNED) if payload is None else payload[self.rows]
            motion = elsewhere(
                self.model,
                self.rows,
                self._everywhere if everywhere else self.readings[self.rows],
                own + PAYLOAD if other == "payload" else None,
                SECOND_TOOL if other == "tool" else None,
            )
            slopes = point_slopes(self.model, motion, self._values)
            self._slopes[everywhere, other] = motion.points(self._values).T, slopes
        return self._slopes[everywhere, other]

    def _seen(self, changes: tuple[str, ...]) -> np.ndarray:
        """Whitened rows (R, P) of a session with changes, free of the place of its targets."""
        points, rows, second = [], [], []
        ours = np.array([p.effect == TOOL.name for p in self.model.parameters])
        for other in ("", *(c for c in ("payload", "tool") if c in changes)):
            at, slopes = self._points("poses" in changes, other)
            points.append(at)
            second.append(slopes[..., ours] * (other == "tool"))
            rows.append(np.where(ours, 0.0, slopes) if other == "tool" else slopes)
        look = np.eye(3) if "directions" in changes else np.tile(self._look[self.rows], (len(points), 1, 1))
        place = _body(np.concatenate(points), not (self._metric or "length" in changes))
        unknown = np.concatenate([place.reshape(-1, 3, place.shape[1]), np.concatenate(second)], axis=2)
        a = look @ np.concatenate(rows)[..., self.index]
        unknown = look @ unknown
        return _free_of(a.reshape(-1, a.shape[2]), unknown.reshape(-1, unknown.shape[2])) / self.noise


def _body(points: np.ndarray, size: bool) -> np.ndarray:
    """Displacements (3 N, 6 or 7) of points (N, 3) by the place of a body, and by its size."""
    at = points - points.mean(axis=0)
    scale = max(float(np.sqrt(np.mean(at**2))), 1e-3)
    moved = [np.broadcast_to(axis, at.shape) for axis in np.eye(3)]
    turned = [np.cross(axis, at) / scale for axis in np.eye(3)]
    return np.stack([*moved, *turned, *([at / scale] if size else [])], axis=2).reshape(at.size, -1)


def _free_of(a: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    """Rows (R, P) without what unknowns (R, K) explain."""
    u, s, _ = np.linalg.svd(unknown, full_matrices=False)
    u = u[:, s > 1e-9 * max(float(s[0]), 1e-30)]
    return np.asarray(a - u @ (u.T @ a))
