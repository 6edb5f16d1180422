"""`python -m analysis.fleet_study`: what a fleet of simulated arms of one model shows, and saves the next arm.

The arms are made by `analysis.world`, which shares no code with the model. Their deviations from nominal have
a common part (all of the stated priors' size) and an individual one (`SPREAD` of it). Three have backlash at
one joint, one has a joint zero far from the others, one changes a joint zero between two sessions.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from analysis.world import arm, joints, scene, session, write
from analysis.world.size import modest
from analysis.world.touch import SOLVED, Act, World

ARMS, SPREAD = 12, 0.3
SHARING, JOINT, PLAY = (1, 4, 8), 4, 2.5e-4
"""Arms with backlash, its joint, and its half-width, rad."""
OUTLIER, ZERO, FAR = 6, 3, 5e-3
"""The arm that differs, the joint, and by how much its zero does, rad: 8 times the spread of the others."""
DRIFTED, MOVED, BY = 10, 5, 4e-4
"""The arm that changes, the joint, and the change of its zero, rad."""
NOISE = 7e-6
GEOMETRY = ("a", "alpha", "d", "zero", "beta3", "mass", "com")


def shapes(seed: int, count: int = ARMS, spread: float = SPREAD) -> list[arm.Shape]:
    """Arms with a common deviation from nominal and individual ones; each with its tool."""
    rng = np.random.default_rng([seed, 0])
    nominal, common = arm.nominal(), arm.draw(rng)
    out = []
    for _ in range(count):
        own = arm.draw(rng)
        values = {
            key: getattr(common, key) + spread * (getattr(own, key) - getattr(nominal, key))
            for key in GEOMETRY
        }
        give = common.give * np.exp(0.5 * spread * rng.standard_normal(6))
        out.append(replace(own, **values, give=give, hinge_at=common.hinge_at))
    return out


def probed(
    seed: int, shape: arm.Shape, name: str, *, serial: str, date: str, play: float = 0.0
) -> tuple[dict[str, str], World]:
    """The files of a session on the cube, with validation on spheres, and the world that was probed."""
    rng = np.random.default_rng([seed, 1])
    things = scene.draw(rng)
    plan = session.plan(rng, things, {"reverse": 0.05, "payload": "none", "velocity": True})
    world, _, _ = modest(World(arm.Arm(shape), things, plan, shape.give), True, NOISE)
    acts = [(_backlash(rng, world), play)] if play else []
    readings, worst = world.touch(acts, NOISE * rng.standard_normal(len(plan.time)))
    if worst > SOLVED:
        msg = f"{name}: {worst:g} m off the touch"
        raise RuntimeError(msg)
    velocity = plan.velocity + np.radians(0.002) * rng.standard_normal((len(readings), 6))
    record = f"record: {{date: {date}, serials: {{arm: {serial}}}}}\n"
    return {
        "dataset.yaml": write.dataset_text(world, name, NOISE) + record,
        "robot.yaml": write.robot_text(),
        "measurements.csv": write.measurements_text(world.session, readings, velocity, None),
    }, world


def _backlash(rng: np.random.Generator, world: World) -> Act:
    while True:
        act = joints.backlash(rng, world)
        if act.detail["joint"] == JOINT and not act.detail["link_side"]:
            return act


def subset(texts: dict[str, str], calibrate: int, seed: int, validate: int | None = None) -> dict[str, str]:
    """The session with fewer rows of each role, in their order."""
    head, *rows = texts["measurements.csv"].splitlines()
    rng = np.random.default_rng([seed, 2])
    kept: set[str] = set()
    for role, count in (("calibrate", calibrate), ("validate", validate)):
        own = [row for row in rows if row.split(",")[1] == role]
        some = range(len(own)) if count is None else rng.choice(len(own), count, replace=False)
        kept |= {own[k] for k in some}
    return texts | {"measurements.csv": "\n".join([head, *(row for row in rows if row in kept), ""])}


def put(folder: Path, texts: dict[str, str]) -> Path:
    """Write a session."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def made(folder: Path, seed: int, count: int = ARMS, calibrate: int | None = None) -> list[Path]:
    """Write the sessions of a fleet, and truth.json beside them; those that are there are kept."""
    every = shapes(seed, count)
    out, truth = [], {}
    for k, shape in enumerate(every):
        zero = shape.zero.copy()
        zero[ZERO - 1] += FAR * (k == OUTLIER)
        for part in range(1 + (k == DRIFTED)):
            zero = zero.copy()
            zero[MOVED - 1] += BY * part
            name = f"arm-{k:02d}{'ab'[part] if k == DRIFTED else ''}"
            path = folder / name
            out.append(path)
            truth[name] = {
                "zero_rad": zero.tolist(),
                "a_m": shape.a.tolist(),
                "alpha_rad": shape.alpha.tolist(),
            }
            if (path / "measurements.csv").exists():
                continue
            texts, _ = probed(
                1000 * seed + 10 * k + part, replace(shape, zero=zero), name,
                serial=f"SN-{k:02d}", date=f"2026-0{3 + part}-01", play=PLAY if k in SHARING else 0.0,
            )  # fmt: skip
            put(path, texts if calibrate is None else subset(texts, calibrate, k, 60))
    (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    return out
