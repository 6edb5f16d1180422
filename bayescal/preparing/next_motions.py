"""What to log next: commands of motions that make a joint log tell of what it does not tell of yet.

Every motion begins and ends at rest in the first pose of the log. It stays within the range of the log, or
within the limits of the joints where the robot states these, is no faster and no harder than stated or
logged, needs no more torque by the nominal arm than rated or logged, and keeps the arm free of itself where
the robot file has its geometry. What stands around the arm is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayescal.arm.motion import NominalArm
from bayescal.dataset.types import Tool
from bayescal.logs import Log
from bayescal.logs.types import TRANSITION
from bayescal.motion.dynamics import carried, regressor
from bayescal.motion.signals import derivative
from bayescal.preparing.joint_facts import SLOW, gravity_torques, joints_of
from bayescal.preparing.joint_findings import FAST, LENGTH, missing
from bayescal.probing.clearance import Clearance
from bayescal.storage.reading import table_beside

SECONDS = 2.0 * LENGTH
"""Of each motion (assumed)."""
EASE = 2.5
"""s, in which a motion leaves its pose and returns to it (assumed)."""
SLOWEST = 0.9 * SLOW[1]
"""rad/s, largest speed of a slow motion."""
QUICK, STATED = 1.15 * FAST, 0.7
"""rad/s, of a fast motion where no largest speed is stated; share of a stated one (assumed)."""
HARDER, STRONGER = 1.5, 1.1
"""Acceleration over the largest one logged; torque over the largest one logged, or share of `RATED`."""
RATED = 0.8
"""Share of a rated torque that a motion may need (assumed)."""
SOFTEST = 3.0
"""rad/s2, acceleration that any arm has (assumed)."""
MARGIN = np.radians(3.0)
"""rad, distance from a limit (assumed)."""
WIDEST = np.radians(60.0)
"""rad, of a motion beyond the range of the log, to either side of its first pose (assumed)."""
PAUSE, HOLD = 3.0, 0.4
"""s at rest between motions, and in a pose."""
TRIES, SHRINK = 24, 0.85
"""Of a motion, each smaller by this factor, until it keeps all limits."""
SMALLEST = 0.06
"""Of a motion of a joint, below which the joint rests (assumed)."""
SAMPLED = 400
"""Poses among which those of the most different gravity torques are chosen (cost)."""
CLEAR = 0.01
"""m between parts of the arm (assumed)."""

Shape = Callable[["Bounds", np.random.Generator, np.ndarray], np.ndarray]
"""Positions (N, n) of a motion at times (N,), away from its first pose (n,), before it is eased."""


@dataclass(frozen=True)
class Planned:
    """A motion that is to be logged: readings (N, n), rad, at the rate of the log."""

    name: str
    purpose: Purpose
    position: np.ndarray
    same_as: str
    loaded: bool


@dataclass(frozen=True)
class MotionPlan:
    """Motions that are to be logged next, one after the other with a pause; `left_out` says what is not."""

    motions: tuple[Planned, ...]
    left_out: tuple[str, ...]
    bounds: Bounds

    @property
    def timed(self) -> Iterator[tuple[Planned, np.ndarray]]:
        """Every motion, with its times (N,), s."""
        start, step = 0.0, self.bounds.step
        for m in self.motions:
            yield m, start + step * np.arange(len(m.position))
            start += step * len(m.position) + PAUSE


@dataclass(frozen=True)
class Bounds:
    """What a motion keeps: readings, speeds, accelerations (n,), torques (n,) and clearance."""

    log: Log
    step: float
    home: np.ndarray  # (n,) rad, where motions begin and end
    low: np.ndarray
    high: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    assumed: tuple[str, ...]
    arm: NominalArm | None = None
    clearance: Clearance | None = field(default=None, repr=False)

    @classmethod
    def of(cls, log: Log) -> Bounds:
        """The bounds of a log."""
        robot, motions, m = log.mechanism.robot, log.motions, log.mechanism
        step = float(np.median(np.concatenate([np.diff(x.time) for x in motions])))
        position = np.concatenate([x.position for x in motions])
        home, low, high = motions[0].position[0], position.min(axis=0), position.max(axis=0)
        rates = [np.gradient(x.position, x.time, axis=0) for x in motions]
        fastest = np.abs(np.concatenate(rates)).max(axis=0)
        hard = [np.percentile(np.abs(np.gradient(r, x.time, axis=0)), 99, axis=0)
                for r, x in zip(rates, motions, strict=True)]  # fmt: skip
        most = np.maximum(HARDER * np.median(hard, axis=0), SOFTEST)
        torques = [x.torque for x in motions if x.torque is not None]
        logged = np.abs(np.concatenate(torques)).max(axis=0) if torques else np.full(m.n, np.nan)
        torque = np.fmax(RATED * m.rated, STRONGER * logged)
        assumed = ["what stands around the arm is not known: run the motions slowly first"]
        unknown = np.isnan(m.fastest)
        speed = np.where(unknown, np.maximum(fastest, QUICK), STATED * m.fastest)
        if unknown.any():
            assumed.append(f"largest speeds are not stated: those logged, or {QUICK:.3g} rad/s, are assumed")
        if np.isnan(torque).any():
            assumed.append("largest torques are neither stated nor logged: motions keep none")
        bounds = cls(log, step, home, low, high, speed, most, torque, tuple(assumed))
        if robot is None:
            more = "dataset.yaml has no shape of the arm: motions stay within the range of the log"
            return replace(bounds, assumed=(*assumed, more))
        arm = NominalArm(robot, np.zeros(3))
        low, high = np.minimum(low, home - WIDEST), np.maximum(high, home + WIDEST)
        clearance = Clearance.of(robot, Tool("none", np.zeros(3)))
        return replace(bounds, low=low, high=high, arm=arm, clearance=clearance)

    @property
    def middle(self) -> np.ndarray:
        """Middle (n,) of the range."""
        return 0.5 * (self.low + self.high)

    def broken(self, q: np.ndarray, kilograms: float) -> tuple[str, np.ndarray]:
        """What a motion (N, n) does not keep, or "", and the joints (n,) that do not."""
        dq = derivative(q, self.step)
        ddq = derivative(dq, self.step)
        some = slice(None, None, max(round(0.05 / self.step), 1))
        loads = (self._needed(q[some], dq[some], ddq[some], w) for w in (0.0, kilograms))
        needed = np.max([np.abs(x) for x in loads], axis=0)
        checks = {
            "range": (q < self.low - 1e-9) | (q > self.high + 1e-9) | ~self._within(q),
            "largest speed": np.abs(dq) > self.speed,
            "largest acceleration": np.abs(ddq) > self.acceleration,
            "largest torque": needed > self.torque,
        }
        for why, rows in checks.items():
            if rows.any():
                return why, rows.any(axis=0)
        # the way from one of these rows to the next is checked too
        if self.clearance is not None and np.any(self.clearance.hits(q[some][:-1], q[some][1:], CLEAR)):
            return "clearance of the arm", np.ones(len(self.home), bool)
        return "", np.zeros(len(self.home), bool)

    def _within(self, q: np.ndarray) -> np.ndarray:
        """Which readings (N, n) are within the limits that the robot states."""
        if self.arm is None:
            return np.ones_like(q, bool)
        # coupled readings have limits of angles; the log may be nearer to a limit than the margin
        angles, first = self.arm.angles_of(q), self.arm.angles_of(self.home[None])
        lowest, highest = self.arm.robot.limits.T
        low, high = np.minimum(lowest + MARGIN, first), np.maximum(highest - MARGIN, first)
        return np.asarray((angles >= low - 1e-9) & (angles <= high + 1e-9))

    def _needed(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, kilograms: float) -> np.ndarray:
        """Torques (N, n) of the nominal arm with a payload."""
        m = self.log.mechanism
        rigid = regressor(m, q, dq, ddq, self.log.gravity)
        load = carried(rigid, m.inertials, m, np.full(len(q), kilograms))
        way = np.tanh(dq / (m.transition or TRANSITION))
        friction = np.nan_to_num(m.coulomb) * way + np.nan_to_num(m.viscous) * dq
        return np.asarray(load + friction + np.nan_to_num(m.armature) * ddq)

    @cached_property
    def poses(self) -> np.ndarray:
        """Random readings (S, n) within the range, free of the arm itself."""
        q = np.random.default_rng(0).uniform(self.low, self.high, (SAMPLED, len(self.home)))
        q = q[self._within(q).all(axis=1)]
        return q if self.clearance is None else q[self.clearance.collides(q) == 0]


def _waves(
    b: Bounds, rng: np.random.Generator, t: np.ndarray, hertz: tuple[float, float], speed: np.ndarray,
    travel: np.ndarray, middle: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Sums of three sines about a pose, of a largest speed (n,), rad/s, and way to either side (n,), rad."""
    low, high = np.log(hertz)
    of = np.exp(rng.uniform(low, high, (len(b.home), 3)))
    size = rng.uniform(0.4, 1.0, of.shape) / of
    angle = 2.0 * np.pi * of * t[:, None, None] + rng.uniform(0.0, 2.0 * np.pi, of.shape)
    way = np.sum(size * np.sin(angle), axis=2)
    rate, most = np.max(np.abs(np.gradient(way, t, axis=0)), axis=0), np.max(np.abs(way), axis=0)
    return middle + way * np.minimum(travel / most, speed / rate)


