"""Two arms on one stand, of which one carries a cube and the other probes it: MuJoCo moves and loads them.

The nominal cell is a URDF; the true one is the same text with displaced joints. Where the arms stand, and
the torque of gravity on each joint, are MuJoCo's of the true text; a joint deflects by its compliance times
this torque until the arm is at rest. Nothing here is bayescal's: only the files that it reads are written.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

SHOULDER, ELBOW, WRIST = 0.30, 0.34, 0.10  # m
ROWS = (  # origin, m, axis, mass of the link behind, kg, and its centre, m
    ((0.0, 0.0, 0.12), (0, 0, 1), 3.7, (0.0, -0.02, 0.05)),
    ((0.0, 0.08, 0.0), (0, 1, 0), 8.4, (0.14, 0.05, 0.01)),
    ((SHOULDER, 0.0, 0.0), (0, 1, 0), 2.3, (0.16, -0.02, 0.0)),
    ((ELBOW, 0.0, 0.0), (0, 1, 0), 1.2, (0.01, 0.05, 0.0)),
    ((0.0, 0.09, 0.0), (1, 0, 0), 1.2, (0.05, 0.0, 0.01)),
    ((WRIST, 0.0, 0.0), (0, 1, 0), 0.4, (0.03, 0.0, 0.0)),
)
TWIST = (0.3, -0.2, 0.5)  # rad: of the flange in the last link, so that no axis is one of F0
COMPLIANCE = np.array([4.0, 6.0, 8.0, 20.0, 30.0, 40.0]) * 1e-6  # rad/(N m)
LIMITS = '<limit lower="-3.1" upper="3.1" effort="150" velocity="3"/>'
SIDES = ("left", "right")
STANDS = {"left": ((0.0, 0.42, 0.3), (0.4, 0.0, -0.3)), "right": ((0.0, -0.42, 0.3), (-0.4, 0.0, 0.3))}
CUBE, CENTRE = 0.12, np.array([0.10, 0.02, 0.03])  # edge and centre in the left flange, m
CUBE_MASS = 2.2
BALL, RADIUS, PROBE_MASS = np.array([0.14, 0.01, 0.02]), 0.003, 0.6
NOISE = 3e-6
REACH = 0.75  # m, from the right shoulder
FACES = {f"cube.{s}{'xyz'[k]}": (float(f"{s}1") * np.eye(3)[k]) for k in range(3) for s in "+-"}
"""Outward normals of the faces in F0; those that look at the left arm are left out."""
SEATS = {
    f"seat.{k}": CENTRE + (CUBE / 2 + 0.01) * np.array([1.0, y, z])
    for k, (y, z) in enumerate(((0.7, 0.6), (-0.8, 0.1), (0.3, -0.7)), start=1)
}
"""Centres of the ball in its seats on the cube, in F0, m."""
USED = ("cube.+x", "cube.+y", "cube.-y", "cube.+z", "cube.-z")


def _numbers(values: np.ndarray | tuple[float, ...]) -> str:
    return " ".join(repr(float(v)) for v in values)


def cell(places: dict[str, tuple[np.ndarray, np.ndarray]] | None = None) -> str:
    """The URDF of the cell; `places`: displacements of joints by name, m and rotation vectors, rad."""
    parts = ['<link name="stand"/>']
    for side in SIDES:
        before = "stand"
        for k, (origin, axis, mass, centre) in enumerate(ROWS, start=1):
            name, turn = f"{side}_j{k}", Rotation.identity()
            if k == 1:
                at, rpy = STANDS[side]
                origin, turn = (
                    tuple(np.add(at, Rotation.from_euler("xyz", rpy).apply(origin))),
                    Rotation.from_euler("xyz", rpy),
                )
            shift, vector = (places or {}).get(name, (np.zeros(3), np.zeros(3)))
            turn = turn * Rotation.from_rotvec(vector)
            parts += [
                f'<link name="{side}_{k}"><inertial><origin xyz="{_numbers(centre)}"/><mass value="{mass}"/>'
                '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>',
                f'<joint name="{name}" type="revolute"><origin xyz="{_numbers(np.add(origin, shift))}" '
                f'rpy="{_numbers(turn.as_euler("xyz"))}"/><parent link="{before}"/><child link="{side}_{k}"/>'
                f'<axis xyz="{_numbers(axis)}"/>{LIMITS}</joint>',
            ]
            before = f"{side}_{k}"
        parts += [
            f'<link name="{side}_flange"/><joint name="{side}_end" type="fixed"><origin xyz="0.05 0 0" '
            f'rpy="{_numbers(TWIST)}"/><parent link="{before}"/><child link="{side}_flange"/></joint>'
        ]
    return '<robot name="two-arms">' + "\n".join(parts) + "</robot>\n"


@dataclass
class Cell:
    """A cell in MuJoCo, by the text of its URDF, with what the flanges carry, at readings (12,), rad."""

    model: mujoco.MjModel
    data: mujoco.MjData = field(init=False)
    compliance: np.ndarray = field(default_factory=lambda: np.zeros(12))
    waves: dict[str, tuple[float, float]] = field(default_factory=dict)  # joint: amplitude, phase, rad
    names: tuple[str, ...] = tuple(f"{side}_j{k}" for side in SIDES for k in range(1, 7))

    def __post_init__(self) -> None:
        """Allocate MuJoCo's state; joints are in its order."""
        self.data = mujoco.MjData(self.model)
        assert [self.model.joint(k).name for k in range(12)] == list(self.names)

    def stand(self, q: np.ndarray) -> None:
        """Move to readings, and to rest."""
        wave = np.array([a * np.sin(x + p) for x, (a, p) in zip(q, map(self._wave, self.names), strict=True)])
        pull = np.zeros(12)  # that holds the arm against gravity
        for _ in range(4 if self.compliance.any() else 0):
            self.data.qpos[:] = q + wave - self.compliance * pull
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_rne(self.model, self.data, 0, pull)
        self.data.qpos[:] = q + wave - self.compliance * pull
        mujoco.mj_kinematics(self.model, self.data)

    def _wave(self, name: str) -> tuple[float, float]:
        return self.waves.get(name, (0.0, 0.0))

    def ball(self, q: np.ndarray) -> np.ndarray:
        """Place of the ball's centre in F0, the left flange, (3,), m."""
        self.stand(q)
        (left, a), (right, b) = (self._flange(side) for side in SIDES)
        return np.asarray(left.T @ (right @ BALL + b - a))

    def stylus(self) -> np.ndarray:
        """Direction of the stylus in F0, (3,)."""
        (left, _), (right, _) = (self._flange(side) for side in SIDES)
        return np.asarray(left.T @ right @ BALL / np.linalg.norm(BALL))

    def slope(self, q: np.ndarray) -> np.ndarray:
        """Derivatives (6, 12) of the place of the ball and of the stylus in F0 by the joints of a rigid cell.

        Those of the left joints are of the place in the world, and are not to be used.
        """
        self.stand(q)
        mujoco.mj_comPos(self.model, self.data)
        (left, _), (right, place) = (self._flange(side) for side in SIDES)
        moves, turns = np.zeros((3, 12)), np.zeros((3, 12))
        body = self.data.body("right_flange").id
        mujoco.mj_jac(self.model, self.data, moves, turns, right @ BALL + place, body)
        stylus = right @ BALL / np.linalg.norm(BALL)
        return np.asarray(np.concatenate([left.T @ moves, left.T @ np.cross(turns.T, stylus).T]))

    def _flange(self, side: str) -> tuple[np.ndarray, np.ndarray]:
        body = self.data.body(f"{side}_flange")
        return body.xmat.reshape(3, 3), body.xpos


