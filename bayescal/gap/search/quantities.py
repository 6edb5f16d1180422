"""Quantities of a session on which an error may depend, with functions of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.arm import chain as reference
from bayescal.arm.statics import gravity_in_f0
from bayescal.effects import Circumstances
from bayescal.effects.common import by_reading, sense
from bayescal.effects.location import Driver
from bayescal.estimate.families import cosines, unit_range
from bayescal.gap.settings import RELATIVES
from bayescal.statistics import rms


@dataclass(frozen=True)
class Argument:
    """A quantity of the session, with functions of it."""

    driver: Driver
    functions: np.ndarray  # (N, k) smooth ones, which modulate a prediction
    factors: np.ndarray  # (N, m) positive ones, in proportion to which an error may be


def arguments(c: Circumstances) -> tuple[Argument, ...]:
    """All quantities of a session on which an error may depend, those that vary over its fitted rows."""
    return tuple(
        Argument(driver, np.column_stack(values), np.column_stack([np.empty((len(c.q), 0)), *factors]))
        for driver, values, factors in _functions(c)
        if values
    )


def at_tool(c: Circumstances) -> np.ndarray:
    """Direction of gravity in the frame of the flange, (N, 3); 0 without gravity."""
    pose = reference.frames(c.chain, c.q)
    down = gravity_in_f0(c.chain, pose, c.gravity / max(float(np.linalg.norm(c.gravity)), 1e-300))
    return np.asarray((pose[:, -1, :3, :3].swapaxes(1, 2) @ down[..., None])[..., 0])


def _functions(c: Circumstances) -> Iterator[tuple[Driver, list[np.ndarray], list[np.ndarray]]]:
    fitted, waves = c.fitted, RELATIVES.waves
    for j in range(1, c.robot.n + 1):
        angle = c.readings[:, j - 1]
        yield by_reading(c.robot, j), cosines(angle, fitted, waves), _ends(angle, fitted)
        if c.torques is not None and np.ptp(c.torques[fitted, j - 1]) > 1e-3:
            load = c.torques[:, j - 1] / rms(c.torques[fitted, j - 1])
            yield Driver("torque", j), cosines(load, fitted, waves), [np.abs(load), *_ends(load, fitted)]
        if c.velocity is not None and np.any(c.velocity[fitted, j - 1]):
            speed, way = np.abs(c.velocity[:, j - 1]), sense(c.velocity[:, j - 1])
            yield Driver("direction", j), [way], [(1.0 + way) / 2, (1.0 - way) / 2]
            yield Driver("joint speed", j), cosines(speed, fitted, 2), [speed / rms(speed[fitted])]
    clock = np.arange(len(c.q), dtype=float) if c.time is None else c.time
    yield Driver("time"), cosines(clock, fitted, waves), _ends(clock, fitted)
    if c.temperature is not None:
        yield Driver("temperature"), cosines(c.temperature, fitted, 2), _ends(c.temperature, fitted)
    place = reference.points(c.chain, c.q, c.tool_centres[c.tool])
    ends = [f for x in place.T for f in _ends(x, fitted)]
    yield Driver("workspace"), [f for x in place.T for f in cosines(x, fitted, 1)], ends
    if np.any(c.touching):
        normal = list(np.where(c.touching[:, None], c.approach, 0.0).T)
        yield Driver("contact direction"), normal, [f for x in normal for f in _ends(x, fitted)]


def _ends(x: np.ndarray, fitted: np.ndarray) -> list[np.ndarray]:
    """Straight lines from 0 at one end of the range of a coordinate x (N,) to 1 at the other, both ways."""
    u = unit_range(x, fitted)
    return [] if u is None else [u, 1.0 - u]
