"""Sessions that never were: any arm with any effects, on a cube and spheres, and what is true of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import EFFECTS
from bayescal.errors import BayescalError
from bayescal.robots import load_robot
from bayescal.simulation.options import Options, stream
from bayescal.simulation.record import document
from bayescal.simulation.session import plan
from bayescal.simulation.touch import World, misstated, touch
from bayescal.simulation.truth import distance_certificates, draws, noise, true_targets

__all__ = ["Options", "Simulation", "simulate"]

READING = 7  # decimals of a reading in deg


@dataclass(frozen=True)
class Simulation:
    """A session, what is true of it, and that as the content of truth.json.

    `exact` is the session with readings before joint noise and rounding, `shift` (N,) m how far outside
    of the true surface each of its contacts is.
    """

    dataset: Dataset
    truth: dict[str, Any]
    world: World
    exact: Dataset
    shift: np.ndarray


def simulate(options: Options, allow_xacro: bool = False) -> Simulation:
    """Simulate a session: plan it on the nominal arm, then let the true arm touch the true targets.

    Parameters
    ----------
    options : Options
        One seed, one result.
    allow_xacro : bool
        Whether a robot in a xacro file, which is a program, may be executed; refused otherwise.

    Raises
    ------
    BayescalError
        For options that cannot be, or a workspace out of reach.
    """
    options.check()
    for name in options.effects:
        if (plain := name.partition("@")[0]) not in EFFECTS:
            raise BayescalError(f"no effect is called '{plain}'", "--effects", f"known: {', '.join(EFFECTS)}")
    robot, _ = load_robot(options.robot, allow_xacro=allow_xacro)
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
    read = read + options.joint_noise * stream(options.seed, "joints").normal(size=read.shape)
    read = np.radians(np.round(np.degrees(read), READING))
    dataset = replace(exact, measurements=replace(exact.measurements, readings=read))
    return Simulation(
        dataset, document(options, dataset, world.model(exact), world.targets, gross), world, exact, shift
    )
