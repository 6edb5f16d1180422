"""A measuring session: which contacts, in which order, how the arm goes there, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.world import reach
from analysis.world.arm import JOINT, LINK_FROM_READING, SIZE, Arm, nominal
from analysis.world.scene import BALL, INSTRUMENT, MIDDLE, NORMALS, SIDE, Scene

TIP = 3e-3  # radius of the probe's ball
GROUPS, TIMES, LATE, PER_BALL = 15, 4, 60, 11
CUBE, SPHERES, TRACKER = "cube", "spheres", "tracker"
"""What calibrates in a session."""
COUNT = {CUBE: (300, 640), SPHERES: (300, 640), TRACKER: (150, 401)}
"""Number of contacts or poses to calibrate with, from and below."""
AT_REST = np.radians(3e-4)  # rad: how far off its target the servo of a joint comes to rest
FURTHER = 3
"""Phase of the contacts of a further round, which are at the end of a session and calibrate."""
MOST = 12.0  # rad a metre of approach: no joint turns faster for a turn's sake


@dataclass
class Session:
    """Contacts, or poses that a tracker reads, in the order of time; m, rad and s."""

    phase: np.ndarray  # 0 calibrate, 1 spheres, 2 later planes or poses, FURTHER
    target: np.ndarray
    start: np.ndarray  # readings at the drawn place (n, 6)
    straight: np.ndarray  # readings a metre straight to the surface (n, 6)
    way: np.ndarray  # readings a metre of approach (n, 6), turning in some sessions
    speed: np.ndarray  # m/s
    time: np.ndarray
    payload: np.ndarray
    repeat: np.ndarray  # number of a repeated contact, -1 without
    temperature: np.ndarray
    measured_temperature: bool
    notes: dict
    stage: str = CUBE
    says_velocity: bool = True

    def of_rows(self, values: np.ndarray) -> np.ndarray:
        """Return values (n, ...) of contacts or poses by rows: a pose that a tracker reads has three."""
        return np.repeat(values, 3, axis=0) if self.stage == TRACKER else values

    @property
    def calibrating(self) -> np.ndarray:
        """Targets of the contacts to calibrate with, each once."""
        return np.unique(self.target[self.phase == 0])

    @property
    def measured_balls(self) -> np.ndarray:
        """Balls (0 to 11) whose distances validate."""
        return np.unique(self.target[self.phase == 1]) - 4

    @property
    def velocity(self) -> np.ndarray:
        """Joint velocities at the touch, of the readings (n, 6)."""
        return self.way * self.speed[:, None]


def _spots(rng: np.random.Generator, scene: Scene, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw the nominal places of contact (n, 3) and their outward normals (n, 3)."""
    n = len(target)
    spot, out = np.empty((n, 3)), np.empty((n, 3))
    if np.all(target == INSTRUMENT):
        return _free(rng, n)
    for f in range(4):
        here = target == f
        uv = rng.uniform(-0.093, 0.093, (here.sum(), 3))
        uv[:, np.argmax(np.abs(NORMALS[f]))] = 0.0
        spot[here] = MIDDLE + NORMALS[f] * (SIDE / 2 + TIP) + uv
        out[here] = NORMALS[f]
    for k in np.flatnonzero(target >= 4):
        up = rng.uniform(0.02, 1.0)
        centre = scene.ball_drawn[target[k] - 4]
        back = np.arctan2(-centre[1], -centre[0])
        around = back + rng.uniform(-2.4, 2.4)
        flat = np.sqrt(1 - up**2)
        out[k] = [flat * np.cos(around), flat * np.sin(around), up]
        spot[k] = centre + out[k] * (BALL / 2 + TIP)
    return spot, out


