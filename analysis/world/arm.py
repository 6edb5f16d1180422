"""The arm of the world: a chain of rigid bodies in Pinocchio, with the hinges at which it may yield.

Nothing here knows the calibration model: joints, hinges and masses are Pinocchio's, and so are positions
and gravity torques.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

Point = tuple[float, ...]
GRAVITY = 9.81
HERE = (0.0, 0.0, 0.0)
LINK_FROM_READING = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, -1, -1, 0, 0, 0],
        [0, 0, 0, -1, 0, 0],
        [0, 0, 0, 0, -1, 0],
        [0, 0, 0, 0, 0, -1],
    ],
    dtype=float,
)
REDUCTIONS = np.array([120, 121, 100, 100, 50, 50], dtype=float)
LIMITS = np.radians([[-170, 170], [-60, 140], [-142, 230], [-190, 190], [-120, 120], [-360, 360]])

BASE = slice(0, 6)  # coordinates: three shifts and three turns of the base, then joints, hinges, growths
JOINT = np.array([6, 10, 14, 17, 21, 24])
HINGE = np.array([[7, 8], [11, 12], [15, 16], [18, 19], [22, 23]])  # across the joint axis, one pair a link
GROWTH = np.array([9, 13, 20])  # links 1, 2 and 4 grow along themselves
SIZE = 25


@dataclass(frozen=True)
class Shape:
    """Lengths (m), angles (rad), masses (kg) and compliances (rad/(N m)) of an arm with its tool."""

    a: np.ndarray
    alpha: np.ndarray
    d: np.ndarray
    zero: np.ndarray
    beta3: float
    mass: np.ndarray
    com: np.ndarray
    tool: np.ndarray
    tool_mass: float
    tool_com: np.ndarray
    give: np.ndarray
    hinge_at: float = 0.5  # where along its link a hinge sits


def nominal() -> Shape:
    """Return the nominal arm, with the tool of the session: stiff."""
    return Shape(
        a=np.array([0, 75, 300, 75, 0, 0]) * 1e-3,
        alpha=np.radians([0, -90, 0, -90, 90, -90]),
        d=np.array([0, 0, 0, 320, 0, 80]) * 1e-3,
        zero=np.radians([0, -90, 0, 0, 0, 0]),
        beta3=0.0,
        mass=np.array([7.54, 8.11, 2.63, 2.5, 0.46, 0.01]),
        com=np.array(
            [[0, 0, -100], [145, 0, 8], [38, 2.5, 1.6], [1.3, -3.6, -107.5], [0, 17.4, 1.5], [0, 0, -5]]
        )
        * 1e-3,
        tool=np.array([0.06, 0.0, 0.12]),
        tool_mass=0.8,
        tool_com=np.array([0.02, 0.0, 0.06]),
        give=np.zeros(6),
    )


def draw(rng: np.random.Generator) -> Shape:
    """Return an arm as built: wrong in every length, angle and mass, and elastic."""
    s = nominal()
    give = np.array([0, 3e-5, 2e-4, 1.5e-3, 1.5e-3, 1.5e-3])
    spread = np.exp(np.clip(0.5 * rng.standard_normal(6), -np.log(3), np.log(3)))
    return replace(
        s,
        a=s.a + 3e-4 * rng.standard_normal(6),
        alpha=s.alpha + 1e-3 * rng.standard_normal(6),
        d=s.d + 3e-4 * rng.standard_normal(6),
        zero=s.zero + 2e-3 * rng.standard_normal(6),
        beta3=1e-3 * rng.standard_normal(),
        mass=s.mass * (1 + rng.uniform(-0.15, 0.15, 6)),
        com=s.com * (1 + rng.uniform(-0.15, 0.15, (6, 3))) + 3e-4 * rng.standard_normal((6, 3)),
        tool=s.tool + 7e-4 * rng.standard_normal(3),
        tool_mass=s.tool_mass * (1 + 0.005 * rng.standard_normal()),
        tool_com=s.tool_com + 5e-4 * rng.standard_normal(3),
        give=give * spread,
        hinge_at=rng.uniform(0.25, 0.75),
    )


def _turn(axis: str, angle: float) -> pin.SE3:
    return pin.SE3(pin.utils.rotate(axis, angle), np.zeros(3))


def _shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z], dtype=float))


def _point(mass: float, com: np.ndarray) -> pin.Inertia:
    return pin.Inertia(mass, np.asarray(com, dtype=float), 1e-6 * np.eye(3))


def _model(s: Shape, extra: float = 0.0, off: Point = HERE) -> tuple[pin.Model, int]:
    """Build the chain; `extra` is a mass beside the tool's, at its centre of mass or `off` it."""
    m = pin.Model()
    m.gravity.linear = np.array([0, 0, -GRAVITY])
    last = 0
    kinds = [
        pin.JointModelPX,
        pin.JointModelPY,
        pin.JointModelPZ,
        pin.JointModelRX,
        pin.JointModelRY,
        pin.JointModelRZ,
    ]
    for k, kind in enumerate(kinds):
        last = m.addJoint(last, kind(), pin.SE3.Identity(), f"base{k}")
    rest = pin.SE3.Identity()
    for i in range(6):
        row = _turn("x", s.alpha[i]) * _shift(x=s.a[i])
        if i == 2:
            row = row * _turn("y", s.beta3)
        last = m.addJoint(last, pin.JointModelRZ(), rest * row * _turn("z", s.zero[i]), f"joint{i + 1}")
        m.appendBodyToJoint(last, _point(s.mass[i], s.com[i] + np.array([0, 0, s.d[i]])), pin.SE3.Identity())
        rest = _shift(z=s.d[i])
        if i < 5:
            along = np.array([s.a[i + 1], 0.0, s.d[i]])
            last = m.addJoint(last, pin.JointModelRX(), _shift(*(s.hinge_at * along)), f"hinge{i + 1}x")
            last = m.addJoint(last, pin.JointModelRY(), pin.SE3.Identity(), f"hinge{i + 1}y")
            rest = _shift(*(-s.hinge_at * along)) * rest
        if i in (0, 1):
            last = m.addJoint(last, pin.JointModelPX(), pin.SE3.Identity(), f"growth{i + 1}")
        if i == 3:
            last = m.addJoint(last, pin.JointModelPZ(), pin.SE3.Identity(), f"growth{i + 1}")
    tool = s.tool_com + np.array([0, 0, s.d[5]])
    beside = extra if off == HERE else 0.0
    m.appendBodyToJoint(last, _point(s.tool_mass + beside, tool), pin.SE3.Identity())
    if off != HERE:
        m.appendBodyToJoint(last, _point(extra, tool + off), pin.SE3.Identity())
    flange = m.addFrame(pin.Frame("flange", last, 0, rest, pin.FrameType.OP_FRAME))
    return m, flange


