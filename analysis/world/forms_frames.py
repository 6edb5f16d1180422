"""Second forms of the effects of what carries the joints: independent of the first."""

from __future__ import annotations

import numpy as np

from analysis.world.arm import HINGE
from analysis.world.frames import LINKS
from analysis.world.touch import Act, Moved, Seen, World


def _rotation(axis: str, angle: np.ndarray) -> np.ndarray:
    """Return rotations (n, 3, 3) about x or z."""
    c, s, o, e = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = (e, o, o, o, c, -s, o, s, c) if axis == "x" else (c, -s, o, s, c, o, o, o, e)
    return np.stack(rows, axis=-1).reshape(len(angle), 3, 3)


def link_turn(w: World, link: np.ndarray, k: int) -> np.ndarray:
    """Return the orientation (n, 3, 3) of link k (from 0), undeflected, at link angles (n, 6)."""
    out = np.broadcast_to(np.eye(3), (len(link), 3, 3))
    for i in range(k + 1):
        alpha = np.full(len(link), w.arm.shape.alpha[i])
        out = out @ _rotation("x", alpha) @ _rotation("z", w.arm.shape.zero[i] + link[:, i])
    return out


def thermal_drift(rng: np.random.Generator, w: World) -> Act:
    """Return a warm-up of two time constants that a pause within the session interrupts."""
    s = w.session
    tau, slow = np.array([rng.uniform(200, 800), rng.uniform(2500, 8000)]), rng.uniform(0.3, 0.8)
    rest = np.quantile(s.time[s.phase == 0], rng.uniform(0.3, 0.6)) + np.array([0.0, rng.uniform(400, 1500)])
    idle = ((s.time > rest[0]) & (s.time < rest[1])) | (s.phase == 2)
    state, warm = np.zeros(2), np.empty(len(s.time))
    for k, dt in enumerate(np.diff(s.time, prepend=0.0)):
        goal = 0.0 if idle[k] else 1.0
        state = goal + (state - goal) * np.exp(-dt / tau)
        warm[k] = (1 - slow) * state[0] + slow * state[1]
    tilt, zero, lift = 4e-6 * rng.standard_normal(2), 4e-6 * rng.standard_normal(2), rng.uniform(2e-6, 8e-6)

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.base[:, 2] += size * lift * warm
        m.base[:, 3:5] += size * warm[:, None] * tilt
        m.joint[:, 1:3] += size * warm[:, None] * zero
        m.growth[:, 1:] += size * 4e-6 * warm[:, None]

    also = ["temperature", "thermal", "base", "link 1", "link 2", "link 3", "link 4", "arm", "session"]
    where = [{"site": "time", "driver": "temperature", "also": also, "effect": "thermal-drift"}]
    detail = {"tau_s": tau.tolist(), "slow": slow, "pause_s": rest.tolist()}
    return Act("thermal-drift", where, "K", 5.0, 25.0, move, detail, form="two time constants, a pause")


def step(rng: np.random.Generator, w: World) -> Act:
    """Return a base that slides and turns over three rows of the session, not at once."""
    s = w.session
    row = int(rng.uniform(0.2, 0.8) * np.sum(s.phase == 0))
    shift, turn = rng.standard_normal(3), 1.8 * rng.standard_normal(3)
    shift /= np.linalg.norm(shift)
    share = np.clip((np.arange(len(s.time)) - row + 1) / 3, 0, 1)[:, None]

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.base[:] += size * share * np.concatenate([shift, turn])

    where = [{"site": "base", "driver": "time", "also": ["time", "session", "step"], "effect": "step"}]
    detail = {"row": row, "when_s": s.time[row], "shift": shift.tolist(), "turn_radpm": turn.tolist()}
    return Act("step", where, "m", 2e-5, 3e-4, move, detail, form="ramp over three rows")


