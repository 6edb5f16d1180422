"""Effects of joints, in forms of machines: eccentric discs, oval splines, teeth, backlash with memory."""

from __future__ import annotations

import numpy as np

from analysis.world.arm import JOINT, LINK_FROM_READING, REDUCTIONS
from analysis.world.touch import Act, Moved, Seen, World


def place(joint: int | np.integer, driver: str, name: str, also: tuple[str, ...] = ()) -> list[dict]:
    """Return the location of an effect of a joint (counted from 0), as the ground truth states it."""
    return [{"site": f"joint {joint + 1}", "driver": driver, "also": list(also), "effect": name}]


def eccentricity(rng: np.random.Generator, _w: World) -> Act:
    """Return a graduated disc off its centre, slightly oval."""
    j, phase, oval, second = (
        rng.integers(6),
        rng.uniform(0, 6.28),
        rng.uniform(0.02, 0.15),
        rng.uniform(0, 6.28),
    )

    def move(seen: Seen, size: float, m: Moved) -> None:
        t = seen.link[:, j] + phase
        m.joint[:, j] += np.arctan2(size * np.sin(t), 1 + size * np.cos(t)) + oval * size * np.sin(
            2 * t + second
        )

    where = place(j, "joint angle, once a turn", "eccentricity")
    return Act(
        "eccentricity", where, "rad", 1.5e-4, 5e-4, move, {"joint": j + 1, "phase": phase, "oval": oval}
    )


def second_harmonic(rng: np.random.Generator, _w: World) -> Act:
    """Return an oval spline: two flattened waves a turn, one a little larger."""
    j, phase, sharp, odd = rng.integers(6), rng.uniform(0, 6.28), rng.uniform(0.3, 1.3), rng.uniform(0, 0.12)

    def move(seen: Seen, size: float, m: Moved) -> None:
        t = seen.link[:, j]
        m.joint[:, j] += size * (
            np.tanh(sharp * np.sin(2 * t + phase)) / np.tanh(sharp) + odd * np.sin(t - phase)
        )

    where = place(j, "joint angle, twice a turn", "second-harmonic")
    return Act(
        "second-harmonic", where, "rad", 1e-4, 5e-4, move, {"joint": j + 1, "phase": phase, "sharp": sharp}
    )


def gear_mesh(rng: np.random.Generator, _w: World) -> Act:
    """Return teeth: one or two skewed waves a motor turn, stronger on one side of the wheel."""
    j, waves, phase = rng.integers(6), rng.integers(1, 3), rng.uniform(0, 6.28)
    skew, swell, side = rng.uniform(0.1, 0.4), rng.uniform(0, 0.3), rng.uniform(0, 6.28)

    def move(seen: Seen, size: float, m: Moved) -> None:
        t = waves * REDUCTIONS[j] * seen.link[:, j] + phase
        m.joint[:, j] += size * np.sin(t + skew * np.sin(t)) * (1 + swell * np.cos(seen.link[:, j] + side))

    driver = f"motor angle, {'one wave' if waves == 1 else 'two waves'} a turn"
    detail = {"joint": j + 1, "waves": waves, "phase": phase, "skew": skew, "swell": swell}
    return Act("gear-mesh", place(j, driver, "gear-mesh"), "rad", 5e-5, 2.5e-4, move, detail)


def played(path: np.ndarray, half: float, start: float) -> np.ndarray:
    """Return what follows a path with backlash: it moves only when pushed."""
    out, y = np.empty(len(path)), path[0] + start * half
    for k, x in enumerate(path):
        y = min(max(y, x - half), x + half)
        out[k] = y
    return out


def backlash(rng: np.random.Generator, _w: World) -> Act:
    """Return backlash with memory along the whole path: off the surface, across, and on to the next touch."""
    j, off, start = rng.integers(6), rng.uniform(3e-3, 9e-3), rng.uniform(-1, 1)
    relative = (j == 2 and rng.random() < 0.3) or (j == 1 and rng.random() < 0.5)
    row = LINK_FROM_READING[j] if relative else np.eye(6)[j]
    moves = np.eye(6)[j] if relative else LINK_FROM_READING[:, j]

    def move(seen: Seen, size: float, m: Moved) -> None:
        x, back = seen.readings @ row, (seen.session.way @ row) * off
        path = np.stack([x - back, x, x - back], axis=1).ravel()
        m.joint[:] += (played(path, size, start)[1::3] - x)[:, None] * moves

    where = place(j, f"approach {j + 1}", "backlash")
    return Act(
        "backlash",
        where,
        "rad",
        1e-4,
        5e-4,
        move,
        {"joint": j + 1, "link_side": bool(relative), "off_m": off},
    )