def _free(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw places of the reflector (n, 3) all around the arm, and directions from which it comes (n, 3)."""
    bearing, far, high = rng.uniform([-2.6, 0.2, 0.05], [2.6, 0.7, 0.85], (n, 3)).T
    out = rng.standard_normal((n, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return np.stack([far * np.cos(bearing), far * np.sin(bearing), high], axis=1), out


def _frames(rng: np.random.Generator, out: np.ndarray, tries: int) -> np.ndarray:
    """Draw orientations of the flange (n, tries, 3, 3): its axis looks into the surface, more or less."""
    n = len(out)
    lean = np.radians(rng.uniform(8, 85, (n, tries)))
    side = rng.standard_normal((n, tries, 3))
    side -= np.sum(side * out[:, None], axis=-1, keepdims=True) * out[:, None]
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    z = -np.cos(lean)[..., None] * out[:, None] + np.sin(lean)[..., None] * side
    x = rng.standard_normal((n, tries, 3))
    x -= np.sum(x * z, axis=-1, keepdims=True) * z
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _clear(
    q: np.ndarray, ball: np.ndarray, turn: np.ndarray, out: np.ndarray, cube: np.ndarray
) -> np.ndarray:
    """Return which poses keep flange, wrist and forearm off the surface, and off the cube where it stands."""
    flange = ball - turn @ nominal().tool
    elbow, wrist = reach.joints_in_space(q)
    ok = (np.sum((flange - ball) * out, axis=-1) > 0.025) & (np.sum((wrist - ball) * out, axis=-1) > 0.06)
    ok &= (flange[:, 2] > 0.03) & (wrist[:, 2] > 0.03)
    for share in (0.0, 0.35, 0.7, 1.0):
        at = elbow + share * (wrist - elbow) - MIDDLE
        inside = np.all(np.abs(at) < SIDE / 2 + 0.055, axis=-1)
        ok &= ~(inside & cube)
    return ok & ~(np.all(np.abs(flange - MIDDLE) < SIDE / 2 + 0.02, axis=-1) & cube)


def poses(rng: np.random.Generator, scene: Scene, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return readings (n, 6) at the drawn places, and the outward normals (n, 3) there."""
    n = len(target)
    q, out = np.full((n, 6), np.nan), np.empty((n, 3))
    left = np.arange(n)
    for _ in range(60):
        if not left.size:
            return q, out
        spot, normal = _spots(rng, scene, target[left])
        tries = 12
        frames = _frames(rng, normal, tries).reshape(-1, 3, 3)
        ball, outs = np.repeat(spot, tries, axis=0), np.repeat(normal, tries, axis=0)
        found = reach.readings(ball, frames, rng.random(len(ball)) < 0.5)
        ok = reach.within(found)
        ok[ok] = _clear(found[ok], ball[ok], frames[ok], outs[ok], np.repeat(target[left] < 4, tries)[ok])
        ok = ok.reshape(-1, tries)
        hit = np.flatnonzero(ok.any(axis=1))
        pick = hit * tries + ok[hit].argmax(axis=1)
        q[left[hit]], out[left[hit]] = found[pick], normal[hit]
        left = np.delete(left, hit)
    msg = "some places cannot be reached"
    raise RuntimeError(msg)


def _ways(
    rng: np.random.Generator, q: np.ndarray, out: np.ndarray, speed: np.ndarray, notes: dict
) -> tuple[np.ndarray, np.ndarray]:
    """Return readings a metre (n, 6): straight along the normal; and as approached, askew or turning."""
    coordinates = np.zeros((len(q), SIZE))
    coordinates[:, JOINT] = q @ LINK_FROM_READING.T
    jacobian = Arm(nominal()).jacobian(coordinates) @ LINK_FROM_READING
    straight = -out + 0.05 * rng.standard_normal(out.shape)
    spin = np.radians(notes["spin_degps"]) * rng.standard_normal(out.shape) / speed[:, None]
    inverse = np.linalg.inv(jacobian)
    way = np.einsum("nij,nj->ni", inverse[:, :, :3], straight)
    turning = np.einsum("nij,nj->ni", inverse[:, :, 3:], spin)
    way += turning * np.minimum(1, MOST / np.maximum(np.abs(turning).max(axis=1), 1e-9))[:, None]
    back = np.flatnonzero(rng.random(len(q)) < notes["reverse"])
    for k in back:  # turn about the ball so that one joint comes from the other side
        free, j = inverse[k, :, 3:], rng.integers(6)
        turned = free @ (-2 * way[k, j] * free[j] / (free[j] @ free[j]))
        if np.abs(turned).max() < MOST:
            way[k] += turned
    return np.einsum("nij,nj->ni", inverse[:, :, :3], -out), way


def _order(rng: np.random.Generator, face: np.ndarray, how: str) -> np.ndarray:
    """Return an order of contacts: target by target, at random, or half and half."""
    mixed = rng.permutation(len(face))
    if how == "random":
        return mixed
    _, face = np.unique(face, return_inverse=True)
    turns = rng.permutation(face.max() + 1)
    if how == "face":
        return mixed[np.argsort(turns[face[mixed]], kind="stable")]
    cut = len(face) // 2
    head = mixed[:cut]
    return np.concatenate([head[np.argsort(turns[face[head]], kind="stable")], mixed[cut:]])


def _calibrate(
    rng: np.random.Generator, scene: Scene, among: np.ndarray, count: int, notes: dict
) -> tuple[np.ndarray, ...]:
    """Return target, readings, normal and repeat of the contacts to calibrate with, in order."""
    single = rng.permutation(among[np.arange(count - GROUPS * TIMES) % len(among)])
    single = single[_order(rng, single, notes["order"])]
    again = rng.permutation(among[np.arange(GROUPS) % len(among)])
    target = np.concatenate([single, again])
    q, out = poses(rng, scene, target)
    cut = len(single)
    if notes["repeat"] == "in place":
        blocks = [np.repeat(np.arange(cut, cut + GROUPS), TIMES)]
    else:
        blocks = [np.arange(cut, cut + GROUPS)] * TIMES
    spread = notes["repeat"] == "cycles, spread"
    places = (
        np.sort(rng.integers(0, cut + 1, len(blocks))) if spread else [rng.integers(0, cut + 1)] * len(blocks)
    )
    index, last = [], 0
    for at, block in zip(places, blocks, strict=True):
        index += [np.arange(last, at), block]
        last = at
    order = np.concatenate([*index, np.arange(last, cut)])
    return target[order], q[order], out[order], np.where(order >= cut, order - cut, -1)


def targets(rng: np.random.Generator, stage: str) -> tuple[np.ndarray, np.ndarray]:
    """Return targets to calibrate with, and places of the plate whose distances validate.

    On spheres alone, the balls at two of the four places calibrate and those at the two others validate.
    """
    if stage == CUBE:
        return np.arange(4), np.arange(4)
    places = rng.permutation(4)
    return np.concatenate([np.arange(3) + 3 * p + 4 for p in np.sort(places[:2])]), np.sort(places[2:])


def _probed(
    rng: np.random.Generator, scene: Scene, stage: str, count: int, notes: dict
) -> list[tuple[np.ndarray, ...]]:
    """Return target, readings, normal and repeat of every phase: to calibrate, spheres, later planes."""
    among, places = targets(rng, stage)
    parts = [_calibrate(rng, scene, among, count, notes)]
    place = np.concatenate([rng.permutation(np.repeat(np.arange(3), PER_BALL)) + 3 * p + 4 for p in places])
    late = [rng.permutation(np.arange(LATE) % 4)] if stage == CUBE else []
    for target in (place, *late):
        q, out = poses(rng, scene, target)
        parts.append((target, q, out, np.full(len(target), -1)))
    return parts


def _tracked(rng: np.random.Generator, scene: Scene, count: int, notes: dict) -> list[tuple[np.ndarray, ...]]:
    """Return the same of poses that a tracker reads: to calibrate, no spheres, later poses."""
    target, q, out, repeat = _calibrate(rng, scene, np.array([INSTRUMENT]), count, notes)
    if notes["order"] == "face":  # once around: the first joint goes from one end to the other
        single = np.flatnonzero(repeat < 0)
        around = single[np.argsort(q[single, 0])]
        q[single], out[single] = q[around], out[around]
    late = np.full(int(rng.integers(40, 81)), INSTRUMENT)
    later = (late, *poses(rng, scene, late), np.full(len(late), -1))
    parts = [(target, q, out, repeat), tuple(np.empty_like(part[:0]) for part in later), later]
    return [(t, at + AT_REST * rng.standard_normal(at.shape), o, r) for t, at, o, r in parts]


def plan(rng: np.random.Generator, scene: Scene, wishes: dict, stage: str = CUBE) -> Session:
    """Draw a session.

    Parameters
    ----------
    rng : numpy.random.Generator
        Where chance comes from.
    scene : Scene
        What stands before the arm.
    wishes : dict
        Notes of the session that are not left to chance, for example ``payload``.
    stage : str
        What calibrates: the faces of the cube, spheres alone, or free poses that a tracker reads.
    """
    notes = {
        "order": str(rng.choice(["face", "random", "both"])),
        "repeat": str(rng.choice(["in place", "cycles", "cycles, spread"])),
        "spin_degps": float(rng.uniform(1.5, 3.0)) if rng.random() < 0.3 else 0.0,
        "reverse": float(rng.uniform(0.02, 0.06)) if rng.random() < 0.3 else 0.0,
        "speeds": float(rng.choice([1.0, 1.6, 2.5])),
        "payload": str(rng.choice(["none"] * 10 + ["half", "blocks"])),
        "pause_s": float(rng.uniform(1200, 4500)),
    } | wishes
    count = int(rng.integers(*COUNT[stage]))
    if stage == TRACKER:
        parts = _tracked(rng, scene, count, notes)
        notes.setdefault("velocity", bool(rng.random() < 0.6))
    else:
        parts = _probed(rng, scene, stage, count, notes)
    target, q, out, repeat = (np.concatenate([p[i] for p in parts]) for i in range(4))
    phase = np.repeat(np.arange(len(parts)), [len(p[0]) for p in parts])
    n = len(target)
    speed = rng.uniform(2e-3, 5e-3) * notes["speeds"] ** rng.uniform(-1, 1, n)
    for g in range(GROUPS):
        speed[repeat == g] = speed[repeat == g][0]
    straight, way = _ways(rng, q, out, speed, notes)
    for g in range(GROUPS):
        way[repeat == g] = way[repeat == g][0]
    step = rng.uniform(0.6, 1.4, n) * rng.uniform(1800, 5400) / count
    step[np.flatnonzero(np.diff(target * (phase == 1)) != 0) + 1] += 3.0
    new = np.flatnonzero(np.diff(np.where(phase == 1, (target - 4) // 3, -1)) != 0) + 1
    step[new] += 240.0
    step[np.flatnonzero(phase == 2)[:1]] += notes["pause_s"]
    time = np.round(np.cumsum(step), 2)
    payload = np.zeros(n)
    if notes["payload"] == "half":
        payload[(phase != 1) & (rng.random(n) < 0.5)] = 2.0
        for g in range(GROUPS):
            payload[repeat == g] = payload[repeat == g][0]
    elif notes["payload"] == "blocks":
        payload[(phase == 0) & (np.arange(n) >= count * rng.uniform(0.4, 0.6))] = 2.0
        for g in range(GROUPS):
            payload[repeat == g] = payload[repeat == g][0]
    idle = phase == 2
    warm = 1 - np.exp(-time / rng.uniform(900, 3000))
    warm[idle] *= rng.uniform(0.6, 0.9)
    room = rng.uniform(20, 23) + 0.3 * np.sin(2 * np.pi * time / rng.uniform(5000, 9000))
    temperature = room + rng.uniform(1, 5) * warm + 0.1 * rng.standard_normal(n)
    measured = bool(rng.random() < 0.85)
    return Session(
        phase, target, q, straight, way, speed, time, payload, repeat, temperature, measured, notes, stage,
        notes.get("velocity", True),
    )  # fmt: skip
