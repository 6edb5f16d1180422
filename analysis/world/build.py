"""Worlds to be diagnosed: an arm, a session, and something hidden, each from its seed and number alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from analysis.world import arm, joints, scene, session, tracker, write
from analysis.world.mix import FIRST_OF, GENERATORS, Maker, recipe, stage, wishes
from analysis.world.size import modest, sized
from analysis.world.touch import SOLVED, Act, World
from analysis.world.tracker import Tracked
from analysis.world.truth import told

NOISE = {session.CUBE: (5e-6, 10e-6), session.SPHERES: (5e-6, 10e-6), session.TRACKER: (10e-6, 30e-6)}
"""Standard deviation of a contact, or of a coordinate that the tracker reads, from and to (m)."""


def _outliers(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return what outliers add (m): in a third of worlds 1 to 3 %, of 30 µm to 1 mm."""
    out = np.zeros(count)
    if rng.random() < 1 / 3:
        hit = rng.random(count) < rng.uniform(0.01, 0.03)
        size = np.exp(rng.uniform(np.log(3e-5), np.log(1e-3), count))
        out[hit] = (size * rng.choice([-1, 1], count))[hit]
    return out


def _wild(rng: np.random.Generator, plan: session.Session) -> np.ndarray:
    """Return what outliers add to every row (m); of a point that a tracker reads, in any direction."""
    wild = _outliers(rng, len(plan.time))
    wild[plan.phase != 0] = 0.0
    if plan.stage != session.TRACKER:
        return wild
    way = rng.standard_normal((len(wild), 3))
    return (wild[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)).ravel()


@dataclasses.dataclass(frozen=True)
class Made:
    """A simulated test session: the true arm in it, the hidden effects and their sizes, files, truth."""

    world: World
    acts: list[tuple[Act, float]]
    texts: dict[str, str]
    truth: dict
    makers: list[tuple[Maker, dict]]  # of the effects, and the state of the generator before each
    noise: np.ndarray  # of every row, with outliers (m)
    sigma: float  # of the noise (m)


def build(
    seed: int, number: int, *, spared: bool = False, generator: int = GENERATORS[-1], reserved: bool = False
) -> tuple[dict[str, str], dict]:
    """Return the files of a simulated test session by name, and its ground truth; see `make`."""
    made = make(seed, number, spared=spared, generator=generator, reserved=reserved)
    return made.texts, made.truth


def make(
    seed: int,
    number: int,
    *,
    spared: bool = False,
    generator: int = GENERATORS[-1],
    reserved: bool = False,
    given: Sequence[Maker] = (),
) -> Made:
    """Make a simulated test session.

    Parameters
    ----------
    seed : int
        The same seed gives the same set of sessions.
    number : int
        Which of them; no world depends on another.
    spared : bool
        Leave what is hidden out: the same arm, session and noise, with nothing wrong.
    generator : int
        Version of the generator, one of `mix.GENERATORS`.
    reserved : bool
        Also draw the reserved causes not in the list of known effects.
    given : sequence of Maker
        What is hidden, instead of what `mix.recipe` draws.
    """
    rng = np.random.default_rng([seed, 0, number])
    kind, makers = ("given", list(given)) if given else recipe(seed, number, generator, reserved=reserved)
    only_geometry = any(FIRST_OF.get(maker, maker) is joints.compliance for maker in makers)
    body, things = arm.Arm(arm.draw(rng)), scene.draw(rng)
    what = stage(seed, number, generator, makers)
    plan = session.plan(rng, things, wishes(rng, makers, what), what)
    give = np.zeros(6) if only_geometry else body.shape.give
    world = World(body, things, plan, give)
    if what == session.TRACKER:
        world = Tracked(body, things, plan, give, tracker.draw(rng))
    n = len(plan.time)
    sigma = rng.uniform(*NOISE[what])
    stated = sigma * rng.uniform(0.75, 4 / 3)
    noise, wild = sigma * rng.standard_normal(len(plan.of_rows(plan.time))), _wild(rng, plan)
    world, quiet, model = modest(world, not only_geometry, sigma)
    found = [sized(rng, maker, world, model, quiet, sigma) for maker in makers]
    acts = [(act, size) for act, size, _ in found]
    hidden = () if spared else acts
    texts, worst = write.texts(rng, world, hidden, noise + wild, f"world-{number:03d}", stated)
    texts["baseline.txt"] = "geometry\n" if only_geometry else "geometry,compliance\n"
    truth = told(world, model, found, quiet, sigma, noise)
    truth = {"world": f"{number:03d}", "schema": write.SCHEMA, "kind": kind, "seed": seed} | truth
    truth["generator"] = generator
    truth |= {
        "baseline": texts["baseline.txt"].strip().split(","),
        "session": plan.notes | {"stage": plan.stage},
        "noise_um": 1e6 * sigma,
        "stated_noise_um": 1e6 * stated,
        "outliers": [f"c{k:04d}" for k in np.flatnonzero(wild.reshape(n, -1).any(axis=1))],
        "solver_gap_m": worst,
        "robot": dataclasses.asdict(world.arm.shape),
    }
    if worst > SOLVED:
        msg = f"world {number} of seed {seed}: {worst:g} m off the touch"
        raise RuntimeError(msg)
    if kind == "outside":
        truth["effects"], truth["outside"] = ["unknown"], found[0][0].name
    drawn = [(maker, note["state"]) for maker, (_, _, note) in zip(makers, found, strict=True)]
    return Made(world, acts, texts, truth, drawn, noise + wild, float(sigma))
