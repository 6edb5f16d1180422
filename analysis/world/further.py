"""A further round: contacts that a diagnosis asked for, probed by the same arm after its session.

The machine is the same: every effect is drawn again from the state of the generator that drew it, for the
session with the further contacts at its end. That the contacts of the first round then have their noise and
nothing else is checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from analysis.world import write
from analysis.world.arm import JOINT, LINK_FROM_READING, SIZE, Arm, nominal
from analysis.world.build import Made
from analysis.world.scene import NAMES, NORMALS
from analysis.world.session import AT_REST, FURTHER, TRACKER, Session
from analysis.world.touch import SOLVED, Act, World
from analysis.world.tracker import Tracked

PAUSE, PACE = 600.0, (5.0, 12.0)
"""Time before the further contacts, and between them, s."""
SPEED = 3e-3
"""Of an approach for which none is asked, m/s."""
SLOWEST = 1e-4
"""Of an approach towards the surface, m/s: a slower one is not an approach."""
SAME = 10 * SOLVED
"""How well the contacts of the first round must be found again, m."""


@dataclass(frozen=True)
class Wanted:
    """A contact, or a pose, that was asked for.

    Its target, readings (6,), rad, their velocity (6,), rad/s, if stated, and the payload, kg.
    """

    target: str
    readings: Sequence[float]
    velocity: Sequence[float] | None
    payload: float


def further(made: Made, wanted: Sequence[Wanted], rng: np.random.Generator) -> str:
    """Return measurements.csv of a session with a further round at its end.

    Parameters
    ----------
    made : Made
        The session.
    wanted : sequence of Wanted
        The contacts, in the order in which they are probed.
    rng : numpy.random.Generator
        Of their noise.

    Raises
    ------
    RuntimeError
        If an effect depends on the whole session, so that the first round would have been another.
    """
    old = made.world.session
    world = replace(made.world, session=_joined(old, _session(made.world, wanted, rng)))
    new = world.session.phase == FURTHER
    quiet, _ = world.touch((), np.zeros(len(new)), straight=True)
    start = np.where(new[:, None], quiet, world.session.start)
    world = replace(world, session=replace(world.session, start=start))
    acts = _acts(made, world)
    rows = world.session.of_rows(new)
    noise = np.zeros(len(rows))
    noise[~rows], noise[rows] = made.noise, made.sigma * rng.standard_normal(int(np.sum(rows)))
    _check(made, world, acts)
    readings, worst = world.touch(acts, noise)
    if worst > SOLVED:
        msg = f"{made.truth['world']}: {worst:g} m off the touch"
        raise RuntimeError(msg)
    points = world.points(acts, noise) if isinstance(world, Tracked) else None
    velocity = world.session.velocity + np.radians(0.002) * rng.standard_normal(start.shape)
    says = velocity if world.session.says_velocity else None
    text = write.measurements_text(world.session, readings, says, points, first=len(old.time))
    return made.texts["measurements.csv"] + text.split("\n", 1)[1]


def _session(world: World, wanted: Sequence[Wanted], rng: np.random.Generator) -> Session:
    """Return the further contacts as a session of their own."""
    s, count = world.session, len(wanted)
    q = np.array([w.readings for w in wanted])
    target = np.array([NAMES.index(w.target) for w in wanted])
    coordinates = np.zeros((count, SIZE))
    coordinates[:, JOINT] = q @ LINK_FROM_READING.T
    arm = Arm(nominal())
    origin, turn = arm.place(coordinates)
    out = _outward(world, target, origin + turn @ arm.shape.tool, rng)
    jacobian = arm.jacobian(coordinates) @ LINK_FROM_READING
    straight = np.einsum("nij,nj->ni", np.linalg.inv(jacobian)[:, :, :3], -out)
    asked = np.array([np.zeros(6) if w.velocity is None else w.velocity for w in wanted])
    moving = np.einsum("nij,nj->ni", jacobian[:, :3], asked)
    speed = np.linalg.norm(moving, axis=1) if s.stage == TRACKER else -np.sum(moving * out, axis=1)
    given = speed > SLOWEST
    way = np.where(given[:, None], asked / np.where(given, speed, 1.0)[:, None], straight)
    if s.stage == TRACKER:
        q, straight = q + AT_REST * rng.standard_normal(q.shape), np.zeros_like(q)
    time = s.time[-1] + PAUSE + np.cumsum(rng.uniform(*PACE, count))
    temperature = s.temperature[s.phase == 0][-1] + 0.1 * rng.standard_normal(count)
    return replace(
        s,
        phase=np.full(count, FURTHER),
        target=target,
        start=q,
        straight=straight,
        way=way,
        speed=np.where(given, speed, SPEED),
        time=np.round(time, 2),
        payload=np.array([w.payload for w in wanted]),
        repeat=np.full(count, -1),
        temperature=temperature,
    )


def _outward(world: World, target: np.ndarray, ball: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return outward normals (n, 3) of the nominal targets; random ones before a tracker."""
    out = rng.standard_normal(ball.shape)
    sphere, face = (target >= 4) & (target < 16), target < 4
    out[face] = NORMALS[target[face]]
    out[sphere] = ball[sphere] - world.scene.ball_drawn[target[sphere] - 4]
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def _joined(a: Session, b: Session) -> Session:
    """Return two sessions one after the other."""
    both = {f.name: (getattr(a, f.name), getattr(b, f.name)) for f in fields(Session)}
    joined: dict[str, Any] = {
        name: np.concatenate(x) if isinstance(x[0], np.ndarray) else x[0] for name, x in both.items()
    }
    return Session(**joined)


def _acts(made: Made, world: World) -> list[tuple[Act, float]]:
    """Return the effects of the first round, drawn again for a longer session, with their sizes."""
    out = []
    for (maker, state), (_, size) in zip(made.makers, made.acts, strict=True):
        rng = np.random.default_rng()
        rng.bit_generator.state = state
        out.append((maker(rng, world), size))
    return out


def _check(made: Made, world: World, acts: list[tuple[Act, float]]) -> None:
    """Raise an error unless effects do to the contacts of the first round what they did in it."""
    start = made.world.session.start
    before = made.world.gap(start, made.acts)
    after = world.gap(np.concatenate([start, world.session.start[len(start) :]]), acts)[: len(before)]
    if np.max(np.abs(after - before)) > SAME:
        names = " and ".join(act.name for act, _ in acts)
        msg = f"{made.truth['world']}: a further round would change what {names} did before"
        raise RuntimeError(msg)
