"""Simulated sessions: any arm with any effects, on a cube and spheres, with their ground truth.

Contacts are the readings at which the ball of the true arm touches the true surface.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Dataset, Target
from bayescal.errors import BayescalError
from bayescal.model import ARM, Block, Model, arm_at_rest, with_parameters
from bayescal.model.scene import Scene
from bayescal.robots import load_robot, only_one_arm
from bayescal.simulation.record import Simulated, distance_certificates, document, draws, noise, true_targets
from bayescal.simulation.session import Options, plan
from bayescal.statistics import stream
from factors.contacts import Plane

__all__ = ["Options", "Simulation", "World", "misstated", "simulate", "state_of", "touch"]

CLOSED = 1e-12  # m
PASSES = 30
STALLED = 5, 0.95
"""Passes, and the share of the largest distance before them above which no contact will close (assumed: those
that do end in 4 to 8 passes; further away, a pass moves a joint by at most a second of its velocity)."""
CORRECTIONS = 4
STILL = 1e-14  # m: of the deflection by gravity, small enough to close contacts to `CLOSED`


@dataclass(frozen=True)
class World:
    """Ground truth of a session: its effects, the deviations of the arm from nominal, the targets.

    `deviations` gives the deviations of the parameters of a model, (P,), SI.
    """

    effects: tuple[str, ...]
    deviations: Callable[[Model], np.ndarray]
    targets: tuple[Target, ...]

    def model(self, dataset: Dataset, near: Scene | None = None) -> Model:
        """The true arm at the readings of a session, with its drivers, and the true targets.

        Gravity acts at the true, deflected pose, as on a real arm. That pose is searched from the one in
        the scene `near`, of almost the same readings.
        """
        model = arm_at_rest(Scene(dataset), self.effects, self.deviations, STILL, near)
        true = replace(dataset, targets=self.targets)
        return replace(model, scene=replace(model.scene, dataset=true))

    def distances(self, model: Model) -> np.ndarray:
        """Distances (N,), m, of the ball of the true arm from the true surfaces, along their normals."""
        values = self.deviations(model)
        rows = model.scene.dataset.measurements.target
        out = np.empty(len(rows))
        for target in np.unique(rows):
            touching = np.flatnonzero(rows == target)
            block = model.block(int(target), touching)
            out[touching] = block.residual(values, np.zeros(block.size))[0]
        return out


def misstated(world: World, dataset: Dataset) -> World:
    """The world with its faces moved by the smallest amount that gives the certificates their error.

    Certificates refer to faces in their nominal directions, as in a fit.
    """
    arm = world.model(dataset)
    model = with_parameters(Scene(dataset), arm.effects, arm.parameters)
    values = world.deviations(model)
    wrong = [constraint for constraint in model.constraints if len(constraint.index)]
    faces = [b.target for b in model.blocks if isinstance(b.kind, Plane)]
    true = {t.name: t for t in world.targets}
    z = {name: state_of(true[name], model.block_of[name]) for name in faces}
    z |= {ARM: -model.shift / model.sd}
    right = [model.linearised(constraint, z)[0] for constraint in wrong]
    z |= {ARM: (values - model.shift) / model.sd}
    for _ in range(CORRECTIONS if wrong else 0):
        linear = [model.linearised(constraint, z) for constraint in wrong]
        off = np.concatenate([r - before for (r, _), before in zip(linear, right, strict=True)])
        by = [[slopes.get(name, np.zeros((len(r), 3))) for name in faces] for r, slopes in linear]
        steps = np.linalg.lstsq(np.block(by), off, rcond=None)[0].reshape(-1, 3)
        z |= {name: z[name] - step for name, step in zip(faces, steps, strict=True)}
    return replace(world, targets=tuple(_at(t, model, z) if wrong else t for t in world.targets))


def state_of(face: Target, block: Block) -> np.ndarray:
    """A true face as whitened state (3,) of the nominal face."""
    plane, normal = block.kind, np.asarray(face.values["normal"], float)
    assert isinstance(plane, Plane)
    tilt = plane.tangents @ normal / (plane.normal @ normal)
    return np.append(tilt, face.values["offset"] - normal @ plane.pivot) / plane.sd


def _at(target: Target, model: Model, z: Mapping[str, np.ndarray]) -> Target:
    if target.name not in z:
        return target
    block = model.block_of[target.name]
    assert isinstance(block.kind, Plane)
    normal, offset = block.kind.normal_and_offset(block.state(z[target.name]))
    return replace(target, values={"normal": normal, "offset": float(offset)})


def touch(world: World, dataset: Dataset, shift: np.ndarray) -> Dataset:
    """The session with every contact closed: each row moves at its joint velocities until it touches.

    Torques and other drivers of effects are evaluated at the resulting readings.

    Parameters
    ----------
    world : World
        Ground truth.
    dataset : Dataset
        With readings at which the nominal arm touches the nominal targets, and velocities.
    shift : np.ndarray, shape (N,)
        Distance outside of the true surface at which each contact triggers, m: noise and gross errors.

    Returns
    -------
    Dataset
        With readings at which the ball touches the surface, to 1e-12 m.

    Raises
    ------
    BayescalError
        If a contact cannot be closed: the errors are so large that the ball misses the target.
    """
    start, velocity = dataset.measurements.readings, dataset.measurements.velocity
    assert velocity is not None

    near: Scene | None = None

    def after(seconds: np.ndarray) -> tuple[Dataset, np.ndarray]:
        nonlocal near
        readings = start + seconds[:, None] * velocity
        moved = replace(dataset, measurements=replace(dataset.measurements, readings=readings))
        model = world.model(moved, near)
        near = model.scene
        return moved, world.distances(model) - shift

    seconds = np.zeros(len(start))
    moved, off = after(seconds)
    slope = (after(seconds + 1e-3)[1] - off) / 1e-3  # m/s: speed of the ball towards the surface
    largest = [np.inf] * STALLED[0]
    for _ in range(PASSES):
        if np.all(np.abs(off) < CLOSED):
            return moved
        largest.append(float(np.max(np.abs(off))))
        if largest[-1] > STALLED[1] * largest[-1 - STALLED[0]]:
            break
        step = np.clip(-off / slope, -1.0, 1.0)
        seconds = seconds + step
        before = off
        moved, off = after(seconds)
        far = np.abs(step) > 1e-7  # below, the difference is rounding error
        slope = np.where(far, (off - before) / np.where(far, step, 1.0), slope)
        if not np.all(np.isfinite(slope) & (slope != 0)):
            break
    row = int(np.argmax(np.where(np.isfinite(off), np.abs(off), np.inf)))
    name = dataset.targets[dataset.measurements.target[row]].name
    what = f"the arm with its errors does not touch {name}"
    raise BayescalError(what, dataset.name, "give a smaller --error-scale, or another --seed")


READING = 7  # decimals of a reading in deg


@dataclass(frozen=True)
class Simulation(Simulated):
    """A session with its ground truth.

    `exact` is the session with readings before joint noise and rounding; `shift` (N,), m, is the distance of
    each contact from the true surface, outwards.
    """

    world: World
    exact: Dataset
    shift: np.ndarray


def simulate(options: Options, robot: Robot | None = None) -> Simulation:
    """Simulate a session: plan it with the nominal arm, then compute contacts of the true arm and targets.

    Parameters
    ----------
    options : Options
        The same seed gives the same result.
    robot : Robot, optional
        In place of the one that the options name.

    Raises
    ------
    BayescalError
        For invalid options, or a workspace out of reach.
    """
    options.check()
    robot = robot or load_robot(options.robot)[0]
    only_one_arm(robot, "simulated sessions")
    planned, scenery = plan(options, robot)
    targets = true_targets(options, scenery)
    certificates = (*planned.certificates, *distance_certificates(options, scenery, targets))
    planned = replace(planned, certificates=certificates)
    world = World(options.effects, lambda model: draws(options, model), targets)
    try:
        world = misstated(world, planned)
    except BayescalError as error:
        raise BayescalError(error.what, "--effects", error.remedy) from None
    shift, gross = noise(options, len(planned.measurements.ids))
    exact = touch(world, planned, shift)
    read = exact.measurements.readings
    noisy = np.where(robot.slides, 0.0, options.joint_noise)  # of revolute joints
    read = read + noisy * stream(options.seed, "joints").normal(size=read.shape)
    read = robot.read(np.round(robot.shown(read), READING))
    dataset = replace(exact, measurements=replace(exact.measurements, readings=read))
    truth = document(options, dataset, world.model(exact), world.targets, gross)
    return Simulation(dataset, truth, world, exact, shift)