def _slow(b: Bounds, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    each = np.full(len(b.home), SLOWEST)
    middle = np.clip(b.home, b.low + 0.1, np.maximum(b.high - 0.1, b.low + 0.1))
    return _waves(b, rng, t, (0.07, 0.14), each, each, middle)


def _excitation(b: Bounds, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    return _waves(b, rng, t, (0.08, 0.7), 0.9 * b.speed, 0.45 * (b.high - b.low), b.middle)


def _fast(b: Bounds, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A sine of each joint at the frequency at which its range has the speed."""
    speed, travel = np.minimum(b.speed, QUICK), np.minimum(0.4 * (b.high - b.low), 1.0)
    angle = speed / travel * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, len(speed))
    return np.asarray(b.middle + travel * np.sin(angle))


def _legs(poses: np.ndarray, t: np.ndarray) -> np.ndarray:
    """From pose to pose (P, n), each way a polynomial of degree five, with a rest in each."""
    each = t[-1] / (len(poses) - 1)
    leg = np.minimum((t / each).astype(int), len(poses) - 2)
    x = np.clip((t - leg * each) / max(each - HOLD, HOLD), 0.0, 1.0)[:, None]
    return np.asarray(poses[leg] + (poses[leg + 1] - poses[leg]) * x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


def _poses(b: Bounds, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """In turn in the two poses in which gravity loads the joints most differently, with small motions."""
    torque = gravity_torques(b.log, b.poses)
    size = np.max(np.abs(torque), axis=0)
    apart = np.sum(((torque[:, None] - torque[None]) / np.maximum(size, 0.01 * size.max())) ** 2, axis=2)
    one, two = b.poses[list(np.unravel_index(np.argmax(apart), apart.shape))]
    small = _waves(b, rng, t, (0.2, 0.4), 0.25 * b.speed, np.full(len(b.home), 0.1), np.zeros(len(b.home)))
    return _legs(np.array([b.home, one, one, two, two, b.home]), t) + small


def _pick(b: Bounds, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    return _legs(np.array([b.home, *b.poses[rng.integers(0, len(b.poses), 4)], b.home]), t)


@dataclass(frozen=True)
class Purpose:
    """A motion that a log may lack: what is lacking (codes of `check`, effects), and its shape."""

    name: str
    kind: str
    words: str
    codes: tuple[str, ...]
    effects: tuple[str, ...]  # that it makes assessable
    shape: Shape
    copies: int = 1
    loaded: tuple[bool, ...] = (False,)
    times: int = 1  # that each copy is to be run
    role: str = "calibrate"


SHAPES: dict[str, Shape] = {
    "excitation": _excitation, "slow": _slow, "fast": _fast, "poses": _poses, "pick": _pick,
}  # fmt: skip


def _purpose(entry: dict[str, Any]) -> Purpose:
    words = entry["words"].format(slow=SLOW[1], fast=FAST, times=entry.get("times"))
    lists = {key: tuple(value) for key, value in entry.items() if isinstance(value, list)}
    return Purpose(**entry | lists | {"words": words, "shape": SHAPES[entry["shape"]]})


PURPOSES = tuple(map(_purpose, table_beside(__file__, "motions.toml")["motions"]))
"""Motions in the order in which they are to be logged."""


def next_motions(log: Log, effects: Collection[str] = (), sites: Sequence[str] = ()) -> MotionPlan:
    """Plan the motions that a log lacks.

    Parameters
    ----------
    log : Log
    effects : collection of str
        Effects that a diagnosis could not assess, beside what a check of the log tells.
    sites : sequence of str
        Joints ('joint 3') at which a diagnosis has left a cause open: each is moved alone.
    """
    bounds = Bounds.of(log)
    findings = list(missing(log, joints_of(log), ""))
    codes = {f.code for f in findings}
    if any(f.kind == "refused" for f in findings):
        why = "without torques with a sign no motion tells more: log them first"
        return MotionPlan((), (why,), bounds)
    asked = [p for p in PURPOSES if codes.intersection(p.codes) or set(p.effects) & set(effects)]
    for site in sites:
        if site.startswith("joint "):
            asked.append(_alone(int(site.removeprefix("joint ")) - 1))
    motions: list[Planned] = []
    left_out: list[str] = []
    kilograms = max(float(np.max(m.payload)) for m in log.motions)
    for number, p in enumerate(asked):
        position, why = _fitted(bounds, p, number, kilograms if any(p.loaded) else 0.0)
        if any(p.loaded) and not kilograms:
            more = "the torques of the payload are not in those that motions keep: no payload is logged"
            bounds = replace(bounds, assumed=(*bounds.assumed, more))
        if position is None:
            left_out.append(f"{p.name} ({p.words}): no such motion keeps the {why}")
            continue
        names = [p.name if p.copies == 1 else f"{p.name}-{k + 1}" for k in range(p.copies)]
        motions += [
            Planned(name, p, position, names[0] if k else "", p.loaded[k % len(p.loaded)])
            for k, name in enumerate(names)
        ]
    if "no_fast" in codes:
        every = [derivative(m.position, bounds.step) for m in motions]
        fastest = np.max(np.abs(np.concatenate([*every, np.zeros((1, log.n))])), axis=0)
        names = [n for n, v in zip(log.mechanism.joint_names, fastest, strict=True) if v < FAST]
        left_out += [f"{n}: no motion within its bounds is faster than {FAST:g} rad/s" for n in names]
    if "resting" in codes and bounds.arm is None:
        left_out.append("joints that never moved: give a robot file with their limits")
    if "no_temperature" in codes and any(p.name == "warm-up" for p in asked):
        left_out.append("log `temperature_degC`: warm-up is assessed by time alone without it")
    return MotionPlan(tuple(motions), tuple(left_out), bounds)


def _alone(joint: int) -> Purpose:
    """A motion of one joint, the others at rest."""

    def shape(b: Bounds, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
        out = np.tile(b.home, (len(t), 1))
        out[:, joint] = _excitation(b, rng, t)[:, joint]
        return out

    words = f"joint {joint + 1} alone, the others at rest: what varies with it"
    return Purpose(f"joint-{joint + 1}", "alone", words, (), (), shape)


def _fitted(b: Bounds, p: Purpose, number: int, kilograms: float) -> tuple[np.ndarray | None, str]:
    """A motion that keeps all bounds, as large as possible; None, and what no motion keeps."""
    rng, why = np.random.default_rng(number), ""
    t = np.arange(0.0, SECONDS, b.step)
    x = np.clip(np.minimum(t, t[-1] - t) / EASE, 0.0, 1.0)[:, None]
    eased = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    size = np.ones(len(b.home))
    for _ in range(TRIES):
        position = b.home + size * eased * (p.shape(b, rng, t) - b.home)
        why, joints = b.broken(position, kilograms)
        if not why:
            return position, ""
        size = np.where(joints, SHRINK * size, size)
        size[size < SMALLEST] = 0.0  # such a joint rests, and the others move
    return None, why