@dataclass
class Arm:
    """An arm that can be placed and weighed, contact by contact.

    Parameters
    ----------
    shape : Shape
        Its sizes.
    """

    shape: Shape
    _models: dict = field(default_factory=dict)

    def _built(self, extra: float, off: Point = HERE) -> tuple[pin.Model, pin.Data, int]:
        if (extra, off) not in self._models:
            model, flange = _model(self.shape, extra, off)
            self._models[extra, off] = (model, model.createData(), flange)
        return self._models[extra, off]

    def place(self, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origin (n, 3) and rotation (n, 3, 3) of the flange."""
        model, data, flange = self._built(0.0)
        n = len(coordinates)
        origin, turn = np.empty((n, 3)), np.empty((n, 3, 3))
        for k in range(n):
            pin.forwardKinematics(model, data, coordinates[k])
            here = pin.updateFramePlacement(model, data, flange)
            origin[k], turn[k] = here.translation, here.rotation
        return origin, turn

    def weigh(self, coordinates: np.ndarray, extra: float = 0.0, off: Point = HERE) -> np.ndarray:
        """Return the gravity torque (n, coordinates) on every joint and hinge.

        An extra mass (kg) hangs at the tool's centre of mass, or `off` it (m, in the flange's frame).
        """
        model, data, _ = self._built(extra, off)
        out = np.empty((len(coordinates), SIZE))
        for k, q in enumerate(coordinates):
            out[k] = pin.computeGeneralizedGravity(model, data, q)
        return -out

    def jacobian(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, 6, 6) of the ball's shift and turn by the joints' link angles."""
        model, data, flange = self._built(0.0)
        out = np.empty((len(coordinates), 6, 6))
        for k, q in enumerate(coordinates):
            full = pin.computeFrameJacobian(model, data, q, flange, pin.LOCAL_WORLD_ALIGNED)[:, JOINT]
            lever = data.oMi[model.frames[flange].parentJoint].rotation @ self.shape.tool
            out[k] = full
            out[k, :3] += np.cross(full[3:].T, lever).T
        return out
