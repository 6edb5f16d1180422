"""Simulated sessions: any arm with any effects, on a cube and spheres, with their ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Dataset
from bayescal.errors import BayescalError
from bayescal.robots import load_robot, only_one_arm
from bayescal.simulation.record import Simulated, distance_certificates, document, draws, noise, true_targets
from bayescal.simulation.session import Options, plan
from bayescal.simulation.touch import World, misstated, touch
from bayescal.statistics import stream

__all__ = ["Options", "Simulation", "simulate"]

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
    return Simulation(
        dataset, document(options, dataset, world.model(exact), world.targets, gross), world, exact, shift
    )
