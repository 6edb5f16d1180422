"""The maker of sessions in memory: an LR Mate with known errors, and simulated sessions; and changes of them.

The truth of `cube` and `tracker` is made without the effects under test: a robot whose DH table is wrong, an
angle more where two axes should be parallel, joints that turn by torque times compliance, a cube that is
slightly turned.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bayescal.arm.chain import Robot, chain_of, link_angles, points, wrenches
from bayescal.arm.inverse import LEVER, descend, to_points
from bayescal.arm.motion import NominalArm
from bayescal.arm.statics import gravity_loads
from bayescal.arm.transforms import rigid, rotation, rpy_matrix
from bayescal.dataset import Certificate, Dataset, Measurements, Noise, Target, Tool
from bayescal.effects import Circumstances
from bayescal.model.scene import Scene
from bayescal.robots import load_robot
from bayescal.simulation import Options, Simulation, simulate

GRAVITY = np.array([0.0, 0.0, -9.81])
CENTRE, SIDE, RADIUS = np.array([0.45, 0.0, 0.15]), 0.2286, 3e-3
FACES = {"cube.+y": (0, 1, 0), "cube.-y": (0, -1, 0), "cube.-x": (-1, 0, 0), "cube.+z": (0, 0, 1)}
SQUARE = (("cube.+y", "cube.-x"), ("cube.+y", "cube.+z"), ("cube.-x", "cube.+z"))
TOOL = Tool("ball", np.array([0.06, 0, 0.12]), RADIUS, 0.8, np.array([0.02, 0, 0.06]))
U_ANGLE, U_DISTANCE = 1.2e-5, 3e-6
TYPICAL = (0.0, 3e-5, 2e-4, 2e-3, 2e-3, 2e-3)  # compliances, rad/(N m)


@dataclass(frozen=True)
class Arm:
    """The true arm: its wrong table, `beta` behind joint 2, compliances and ball."""

    drawing: Robot
    robot: Robot
    beta: float
    compliance: np.ndarray
    tool: np.ndarray

    def angles(self, readings: np.ndarray, payload: np.ndarray) -> np.ndarray:
        """True link angles (C, n): with the sag of every joint under the weights of the drawing."""
        load = np.broadcast_to(TOOL.centre_of_mass, (len(readings), 3))
        q = link_angles(self.drawing, readings)
        loads = gravity_loads(self.drawing, chain_of(self.drawing), q, GRAVITY, TOOL.mass + payload, load)
        return link_angles(self.robot, readings) + self.compliance * loads.moments[:, 1:, 2]

    def _delta(self, count: int) -> np.ndarray:
        delta = np.zeros((count, self.robot.n + 2, 6))
        delta[:, 2, 4] = self.beta
        return delta

    def points(self, readings: np.ndarray, payload: np.ndarray) -> np.ndarray:
        q = self.angles(readings, payload)
        return points(chain_of(self.robot), q, self.tool, self._delta(len(q)))

    def gradient(self, readings: np.ndarray, payload: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Derivatives (C, n) of u . p by the readings."""
        q = self.angles(readings, payload)
        tool = np.broadcast_to(self.tool, (len(q), 3))
        back = wrenches(chain_of(self.robot), q, tool, self._delta(len(q)), u)
        return back[:, 1:-1, 0] @ self.robot.link_from_reading

    def driven(self, readings: np.ndarray, payload: np.ndarray, residual, joints: int = 3, to: float = 1e-9):
        """Readings (C, n) turned about the first joints until a residual of the ball is zero, and which did.

        `residual(p (M, 3), which (M,))` -> r (M, k), m, and its gradients u (M, k, 3) by p.
        """

        def task(q: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            r, u = residual(self.points(q, payload[which]), which)
            by = np.stack([self.gradient(q, payload[which], u[:, k]) for k in range(u.shape[1])], axis=1)
            return -r / LEVER, by / LEVER, np.abs(r).max(axis=1) < to

        anywhere = np.full(self.robot.n, np.inf)
        return descend(task, readings, -anywhere, anywhere, free=np.arange(self.robot.n) < joints)

    @property
    def values(self) -> dict[str, float]:
        """True values, SI, under the names that a model gives to its parameters."""
        r = self.robot
        out = {"beta2": self.beta}
        for i in range(1, 6):
            out |= {f"theta{i}": r.offset[i - 1], f"d{i}": r.d[i - 1]}
            out |= {f"a{i}": r.a[i], f"alpha{i}": r.alpha[i]}
        out |= {f"compliance {name}": c for name, c in zip(r.joint_names, self.compliance, strict=True)}
        return out | {f"ball {axis}": self.tool[k] for k, axis in enumerate("xyz")}


def true_arm(robot: Robot, rng: np.random.Generator, spread: float) -> Arm:
    """An arm drawn from the tolerances of small arms, times `spread`."""

    def off(sd: float, which: list[int]) -> np.ndarray:
        out = np.zeros(6)
        out[which] = spread * sd * rng.standard_normal(len(which))
        return out

    a, alpha = robot.a + off(0.3e-3, [1, 2, 3, 4, 5]), robot.alpha + off(1e-3, [1, 2, 3, 4, 5])
    d, offset = robot.d + off(0.3e-3, [1, 2, 3, 4]), robot.offset + off(2e-3, [1, 2, 3, 4])
    wrong = replace(robot, a=a, alpha=alpha, d=d, offset=offset)
    compliance = np.array(TYPICAL) * np.exp(0.5 * rng.standard_normal(6))
    tool = TOOL.centre + spread * 1e-3 * rng.standard_normal(3)
    return Arm(robot, wrong, spread * 1e-3 * rng.standard_normal(), compliance, tool)


def reach(robot: Robot, goals: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Readings of the drawing whose ball is at the goals (C, 3) under random wrists, and which were found."""
    drawn = NominalArm(robot, TOOL.centre)
    wrist = rng.uniform([-30, -10, -60, -170, -110, -170], [30, 40, 0, 170, 110, 170], (len(goals), 6))
    starts = drawn.angles_of(np.radians(wrist))
    anywhere = np.full(6, np.inf)
    angles, found = descend(to_points(drawn, goals), starts, -anywhere, anywhere, free=np.arange(6) < 3)
    readings = drawn.readings_of(angles)
    return readings, found & np.all(np.abs(readings[:, :3]) < np.radians([170, 120, 160]), axis=1)


def _some(robot: Robot, goals, count: int, rng: np.random.Generator) -> np.ndarray:
    """`count` readings whose ball reaches points drawn by goals(number)."""
    readings, found = reach(robot, goals(3 * count // 2 + 20), rng)
    assert found.sum() >= count
    return readings[found][:count]


def measurements(
    rng: np.random.Generator, readings: np.ndarray, target: np.ndarray, payload: np.ndarray
) -> Measurements:
    """A table with every column that an effect may ask for."""
    count = len(readings)
    return Measurements(
        ids=tuple(f"c{k}" for k in range(count)),
        role=np.full(count, "calibrate"),
        target=target,
        tool=np.zeros(count, int),
        readings=readings,
        line=np.arange(2, count + 2),
        velocity=np.radians(rng.uniform(-1, 1, readings.shape)),
        command=readings,
        torque=rng.uniform(-5, 5, readings.shape),
        time=10.0 * np.arange(count),
        temperature=20 + 4 * np.sin(np.arange(count) / 30.0),
        payload=payload,
    )


@cache
def cube(
    seed: int = 0,
    count: int = 120,
    noise: float = 5e-6,
    stated: float | None = None,
    spread: float = 1.0,
    outliers: int = 0,
    joint: float = 0.0,
    lean: tuple[float, float] = (0.0, 0.0),
) -> SimpleNamespace:
    """Contacts with four faces of a cube.

    `noise` is that of a contact, m, `stated` what the session says of it; `joint` that of a reading,
    rad; `outliers` of the contacts are 8 to 100 times the noise off. Face -y leans about x and z by
    `lean`, rad, more than its paper says. Returns `dataset`, the `arm`, true `planes` (normal, offset) by
    name and `outliers`.
    """
    rng = np.random.default_rng(seed)
    robot, _ = load_robot("fanuc-lrmate200ic")
    robot = replace(robot, reductions=np.array([120.0, 121, 100, 100, 50, 50]))
    arm = true_arm(robot, rng, spread)
    turn, shift = rpy_matrix(2e-3 * rng.standard_normal(3)), 1e-3 * rng.standard_normal(3)
    targets, planes, readings, target = [], {}, [], []
    for k, (name, direction) in enumerate(FACES.items()):
        normal = np.array(direction, float)
        targets.append(Target(name, "plane", {"normal": normal, "offset": float(normal @ CENTRE + SIDE / 2)}))
        crooked = rpy_matrix(U_ANGLE / 2 * rng.standard_normal(3)) @ turn @ normal
        if name == "cube.-y":
            crooked = rotation(0, lean[0]) @ rotation(2, lean[1]) @ crooked
        through = CENTRE + shift + turn @ normal * (SIDE / 2 + U_DISTANCE / 2 * rng.standard_normal())
        planes[name] = (crooked, float(crooked @ through))
        mine = count // 4 + (k < count % 4)

        def goals(number: int, normal: np.ndarray = normal) -> np.ndarray:
            across = rng.uniform(-0.09, 0.09, (number, 3)) * (normal == 0)
            return CENTRE + across + normal * (SIDE / 2 + RADIUS)

        readings.append(_some(robot, goals, mine, rng))
        target += [k] * mine
    readings, target = np.concatenate(readings), np.array(target)
    order = rng.permutation(count)
    readings, target = readings[order], target[order]
    payload = np.where(np.arange(count) % 3 == 0, 0.5, 0.0)
    gap = noise * rng.standard_normal(count)
    bad = np.sort(rng.choice(count, outliers, replace=False))
    gap[bad] += noise * np.geomspace(8, 100, outliers) * rng.choice([-1, 1], outliers)
    normals = np.array([planes[t.name][0] for t in targets])[target]
    offsets = np.array([planes[t.name][1] for t in targets])[target]
    readings, closed = arm.driven(
        readings,
        payload,
        lambda p, which: (
            (np.sum(normals[which] * p, axis=1) - (offsets + RADIUS + gap)[which])[:, None],
            normals[which, None],
        ),
        to=1e-12,
    )
    assert np.all(closed)
    readings = readings + joint * rng.standard_normal(readings.shape)
    certificates = [Certificate("parallel", ("cube.+y", "cube.-y"), SIDE, U_DISTANCE, U_ANGLE)]
    certificates += [Certificate("perpendicular", pair, u_angle=U_ANGLE) for pair in SQUARE]
    dataset = Dataset(
        f"cube-{seed}", Path(), robot, "fanuc-lrmate200ic", "encoder", GRAVITY, (TOOL,),
        Noise(contact=noise if stated is None else stated, joint=joint), tuple(targets), tuple(certificates),
        measurements(rng, readings, target, payload), "arm",
    )  # fmt: skip
    return SimpleNamespace(dataset=dataset, arm=arm, planes=planes, outliers=bad)


@cache
def tracker(seed: int = 0, count: int = 100, noise: float = 10e-6, spread: float = 1.0) -> SimpleNamespace:
    """Points of a reflector, read by an instrument two metres away that is not quite where drawn."""
    rng = np.random.default_rng(seed)
    robot, _ = load_robot("fanuc-lrmate200ic")
    arm = true_arm(robot, rng, spread)

    def goals(number: int) -> np.ndarray:
        return np.array([0.45, 0.0, 0.3]) + rng.uniform(-0.2, 0.2, (number, 3))

    readings = _some(robot, goals, count, rng)
    xyz, rpy = np.array([2.0, 0.3, 0.5]), np.radians([5.0, -3.0, 170.0])
    frame = rigid(rpy_matrix(rpy), xyz)
    true = rigid(rotation(2, 4e-3) @ rotation(0, -2e-3), np.array([2e-3, -1e-3, 3e-3])) @ frame
    payload = np.zeros(count)
    exact = (arm.points(readings, payload) - true[:3, 3]) @ true[:3, :3]
    read = exact + noise * rng.standard_normal((count, 3))
    table = replace(measurements(rng, readings, np.zeros(count, int), payload), xyz=read)
    dataset = Dataset(
        f"tracker-{seed}", Path(), robot, "fanuc-lrmate200ic", "encoder", GRAVITY, (TOOL,),
        Noise(point=noise),
        (Target("tracker", "instrument", {"xyz": xyz, "rpy": rpy}),), (), table,
    )  # fmt: skip
    return SimpleNamespace(dataset=dataset, arm=arm, frame=true, exact=exact)


def raised(session: Dataset, by: Callable) -> Dataset:
    """The session whose contacts on +y are off by by(face) (N,), m, along its normal."""
    scene = Scene(session)
    face = next(f for f in scene.circumstances(scene.rows("calibrate")).faces if f.name == "cube.+y")
    # turning J1 moves a contact on +y along the normal by its x
    return misread(session, 1, by(face) * face.rows / scene.points[:, 0])


def rough(session: Dataset, amount: float) -> Dataset:
    """The session with noise of an amount, m, on +y."""
    return raised(session, lambda face: amount * np.random.default_rng(4).standard_normal(len(face.rows)))


def bulging(session: Dataset, amount: float) -> Dataset:
    """The session with +y bulging by an amount, m."""
    return raised(session, lambda face: amount * (1 - np.sum(face.place**2, axis=1)))


def reflectors(shared: float, seed: int, wave: float = 0.0, stops: int = 20, noise: float = 10e-6) -> Dataset:
    """Three reflectors on the flange at every stop of a nominal arm, and an error `shared`, m, of each stop.

    Joint 1 turns by `wave`, rad, times the sine of twice its reading.
    """
    one = tracker(seed, stops, noise).dataset
    rng = np.random.default_rng(seed)
    centres = TOOL.centre + np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.05, 0.01]])
    tools = tuple(replace(TOOL, name=f"reflector {k}", centre=c) for k, c in enumerate(centres))
    at = np.repeat(np.arange(stops), 3)
    one = plain(with_rows(one, at, tuple(f"r{k}" for k in range(len(at)))))
    dataset = with_columns(replace(one, tools=tools), tool=np.tile(np.arange(3), stops))
    q = dataset.measurements.readings
    true = with_columns(dataset, readings=q + wave * np.sin(2 * q) * (np.arange(6) == 0))
    points = Scene(true).points + shared * rng.standard_normal((stops, 3))[at]
    frame = dataset.targets[0].values
    read = (points - frame["xyz"]) @ rpy_matrix(np.asarray(frame["rpy"]))
    return with_columns(dataset, xyz=read + noise * rng.standard_normal(read.shape))


@cache
def simulated(**options: object) -> Simulation:
    """A session by the simulator of bayescal, made once for the same options."""
    return simulate(Options(**options))  # type: ignore[arg-type]


LITTLE = {"contacts": 60, "later": 12, "repeats": 3, "placements": 1, "sphere_contacts": 10}


def little(**options: object) -> Simulation:
    """A little session of the built-in arm."""
    return simulated(**(LITTLE | {"seed": 4} | options))


def circumstances(session: Dataset | Scene) -> Circumstances:
    """What the effects of a session may depend on, at its rows to calibrate."""
    scene = session if isinstance(session, Scene) else Scene(session)
    return scene.circumstances(scene.rows("calibrate"))


def with_columns(dataset: Dataset, **columns: object) -> Dataset:
    """The session with other columns of its table; None is an absent one."""
    return replace(dataset, measurements=replace(dataset.measurements, **columns))


def with_rows(dataset: Dataset, rows: np.ndarray, ids: tuple[str, ...] = ()) -> Dataset:
    """The session with some of its rows, in their order, under other ids if such are given."""
    m = dataset.measurements
    columns = {f.name: getattr(m, f.name) for f in fields(m) if getattr(m, f.name) is not None}
    columns |= {name: np.asarray(column)[rows] for name, column in columns.items()}
    columns |= {"ids": ids or tuple(columns["ids"].tolist()), "line": np.arange(2, len(rows) + 2)}
    return replace(dataset, measurements=Measurements(**columns))


def of_targets(dataset: Dataset, *names: str) -> Dataset:
    """A session without rows, with some of its targets and their certificates."""
    targets = tuple(t for t in dataset.targets if t.name in names)
    certificates = tuple(c for c in dataset.certificates if {*c.targets} <= {*names})
    return replace(dataset, targets=targets, certificates=certificates)


def geared(dataset: Dataset) -> Dataset:
    """The session of a robot whose gear ratios are known: a diagnosis scans none."""
    return replace(dataset, robot=replace(dataset.robot, reductions=np.full(dataset.robot.n, 100.0)))


def plain(dataset: Dataset) -> Dataset:
    """The same, with no columns of time, motion and temperature: a diagnosis has fewest candidates."""
    absent = dict.fromkeys(("velocity", "command", "torque", "time", "temperature"))
    return with_columns(geared(dataset), **absent)


def wavy(dataset: Dataset) -> Dataset:
    """The session with a wave of joint 5 that no geometry absorbs."""
    wave = 1e-3 * np.sin(2 * dataset.measurements.readings[:, 4])
    return with_columns(misread(geared(dataset), 5, wave), command=None)


def validating(dataset: Dataset, every: int) -> Dataset:
    """The session with one row in `every` kept for validation, from the first on."""
    rows = np.arange(len(dataset.measurements.ids))
    return with_columns(dataset, role=np.where(rows % every == 0, "validate", "calibrate"))


def kept_back(dataset: Dataset, count: int) -> Dataset:
    """The session with the last `count` rows kept for validation."""
    role = dataset.measurements.role.copy()
    role[-count:] = "validate"
    return with_columns(dataset, role=role)


def misread(dataset: Dataset, joint: int, error: np.ndarray | float, rows: object = slice(None)) -> Dataset:
    """The session with readings of a joint (from 1) wrong by an error, rad, in some rows."""
    readings = dataset.measurements.readings.copy()
    readings[rows, joint - 1] += error
    return with_columns(dataset, readings=readings)