def hysteresis(rng: np.random.Generator, _w: World) -> Act:
    """Return wind-up that leans with the load, with shares of the way of approach and of the past."""
    j, steep = rng.integers(1, 6), rng.uniform(0.1, 0.35)
    friction, memory, band = rng.uniform(0.05, 0.3), rng.uniform(0.0, 0.25), rng.uniform(0.3, 0.8)

    def move(seen: Seen, size: float, m: Moved) -> None:
        load, way = seen.load[:, JOINT[j]], seen.session.velocity @ LINK_FROM_READING[j]
        scale = steep * np.std(seen.first(load))
        lean = np.tanh((load + friction * scale * np.sign(way)) / scale)
        past = (load - played(load, band * np.std(seen.first(load)), 0.0)) / (band * np.std(seen.first(load)))
        m.joint[:, j] += size * ((1 - memory) * lean + memory * past)

    detail = {"joint": j + 1, "steep": steep, "friction": friction, "memory": memory}
    return Act("hysteresis", place(j, f"torque {j + 1}", "hysteresis"), "rad", 1e-4, 9e-4, move, detail)


def encoder_scale(rng: np.random.Generator, _w: World) -> Act:
    """Return a graduation that is too long, and a little more so at one end."""
    j, bend, sign = rng.integers(6), rng.uniform(-0.1, 0.1), rng.choice([-1.0, 1.0])
    relative = j in (1, 2) and rng.random() < 0.5
    row = LINK_FROM_READING[j] if relative else np.eye(6)[j]
    moves = np.eye(6)[j] if relative else LINK_FROM_READING[:, j]

    def move(seen: Seen, size: float, m: Moved) -> None:
        x = seen.readings @ row
        m.joint[:] += (sign * size * (x + bend * x * x))[:, None] * moves

    where = place(j, "joint angle", "encoder-scale", (f"reading {j + 1}",))
    return Act(
        "encoder-scale",
        where,
        "rad/rad",
        4e-5,
        4e-4,
        move,
        {"joint": j + 1, "link_side": bool(relative), "bend": bend, "sign": sign},
    )


def coupling(rng: np.random.Generator, _w: World) -> Act:
    """Return one joint dragged along by another."""
    pairs = [(3, 4), (4, 5), (3, 5), (1, 2), (2, 3), (0, 1), (1, 0)]
    i, j = pairs[rng.choice(len(pairs), p=[0.25, 0.25, 0.15, 0.1, 0.1, 0.1, 0.05])]
    bend, sign = rng.uniform(-0.15, 0.15), rng.choice([-1.0, 1.0])

    def move(seen: Seen, size: float, m: Moved) -> None:
        x = seen.readings[:, i]
        m.joint[:, j] += sign * size * (x + bend * x * x)

    also = (
        f"joint {i + 1}->{j + 1}",
        f"joint {i + 1} -> joint {j + 1}",
        f"{i + 1}->{j + 1}",
        f"reading {i + 1}",
    )
    detail = {"driver": i + 1, "driven": j + 1, "bend": bend, "sign": sign}
    return Act("coupling", place(j, f"joint {i + 1}", "coupling", also), "rad/rad", 5e-5, 4e-4, move, detail)


def hardening(rng: np.random.Generator, w: World) -> Act:
    """Return a joint that is softer near no load: extra wind-up that levels off."""
    j, knee = rng.integers(1, 6), rng.uniform(0.15, 0.5)

    def move(seen: Seen, size: float, m: Moved) -> None:
        load = seen.load[:, JOINT[j]]
        scale = knee * np.percentile(np.abs(seen.first(load)), 90)
        m.joint[:, j] += size * w.give[j] * scale * np.arctan(load / scale)

    where = place(j, f"torque {j + 1}", "hardening")
    return Act("hardening", where, "1", 0.3, 0.7, move, {"joint": j + 1, "knee": knee})


def compliance(_rng: np.random.Generator, w: World) -> Act:
    """Return the arm's whole elasticity, for a baseline that knows geometry only."""
    give = w.arm.shape.give

    def move(seen: Seen, size: float, m: Moved) -> None:
        m.joint[:] += size * give * seen.load[:, JOINT]

    where = [
        {"site": f"joint {j}", "driver": f"torque {j}", "also": [], "effect": "compliance"}
        for j in (3, 2, 5, 4, 6)
    ]
    return Act("compliance", where, "1", 0.1, 1.5, move)
