"""Joint logs of an arm of two joints with known delays, filters and mistakes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import yaml

ROBOT = {
    "joints": [
        {"name": "J1", "origin_mm": [0, 0, 100], "rpy_deg": [90, 0, 0], "axis": [0, 0, 1], "gear_ratio": 100,
         "mass_kg": 5.0, "centre_of_mass_mm": [200, 0, 0], "inertia_kgm2": [0.01, 0.1, 0.1, 0, 0, 0]},
        {"name": "J2", "origin_mm": [400, 0, 0], "rpy_deg": [0, 0, 0], "axis": [0, 0, 1], "gear_ratio": 100,
         "mass_kg": 2.0, "centre_of_mass_mm": [150, 0, 0], "inertia_kgm2": [0.01, 0.05, 0.05, 0, 0, 0]},
    ],
}  # fmt: skip
GRAVITY = 9.81
LOADS = (0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0)
KINDS = ("excitation",) * 5 + ("pick",) * 2
SAME = (1, 2, 1, 4, 1, 6, 7)


def sines(seed: int, time: np.ndarray, amplitude: float = 0.8) -> np.ndarray:
    rng = np.random.default_rng(seed)
    edge = np.clip(np.minimum(time, time[-1] - time), 0.0, 1.0)[:, None]
    window = edge**3 * (10 - 15 * edge + 6 * edge**2)
    out = np.zeros((len(time), 2))
    for f in (0.15, 0.5, 1.2):
        out += np.sin(2 * np.pi * f * time[:, None] + rng.uniform(0, 6, 2)) / (1 + 2 * f)
    return amplitude * window * out


def planar(q: np.ndarray, v: np.ndarray, a: np.ndarray, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Torques of two links of 0.4 m in a vertical plane; `weight`, N m, is of the second by its lever."""
    coupled = 0.4 * weight / GRAVITY
    cosine, sine = np.cos(q[:, 1]), np.sin(q[:, 1])
    pull = weight * np.cos(q.sum(axis=1))
    second = coupled * (cosine * a[:, 0] + sine * v[:, 0] ** 2) + pull
    first = cosine * (2 * a[:, 0] + a[:, 1]) - sine * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2)
    return coupled * first + pull + 20.0 * np.cos(q[:, 0]), second


def presliding(q: np.ndarray, bristles: float) -> np.ndarray:
    """Friction over its largest, by Dahl: it approaches the direction of motion over a way."""
    out = np.zeros_like(q)
    for k, step in enumerate(np.diff(q, axis=0), 1):
        out[k] = np.sign(step) + (out[k - 1] - np.sign(step)) * np.exp(-np.abs(step) / bristles)
    return out


@cache
def course(
    trajectory: Callable[[int, np.ndarray], np.ndarray], seed: int, end: float, bristles: float
) -> tuple[np.ndarray, ...]:
    """Times, and positions, velocities, accelerations and friction over its largest at them."""
    time = np.arange(0.0, end, 1e-3)
    q = trajectory(seed, time)
    v = np.gradient(q, 1e-3, axis=0)
    way = presliding(q, bristles) if bristles else np.tanh(v / 0.03)
    return time, q, v, np.gradient(v, 1e-3, axis=0), way


@dataclass
class Made:
    """Rows by column, in the units of motion.csv, and the settings: what a test changes."""

    columns: dict[str, np.ndarray]
    settings: dict
    motion: np.ndarray

    def of(self, motion: int) -> np.ndarray:
        return np.flatnonzero(self.motion == motion)


def made(
    delay: Sequence[float] = (0.0, 0.0),
    velocity: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    lag: float = 0.0,
    step: float = 0.008,
    length: float = 10.5,
    motions: int = 7,
    trajectory: Callable[[int, np.ndarray], np.ndarray] = sines,
    stamps: Callable[[np.ndarray], np.ndarray] = lambda time: time,
    bristles: float = 0.0,
) -> Made:
    """A log: `delay` of each torque, `lag` of positions behind commands, s; `velocity` from the true one.

    `bristles`, rad, is the way over which friction reverses (Dahl); at 0 it is a function of speed.
    """
    rng = np.random.default_rng(3)
    parts = []
    for k in range(motions):
        time = stamps(np.arange(0.0, length, step))

        def at(t, seed=SAME[k]):
            fine, *values = course(trajectory, seed, length + step, bristles)
            return tuple(np.column_stack([np.interp(t, fine, c) for c in x.T]) for x in values)

        q, v, *_ = at(time)
        tau = []
        for j in range(2):
            dq, dv, da, way = at(time - delay[j])
            arm = planar(dq, dv, da, 3.0 * (1 + LOADS[k]))[j]
            tau.append((1.0, 0.6)[j] * da[:, j] + arm + 2.0 * way[:, j] + 1.5 * dv[:, j])
        tau = np.column_stack(tau) + 0.05 * rng.standard_normal(q.shape)
        command = at(time + lag)[0]
        seen = v if velocity is None else velocity(time, v)
        parts.append((k + 1, time + (length + 2.0) * k, q, seen, command, tau))
    number = np.concatenate([np.full(len(p[1]), p[0]) for p in parts])
    columns = {"t_s": np.concatenate([p[1] for p in parts]), "motion": number}
    deg = np.degrees(1.0)
    units = {"q": ("deg", deg), "dq": ("degps", deg), "command": ("deg", deg), "torque": ("Nm", 1.0)}
    for k, (name, (unit, factor)) in enumerate(units.items(), 2):
        values = np.concatenate([p[k] for p in parts]) * factor
        columns |= {f"{name}{j + 1}_{unit}": values[:, j] for j in range(2)}
    columns["temperature_degC"] = 25 + 12 * columns["t_s"] / columns["t_s"][-1]
    keys = ("id", "role", "kind", "same_as", "payload_kg")
    roles = ["validate" if k >= 5 else "calibrate" for k in range(motions)]
    each = [(str(k + 1), roles[k], KINDS[k], str(SAME[k]), LOADS[k]) for k in range(motions)]
    entries = [dict(zip(keys, values, strict=True)) for values in each]
    settings = {"schema": "bayescal-motion/1", "name": "two joints", "robot": ROBOT, "motions": entries}
    return Made(columns, settings, number)


def written(log: Made, folder: Path, **settings: Mapping) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "dataset.yaml").write_text(yaml.safe_dump(log.settings | settings, sort_keys=False))
    row = ",".join(["%.9g"] * len(log.columns)) + "\n"
    lines = map(row.__mod__, zip(*(x.tolist() for x in log.columns.values()), strict=True))
    (folder / "motion.csv").write_text(",".join(log.columns) + "\n" + "".join(lines))
    return folder