def bending(rng: np.random.Generator, w: World) -> Act:
    """Return a link that yields along its whole length: the angle of a hinge, centred elsewhere, and twist.

    The curvature is largest at the root, so that the link turns about a place in its first half. Beyond the
    link everything shifts by the difference of the two places; that shift is the same for the ball.
    """
    k = int(rng.choice(5, p=[0.2, 0.2, 0.15, 0.3, 0.15]))
    centre, ratio, twist = rng.uniform(0.2, 0.45), rng.uniform(0.6, 1.0), rng.uniform(-0.2, 0.2)
    shape = w.arm.shape
    along = (shape.hinge_at - centre) * np.array([shape.a[k + 1], 0.0, shape.d[k]])

    def move(seen: Seen, size: float, m: Moved) -> None:
        angle = size * np.array([1.0, ratio]) * seen.load[:, HINGE[k]]
        m.hinge[:, k] += angle
        m.joint[:, k] += twist * angle[:, 0]
        shift = np.cross(np.pad(angle, ((0, 0), (0, 1))), along)
        in_base = np.einsum("nij,nj->ni", link_turn(w, seen.link, k), shift)
        m.tip[:] += np.einsum("nji,nj->ni", seen.turn, in_base)

    also = [f"joint {k + 1}", LINKS[k]]
    where = [{"site": f"link {k + 1}", "driver": "bending moment", "also": also, "effect": "bending"}]
    cap = (2e-5, 1.2e-4, 1.2e-4, 3e-4, 3e-4)[k]
    detail = {"link": k + 1, "centre": centre, "ratio": ratio, "twist": twist}
    return Act("bending", where, "rad/(N m)", 0.3 * cap, cap, move, detail, form="along the whole link")


def base_compliance(rng: np.random.Generator, _w: World) -> Act:
    """Return a stand that turns about a place far below the arm, with axes of its own."""
    below, bearing, ratio = rng.uniform(0.3, 1.0), rng.uniform(0, np.pi), rng.uniform(0.2, 0.9)
    c, s = np.cos(bearing), np.sin(bearing)
    turned = np.array([[c, -s], [s, c]])
    give = turned @ np.diag([1.0, ratio]) @ turned.T

    def move(seen: Seen, size: float, m: Moved) -> None:
        tilt = size * seen.load[:, 3:5] @ give
        m.base[:, 3:5] += tilt
        m.base[:, :2] += below * np.stack([tilt[:, 1], -tilt[:, 0]], axis=1)

    also = ["joint 0", "link 0", "pedestal"]
    where = [{"site": "base", "driver": "base moment", "also": also, "effect": "base-compliance"}]
    detail = {"below_m": below, "bearing": bearing, "ratio": ratio}
    return Act("base-compliance", where, "rad/(N m)", 8e-6, 4e-5, move, detail, form="hinge below the stand")


def _hung(rng: np.random.Generator) -> np.ndarray:
    """Return how far (m) a mass hangs from the stated centre: 30 to 120 mm, in any direction."""
    off = rng.standard_normal(3)
    return rng.uniform(0.03, 0.12) * off / np.linalg.norm(off)


def payload(rng: np.random.Generator, _w: World) -> Act:
    """Return a mass that was not stated and hangs elsewhere than the tool's centre of mass."""
    sign, off = rng.choice([-1.0, 1.0]), _hung(rng)

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.kilos[:] += sign * size
        m.aside[:] += sign * size * off

    where = [{"site": "tool", "driver": "mass", "also": ["payload", "flange"], "effect": "payload"}]
    detail = {"which": "tool", "sign": sign, "off_m": off.tolist()}
    return Act("payload", where, "kg", 0.15, 0.4, move, detail, form="centre elsewhere")


def added_payload(rng: np.random.Generator, w: World) -> Act:
    """Return an added mass that is as stated, but hangs elsewhere than stated; the size is a share of it."""
    off = _hung(rng)

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.aside[:] += size * w.session.payload[:, None] * off

    where = [{"site": "tool", "driver": "mass", "also": ["payload", "flange"], "effect": "payload"}]
    detail = {"which": "added", "off_m": off.tolist()}
    return Act("payload", where, "1", 0.5, 1.5, move, detail, form="added load hung elsewhere")
