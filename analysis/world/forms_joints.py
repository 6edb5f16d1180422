"""Second forms of the effects of joints: independent of the first, and of any basis of a model."""

from __future__ import annotations

import numpy as np

from analysis.world.arm import JOINT, LINK_FROM_READING, REDUCTIONS
from analysis.world.joints import place
from analysis.world.touch import Act, Moved, Seen, World


def _angle(rng: np.random.Generator) -> float:
    return float(rng.uniform(0, 2 * np.pi))


def eccentricity(rng: np.random.Generator, _w: World) -> Act:
    """Return a disc off its centre that is read by one head: once a turn, with a share of the third order."""
    j, phase, share, third = rng.integers(6), _angle(rng), rng.uniform(0.1, 0.3), _angle(rng)

    def move(seen: Seen, size: float, m: Moved) -> None:
        t = seen.link[:, j]
        m.joint[:, j] += size * (np.sin(t + phase) + share * np.sin(3 * t + third))

    where = place(j, "joint angle, once a turn", "eccentricity")
    detail = {"joint": j + 1, "phase": phase, "third": share}
    return Act("eccentricity", where, "rad", 1.5e-4, 5e-4, move, detail, form="with a third harmonic")


def second_harmonic(rng: np.random.Generator, _w: World) -> Act:
    """Return two straight-sided waves a turn, one side steeper."""
    j, phase, lean = rng.integers(6), _angle(rng), rng.uniform(-0.25, 0.25)

    def move(seen: Seen, size: float, m: Moved) -> None:
        t = 2 * seen.link[:, j] + phase
        m.joint[:, j] += size * np.arcsin(np.sin(t + lean * np.sin(t))) / (np.pi / 2)

    where = place(j, "joint angle, twice a turn", "second-harmonic")
    detail = {"joint": j + 1, "phase": phase, "lean": lean}
    return Act("second-harmonic", where, "rad", 1e-4, 5e-4, move, detail, form="triangular waves")


def gear_mesh(rng: np.random.Generator, _w: World) -> Act:
    """Return teeth that give with the load: the ripple is larger under torque, and later."""
    j, waves, phase = rng.integers(1, 6), rng.integers(1, 3), _angle(rng)
    grow, late = rng.uniform(0.3, 0.8), rng.uniform(0.0, 0.6)

    def move(seen: Seen, size: float, m: Moved) -> None:
        load = seen.load[:, JOINT[j]]
        share = load / np.percentile(np.abs(seen.first(load)), 90)
        t = waves * REDUCTIONS[j] * seen.link[:, j] + phase + late * share
        m.joint[:, j] += size * np.sin(t) * (1 - grow / 2 + grow * np.abs(share))

    driver = f"motor angle, {'one wave' if waves == 1 else 'two waves'} a turn"
    detail = {"joint": j + 1, "waves": waves, "phase": phase, "grow": grow, "late": late}
    where = place(j, driver, "gear-mesh")
    return Act("gear-mesh", where, "rad", 5e-5, 2.5e-4, move, detail, form="amplitude by load")


def backlash(rng: np.random.Generator, _w: World) -> Act:
    """Return backlash with a soft transition in speed; gravity may hold the joint on one flank."""
    j, soft, held = rng.integers(6), rng.uniform(0.05, 0.5), rng.uniform(0.0, 0.4)

    def move(seen: Seen, size: float, m: Moved) -> None:
        way, load = seen.session.velocity @ LINK_FROM_READING[j], seen.load[:, JOINT[j]]
        lean = held * load / max(float(np.percentile(np.abs(seen.first(load)), 90)), 1e-9)
        m.joint[:, j] -= size * np.tanh((way / np.std(seen.first(way)) + lean) / soft)

    where = place(j, f"approach {j + 1}", "backlash")
    detail = {"joint": j + 1, "soft": soft, "held": held}
    return Act("backlash", where, "rad", 1e-4, 5e-4, move, detail, form="soft transition")


