"""Worlds to be diagnosed: an arm, a session, and something hidden, each from its seed and number alone."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.world import arm, joints, scene, session, write
from bayescal.world.mix import recipe, wishes
from bayescal.world.size import modest, sized
from bayescal.world.touch import World
from bayescal.world.truth import told

SOLVED = 1e-8  # m


def _outliers(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return what outliers add (m): in a third of worlds 1 to 3 %, of 30 um to 1 mm."""
    out = np.zeros(count)
    if rng.random() < 1 / 3:
        hit = rng.random(count) < rng.uniform(0.01, 0.03)
        size = np.exp(rng.uniform(np.log(3e-5), np.log(1e-3), count))
        out[hit] = (size * rng.choice([-1, 1], count))[hit]
    return out


def build(seed: int, number: int, *, spared: bool = False) -> tuple[dict[str, str], dict]:
    """Return the files of a world by name, and its truth.

    Parameters
    ----------
    seed : int
        One seed, one set of worlds.
    number : int
        Which of them; no world depends on another.
    spared : bool
        Leave what is hidden out: the same arm, session and noise, with nothing wrong.
    """
    rng = np.random.default_rng([seed, 0, number])
    kind, makers = recipe(seed, number)
    only_geometry = joints.compliance in makers
    body, stage = arm.Arm(arm.draw(rng)), scene.draw(rng)
    plan = session.plan(rng, stage, wishes(rng, makers))
    world = World(body, stage, plan, np.zeros(6) if only_geometry else body.shape.give)
    n = len(plan.time)
    sigma = rng.uniform(5e-6, 10e-6)
    stated = sigma * rng.uniform(0.75, 4 / 3)
    noise, wild = sigma * rng.standard_normal(n), _outliers(rng, n)
    wild[plan.phase != 0] = 0.0
    world, quiet, model = modest(world, not only_geometry, sigma)
    found = [sized(rng, maker, world, model, quiet, sigma) for maker in makers]
    acts = [(act, size) for act, size, _ in found]
    readings, worst = world.touch(() if spared else acts, noise + wild)
    velocity = world.session.velocity + np.radians(0.002) * rng.standard_normal((n, 6))
    name = f"world-{number:03d}"
    texts = {
        "dataset.yaml": write.dataset_text(world, name, stated),
        "robot.yaml": write.robot_text(),
        "measurements.csv": write.measurements_text(world, readings, velocity),
        "baseline.txt": "geometry\n" if only_geometry else "geometry,compliance\n",
    }
    truth = told(world, model, found, quiet, sigma, noise)
    truth = {"world": f"{number:03d}", "schema": write.SCHEMA, "kind": kind, "seed": seed} | truth
    truth |= {
        "baseline": texts["baseline.txt"].strip().split(","),
        "session": plan.notes,
        "noise_um": 1e6 * sigma,
        "stated_noise_um": 1e6 * stated,
        "outliers": [f"c{k:04d}" for k in np.flatnonzero(wild)],
        "solver_gap_m": worst,
        "robot": dataclasses.asdict(world.arm.shape),
    }
    if worst > SOLVED:
        msg = f"world {number} of seed {seed}: {worst:g} m off the touch"
        raise RuntimeError(msg)
    if kind == "outside":
        truth["effects"], truth["outside"] = ["unknown"], found[0][0].name
    return texts, truth


def make(folder: str | Path, worlds: int, seed: int, first: int = 0) -> None:
    """Write worlds, one folder each, and their truth apart in `truth`.

    Parameters
    ----------
    folder : str or pathlib.Path
        Where to.
    worlds : int
        How many.
    seed : int
        One seed, one set of worlds.
    first : int
        Number of the first; world k of a seed is the same however many are made.
    """
    if worlds < 1 or first < 0 or seed < 0:
        raise BayescalError("a positive number of worlds, a seed and a first number from 0 on are needed")
    for number in range(first, first + worlds):
        texts, truth = build(seed, number)
        write.folder(Path(folder), f"{number:03d}", texts, truth)


def main() -> None:
    """Make worlds from the command line."""
    parser = argparse.ArgumentParser(prog="python -m bayescal.world.build", description=make.__doc__)
    parser.add_argument("--worlds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", default="worlds")
    args = parser.parse_args()
    make(args.out, args.worlds, args.seed, args.first)


if __name__ == "__main__":
    main()
