"""Effects of what carries the joints: heat, a knock, yielding links and stand, a mass misstated."""

from __future__ import annotations

import numpy as np

from analysis.world.arm import HINGE
from analysis.world.session import FURTHER
from analysis.world.touch import Act, Moved, Seen, World

LINKS = ("column", "upper arm", "elbow", "forearm", "wrist")


def thermal_drift(rng: np.random.Generator, w: World) -> Act:
    """Return a warm-up of three bodies, each in its own time; what is long grows, what is lopsided tilts."""
    s = w.session
    tau = rng.uniform(500, 4000, 3)
    share = rng.uniform(0.3, 1.0, 3)
    warm = share * (1 - np.exp(-s.time[:, None] / tau))
    warm[s.phase == 2] *= rng.uniform(0.7, 0.95)
    grow = rng.uniform(12e-6, 23e-6)
    turn = 3e-6 * rng.standard_normal(2)
    zero = 3e-6 * rng.standard_normal(2)

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.base[:, 2] += size * grow * 0.33 * warm[:, 0]
        m.base[:, 3:5] += size * warm[:, :1] * turn
        m.growth[:] += size * grow * np.array([0.075, 0.3, 0.32]) * warm
        m.joint[:, 1:3] += size * warm[:, 1:] * zero

    also = ["temperature", "thermal", "base", "link 1", "link 2", "link 3", "link 4", "arm", "session"]
    where = [{"site": "time", "driver": "temperature", "also": also, "effect": "thermal-drift"}]
    detail = {
        "tau_s": tau.tolist(),
        "share": share.tolist(),
        "base_radpk": turn.tolist(),
        "zero_radpk": zero.tolist(),
    }
    return Act("thermal-drift", where, "K", 5.0, 25.0, move, detail)


def step(rng: np.random.Generator, w: World) -> Act:
    """Return a base that shifts and rotates at one row of the session."""
    s = w.session
    when = np.quantile(s.time[s.phase == 0], rng.uniform(0.2, 0.8))
    shift = rng.standard_normal(3)
    shift /= np.linalg.norm(shift)
    turn = 1.8 * rng.standard_normal(3)
    after = (s.time > when)[:, None]

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.base[:] += size * after * np.concatenate([shift, turn])

    where = [{"site": "base", "driver": "time", "also": ["time", "session", "step"], "effect": "step"}]
    detail = {"when_s": when, "shift": shift.tolist(), "turn_radpm": turn.tolist()}
    return Act("step", where, "m", 2e-5, 3e-4, move, detail)


def bending(rng: np.random.Generator, _w: World) -> Act:
    """Return a link that yields somewhere along itself, across its joint, unequally in its two directions."""
    k = rng.choice(5, p=[0.2, 0.2, 0.15, 0.3, 0.15])
    ratio = np.array([1.0, rng.uniform(0.4, 1.0)])
    if rng.random() < 0.5:
        ratio = ratio[::-1]

    def move(seen: Seen, size: float, m: Moved) -> None:
        m.hinge[:, k] += size * ratio * seen.load[:, HINGE[k]]

    also = [f"joint {k + 1}", LINKS[k]]
    where = [{"site": f"link {k + 1}", "driver": "bending moment", "also": also, "effect": "bending"}]
    cap = (2e-5, 1.2e-4, 1.2e-4, 3e-4, 3e-4)[k]
    return Act("bending", where, "rad/(N m)", 0.3 * cap, cap, move, {"link": k + 1, "ratio": ratio.tolist()})


def base_compliance(rng: np.random.Generator, _w: World) -> Act:
    """Return a stand that yields more to one side than to the other."""
    ratio = np.array([1.0, rng.uniform(0.2, 0.9)])
    if rng.random() < 0.5:
        ratio = ratio[::-1]

    def move(seen: Seen, size: float, m: Moved) -> None:
        m.base[:, 3:5] += size * ratio * seen.load[:, 3:5]

    also = ["joint 0", "link 0", "pedestal"]
    where = [{"site": "base", "driver": "base moment", "also": also, "effect": "base-compliance"}]
    return Act("base-compliance", where, "rad/(N m)", 8e-6, 4e-5, move, {"ratio": ratio.tolist()})


def payload(rng: np.random.Generator, w: World) -> Act:
    """Return a mass that was not stated, on the tool always or with what was added."""
    added = np.any(w.session.payload[w.session.phase < FURTHER] > 0) and rng.random() < 0.4
    sign = rng.choice([-1.0, 1.0])
    on = w.session.payload > 0 if added else np.ones(len(w.session.time), dtype=bool)

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.kilos[on] += sign * size

    where = [{"site": "tool", "driver": "mass", "also": ["payload", "flange"], "effect": "payload"}]
    return Act("payload", where, "kg", 0.15, 0.4, move, {"which": "added" if added else "tool", "sign": sign})