def hysteresis(rng: np.random.Generator, _w: World) -> Act:
    """Return wind-up that follows the load late, as in Jiles and Atherton: it tends to Langevin's curve."""
    j, knee, late = rng.integers(1, 6), rng.uniform(0.1, 0.3), rng.uniform(0.2, 0.7)

    def move(seen: Seen, size: float, m: Moved) -> None:
        load = seen.load[:, JOINT[j]]
        x = load / (knee * np.std(seen.first(load)))
        small = np.abs(x) < 1e-3
        goal = np.where(small, x / 3, 1 / np.tanh(np.where(small, 1.0, x)) - 1 / np.where(small, 1.0, x))
        keep = np.exp(-np.abs(np.diff(load, prepend=load[0])) / (late * np.std(seen.first(load))))
        state, out = goal[0], np.empty(len(load))
        for k in range(len(load)):
            state = goal[k] + keep[k] * (state - goal[k])
            out[k] = state
        m.joint[:, j] += size * out

    detail = {"joint": j + 1, "knee": knee, "late": late}
    where = place(j, f"torque {j + 1}", "hysteresis")
    return Act("hysteresis", where, "rad", 1e-4, 9e-4, move, detail, form="Jiles")


def encoder_scale(rng: np.random.Generator, _w: World) -> Act:
    """Return a graduation of two parts: its scale changes at one angle."""
    j, sign, share = rng.integers(6), rng.choice([-1.0, 1.0]), rng.uniform(0.5, 0.9)

    def move(seen: Seen, size: float, m: Moved) -> None:
        x = seen.readings[:, j]
        kink = np.median(seen.first(x))
        scaled = np.where(x > kink, x, kink + share * (x - kink))
        m.joint[:] += (sign * size * scaled)[:, None] * LINK_FROM_READING[:, j]

    detail = {"joint": j + 1, "share": share, "sign": sign}
    where = place(j, "joint angle", "encoder-scale", (f"reading {j + 1}",))
    return Act("encoder-scale", where, "rad/rad", 4e-5, 4e-4, move, detail, form="two scales")


def coupling(rng: np.random.Generator, _w: World) -> Act:
    """Return a joint that another one drags along, less and less far from the middle."""
    pairs = [(3, 4), (4, 5), (3, 5), (1, 2), (2, 3), (0, 1)]
    i, j = pairs[rng.integers(len(pairs))]
    level, sign = rng.uniform(1.0, 2.0), rng.choice([-1.0, 1.0])

    def move(seen: Seen, size: float, m: Moved) -> None:
        x = seen.readings[:, i]
        reach = level * np.std(seen.first(x))
        m.joint[:, j] += sign * size * reach * np.tanh((x - np.median(seen.first(x))) / reach)

    also = tuple(f"{word}{i + 1}{arrow}{j + 1}" for word in ("joint ", "") for arrow in ("->", " -> "))
    detail = {"driver": i + 1, "driven": j + 1, "level": level, "sign": sign}
    where = place(j, f"joint {i + 1}", "coupling", (*also, f"reading {i + 1}"))
    return Act("coupling", where, "rad/rad", 5e-5, 4e-4, move, detail, form="levels off")


def hardening(rng: np.random.Generator, w: World) -> Act:
    """Return a joint of two stiffnesses, with a corner at each sign of the torque, not the same."""
    j, corners = rng.integers(1, 6), rng.uniform(0.15, 0.6, 2)

    def move(seen: Seen, size: float, m: Moved) -> None:
        load = seen.load[:, JOINT[j]]
        most = np.percentile(np.abs(seen.first(load)), 90)
        m.joint[:, j] += size * w.give[j] * np.clip(load, -corners[0] * most, corners[1] * most)

    detail = {"joint": j + 1, "corners": corners.tolist()}
    where = place(j, f"torque {j + 1}", "hardening")
    return Act("hardening", where, "1", 0.3, 0.7, move, detail, form="piecewise")


def compliance(rng: np.random.Generator, w: World) -> Act:
    """Return the arm's whole elasticity, varying with the angle of every joint by some per cent."""
    give, swing, phase = w.arm.shape.give, rng.uniform(0.02, 0.12, 6), rng.uniform(0, 2 * np.pi, 6)

    def move(seen: Seen, size: float, m: Moved) -> None:
        m.joint[:] += size * give * (1 + swing * np.cos(2 * seen.link + phase)) * seen.load[:, JOINT]

    where = [place(j - 1, f"torque {j}", "compliance")[0] for j in (3, 2, 5, 4, 6)]
    return Act("compliance", where, "1", 0.1, 1.5, move, {"swing": swing.tolist()}, form="varies with angle")