def in_mujoco(text: str, **options: object) -> Cell:
    """The cell of a URDF, loaded with cube and probe."""
    compiler = '<mujoco><compiler fusestatic="false" inertiafromgeom="false"/></mujoco>'
    root = ET.fromstring(text.replace('<robot name="two-arms">', f'<robot name="two-arms">{compiler}'))
    for side, mass, centre in (("left", CUBE_MASS, CENTRE), ("right", PROBE_MASS, BALL)):
        flange = next(link for link in root.iter("link") if link.get("name") == f"{side}_flange")
        inertial = f'<inertial><origin xyz="{_numbers(centre)}"/><mass value="{mass}"/>'
        inertial += '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
        flange.append(ET.fromstring(inertial))
    return Cell(mujoco.MjModel.from_xml_string(ET.tostring(root, "unicode")), **options)  # type: ignore[arg-type]


def displacements(rng: np.random.Generator) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Draw the errors of a true cell: each joint 0.3 mm and 0.5 mrad per axis."""
    names = [f"{side}_j{k}" for side in SIDES for k in range(1, 7)]
    return {name: (3e-4 * rng.standard_normal(3), 5e-4 * rng.standard_normal(3)) for name in names}


def contacts(rng: np.random.Generator, ideal: Cell, names: tuple[str, ...]) -> Iterator[np.ndarray]:
    """Nominal readings (12,) at which the ball touches each of some targets, all over the workspace."""
    for name in names:
        normal = FACES.get(name, np.array([1.0, 0.0, 0.0]))
        while True:
            left, guess = rng.uniform(-1.6, 1.6, 6), rng.uniform(-1.6, 1.6, 6)
            point = SEATS.get(name, CENTRE + (CUBE / 2 + RADIUS) * normal)
            point = point + (name in FACES) * 0.045 * rng.uniform(-1, 1, 3) * (normal == 0)
            ideal.stand(np.concatenate([left, guess]))
            apart = ideal.data.body("left_flange").xpos - ideal.data.body("right_1").xpos
            if np.linalg.norm(apart) > REACH:
                continue
            q = _reached(ideal, left, guess, point, normal)
            if q is not None:
                yield q
                break


def _reached(
    ideal: Cell, left: np.ndarray, right: np.ndarray, point: np.ndarray, normal: np.ndarray
) -> np.ndarray | None:
    """Readings at which the ball is at a point, with the stylus against a normal; None if there are none.

    Damped least squares from `right` (6,), at the end without the direction of the stylus.
    """
    for turn in (*20 * [0.03], *6 * [0.0]):
        q = np.concatenate([left, right])
        slope = ideal.slope(q)[:, 6:] * np.repeat([1.0, turn], 3)[:, None]
        missed = np.concatenate([ideal.ball(q) - point, turn * (ideal.stylus() + normal)])
        step = slope.T @ np.linalg.solve(slope @ slope.T + 1e-6 * np.eye(6), missed)
        right = right - step * min(1.0, 0.5 / np.linalg.norm(step))
    q = np.concatenate([left, right])
    good = np.abs(ideal.ball(q) - point).max() < 1e-7 and ideal.stylus() @ normal < -0.5
    return q if good and np.abs(q).max() < 3.0 else None


def touching(true: Cell, q: np.ndarray, name: str, off: np.ndarray) -> np.ndarray:
    """The readings nearest to q at which the ball of the true cell misses a target by `off` (3,), m."""

    def miss(q: np.ndarray) -> np.ndarray:
        if name in SEATS:
            return true.ball(q) - SEATS[name] - off
        return np.atleast_1d(FACES[name] @ (true.ball(q) - CENTRE) - CUBE / 2 - RADIUS - off[0])

    step = 1e-5
    for _ in range(4):
        slope = np.column_stack([(miss(q + h) - miss(q - h)) / (2 * step) for h in step * np.eye(12)])
        q = q - np.linalg.pinv(slope) @ miss(q)
    return q


def make(
    seed: int, count: int = 200, later: int = 40, seats: bool = False, **hidden: object
) -> tuple[dict[str, str], Cell]:
    """The files of a session, and the true cell; columns are in the order of the chain from the cube.

    With `seats` the ball also sits in three of them on the cube: both arms hold it.
    """
    rng = np.random.default_rng([seed, 11])
    spread = np.exp(0.3 * rng.standard_normal(12))
    options = {"compliance": spread * np.tile(COMPLIANCE, 2), **hidden}
    true = in_mujoco(cell(displacements(rng)), **options)
    names = tuple(rng.choice([*USED, *SEATS] if seats else USED, count + later).tolist())
    rows = []
    for k, (name, q) in enumerate(zip(names, contacts(rng, in_mujoco(cell()), names), strict=True)):
        q = np.degrees(touching(true, q, name, NOISE * rng.standard_normal(3)))
        role = "calibrate" if k < count else "validate"
        rows.append(f"c{k:04d},{role},{name}," + ",".join(f"{x:.7f}" for x in (*q[5::-1], *q[6:])))
    head = "id,role,target," + ",".join(f"j{k}_deg" for k in range(1, 13))
    table = "\n".join([head, *rows]) + "\n"
    return {"cell.urdf": cell(), "measurements.csv": table, "dataset.yaml": _settings(seats)}, true


def _settings(seats: bool) -> str:
    mm = {"ball": BALL * 1e3, "cube": CENTRE * 1e3}
    faces = "".join(
        f"  {face}: {{kind: plane, normal: {n.tolist()}, offset_mm: {1e3 * (n @ CENTRE + CUBE / 2):.6f}}}\n"
        for face, n in ((face, FACES[face]) for face in USED)
    )
    mounted = "".join(
        f"  {name}: {{kind: fixed-point, centre_mm: {(1e3 * at).tolist()}}}\n" for name, at in SEATS.items()
    )
    edge = f"distance_mm: {1e3 * CUBE}, u_distance_mm: 0.001, u_angle_rad: 1.0e-5"
    return f"""schema: bayescal-dataset/1
name: two-arms
robot: cell.urdf#left_flange..right_flange
readings: encoder
gravity_mps2: [0, 0, -9.81]
tools:
  ball: {{centre_mm: {mm["ball"].tolist()}, ball_radius_mm: {1e3 * RADIUS}, mass_kg: {PROBE_MASS}}}
held: {{mass_kg: {CUBE_MASS}, centre_of_mass_mm: {mm["cube"].tolist()}}}
noise: {{contact_mm: {1e3 * NOISE}}}
targets:
{faces}{mounted if seats else ""}certificates:
  - {{kind: parallel, faces: [cube.+y, cube.-y], {edge}}}
  - {{kind: parallel, faces: [cube.+z, cube.-z], {edge}}}
"""
