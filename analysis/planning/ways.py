"""Whether planned motions are as free as they are stated, by fine sampling (`sampled`) in random cells.

A cell is a robot with a probe, a box and spheres on stems at random places, of which some are placed one
after the other, and a seed. `python -m analysis.planning.ways CELLS` prints the collisions, and the cells
with a way that is nearer than stated, among all motions of all cells. `CELLS FIRST rail`: on rails.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

from analysis.planning.sampled import Cell, Table
from bayescal.arm.chain import Robot
from bayescal.arm.shapes import HalfSpace
from bayescal.arm.transforms import rigid, rotation
from bayescal.dataset import Dataset, Noise, Target, Tool
from bayescal.dataset.read import no_rows
from bayescal.errors import BayescalError
from bayescal.planning import order as orders
from bayescal.planning.candidates import candidates
from bayescal.planning.order import Transits
from bayescal.planning.pool import Setup
from bayescal.planning.setup import continued
from bayescal.probing.clearance import Clearance
from bayescal.probing.scene import held_by
from bayescal.robots import load_robot

ROBOTS = (
    "fanuc-lrmate200ic", "universal-robots-ur5e", "abb-irb120", "mecademic-meca500", "universal-robots-ur10",
    "yaskawa-ma1400", "franka-panda", "kuka-iiwa7", "staubli-tx90", "unimation-puma560", "fanuc-lrmate200id",
)  # fmt: skip
CANDIDATES, CONTACTS = 40, 10
ROUNDING = 2e-6
"""m: by which sampled clearances may be less than those stated: rounding, and the ends of the contacts."""


def on_rail(robot: Robot, travel: float) -> Robot:
    """The robot on a carriage that slides along y of its base by up to +-`travel`, m."""
    rows = {name: np.insert(getattr(robot, name), 0, 0.0) for name in ("alpha", "a", "d", "offset", "beta")}
    rows["alpha"][1 if robot.convention == "mdh" else 0] += np.pi / 2  # back from the axis of the rail
    coupling = np.eye(robot.n + 1)
    coupling[1:, 1:] = robot.link_from_reading
    return Robot(
        name=f"{robot.name} on a rail", convention=robot.convention, joint_names=("RAIL", *robot.joint_names),
        limits=np.insert(robot.limits, 0, (-travel, travel), axis=0), link_from_reading=coupling,
        base=robot.base @ rigid(rotation(0, -np.pi / 2)), flange=robot.flange,
        prismatic=np.arange(robot.n + 1) == 0, **rows,
    )  # fmt: skip


def setup_of(seed: int, rail: bool = False) -> Setup:
    """A random cell."""
    rng = np.random.default_rng(seed)
    robot = load_robot(ROBOTS[seed % len(ROBOTS)])[0]
    size = 0.4 * (np.sum(np.abs(robot.a)) + np.sum(np.abs(robot.d)))
    if rail:
        robot = on_rail(robot, 2.0 * size)
    angle = rng.uniform(-0.8, 0.8)
    middle = size * rng.uniform(0.85, 1.15) * np.array([np.cos(angle), np.sin(angle), 0])
    middle[2] = size * rng.uniform(0.0, 0.4)
    half = size * rng.uniform(0.1, 0.22, 3)
    turn = rng.uniform(-0.7, 0.7)
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    targets = []
    for k, axis in enumerate(axes):
        for sign in (1, -1):
            if (k, sign) != (2, -1):
                values = {"normal": sign * axis, "offset": float(sign * axis @ middle + half[k])}
                targets.append(Target(f"block.{'-+'[sign > 0]}{'xyz'[k]}", "plane", values))
    for k in range(4):
        away = (
            middle
            + axes[0] * rng.uniform(-1, 1) * half[0]
            + axes[1] * rng.choice([-1, 1]) * (half[1] + size * rng.uniform(0.15, 0.35))
        )
        away[2] = middle[2] + rng.uniform(-0.5, 1.2) * half[2]
        name = f"ball.{'AB'[k % 2]}@{1 + k // 2}"
        targets.append(Target(name, "sphere", {"centre": away, "diameter": 0.0508}))
    length = size * rng.uniform(0.15, 0.35)
    bent = rng.uniform(-0.5, 0.5) * length
    tools = [Tool("ball", np.array([bent, 0.0, length]), float(rng.choice([1e-3, 2e-3, 3e-3])))]
    if seed % 3 == 0:
        tools.append(Tool("other", np.array([0.0, bent, 0.8 * length]), 2e-3))
    dataset = Dataset(
        name=f"cell {seed}", folder=Path(), robot=robot, readings="encoder", gravity=np.array([0, 0, -9.81]),
        tools=tuple(tools), noise=Noise(contact=5e-6), targets=tuple(targets), certificates=(),
        measurements=no_rows(robot.n), robot_reference=robot.name,
    )  # fmt: skip
    return continued(dataset)


def cell_of(setup: Setup, tool: int, label: str) -> Cell:
    """The numbers of a cell, with the solids that are there with a placement; others are empty."""
    robot = setup.dataset.robot
    rows = np.stack([robot.alpha, robot.a, robot.d, robot.offset], axis=1)
    table = Table(rows, robot.convention, robot.link_from_reading, robot.base, robot.flange, robot.slides)
    around = setup.scene
    held = held_by(setup.dataset, tool)
    check = Clearance.of(robot, setup.dataset.tools[tool], around.solids, held=held)
    capsules = [(c.frame, c.a, c.b, c.radius, c.probe) for c in check.capsules]
    solids = []
    for solid in around.solids:
        own = []
        for shape in solid.shapes if solid.placement in ("", label) else ():
            if isinstance(shape, HalfSpace):
                own.append(("plane", shape.normal, shape.offset))
            elif hasattr(shape, "half"):
                own.append(("box", shape.pose[:3, :3], shape.pose[:3, 3], shape.half))
            elif hasattr(shape, "centre"):
                own.append(("segment", shape.centre, shape.centre, shape.radius))
            else:
                own.append(("segment", shape.a, shape.b, shape.radius))
        solids.append(own)
    return Cell(table, capsules, list(check.self_pairs), {(p.capsule, p.solid) for p in check.pairs}, solids)


def checked(seed: int, rail: bool = False) -> dict[str, float]:
    """Motions of a cell, their sampled clearance, and how much it is less than what is stated, m."""
    begin = time.process_time()
    setup = setup_of(seed, rail)
    try:
        pool = candidates(setup, CANDIDATES, seed)
    except BayescalError as error:
        return {"seed": seed, "refused": str(error)}
    rng = np.random.default_rng(seed)
    moves = Transits(pool)
    some = rng.permutation(pool.candidates)[:CONTACTS]
    rows = some[orders.ordered(pool, some, "sweeps", rng, moves.blocked)]
    ways = moves.ways(rows)
    planned = time.process_time() - begin
    return {"seed": seed, "planned_s": planned, **against(pool, rows, ways), "s": time.process_time() - begin}


def against(pool, rows, ways) -> dict[str, float]:
    """The motions to rows of a pool: how many, the nearest, and the largest overstatement of a clearance."""
    setup, m = pool.setup, pool.session.measurements
    around = setup.scene
    names = [t.name for t in pool.session.targets]
    label, cells = "", {}
    known = [n.partition("@")[2] for n in (names[t] for t in m.target[rows])]
    label = next((n for n in known if n), "")
    if len({*known, *(n.partition("@")[2] for n in names)} - {""}) < 2:
        known, label = [""] * len(known), ""
    tool = int(m.tool[rows[0]])
    least, over, motions, by_hand, at = np.inf, -np.inf, 0, 0, None
    for k, row in enumerate(rows):
        before = cells.setdefault((tool, label), cell_of(setup, tool, label))
        tool, label = int(m.tool[row]), known[k] or label
        cell = cells.setdefault((tool, label), cell_of(setup, tool, label))
        up, down = ways.leave[k], ways.via[k]
        found = []
        if up is None or down is None:
            by_hand += 1
        else:
            points = [] if at is None else [at]
            for point in up:
                found += [before.motion(p, point) for p in points[-1:]]
                points.append(point)
            for point in [*down, pool.approach[row]]:
                found += [cell.motion(p, point) for p in points[-1:]]
                points.append(point)
        at = pool.approach[row]
        touched = around.of.get(names[m.target[row]], -1)
        if not np.array_equal(at, m.readings[row]):
            centre = setup.dataset.tools[tool].centre
            found.append(cell.line(m.readings[row], at, centre, touched))
        motions += len(found)
        least = min([least, *found])
        stated = ways.clearance[k]
        if not np.isnan(stated):
            over = max([over, *(stated - d for d in found if d < stated)])
    return {"motions": motions, "by_hand": by_hand, "nearest_mm": 1e3 * least, "overstated_mm": 1e3 * over}


def main(count: int, first: int = 0, rail: bool = False) -> None:
    """Check cells, one line each, and the sum."""
    total = {"cells": 0, "refused": 0, "motions": 0, "by_hand": 0, "collisions": 0, "overstated": 0}
    for seed in range(first, first + count):
        found = checked(seed, rail)
        print(json.dumps(found), flush=True)
        if "refused" in found:
            total["refused"] += 1
            continue
        total["cells"] += 1
        for key in ("motions", "by_hand"):
            total[key] += found[key]
        total["collisions"] += found["nearest_mm"] < 0
        total["overstated"] += found["overstated_mm"] > 1e3 * ROUNDING
    print(json.dumps(total))


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:3]), rail=sys.argv[3:] == ["rail"])
