"""Where the ball is, and where it touches: elastic equilibrium by iteration, then the touch by iteration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from analysis.world.arm import BASE, GROWTH, HINGE, JOINT, LINK_FROM_READING, SIZE, Arm
from analysis.world.scene import Scene
from analysis.world.session import FURTHER, TIP, Session

PASSES = 4
CLOSE = 1e-11  # m
SOLVED = 1e-8  # m
"""A touch is refused above it. Few iterations end between these two: steps of a hidden effect are rough."""
USUAL = 15
"""Iterations; further ones end at `SOLVED`."""
FIRST = "first"
"""The form of an effect in generator 1; every other form has its own words."""


@dataclass
class Moved:
    """What effects move at every contact; all start at zero."""

    joint: np.ndarray  # link angles (n, 6)
    base: np.ndarray  # shifts and turns (n, 6)
    hinge: np.ndarray  # links 1 to 5, x and y (n, 5, 2)
    growth: np.ndarray  # links 1, 2 and 4 (n, 3)
    tip: np.ndarray  # the ball, in the flange's frame (n, 3)
    travel: np.ndarray  # from touch to trigger (n,)
    height: np.ndarray  # of the surface over its plane (n,)
    kilos: np.ndarray  # mass at the tool that was not stated (n,)
    aside: np.ndarray  # kg m, first moment about the tool's centre of mass, in the flange's frame (n, 3)
    lag: np.ndarray  # s, from trigger to reading (n,)

    @classmethod
    def nothing(cls, n: int) -> Moved:
        """Return zeros for n contacts."""
        shapes = [(n, 6), (n, 6), (n, 5, 2), (n, 3), (n, 3), (n,), (n,), (n,), (n, 3), (n,)]
        return cls(*(np.zeros(s) for s in shapes))


@dataclass
class Seen:
    """What an effect may look at, contact by contact, as of the last pass."""

    session: Session
    scene: Scene
    readings: np.ndarray
    link: np.ndarray
    load: np.ndarray  # gravity's moment on every coordinate
    ball: np.ndarray
    turn: np.ndarray
    normal: np.ndarray

    def first(self, values: np.ndarray) -> np.ndarray:
        """Return values of contacts (n, ...) without further rounds, which change no scale of the machine."""
        return values[self.session.phase < FURTHER]

    def on_face(self) -> np.ndarray:
        """Return places on the touched face, -1 to 1 from edge to edge (n, 2); 0 on balls."""
        face = np.minimum(self.session.target, 3)
        arm = self.ball - self.scene.point[face]
        uv = np.einsum("nij,nj->ni", self.scene.across[face], arm) / 0.1143
        return uv * (self.session.target < 4)[:, None]

    def push(self) -> np.ndarray:
        """Return the direction of approach in the flange's frame (n, 3)."""
        return -np.einsum("nji,nj->ni", self.turn, self.normal)


@dataclass
class Act:
    """One hidden effect: what it does at a size, and the words for it."""

    name: str
    where: list[dict]
    unit: str
    size: float
    cap: float
    move: Callable[[Seen, float, Moved], None]
    detail: dict = field(default_factory=dict)
    artefact: bool = False
    form: str = FIRST


