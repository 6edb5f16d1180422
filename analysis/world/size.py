"""How large: effects as visible as wished for, and masses wrong only as far as is not visible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.world import arm, visible
from analysis.world.mix import Maker
from analysis.world.touch import Act, Moved, World

WEAKEST, STRONGEST = 3.0, 300.0
CLOSE, TRIES = 0.02, 6
UNSEEN = 2.0  # lambda that wrong masses may have in all


def sized(
    rng: np.random.Generator,
    maker: Maker,
    world: World,
    model: visible.Fitted,
    readings: np.ndarray,
    sigma: float,
) -> tuple[Act, float, dict]:
    """Draw an effect and its size: as visible as wished for, or as large as a machine would have it."""
    goal = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    still, best = world.gap(readings), None
    for _ in range(TRIES):
        state = rng.bit_generator.state
        act = maker(rng, world)
        size, seen = act.size, 0.0
        for _ in range(12):
            shift = world.gap(readings, [(act, size)]) - still
            seen = float(np.sum(model.left(shift, sigma, act.artefact) ** 2))
            if abs(seen / goal - 1) < CLOSE or (size >= act.cap and seen < goal):
                break
            size = min(act.cap, size * float(np.clip(np.sqrt(goal / max(seen, 1e-12)), 0.02, 50)))
        found = (
            act,
            size,
            {"goal": goal, "value": seen, "capped": bool(size >= act.cap), "shift": shift, "state": state},
        )
        if best is None or seen > best[2]["value"]:
            best = found
        if seen > max(WEAKEST, 0.3 * goal):
            return found
    assert best is not None
    return best


def masses(world: World, share: float) -> World:
    """Return the world with its masses brought to a share of their errors."""
    n, s = arm.nominal(), world.arm.shape
    new = {
        k: getattr(n, k) + share * (getattr(s, k) - getattr(n, k))
        for k in ("mass", "com", "tool_mass", "tool_com")
    }
    return replace(world, arm=arm.Arm(replace(s, **new)))


def modest(world: World, stiffness: bool, sigma: float) -> tuple[World, np.ndarray, visible.Fitted]:
    """Bring wrong masses to where they are not visible; return readings without noise, and derivatives."""
    still = np.zeros(len(world.session.time))
    first, _ = world.touch((), still, straight=True)
    world = replace(world, session=replace(world.session, start=first))
    for _ in range(5):
        quiet, _ = world.touch((), still)
        model = visible.fitted(world, quiet, stiffness)
        wrong = wrong_masses(world, model, quiet, sigma)
        if wrong <= UNSEEN:
            break
        world = masses(world, 0.95 * np.sqrt(UNSEEN / wrong))
    return world, quiet, model


def wrong_masses(world: World, model: visible.Fitted, readings: np.ndarray, sigma: float) -> float:
    """Return how visible the error of masses is."""
    return float(np.sum(model.left(world.gap(readings) - masses(world, 0.0).gap(readings), sigma) ** 2))


def second_order(world: World, model: visible.Fitted, readings: np.ndarray, sigma: float) -> float:
    """Return how visible it is that torques are those of the true arm, deflected, not of the nominal arm."""
    n, s = arm.nominal(), world.arm.shape
    drawn = arm.Arm(replace(s, a=n.a, alpha=n.alpha, d=n.d, zero=n.zero, beta3=0.0))
    coordinates = np.zeros((len(readings), arm.SIZE))
    coordinates[:, arm.JOINT] = readings @ arm.LINK_FROM_READING.T
    load = drawn.weigh(coordinates)
    load += world.session.payload[:, None] * (drawn.weigh(coordinates, 1.0) - load)
    coordinates[:, arm.JOINT] += world.give * load[:, arm.JOINT]
    ball, _ = world.place(coordinates, Moved.nothing(len(readings)))
    return float(np.sum(model.left(world.gap(readings) - world.clearance(ball), sigma) ** 2))
