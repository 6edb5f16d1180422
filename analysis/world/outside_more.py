"""More causes not in the list of known effects, of two coordinates or with memory; half of them are reserved.

Reserved causes are drawn only on request: no constant may be chosen on them.
"""

from __future__ import annotations

import numpy as np

from analysis.world.arm import JOINT, LINK_FROM_READING
from analysis.world.joints import played
from analysis.world.outside import place
from analysis.world.session import FURTHER
from analysis.world.touch import Act, Moved, Seen, World


def drag(rng: np.random.Generator, w: World) -> Act:
    """Return a hose over two joints: it is taut only where both are turned far, and drags one of them."""
    i, k, j = [(3, 4, 4), (4, 5, 4), (3, 5, 5), (0, 1, 1), (1, 2, 2), (2, 4, 3)][rng.integers(6)]
    ways, soft = rng.choice([-1.0, 1.0], 2), rng.uniform(0.1, 0.3)
    x = w.session.start[w.session.phase < FURTHER]
    middle, wide = np.median(x[:, [i, k]], axis=0), np.std(x[:, [i, k]], axis=0)

    def move(seen: Seen, size: float, m: Moved) -> None:
        both = soft * np.logaddexp(0, ways * (seen.readings[:, [i, k]] - middle) / wide / soft)
        m.joint[:, j] += size * both[:, 0] * both[:, 1]

    driver, also = f"joint {i + 1} and joint {k + 1}", (f"joint {i + 1}", f"joint {k + 1}", "joint angle")
    detail = {"by": [i + 1, k + 1], "joint": j + 1, "ways": ways.tolist()}
    return Act("drag", place(f"joint {j + 1}", driver, "drag", *also), "rad", 1e-4, 9e-4, move, detail)


def carried_play(rng: np.random.Generator, _w: World) -> Act:
    """Return backlash whose state goes from contact to contact: the approach is too short to take it up."""
    j, start = rng.integers(6), rng.uniform(-1, 1)

    def move(seen: Seen, size: float, m: Moved) -> None:
        x = seen.readings @ LINK_FROM_READING[j]
        m.joint[:, j] += played(x, size, start) - x

    where = place(f"joint {j + 1}", f"past angle {j + 1}", "carried-play", f"approach {j + 1}", "time")
    return Act("carried-play", where, "rad", 1e-4, 5e-4, move, {"joint": j + 1})


def shoved_target(rng: np.random.Generator, w: World) -> Act:
    """Return a cube on a smooth table: every contact shoves it on, until a stop holds it."""
    s, power = w.session, rng.uniform(0.3, 0.8)
    on = s.target < 4
    push = np.where(on[:, None], -w.scene.normal[np.minimum(s.target, 3)], 0.0)
    push[:, 2] = 0.0
    drift = np.cumsum(rng.uniform(0.2, 1.0, (len(on), 1)) * push * rng.uniform(0.5, 1.5, 3), axis=0)
    drift = np.sign(drift) * np.abs(drift) ** power
    drift /= np.abs(drift).max()

    def move(seen: Seen, size: float, m: Moved) -> None:
        m.height[:] += size * np.sum(drift * seen.normal, axis=1) * on

    where = place("cube", "count of contacts", "shoved-target", "cube.", "target", "time", "session")
    return Act("shoved-target", where, "m", 3e-5, 2e-4, move, {"power": power})


def slipping_tip(rng: np.random.Generator, w: World) -> Act:
    """Return a tip (a stylus, a reflector in its nest) that slips at one row and half back at another."""
    s, count = w.session, int(np.sum(w.session.phase == 0))
    rows = np.sort(rng.choice(np.arange(count // 10, count - count // 10), 2, replace=False))
    ways = rng.standard_normal((2, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ways[1] = -0.5 * ways[0] + 0.5 * ways[1]
    after = np.arange(len(s.time))[:, None] >= rows

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.tip[:] += size * after @ ways

    where = place("tool", "time", "slipping-tip", "probe", "stylus", "reflector", "session", "time", "flange")
    detail = {"rows": rows.tolist(), "when_s": s.time[rows].tolist()}
    return Act("slipping-tip", where, "m", 3e-5, 2e-4, move, detail)


def hasty_trigger(rng: np.random.Generator, w: World) -> Act:
    """Return a trigger whose travel grows with the speed, the more the further to one side it is pushed."""
    bearing, power = rng.uniform(0, 2 * np.pi), rng.uniform(0.6, 1.4)
    speed = (w.session.speed / np.median(w.session.speed[w.session.phase < FURTHER])) ** power

    def move(seen: Seen, size: float, m: Moved) -> None:
        d = seen.push()
        side = d[:, 0] * np.cos(bearing) + d[:, 1] * np.sin(bearing)
        m.travel[:] += size * speed * side

    also = ("approach direction in the tool frame", "tool", "stylus", "velocity", "flange")
    where = place("probe", "speed and direction of approach", "hasty-trigger", *also)
    detail = {"bearing": bearing, "power": power}
    return Act("hasty-trigger", where, "m", 1e-5, 6e-5, move, detail)


def loose_bolt(rng: np.random.Generator, _w: World) -> Act:
    """Return a bolt of a link with clearance: the link rocks to the side of the load and stays."""
    j, stick = rng.integers(1, 6), rng.uniform(0.2, 0.8)
    way = rng.standard_normal(3)
    way *= rng.uniform(0.0, 0.3) / np.linalg.norm(way)

    def move(seen: Seen, size: float, m: Moved) -> None:
        load = seen.load[:, JOINT[j]]
        band, side, last = stick * np.std(seen.first(load)), np.empty(len(load)), 1.0
        for k, x in enumerate(load):
            last = np.sign(x) if abs(x) > band else last
            side[k] = last
        m.joint[:, j] += size * side
        m.tip[:] += size * side[:, None] * way

    where = place(
        f"joint {j + 1}", f"past torque {j + 1}", "loose-bolt", f"link {j + 1}", f"link {j}", "tool"
    )
    return Act("loose-bolt", where, "rad", 1e-4, 5e-4, move, {"joint": j + 1, "stick": stick})


MORE = (drag, carried_play, shoved_target)
RESERVED = (slipping_tip, hasty_trigger, loose_bolt)
