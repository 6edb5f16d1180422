"""A robot description with springs where it yields, as MuJoCo holds it: rigid bodies and hinges.

Only the robot file's table, masses, tool and mounting are read, nothing of the model of bayescal. A hinge of
stiffness k turns by the moment about its own axis over k. It does its own kinematics and statics.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot

TINY = 1e-12
"""Mass and inertia of a body between two hinges, kg and kg m2."""
X, Y, Z = np.eye(3)


@dataclass
class Springs:
    """Compliances, rad/(N m), (n,) each; 0 is rigid. Bearings yield about x and y."""

    joint: np.ndarray
    bearing: np.ndarray
    y: np.ndarray  # of a link at its middle, about y and the other axis across it
    other: np.ndarray
    base: list[tuple[np.ndarray, np.ndarray, float]] = field(default_factory=list)  # axis, point in F0, give


@dataclass
class Errors:
    """Errors of the table, (n,) each, rad and m."""

    theta: np.ndarray
    d: np.ndarray
    alpha: np.ndarray
    a: np.ndarray
    beta: np.ndarray


@dataclass
class Hinge:
    """A joint of an arm: its axis in its own frame, compliance, and the number of the motor in it, or -1."""

    axis: np.ndarray
    give: float
    motor: int = -1


@dataclass
class Mass:
    """A point mass, kg."""

    kilograms: float


Part = Hinge | Mass


def move(by: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = by
    return out


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    k, out = np.cross(np.eye(3), axis), np.eye(4)
    out[:3, :3] += np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return out


def parts(
    robot: Robot, springs: Springs, errors: Errors, load: float, load_centre: np.ndarray
) -> Iterator[tuple[np.ndarray, Part | None]]:
    """All parts from the base to the flange, each with its place (4, 4) in the frame of the hinge before it.

    The last is the flange.
    """
    here = np.eye(4)
    for axis, point, give in springs.base:
        yield here @ move(point), Hinge(axis, give)
        here = move(-point)
    here = here @ robot.base
    mdh = robot.convention == "mdh"
    for i in range(robot.n):
        twisted, shifted = turn(X, robot.alpha[i]), move(robot.a[i] * X)
        row = (twisted @ shifted if mdh else shifted @ twisted) @ turn(Y, robot.beta[i])
        yield (here @ row if mdh else here), Hinge(Z, springs.joint[i], i)
        here = turn(Z, errors.theta[i]) @ move((robot.d[i] + errors.d[i]) * Z)
        twist = turn(X, errors.alpha[i]) @ move(errors.a[i] * X)
        ahead = (robot.a[i + 1] if i + 1 < robot.n else 0.0) if mdh else robot.a[i]
        middle, length = move(0.5 * (ahead * X - robot.d[i] * Z)), np.hypot(ahead, robot.d[i])
        other = (ahead * Z - robot.d[i] * X) / max(length, 1e-9)
        steep = abs(robot.d[i]) > abs(ahead)
        # a frame yields about z, x and y, and a row's errors stand between its x and y axes
        slots: list[list[tuple[np.ndarray, float, bool]]] = [
            [(other, 0.0 if steep else springs.other[i], True)],
            [(X, springs.bearing[i], False), (other, springs.other[i] if steep else 0.0, True)],
            [(Y, springs.bearing[i], False), (Y, springs.y[i], True)],
        ]
        for slot, before in zip(slots, (np.eye(4), np.eye(4), twist), strict=True):
            here = here @ before
            for axis, give, halfway in slot:
                if give:
                    at = middle if halfway else np.eye(4)
                    yield here @ at, Hinge(axis, give)
                    here = np.linalg.inv(at)
        slant = turn(Y, errors.beta[i])
        # a modified row's errors of alpha, a and beta place the next joint on the link, not the link
        own = np.linalg.inv(twist) if mdh else slant @ row
        yield here @ own @ move(robot.centres_of_mass[i]), Mass(robot.masses[i])
        here = here @ slant if mdh else here @ slant @ row
    here = here @ robot.flange
    yield here @ move(load_centre), Mass(load)
    yield here, None


class MuJoCoArm:
    """The arm in MuJoCo, a body a hinge."""

    def __init__(self, chain: list[tuple[np.ndarray, Part | None]], gravity: np.ndarray) -> None:
        import mujoco

        self.engine, spec = mujoco, mujoco.MjSpec()
        spec.option.gravity = gravity
        body, self.hinges = spec.worldbody, []
        for place, part in chain:
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, place[:3, :3].ravel())
            if isinstance(part, Hinge):
                body = body.add_body(pos=place[:3, 3], quat=quaternion)
                self._weigh(body, TINY)
                stiff = 1.0 / part.give if part.give else 0.0
                body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=part.axis, stiffness=stiff)
                self.hinges.append(part)
            elif isinstance(part, Mass):
                self._weigh(body.add_body(pos=place[:3, 3]), part.kilograms)
            else:
                body.add_site(name="flange", pos=place[:3, 3], quat=quaternion)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    @staticmethod
    def _weigh(body: Any, kilograms: float) -> None:
        """Give a body a point mass at its origin, which must be said: its default is `pos`."""
        body.mass, body.inertia, body.ipos, body.explicitinertial = kilograms, [TINY] * 3, [0.0] * 3, True

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Gravity's moments on all hinges, N m."""
        self.data.qpos[:] = q
        self.engine.mj_forward(self.model, self.data)
        return -self.data.qfrc_bias

    def check(self, rest: np.ndarray) -> None:
        """MuJoCo's springs hold the arm where it is: they pull as much as gravity."""
        soft = np.array([h.give > 0 for h in self.hinges])
        self.model.qpos_spring[:] = rest
        self.engine.mj_forward(self.model, self.data)
        np.testing.assert_allclose((self.data.qfrc_passive - self.data.qfrc_bias)[soft], 0.0, atol=1e-9)

    def flange(self) -> np.ndarray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = self.data.site("flange").xmat.reshape(3, 3), self.data.site("flange").xpos
        return out


def tool_points(arm: MuJoCoArm, links: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """TCP positions (N, 3), m, at motor angles (N, n), rad, of the links; every spring is in equilibrium."""
    give = np.array([h.give for h in arm.hinges])
    motor = np.array([h.motor for h in arm.hinges])
    out = np.empty((len(links), 3))
    for k, angles in enumerate(links):
        rest = np.where(motor >= 0, angles[motor], 0.0)
        q, before = rest, np.full(len(rest), np.inf)
        while np.max(np.abs(q - before)) > 1e-14:
            before, q = q, rest + give * arm.gravity(q)
        arm.gravity(q)
        arm.check(rest)
        out[k] = (arm.flange() @ np.append(tool, 1.0))[:3]
    return out
