"""A simulated controller cell for the interpreters of probing programs; it shares no code with the package.

The controller moves by the nominal arm; the true arm differs. Kinematics is written out from the robot file.
A surface is a patch of a plane about each planned contact, so that motions between contacts touch nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import yaml
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import bayescal

PATCH, DEEP = 5e-3, 12e-3
"""m: radius of a patch, and how far behind it the ball is still inside."""
KNOTS = 8
PHASE = 0.37
"""Of the first control cycle: no cycle ends exactly at a planned contact."""
COARSE = 40
"""Control cycles of a motion by joint angles: fewer than a controller has, for the time of a test."""


class Stopped(Exception):
    """A program that has ended before its last line."""


class Arm:
    """Forward kinematics of modified DH rows (Craig), (M, 6) rad -> flange poses (M, 4, 4), m."""

    def __init__(self, name: str, tool: np.ndarray, error: dict | None = None):
        robot = yaml.safe_load((Path(bayescal.__file__).parent / "robots" / f"{name}.yaml").read_text())
        assert robot["convention"] == "mdh"
        rows = robot["joints"]
        angles = ([r[key] for r in rows] for key in ("alpha_deg", "offset_deg"))
        self.alpha, self.offset = (np.radians(values).astype(float) for values in angles)
        self.a, self.d = (1e-3 * np.array([r[k] for r in rows], float) for k in ("a_mm", "d_mm"))
        for key, value in (error or {}).items():
            setattr(self, key, getattr(self, key) + np.array(value))
        self.links = np.array(robot.get("link_from_reading", np.eye(len(rows))), float)
        self.tool = np.asarray(tool, float)

    def flange(self, q: np.ndarray) -> np.ndarray:
        theta = np.atleast_2d(q) @ self.links.T + self.offset
        pose = np.broadcast_to(np.eye(4), (len(theta), 4, 4))
        for k in range(theta.shape[1]):
            c, s = np.cos(theta[:, k]), np.sin(theta[:, k])
            ca, sa = np.cos(self.alpha[k]), np.sin(self.alpha[k])
            step = np.zeros((len(theta), 4, 4))
            step[:, 0, 0], step[:, 0, 1], step[:, 0, 3] = c, -s, self.a[k]
            step[:, 1, 0], step[:, 1, 1], step[:, 1, 2], step[:, 1, 3] = s * ca, c * ca, -sa, -sa * self.d[k]
            step[:, 2, 0], step[:, 2, 1], step[:, 2, 2], step[:, 2, 3] = s * sa, c * sa, ca, ca * self.d[k]
            step[:, 3, 3] = 1.0
            pose = pose @ step
        return pose

    def ball(self, q: np.ndarray) -> np.ndarray:
        pose = self.flange(q)
        return pose[:, :3, :3] @ self.tool + pose[:, :3, 3]

    def inverse(self, at: np.ndarray, turn: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Joints near `q` that bring the ball to `at` with the flange turned as `turn` (3, 3)."""

        def off(q):
            pose = self.flange(q)
            spin = Rotation.from_matrix(turn @ np.swapaxes(pose[:, :3, :3], 1, 2)).as_rotvec()
            ball = pose[:, :3, :3] @ self.tool + pose[:, :3, 3]
            return np.concatenate([at - ball, 0.3 * spin], axis=1)

        for _ in range(20):
            here, *beside = off(q + 1e-7 * np.eye(7, 6, -1))
            if np.abs(here).max() < 1e-12:
                break
            q = q - np.linalg.solve((np.array(beside) - here).T / 1e-7, here)
        return q

    def line(self, begin: np.ndarray, end: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Joints (M, 6) at shares (M,) of the straight motion of the ball; its rotation is in proportion."""
        poses = self.flange(np.stack([begin, end]))
        balls = self.ball(np.stack([begin, end]))
        turn = Rotation.from_matrix(poses[1, :3, :3] @ poses[0, :3, :3].T).as_rotvec()
        knots, q = np.linspace(0, 1, KNOTS), [begin]
        for s in knots[1:]:
            spun = Rotation.from_rotvec(s * turn).as_matrix() @ poses[0, :3, :3]
            q.append(self.inverse(balls[0] + s * (balls[1] - balls[0]), spun, q[-1]))
        return CubicSpline(knots, np.array(q))(shares)


@dataclass
class Cell:
    """An arm at `q`, its probe, and what happened.

    Attributes
    ----------
    nominal, true : Arm
    points, normals : np.ndarray, shape (N, 3)
        Of the surface at each planned contact, m, moved by the radius of the ball.
    cycle : float
        s of the controller.
    absent : set of int
        Rows without a surface.
    raised : dict of int to float
        m by which the surface of a row is nearer.
    """

    nominal: Arm
    true: Arm
    points: np.ndarray
    normals: np.ndarray
    q: np.ndarray
    cycle: float = 2e-3
    absent: set = field(default_factory=set)
    raised: dict = field(default_factory=dict)
    path: np.ndarray = field(default_factory=lambda: np.empty((0, 6)))
    at: int = 0
    speed: float = 0.0
    kind: str = ""
    texts: list = field(default_factory=list)
    deepest: float = 0.0
    travelled: list = field(default_factory=list)  # (kind, readings) of ended motions
    by_hand: bool = False
    inside: np.ndarray = field(default_factory=lambda: np.empty(0))  # depth along the path

    def depth(self, q: np.ndarray) -> np.ndarray:
        """How far the ball is inside a surface, m, at readings (M, 6); negative outside."""
        off = self.true.ball(q)[:, None] - self.points - self._lift[:, None] * self.normals
        inward = -np.einsum("mki,ki->mk", off, self.normals)
        across = np.linalg.norm(off + inward[..., None] * self.normals, axis=2)
        inward = np.where((across < PATCH) & (inward < DEEP), inward, -1.0)
        inward[:, sorted(self.absent)] = -1.0
        return inward.max(axis=1)

    @property
    def _lift(self) -> np.ndarray:
        return np.array([self.raised.get(k, 0.0) for k in range(len(self.points))])

    def pressed(self) -> bool:
        """Whether the probe is pressed, by a surface or by hand."""
        deep = self.inside[self.at - 1] if self.kind and self.at else self.depth(self.q[None])[0]
        return self.by_hand or bool(deep > 0)

    def start(self, kind: str, goal: np.ndarray, speed: float) -> None:
        """Begin a motion: 'joint' (rad/s of the fastest joint) or 'line' (m/s of the ball)."""
        goal = np.asarray(goal, float)
        assert goal.shape == (6,)
        if kind == "joint":
            span = np.abs(goal - self.q).max()
            speed = max(speed, span / self.cycle / COARSE)
        else:
            span = np.linalg.norm(np.diff(self.nominal.ball(np.stack([self.q, goal])), axis=0))
        count = max(int(np.ceil(span / speed / self.cycle)), 1)
        shares = np.minimum((np.arange(count) + PHASE) * speed * self.cycle / max(span, 1e-12), 1.0)
        shares[-1] = 1.0
        if kind == "joint":
            self.path = self.q + shares[:, None] * (goal - self.q)
        else:
            self.path = self.nominal.line(self.q, goal, shares)
        self.at, self.speed, self.kind = 0, speed, kind
        self.inside = self.depth(self.path)

    def tick(self) -> bool:
        """A control cycle of the motion; whether it has ended."""
        if self.at < len(self.path):
            self.q = self.path[self.at]
            self.deepest = max(self.deepest, float(self.inside[self.at]))
            self.at += 1
        if self.at == len(self.path) and self.kind:
            self.travelled.append((self.kind, self.q))
            self.kind = ""
        return self.at >= len(self.path)

    def brake(self, deceleration: float) -> None:
        """Stop: the motion goes on along its path by v2/(2 a), m of the ball or rad of the fastest joint."""
        further = self.speed**2 / (2 * deceleration)
        last = min(self.at + int(np.ceil(further / self.speed / self.cycle)), len(self.path))
        while self.at < last:
            self.tick()
        self.path, self.kind = self.path[:0], ""
        self.at = 0

    def run(self, kind: str, goal: np.ndarray, speed: float, watch: bool, deceleration: float):
        """A whole motion; the readings at the trigger if it is watched and touches, else None."""
        if watch and self.pressed():
            return self.q.copy()
        self.start(kind, goal, speed)
        while not self.tick():
            if watch and self.pressed():
                seen = self.q.copy()
                self.brake(deceleration)
                return seen
        return None


def cell_of(plan, error: dict, shift: dict, seed: int = 0, **options) -> Cell:
    """The cell of a plan of planes: a true arm with errors, and planes that are `shift`, m, off by name."""
    session, m = plan.session, plan.session.measurements
    tool = session.tools[0]
    nominal = Arm(session.robot.name, tool.centre)
    true = Arm(session.robot.name, tool.centre + 1e-4, error)
    targets = [session.targets[k] for k in m.target]
    normals = np.array([t.values["normal"] for t in targets])
    offsets = np.array([t.values["offset"] + shift.get(t.name, 0.0) for t in targets]) + tool.ball_radius
    balls = true.ball(m.readings)
    points = balls - (np.einsum("mi,mi->m", balls, normals) - offsets)[:, None] * normals
    return Cell(nominal, true, points, normals, plan.approach[0] + 0.05, **options)


def on_planes(plan):
    """A plan of planes whose contacts are those of the nominal arm.

    Approaches are 20 mm off and 2 deg turned, ways pass points 120 mm off; a change before the sixth.
    """
    session, m = plan.session, plan.session.measurements
    tool = session.tools[0]
    arm = Arm(session.robot.name, tool.centre)
    tilt = Rotation.from_rotvec([0.02, -0.02, 0.02]).as_matrix()
    at, away, raised = [], [], []
    for q, k, ball, pose in zip(
        m.readings, m.target, arm.ball(m.readings), arm.flange(m.readings), strict=True
    ):
        n = np.array(session.targets[k].values["normal"])
        ball = ball - (n @ ball - session.targets[k].values["offset"] - tool.ball_radius) * n
        at.append(arm.inverse(ball, pose[:3, :3], q))
        away.append(arm.inverse(ball + 0.02 * n, tilt @ pose[:3, :3], at[-1]))
        raised.append(arm.inverse(ball + 0.12 * n, tilt @ pose[:3, :3], away[-1]))
    session, count = replace(session, measurements=replace(m, readings=np.array(at))), len(at)
    leave = [
        np.array(raised[:1]),
        *(np.array(raised[k - 1 : k][: k == 5]).reshape(-1, 6) for k in range(1, count)),
    ]
    via = [np.empty((0, 6)), *(np.array(raised[k - 1 + (k == 5) : k + 1]) for k in range(1, count))]
    changes = tuple("attach 0.5 kg beyond the tool" if k == 5 else "" for k in range(count))
    return replace(
        plan, session=session, approach=np.array(away), via=tuple(via), leave=tuple(leave), changes=changes,
        by_hand=("",) * count,
    )  # fmt: skip
