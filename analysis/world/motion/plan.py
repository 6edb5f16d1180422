"""The motions of a log: excitation, slow crossings, pick and place; when, with which load, and how warm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.world.motion.arms import Arm

Path = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Positions, velocities and accelerations (rows, n) at times since the start of a motion (rows,), s."""
EASE = 1.0
"""Time in which an excitation fades in, and out, s."""
LOADS = ("none", "after", "interleaved")
"""Where the loaded motions are."""


@dataclass(frozen=True)
class Motion:
    """One motion: what dataset.yaml states of it, its start (s), its number of rows and its path."""

    role: str
    kind: str
    same_as: int
    payload: float
    start: float
    rows: int
    path: Path


@dataclass(frozen=True)
class Session:
    """All rows of a log in the order of time; rad, s, K."""

    rate: float
    motions: tuple[Motion, ...]
    runs: tuple[slice, ...]  # rows of each motion
    time: np.ndarray
    since: np.ndarray  # the start of the motion, s
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    payload: np.ndarray
    warm: np.ndarray  # temperature above the first one (rows,)
    notes: dict

    @property
    def step(self) -> float:
        """Time between rows, s."""
        return 1 / self.rate

    def of(self, role: str) -> list[slice]:
        """Rows of the motions of a role."""
        return [run for run, m in zip(self.runs, self.motions, strict=True) if m.role == role]

    def rows(self, role: str) -> np.ndarray:
        """Which rows are of a role (rows,)."""
        return np.repeat([m.role == role for m in self.motions], [m.rows for m in self.motions])


def _ease(t: np.ndarray, length: float) -> tuple[np.ndarray, ...]:
    """Return a window that is 0 at both ends of a motion, 1 between, and its derivatives (rows, 1)."""
    ahead = t < length / 2
    x = np.clip(np.where(ahead, t, length - t) / EASE, 0, 1)[:, None]
    sign = np.where(ahead, 1.0, -1.0)[:, None]
    value = x**3 * (10 - 15 * x + 6 * x**2)
    return value, sign * 30 * x**2 * (1 - x) ** 2 / EASE, 60 * x * (1 - x) * (1 - 2 * x) / EASE**2


