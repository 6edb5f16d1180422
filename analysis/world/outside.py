"""Effects not in the list of known effects; the correct answer is 'unknown', with a location."""

from __future__ import annotations

import numpy as np

from analysis.world.arm import JOINT, LINK_FROM_READING
from analysis.world.scene import FACES
from analysis.world.session import CUBE
from analysis.world.touch import Act, Moved, Seen, World


def place(site: str, driver: str, name: str, *also: str) -> list[dict]:
    """Return the location of a cause, as the ground truth states it."""
    return [{"site": site, "driver": driver, "also": list(also), "effect": name}]


def tooth(rng: np.random.Generator, w: World) -> Act:
    """Return one damaged tooth: a steep side, a long side, and zero elsewhere."""
    j = rng.integers(6)
    link = w.session.start[w.session.phase == 0] @ LINK_FROM_READING[j]
    at, steep, long = (
        np.quantile(link, rng.uniform(0.15, 0.85)),
        *np.radians(rng.uniform([1.0, 3.0], [3.0, 9.0])),
    )

    def move(seen: Seen, size: float, m: Moved) -> None:
        x = seen.link[:, j] - at
        m.joint[:, j] += size * np.exp(-np.abs(x) / np.where(x < 0, steep, long))

    detail = {
        "joint": j + 1,
        "at_deg": np.degrees(at),
        "steep_deg": np.degrees(steep),
        "long_deg": np.degrees(long),
    }
    return Act(
        "tooth", place(f"joint {j + 1}", "joint angle, one place", "tooth"), "rad", 2e-4, 9e-4, move, detail
    )


def loosening(rng: np.random.Generator, w: World) -> Act:
    """Return a stylus that works loose: every touch from one side moves it on."""
    s, axis, power = w.session, rng.standard_normal(3), rng.uniform(0.5, 2.5)
    axis /= np.linalg.norm(axis)
    f = int(rng.integers(5))
    f = f if np.any(s.target == f) else 4
    knocks = np.cumsum((s.target == f) if f < 4 else np.ones(len(s.target)))
    share = (knocks / knocks[s.phase == 0].max()) ** power

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.tip[:] += size * share[:, None] * axis

    on = f" on {FACES[f]}" if f < 4 else ""
    where = place(
        "probe", f"count of contacts{on}", "loosening", "tool", "time", "stylus", "flange", "session"
    )
    return Act("loosening", where, "m", 2e-5, 1e-4, move, {"axis": axis.tolist(), "power": power})


def cable(rng: np.random.Generator, w: World) -> Act:
    """Return a hose that hangs slack until one joint pulls it taut, and then drags a joint."""
    i, j = [(3, 4), (5, 4), (4, 5), (0, 1), (3, 3), (5, 5)][rng.integers(6)]
    way = rng.choice([-1.0, 1.0])
    x = way * w.session.start[w.session.phase == 0][:, i]
    taut, soft = np.quantile(x, rng.uniform(0.45, 0.75)), rng.uniform(0.03, 0.12)
    most = np.max(x) - taut

    def move(seen: Seen, size: float, m: Moved) -> None:
        pull = soft * np.logaddexp(0, (way * seen.readings[:, i] - taut) / soft)
        m.joint[:, j] += size * pull / most

    where = place(
        f"joint {j + 1}", f"joint {i + 1}, beyond one angle", "cable", "joint angle", f"joint {i + 1}"
    )
    return Act(
        "cable",
        where,
        "rad",
        2e-4,
        9e-4,
        move,
        {"by": i + 1, "joint": j + 1, "taut_deg": np.degrees(way * taut)},
    )


def warm_trigger(rng: np.random.Generator, w: World) -> Act:
    """Return a probe whose trigger needs more travel as it warms, more along its axis than across."""
    s, tau, axial = w.session, rng.uniform(400, 2500), rng.uniform(0.3, 1.5)
    warm = 1 - np.exp(-s.time / tau)

    def move(seen: Seen, size: float, m: Moved) -> None:
        m.travel[:] += size * warm * (1 + axial * seen.push()[:, 2])

    where = place("probe", "temperature", "warm-trigger", "time", "tool", "stylus", "session")
    return Act("warm-trigger", where, "m", 8e-6, 4e-5, move, {"tau_s": tau, "axial": axial})


