"""Fitted arms for tests of exports: random values of all parameters, as large as their priors."""

from dataclasses import replace
from functools import cache

import numpy as np
from sessions import simulated

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.estimate import estimate
from bayescal.exporting.geometry import constant_displacements
from bayescal.fitted.arm import of_estimate
from bayescal.fitted.unmodelled import state_row
from bayescal.model import Scene, build
from bayescal.robots import load_robot


def session_of(robot="fanuc-lrmate200ic", **options):
    """A small simulated session."""
    usual = {"contacts": 40, "later": 6, "repeats": 2, "spheres": 0, "seed": 3, "payload": 1.0}
    return simulated(robot=robot, **(usual | options)).dataset


def with_robot(dataset, robot):
    """The rows of a session as those of another robot, of as many joints."""
    return replace(dataset, robot=robot, robot_reference="robot.yaml")


@cache
def fitted():
    """The estimate whose model and values `fake` replaces."""
    return estimate(build(Scene(session_of()), ("geometry",)))


def fake(session, effects, seed=0, scale=0.7):
    """An arm with random values; physically positive ones are positive."""
    model = build(Scene(session), effects)
    z = scale * np.random.default_rng(seed).standard_normal(model.size)
    positive = [k for k, p in enumerate(model.parameters) if p.positive]
    z[positive] = np.abs(z[positive])
    return of_estimate(replace(fitted(), model=model, z=z), 0.01 * np.eye(model.size))


def robot_of(path, tmp_path):
    """A robot from a file."""
    return load_robot(str(path), tmp_path)[0]


def calibrated_frames(arm, state=None):
    """Frames 0 to n and the flange (C, n + 2, 4, 4), by the constant geometry, in the rows of the session."""
    robot, readings = arm.dataset.robot, arm.dataset.measurements.readings
    delta = constant_displacements(arm.model, arm.values, state_row(arm.dataset, row=state))
    moved = np.tile(delta, (len(readings), 1, 1))
    return frames(chain_of(robot), link_angles(robot, readings), moved)