@dataclass
class World:
    """The true arm before its scene, in a session."""

    arm: Arm
    scene: Scene
    session: Session
    give: np.ndarray

    def seen(
        self, readings: np.ndarray, acts: Sequence[tuple[Act, float]], passes: int = PASSES
    ) -> tuple[Seen, Moved]:
        """Return the equilibrium at given readings."""
        s, n = self.session, len(readings)
        at, moved = readings, Moved.nothing(n)
        coordinates = np.zeros((n, SIZE))
        coordinates[:, JOINT] = readings @ LINK_FROM_READING.T
        for _ in range(passes):
            link = at @ LINK_FROM_READING.T
            load = self.arm.weigh(coordinates)
            extra = s.payload + moved.kilos
            loaded = np.flatnonzero(extra)
            of_mass = self.arm.weigh(coordinates[loaded], 1.0) - load[loaded]
            load[loaded] += extra[loaded, None] * of_mass
            if np.any(moved.aside):
                load += self._leaning(coordinates, moved.aside)
            if acts:
                ball, turn = self.place(coordinates, moved)
                seen = Seen(s, self.scene, at, link, load, ball, turn, self.normals(ball))
                moved = Moved.nothing(n)
                for act, size in acts:
                    act.move(seen, size, moved)
            at = readings - s.velocity * moved.lag[:, None]
            coordinates[:, BASE] = moved.base
            coordinates[:, JOINT] = at @ LINK_FROM_READING.T + self.give * load[:, JOINT] + moved.joint
            coordinates[:, HINGE] = moved.hinge
            coordinates[:, GROWTH] = moved.growth
        ball, turn = self.place(coordinates, moved)
        return Seen(s, self.scene, at, at @ LINK_FROM_READING.T, load, ball, turn, self.normals(ball)), moved

    def _leaning(self, coordinates: np.ndarray, aside: np.ndarray) -> np.ndarray:
        """Return the gravity torque (n, coordinates) of a first moment (n, 3): it is linear in it."""
        at_tool, out = self.arm.weigh(coordinates, 1.0), np.zeros((len(coordinates), SIZE))
        for axis, metre in enumerate(np.eye(3)):
            if np.any(aside[:, axis]):
                out += aside[:, axis, None] * (self.arm.weigh(coordinates, 1.0, tuple(metre)) - at_tool)
        return out

    def place(self, coordinates: np.ndarray, moved: Moved) -> tuple[np.ndarray, np.ndarray]:
        """Return the ball's centre (n, 3) and the flange's turn (n, 3, 3)."""
        origin, turn = self.arm.place(coordinates)
        return origin + np.einsum("nij,nj->ni", turn, self.arm.shape.tool + moved.tip), turn

    def normals(self, ball: np.ndarray) -> np.ndarray:
        """Return outward normals (n, 3) of what is touched, at the ball."""
        t, out = self.session.target, np.empty_like(ball)
        out[t < 4] = self.scene.normal[t[t < 4]]
        away = ball[t >= 4] - self.scene.ball[t[t >= 4] - 4]
        out[t >= 4] = away / np.linalg.norm(away, axis=1, keepdims=True)
        return out

    def shown(self, move: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Return what rows (n,) show of displacements of the ball (n, 3)."""
        return np.sum(normal * move, axis=1)

    def clearance(self, ball: np.ndarray) -> np.ndarray:
        """Return how far (n,) the probe's ball is off surfaces without form."""
        t, out = self.session.target, np.empty(len(ball))
        f, k = t < 4, t >= 4
        out[f] = np.sum(self.scene.normal[t[f]] * (ball[f] - self.scene.point[t[f]]), axis=1) - TIP
        c = t[k] - 4
        out[k] = np.linalg.norm(ball[k] - self.scene.ball[c], axis=1) - self.scene.radius[c] - TIP
        return out

    def gap(self, readings: np.ndarray, acts: Sequence[tuple[Act, float]] = ()) -> np.ndarray:
        """Return what is missing (n,) until the probe triggers."""
        seen, moved = self.seen(readings, acts)
        return self.clearance(seen.ball) + moved.travel - moved.height

    def touch(
        self, acts: Sequence[tuple[Act, float]], noise: np.ndarray, *, straight: bool = False
    ) -> tuple[np.ndarray, float]:
        """Move on from the start until the probe triggers; return readings and the largest gap left.

        Parameters
        ----------
        acts : sequence of (Act, float)
            What is hidden, and its sizes.
        noise : numpy.ndarray
            How far off the surface the probe triggers (n,).
        straight : bool
            Straight to the surface, from a start that is still far; else along the approach.
        """
        s = self.session
        way = s.straight if straight else s.way
        along, slope, last = np.zeros(len(noise)), np.ones(len(noise)), None
        for turn in range(4 * USUAL):
            left = self.gap(s.start + way * along[:, None], acts) - noise
            if np.max(np.abs(left)) < (CLOSE if turn < USUAL else SOLVED):
                break
            if last is not None:
                step, fell = along - last[0], last[1] - left
                sure = np.abs(step) > 1e-7
                slope[sure] = np.clip(fell[sure] / step[sure], 0.6, 2.5)
            last = (along, left)
            along = along + left / slope
        readings = s.start + way * along[:, None]
        return readings, float(np.max(np.abs(self.gap(readings, acts) - noise)))