def waves(home: np.ndarray, size: np.ndarray, speed: np.ndarray, phase: np.ndarray, length: float) -> Path:
    """Return sums of sines about a pose, that begin and end at rest in it.

    Parameters
    ----------
    home : numpy.ndarray
        The pose (n,).
    size, speed, phase : numpy.ndarray
        Amplitudes, angular frequencies, phases (n, waves).
    length : float
        Duration, s.
    """

    def path(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angle = t[:, None, None] * speed + phase
        s = np.sum(size * np.sin(angle), axis=2)
        ds = np.sum(size * speed * np.cos(angle), axis=2)
        dds = -np.sum(size * speed**2 * np.sin(angle), axis=2)
        w, dw, ddw = _ease(t, length)
        return home + w * s, dw * s + w * ds, ddw * s + 2 * dw * ds + w * dds

    return path


def _excitation(rng: np.random.Generator, arm: Arm, length: float) -> Path:
    """Return an excitation: low waves that travel, and quick ones; speeds of about 1 rad/s."""
    count = int(rng.integers(3, 6))
    hertz = np.exp(rng.uniform(np.log(0.07), np.log(1.1), (arm.size, count)))
    hertz[:, 0] = rng.uniform(0.06, 0.14, arm.size)
    size = rng.uniform(0.3, 1, hertz.shape) / hertz ** rng.uniform(0.7, 1.1)
    size *= (arm.span * rng.uniform(0.55, 1.0, arm.size) / size.sum(axis=1))[:, None]
    speed = 2 * np.pi * hertz
    fast = np.sum(size * speed, axis=1) / rng.uniform(1.2, 2.4, arm.size)
    speed /= np.maximum(1, fast)[:, None]
    return waves(arm.home, size, speed, rng.uniform(0, 2 * np.pi, hertz.shape), length)


def _slow(rng: np.random.Generator, arm: Arm, length: float) -> Path:
    """Return slow crossings: no joint turns faster than .08 rad/s, all turn back several times."""
    hertz = rng.uniform(0.12, 0.35, (arm.size, 2))
    size = rng.uniform(0.02, 0.055, hertz.shape) / (2 * np.pi * hertz) * [0.7, 0.4]
    place = arm.home + arm.span * rng.uniform(-0.5, 0.5, arm.size)
    return waves(place, size, 2 * np.pi * hertz, rng.uniform(0, 2 * np.pi, hertz.shape), length)


def _pick(rng: np.random.Generator, arm: Arm, length: float) -> Path:
    """Return motions from pose to pose, each of a polynomial of degree five, with a rest in each."""
    count = int(length // 2.6)
    hold = 0.3
    each = length / count
    poses = arm.home + arm.span * rng.uniform(-0.85, 0.85, (count + 1, arm.size))
    poses[2::4] = poses[:1]  # the place of picking
    reach = np.abs(np.diff(poses, axis=0)) * 1.875 / (each - hold)
    poses = poses[0] + (poses - poses[0]) / max(1.0, float(reach.max()) / 1.9)

    def path(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        leg = np.minimum((t / each).astype(int), count - 1)
        run = each - hold
        x = np.clip((t - leg * each) / run, 0, 1)[:, None]
        way = poses[leg + 1] - poses[leg]
        value = x**3 * (10 - 15 * x + 6 * x**2)
        speed, curve = 30 * x**2 * (1 - x) ** 2 / run, 60 * x * (1 - x) * (1 - 2 * x) / run**2
        return poses[leg] + way * value, way * speed, way * curve

    return path


def _kinds(rng: np.random.Generator, count: int, slow: bool, loads: str) -> list[tuple[str, str, int, bool]]:
    """Return role, kind, repeated motion and whether loaded, of each motion in order."""
    validate, repeats = (1, 1) if count < 7 else (2 if count < 10 else 3, 3)
    single = count - validate - repeats
    rest = [("calibrate", "slow" if slow and k < 2 else "excitation") for k in range(single)]
    rest = [rest[k] for k in rng.permutation(single)]
    if loads == "none":
        heavy = [False] * single
    elif loads == "after":
        heavy = [k >= single // 2 for k in range(single)]
    else:
        heavy = [k % 2 == 0 for k in range(single)]
    out = [("calibrate", "excitation", 1, False)] * repeats
    if repeats > 1 and loads == "interleaved" and rng.random() < 0.5:  # the repeats are spread over the log
        out = out[:1]
    out += [(*kind, 0, load) for kind, load in zip(rest, heavy, strict=True)]
    for place in (len(out) // 2, len(out)) if len(out) < single + repeats else ():
        out.insert(place, ("calibrate", "excitation", 1, False))
    loaded = loads != "none"
    return out + [
        ("validate", "pick-place", 0, loaded and (k > 0 or loads == "after")) for k in range(validate)
    ]


def _warmth(rng: np.random.Generator, time: np.ndarray, most: float) -> np.ndarray:
    """Return the temperature above the first one: it warms towards a limit, and wavers with the room."""
    tau = rng.uniform(0.35, 0.9) * time[-1]
    rise = 1 - np.exp(-(time - time[0]) / tau)
    return most * rise / rise[-1] + 0.06 * np.sin(2 * np.pi * time / rng.uniform(60, 140)) * min(1.0, most)


def plan(rng: np.random.Generator, arm: Arm, wishes: dict, motions: int = 0, length: float = 0.0) -> Session:
    """Draw the motions of a log.

    Parameters
    ----------
    rng : numpy.random.Generator
        Where chance comes from.
    arm : Arm
        The arm.
    wishes : dict
        Notes of the session that are not left to chance: ``slow``, ``loads``, ``warm_K``.
    motions, length : int, float
        Number of motions and their duration (s); by default drawn.
    """
    notes = {
        "slow": bool(rng.random() < 0.6),
        "loads": str(rng.choice(LOADS, p=[0.35, 0.25, 0.4])),
        "warm_K": float(rng.choice([rng.uniform(1, 4), rng.uniform(4, 10)])),
        "two_loads": bool(rng.random() < 0.4),
    } | wishes
    rate = float(rng.choice([100, 125, 125, 200, 250]))
    count = motions or int(rng.integers(9, 13 if rate < 200 else 11))
    length = length or float(rng.uniform(9.5, 12.0) * (1 if rate < 200 else 0.85))
    kinds = _kinds(rng, count, notes["slow"], notes["loads"])
    notes["repeats_at"] = [k + 1 for k, kind in enumerate(kinds) if kind[2] == 1]
    made: list[Motion] = []
    start, first = 5.0, None
    kilos = float(np.round(arm.load * rng.uniform(0.7, 1.1), 2))
    for number, (role, kind, same, loaded) in enumerate(kinds, 1):
        draw = {"excitation": _excitation, "slow": _slow, "pick-place": _pick}[kind]
        path = first if same and first is not None else draw(rng, arm, length)
        first = path if same and first is None else first
        carried = kilos if loaded else 0.0
        if loaded and notes["two_loads"] and number % 2:
            carried = float(np.round(kilos / 2, 2))
        rows = int(length * rate)
        made.append(Motion(role, kind, same or number, carried, start, rows, path))
        start += length + rng.uniform(2, 9) + (rng.uniform(60, 240) if rng.random() < 0.15 else 0)
    since = [np.arange(m.rows) / rate for m in made]
    parts = [m.path(t) for m, t in zip(made, since, strict=True)]
    q, dq, ddq = (np.concatenate([p[k] for p in parts]) for k in range(3))
    ends = np.cumsum([m.rows for m in made])
    time = np.concatenate([m.start + t for m, t in zip(made, since, strict=True)])
    return Session(
        rate, tuple(made), tuple(slice(e - m.rows, e) for e, m in zip(ends, made, strict=True)), time,
        np.concatenate(since), q, dq, ddq, np.repeat([m.payload for m in made], [m.rows for m in made]),
        _warmth(rng, time, notes["warm_K"]), notes,
    )  # fmt: skip