def zero_jumps(rng: np.random.Generator, w: World) -> Act:
    """Return a joint whose zero sticks at one of few values and slips to another, several times."""
    s, j, count = w.session, rng.integers(6), rng.integers(3, 7)
    cut = np.sort(rng.choice(np.arange(20, np.sum(s.phase == 0) - 20), count, replace=False))
    values = rng.permutation([-1.0, 0.1, 1.0])
    now, state = np.zeros(len(s.time)), 0
    for a, b in zip([0, *cut], [*cut, len(s.time)], strict=True):
        now[a:b] = values[state]
        state = int(state + rng.integers(1, 3)) % 3

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.joint[:, j] += size * now

    where = place(f"joint {j + 1}", "time", "zero-jumps", "session", "time")
    return Act("zero-jumps", where, "rad", 6e-5, 4e-4, move, {"joint": j + 1, "at_s": s.time[cut].tolist()})


def snag(rng: np.random.Generator, w: World) -> Act:
    """Return a trigger that comes late in one part of the workspace, where the probe's lead is caught."""
    places = w.scene.point if w.session.stage == CUBE else w.scene.ball[w.session.calibrating - 4]
    near = places[rng.integers(len(places))]
    middle, wide = near + rng.uniform(-0.08, 0.08, 3), rng.uniform(0.04, 0.09)

    def move(seen: Seen, size: float, m: Moved) -> None:
        far = np.linalg.norm(seen.ball - middle, axis=1) / wide
        m.travel[:] += size / (1 + far**3)

    where = place(
        "probe", "place in the workspace", "snag", "region", "tool", "position", "place on the face"
    )
    return Act("snag", where, "m", 1e-5, 6e-5, move, {"middle_m": middle.tolist(), "wide_m": wide})


def sway(rng: np.random.Generator, _w: World) -> Act:
    """Return a base that tilts periodically with the cycles of a machine nearby."""
    period, phase, bearing = rng.uniform(250, 1400), rng.uniform(0, 6.28), rng.uniform(0, 6.28)

    def move(seen: Seen, size: float, m: Moved) -> None:
        now = size * np.tanh(1.5 * np.sin(2 * np.pi * seen.session.time / period + phase))
        m.base[:, 3] += now * np.cos(bearing)
        m.base[:, 4] += now * np.sin(bearing)

    where = place("base", "time", "sway", "session", "pedestal", "time")
    return Act("sway", where, "rad", 2e-5, 1.5e-4, move, {"period_s": period})


def dent(rng: np.random.Generator, _w: World) -> Act:
    """Return dirt on one spot of a face, or a dent."""
    f, spot, wide, sign = (
        rng.integers(4),
        rng.uniform(-0.6, 0.6, 2),
        rng.uniform(0.15, 0.35),
        rng.choice([-1, 1]),
    )

    def move(seen: Seen, size: float, m: Moved) -> None:
        far = np.linalg.norm(seen.on_face() - spot, axis=1) / wide
        m.height[:] += sign * size / (1 + far**4) * (seen.session.target == f)

    also = (FACES[f][5:], f"target {FACES[f]}", "place on the face")
    where = place(FACES[f], "place on the face, one spot", "dent", *also)
    return Act("dent", where, "m", 2e-5, 8e-5, move, {"face": FACES[f], "spot": spot.tolist(), "wide": wide})


def creep(rng: np.random.Generator, w: World) -> Act:
    """Return a joint that creeps long after its load has changed."""
    j, tau = rng.integers(1, 6), rng.uniform(40, 200)
    keep = np.exp(-np.diff(w.session.time, prepend=w.session.time[0]) / tau)

    def move(seen: Seen, size: float, m: Moved) -> None:
        load, late = seen.load[:, JOINT[j]], np.empty(len(keep))
        state = load[0]
        for k in range(len(keep)):
            state = keep[k] * state + (1 - keep[k]) * load[k]
            late[k] = state
        m.joint[:, j] += size * w.give[j] * (late - load)

    where = place(f"joint {j + 1}", f"past torque {j + 1}", "creep", f"torque {j + 1}", "time")
    return Act("creep", where, "1", 0.3, 1.0, move, {"joint": j + 1, "tau_s": tau})


OUTSIDE = (tooth, loosening, cable, warm_trigger, zero_jumps, snag, sway, dent, creep)
